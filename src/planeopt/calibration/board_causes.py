"""Which change of a rig explains what new views of a board say against it."""

from collections.abc import Sequence
from dataclasses import dataclass

import scipy.stats

from planeopt.calibration.board_basis import Basis
from planeopt.calibration.rig_evidence import Explained, RigEvidence
from planeopt.estimation.misfits import LEVEL

GROUPS = {
    "the focal length": ("f", "fx", "fy"),
    "the principal point": ("cx", "cy"),
    "the lens's distortion": ("k1", "k2", "p1", "p2", "k3"),
    "the beam's offset": ("e_x", "e_y"),
    "the beam's radius": ("radius",),
    "the beam's direction": ("direction_x", "direction_y"),
    "the board's bow": ("warp_x", "warp_y"),
}
"""What may have moved, each a cause of its own."""

_MOST_CAUSES = 3


@dataclass(frozen=True)
class Moved:
    """A group of parameters that a change alone of which explains what is wrong, or the most of it.

    Attributes
    ----------
    group : str
    chi2, dof : float, int
        What it explains.
    p_value : float
        How often a right rig pulls this group as hard.
    changes : tuple of (name, unit, value, sigma)
        The change, were it the only one.
    """

    group: str
    chi2: float
    dof: int
    p_value: float
    changes: tuple[tuple[str, str, float, float], ...]


def p_value_of(chi2: float, dof: float, dof_noise: float) -> float:
    """Of chi-squared over a noise that was estimated: F; a little too large where the calibration's share is large."""
    return float(scipy.stats.f.sf(chi2 / dof, dof, max(dof_noise, 1.0)))


def groups_alone(evidence: RigEvidence, basis: Basis, dof_noise: float) -> tuple[Moved, ...]:
    """Each group as if it alone had moved."""
    found = []
    for group, members in GROUPS.items():
        rows = _rows_of(basis, members)
        if rows:
            found.append(_moved(group, rows, rows, evidence.explained_by(rows), evidence, basis, dof_noise))
    return tuple(found)


def _moved(
    group: str,
    rows: Sequence[int],
    together: Sequence[int],
    explained: Explained,
    evidence: RigEvidence,
    basis: Basis,
    dof_noise: float,
) -> Moved:
    """One group of those whose change together explains something: what it adds to the others."""
    others = [row for row in together if row not in rows]
    without = evidence.explained_by(others) if others else None
    chi2 = explained.chi2 - (0.0 if without is None else without.chi2)
    dof = explained.dof - (0 if without is None else without.dof)
    places = [list(together).index(row) for row in rows]
    changes = tuple(
        (basis.names[row], unit_of(basis.names[row]), float(explained.change[at]), float(explained.sigma[at]))
        for row, at in zip(rows, places, strict=True)
    )
    p_value = p_value_of(max(chi2, 0.0), dof, dof_noise) if dof > 0 else 1.0
    return Moved(group, float(max(chi2, 0.0)), dof, p_value, changes)


def causes_of(evidence: RigEvidence, basis: Basis, dof_noise: float) -> tuple[Moved, ...]:
    """Return the fewest groups, three at most, whose change leaves what chance explains; each beside the others."""
    total, dof = evidence.test()
    left = {group: rows for group, members in GROUPS.items() if (rows := _rows_of(basis, members))}
    chosen: dict[str, list[int]] = {}
    for _ in range(min(_MOST_CAUSES, len(left))):
        best: tuple[float, float, str] | None = None
        for group, rows in left.items():
            explained = evidence.explained_by([row for known in (*chosen.values(), rows) for row in known])
            remains = max(total - explained.chi2, 0.0)
            # Where all leave what is impossible, probabilities are out of range: chi-squared decides.
            rank = p_value_of(remains, max(dof - explained.dof, 1), dof_noise), -remains, group
            best = rank if best is None or rank > best else best
        if best is None:
            break
        chosen[best[2]] = left.pop(best[2])
        if best[0] >= LEVEL:
            break
    everything = [row for rows in chosen.values() for row in rows]
    explained = evidence.explained_by(everything)
    return tuple(
        _moved(group, rows, everything, explained, evidence, basis, dof_noise) for group, rows in chosen.items()
    )


def instead_of(
    evidence: RigEvidence, causes: tuple[Moved, ...], groups: tuple[Moved, ...], dof_noise: float
) -> tuple[str, ...]:
    """Return the other groups whose change alone leaves what chance explains, where one cause does."""
    if len(causes) != 1:
        return ()
    total, dof = evidence.test()
    return tuple(
        moved.group
        for moved in groups
        if moved.group != causes[0].group
        and p_value_of(max(total - moved.chi2, 0.0), max(dof - moved.dof, 1), dof_noise) >= LEVEL
    )


def _rows_of(basis: Basis, members: Sequence[str]) -> list[int]:
    return [row for row, name in enumerate(basis.names) if name in members]


def unit_of(name: str) -> str:
    """Return the unit of a parameter: px, mm or 1."""
    if name in ("f", "fx", "fy", "cx", "cy"):
        return "px"
    return "mm" if name in ("warp_x", "warp_y", "e_x", "e_y", "radius") else "1"
