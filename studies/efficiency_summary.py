"""What the efficiency study says, made from its cells."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from studies.efficiency_cells import CellRow
from studies.statistics import LEVEL

EFFICIENT = 1.03
"""Pooled RMS error over the bound that is asked for where the bound can be reached."""


@dataclass(frozen=True)
class VerdictRow:
    """What the criterion makes of the cells, and what they are.

    Attributes
    ----------
    criterion : str
        "within" or "beyond".
    cells, draws, lost : int
    pooled_over_bound : float
        RMS over all draws of these cells.
    median_over_bound, worst_over_bound : float
        Of the cells.
    above : int
        Cells whose RMS is above `EFFICIENT` by more than chance, family-wise over all cells.
    below : int
        Cells whose RMS is below the bound by more than chance.
    isotropic_worst : float
        Worst cell where noise moves the points in all directions.
    least_covered_95 : float
        Worst cell's coverage by the 95 % ellipsoid.
    noticed : float
        Mean share of the draws that were flagged.
    """

    criterion: str
    cells: int
    draws: int
    lost: int
    pooled_over_bound: float
    median_over_bound: float
    worst_over_bound: float
    above: int
    below: int
    isotropic_worst: float
    least_covered_95: float
    noticed: float


def limits(rows: Sequence[CellRow], level: float = LEVEL) -> tuple[list[float], list[float]]:
    """Least and largest RMS over the bound that chance leaves each cell, if its own is 1 and `EFFICIENT`."""
    tail, freedom = level / 2 / max(len(rows), 1), [3 * (row.draws - row.lost) for row in rows]
    least = [float(np.sqrt(scipy.stats.chi2.ppf(tail, n) / n)) for n in freedom]
    most = [float(EFFICIENT * np.sqrt(scipy.stats.chi2.isf(tail, n) / n)) for n in freedom]
    return least, most


def verdicts(rows: Sequence[CellRow]) -> list[VerdictRow]:
    """Sum up the cells within the criterion, and those beyond it."""
    parts = {"within": [row for row in rows if row.excess <= 1], "beyond": [row for row in rows if row.excess > 1]}
    return [_verdict(name, part, len(rows)) for name, part in parts.items() if part]


def _verdict(name: str, rows: Sequence[CellRow], tests: int) -> VerdictRow:
    least, most = limits(rows, LEVEL * len(rows) / tests)
    over = np.array([row.over_bound for row in rows])
    solved = np.array([row.draws - row.lost for row in rows])
    return VerdictRow(
        criterion=name,
        cells=len(rows),
        draws=sum(row.draws for row in rows),
        lost=sum(row.lost for row in rows),
        pooled_over_bound=float(np.sqrt(np.sum(solved * over**2) / np.sum(solved))),
        median_over_bound=float(np.median(over)),
        worst_over_bound=float(np.max(over)),
        above=int(np.sum(over > most)),
        below=int(np.sum(over < least)),
        isotropic_worst=max(row.isotropic_over_bound for row in rows),
        least_covered_95=min(row.covered_95 for row in rows),
        noticed=float(np.mean([row.noticed for row in rows])),
    )


def numbers(found: Sequence[VerdictRow]) -> dict[str, float]:
    """Return the headline's numbers: from `verdicts.csv`, its rows within and beyond the criterion."""
    within = found[0]
    said: dict[str, float] = {
        "cells_within": within.cells,
        "over_bound_within": within.pooled_over_bound,
        "worst_over_bound_within": within.worst_over_bound,
        "cells_above_within": within.above,
        "asked_over_bound": EFFICIENT,
    }
    for beyond in found[1:]:
        said |= {
            "cells_above_beyond": beyond.above,
            "cells_beyond": beyond.cells,
            "worst_over_bound_beyond": beyond.worst_over_bound,
        }
    return said


def headline(n: Mapping[str, float]) -> str:
    """Say it in a sentence."""
    said = (
        f"Where the criterion says that the Cramér-Rao bound can be reached ({n['cells_within']:.0f} cells), the error "
        f"of maximum likelihood over the bound is {n['over_bound_within']:.4f} over all draws, "
        f"{n['worst_over_bound_within']:.3f} in the worst cell, and {n['cells_above_within']:.0f} cells are above "
        f"{n['asked_over_bound']:g} by more than chance"
    )
    if "cells_beyond" not in n:
        return f"{said}."
    return (
        f"{said}; beyond it {n['cells_above_beyond']:.0f} of {n['cells_beyond']:.0f} cells are, the worst at "
        f"{n['worst_over_bound_beyond']:.1f}."
    )


def finding(rows: Sequence[CellRow], found: Sequence[VerdictRow]) -> str:
    """Say what was found; every number comes from the tables."""
    lines = [
        "# Maximum likelihood at the Cramér-Rao bound",
        "",
        f"**In short.** {headline(numbers(found))}",
        "",
        "| criterion | cells | draws | without a plane | over the bound: all draws | median cell | worst cell | "
        f"above {EFFICIENT} | below the bound | isotropic noise, worst | least coverage of 95 % | flagged |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {v.criterion} | {v.cells} | {v.draws} | {v.lost} | {v.pooled_over_bound:.4f} | "
            f"{v.median_over_bound:.3f} | {v.worst_over_bound:.3f} | {v.above} | {v.below} | {v.isotropic_worst:.3f} | "
            f"{v.least_covered_95:.3f} | {v.noticed:.3f} |"
            for v in found
        ),
        "",
        f"Above and below count cells beyond two-sided limits of chi-squared with 3 degrees of freedom a draw, at a "
        f"family-wise level of {LEVEL} over all {len(rows)} cells.",
    ]
    bad = sorted((row for row, beyond in zip(rows, _above(rows), strict=True) if beyond), key=lambda row: row.excess)
    if bad:
        lines += ["", _of_the_bad(rows, bad)]
    return "\n".join(lines)


def _above(rows: Sequence[CellRow]) -> list[bool]:
    return [row.over_bound > most for row, most in zip(rows, limits(rows)[1], strict=True)]


def _of_the_bad(rows: Sequence[CellRow], bad: Sequence[CellRow]) -> str:
    marked = sum(row.excess > 1 for row in bad)
    first = bad[0].excess
    needless = sum(1 < row.excess < first for row in rows)
    among = [row for row in rows if row.excess >= first]
    missed = max(1 - row.covered_95 for row in bad)
    early = f", {needless} cells between 1 and {first:.2g} times are marked and not above," if first > 1 else ""
    return (
        f"**The criterion.** It marks {marked} of the {len(bad)} cells whose error is above {EFFICIENT} times the "
        f"bound by more than chance. The first of them is at {first:.2g} times its limits{early} and of the "
        f"{len(among)} cells from there on {len(bad)} are above. In the worst of them intervals of 95 % miss "
        f"{missed:.0%} of the time."
    )
