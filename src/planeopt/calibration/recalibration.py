"""Field recalibration: what images of unknown planes say of the rig, added to what its calibration said.

Each image leaves two numbers that no plane can change, ``t_i(eta)``, white of unit variance at the true rig
(docs/model.md, section 8). The most probable rig minimises

    sum_i |t_i(eta)|^2 + (eta - eta_0)' Sigma'^-1 (eta - eta_0)

over *all* of the rig's free parameters. ``Sigma'`` is the covariance of the calibration, with the move that the beam
may have made since then added to that of e_x, e_y, direction_x and direction_y. The t_i are solved again at every step,
so that the minimum is that of the curved functions. What they see are four numbers, the beam's vanishing point and its
offset over its radius; whatever of the rig does not depend on these stays where it was, as uncertain as it was, and
what does moves along with them as ``Sigma'`` says.

The value at the minimum is chi-squared with two degrees of freedom an image where the rig did not move while the images
were taken; it falls into the parts that `planeopt.estimation.drift` has. A trend, or misfits that no rig explains, are
reasons to refuse the update.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from planeopt.calibration.plane_evidence import MostProbable, most_probable, rig_prior
from planeopt.errors import InputError
from planeopt.estimation import solve_batch
from planeopt.estimation.drift import Drift, drift
from planeopt.estimation.misfits import LEVEL, SEEN_NUMBERS, Misfits, Part, PartTest, seen, seen_by
from planeopt.estimation.rig_part import SEEN
from planeopt.estimation.second_order import image_bends
from planeopt.rig import PARAMETERS, Rig, RigCovariance
from planeopt.spot import Spot

Array = NDArray[np.float64]

FEWEST = 5
"""Images from which something is left over, after a shift and a trend of four numbers each, to tell a bad one by."""

KEPT = (
    "Not updated: the focal length, the lens's distortion, the scale (radius and offset together) and the principal "
    "point apart from the beam's direction. They stay as calibrated; if they may have changed, calibrate with a board."
)
"""What no image of a plane can update."""

# Largest share of the variance allowed for a move that may be left of one of the four numbers: half of its sigma.
_FIXED = 0.25


class Outcome(Enum):
    """How an update ended; the value is the sentence a user reads."""

    UPDATED = "The rig is updated."
    TOO_FEW = "Too few images can be used."
    NOT_FIXED = "The images do not fix the four numbers of the beam: take some at other distances and tilts."
    NOT_CONVERGED = "No rig near the file's explains the images."
    TOO_FAR = "The beam has moved farther than was allowed for: allow for more, or calibrate with a board."
    MOVING = "The beam moved while the images were taken: take them again once it is fastened."
    DISAGREE = "The images contradict each other: no one rig explains them all."

    @property
    def ok(self) -> bool:
        return self is Outcome.UPDATED


@dataclass(frozen=True)
class Moves:
    """How far the beam may have moved since the calibration: standard deviations of each component.

    Parameters
    ----------
    offset_mm : float
    direction_rad : float
        Both 0: the beam has not moved, and the images only add to the calibration.

    Raises
    ------
    InputError
        If one is negative or not finite.
    """

    offset_mm: float = 1.0
    direction_rad: float = 0.01

    def __post_init__(self) -> None:
        for name, value in (("offset", self.offset_mm), ("direction", self.direction_rad)):
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"how far the beam's {name} may have moved must be a number from 0, not {value}")

    @property
    def none(self) -> bool:
        return self.offset_mm == self.direction_rad == 0

    @property
    def variances(self) -> dict[str, float]:
        """Of those of `SEEN` that may have moved."""
        sigmas = dict(zip(SEEN, (self.offset_mm, self.offset_mm, self.direction_rad, self.direction_rad), strict=True))
        return {name: sigma**2 for name, sigma in sigmas.items() if sigma > 0}


@dataclass(frozen=True)
class Updated:
    """One number before and after.

    `sigmas` is the change in standard deviations of the change that an unmoved rig would give.
    """

    name: str
    unit: str
    before: float
    sigma_before: float
    after: float
    sigma_after: float
    sigmas: float

    @property
    def change(self) -> float:
        return self.after - self.before


@dataclass(frozen=True, eq=False)
class Recalibration:
    """An update, or why there is none.

    Attributes
    ----------
    outcome : Outcome
    message : str
        What was found, in words.
    rig : Rig
        With the covariance after the update; the old one where the outcome is not ok.
    old : Rig
    moves : Moves
    before : Drift
        The images against the old rig.
    tests : tuple of PartTest
        The images against each other and what was allowed for; empty where nothing could be tested.
    chi2 : float or None
        Of the images' own misfits at the new rig, without the calibration's share.
    parameters, seen : tuple of Updated
        Free parameters of the rig; the four numbers that images see.
    images : tuple of int
        Which were used, counted from 0.
    image_chi2 : (n,)
        Of the used images' own misfits at the new rig.
    left_out : tuple of (int, str)
        Which could not be, and why.
    worst : tuple of int
        Images that the new rig does not explain, worst first.
    steps : int
    kept : str
        What cannot be updated.
    """

    outcome: Outcome
    message: str
    rig: Rig
    old: Rig
    moves: Moves
    before: Drift
    tests: tuple[PartTest, ...] = ()
    chi2: float | None = None
    parameters: tuple[Updated, ...] = ()
    seen: tuple[Updated, ...] = ()
    images: tuple[int, ...] = ()
    image_chi2: Array | None = None
    left_out: tuple[tuple[int, str], ...] = ()
    worst: tuple[int, ...] = ()
    steps: int = 0
    kept: str = KEPT

    @property
    def ok(self) -> bool:
        return self.outcome.ok


def recalibrate(
    spots: Sequence[Spot], rig: Rig, *, positions: ArrayLike | None = None, moves: Moves | None = None
) -> Recalibration:
    """Update a rig by images of whatever planes.

    Parameters
    ----------
    spots : sequence of Spot
        Boundary points in raw pixels.
    rig : Rig
        With a covariance: it says how well camera and radius are known, which no image of a plane does.
    positions : (n,), optional
        When, or where in a sequence, each image was taken. Their order unless given.
    moves : Moves, optional
        How far the beam may have moved; 1 mm and 10 mrad unless given.

    Returns
    -------
    Recalibration

    Raises
    ------
    InputError
        If the rig has no beam or no covariance, or the positions are not one finite number for each spot.
    """
    allowed = Moves() if moves is None else moves
    if rig.covariance is None:
        raise InputError(
            "the rig has no covariance: an update has to know how well the camera and the beam's radius are known. "
            "Calibrate with a board, or state the standard deviations of f, cx, cy and radius (--sigma)"
        )
    along = np.arange(len(spots), dtype=float) if positions is None else np.asarray(positions, dtype=float)
    if along.shape != (len(spots),) or not np.isfinite(along).all():
        raise InputError(f"positions must be {len(spots)} finite numbers, one for each image")
    first = solve_batch(spots, rig)
    before = drift(first, rig, positions=along)
    refusal = Recalibration(
        Outcome.TOO_FEW, "", rig, rig, allowed, before, images=before.images, left_out=before.left_out
    )
    if len(before.images) < FEWEST:
        return _refused(refusal, f"{len(before.images)} of {len(spots)}, and {FEWEST} are needed.{_first_left(before)}")
    prior = rig_prior(rig, allowed.variances)
    found = most_probable([spots[index] for index in before.images], prior)
    if found is None:
        return _refused(replace(refusal, outcome=Outcome.NOT_CONVERGED), before.verdict)
    return _judged(refusal, found, along[list(before.images)])


def with_stated_sigmas(rig: Rig, sigmas: Mapping[str, float]) -> Rig:
    """Return a rig with independent standard deviations, for one that has no covariance.

    Parameters
    ----------
    rig : Rig
    sigmas : mapping of str to float
        Of free parameters, px, mm and 1.

    Raises
    ------
    InputError
        If the rig has a covariance already, or a name or value is impossible.
    """
    if rig.covariance is not None:
        raise InputError("the rig has a covariance: standard deviations are stated only for a rig that has none")
    names = tuple(name for name in PARAMETERS if name in sigmas)
    unknown = next((name for name in sigmas if name not in PARAMETERS), None)
    if unknown is not None:
        raise InputError(f"{unknown!r} is not a parameter of a rig; known are {', '.join(PARAMETERS)}")
    wrong = next((name for name in names if not (np.isfinite(sigmas[name]) and sigmas[name] > 0)), None)
    if wrong is not None:
        raise InputError(f"the standard deviation of {wrong} must be a positive number, not {sigmas[wrong]}")
    return replace(rig, covariance=RigCovariance(names, np.diag([sigmas[name] ** 2 for name in names])))


def _judged(refusal: Recalibration, found: MostProbable, along: Array) -> Recalibration:
    """Test the images against each other at the updated rig, and say what changed."""
    prior, linear = found.prior, found.linear
    moved = found.values - prior.values
    # What the misfits at the old rig would be if they were straight, seen from the new one.
    straight = linear.misfit - linear.by_rig @ moved
    own = np.sqrt(1 + image_bends(linear.by_rig, found.covariance, linear.fine) ** 2)
    tests = Misfits.of(straight, linear.by_beam, linear.by_rig, prior.allowed, along, own).tests()
    each = np.sum(linear.misfit.reshape(-1, 2) ** 2, axis=1) / own**2
    limit = -2 * np.log(LEVEL / len(each))
    worst = tuple(refusal.images[row] for row in np.argsort(-each) if each[row] > limit)
    rig = replace(prior.at(found.values), covariance=RigCovariance(prior.names, found.covariance))
    result = replace(
        refusal,
        tests=tests,
        chi2=float(each.sum()),
        image_chi2=each,
        worst=worst,
        steps=found.steps,
        parameters=_parameters(found),
        seen=_seen(found, rig),
    )
    outcome = _outcome(found, tests, rig, refusal.moves)
    if not outcome.ok:
        return _refused(replace(result, outcome=outcome), _reasons(outcome, tests, worst))
    return replace(result, outcome=outcome, rig=rig, message=_message(replace(result, rig=rig)))


def _outcome(found: MostProbable, tests: tuple[PartTest, ...], rig: Rig, moves: Moves) -> Outcome:
    failed = {test.part for test in tests if not test.ok}
    if Part.TREND in failed:
        return Outcome.MOVING
    if Part.REST in failed:
        return Outcome.DISAGREE
    if Part.SHIFT in failed:
        return Outcome.TOO_FAR
    if failed:
        return Outcome.DISAGREE
    if not found.converged:
        return Outcome.NOT_CONVERGED
    if not moves.none:
        by_free = seen_by(rig, found.prior.names)
        allowed, left = (by_free @ covariance @ by_free.T for covariance in (found.prior.allowed, found.covariance))
        if scipy.linalg.eigh(left, allowed, eigvals_only=True)[-1] > _FIXED:
            return Outcome.NOT_FIXED
    return Outcome.UPDATED


_UNITS = {"f": "px", "fx": "px", "fy": "px", "cx": "px", "cy": "px", "e_x": "mm", "e_y": "mm", "radius": "mm"}


def _parameters(found: MostProbable) -> tuple[Updated, ...]:
    labels = [(name, _UNITS.get(name, "1")) for name in found.prior.names]
    return _updated(labels, found.prior.values, found.values, found, np.eye(len(labels)))


def _seen(found: MostProbable, rig: Rig) -> tuple[Updated, ...]:
    return _updated(SEEN_NUMBERS, seen(found.prior.rig), seen(rig), found, seen_by(rig, found.prior.names))


def _updated(
    labels: Sequence[tuple[str, str]], before: Array, after: Array, found: MostProbable, by_free: Array
) -> tuple[Updated, ...]:
    """Rows of numbers whose derivative by what is free is (n, k)."""
    # Where the rig is as calibrated the change is that of a gain K: K (I + G Sigma G') K'.
    gain = found.covariance @ found.linear.by_rig.T
    moved = gain @ found.linear.by_rig
    expected = gain @ gain.T + moved @ found.prior.calibrated @ moved.T
    old, new, usual = (
        np.sqrt(np.einsum("ij,jk,ik->i", by_free, covariance, by_free))
        for covariance in (found.prior.calibrated, found.covariance, expected)
    )
    columns = (before, old, after, new, (after - before) / np.maximum(usual, np.finfo(np.float64).tiny))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return tuple(Updated(name, unit, *row) for (name, unit), row in zip(labels, rows, strict=True))


def _refused(result: Recalibration, why: str) -> Recalibration:
    return replace(result, message=f"REFUSED: {result.outcome.value} {why}".rstrip())


def _first_left(before: Drift) -> str:
    return f" The first that cannot: {before.left_out[0][1]}" if before.left_out else ""


def _reasons(outcome: Outcome, tests: tuple[PartTest, ...], worst: tuple[int, ...]) -> str:
    if outcome in (Outcome.NOT_FIXED, Outcome.NOT_CONVERGED):
        return ""
    failed = [f"{test.part.name.lower()}: {_numbers(test)}" for test in tests if not test.ok]
    words = [f"{'; '.join(failed)}."]
    if worst and outcome is Outcome.DISAGREE:
        words.append(f"Worst: image {', '.join(str(index + 1) for index in worst)} (counted from 1).")
    return " ".join(words)


def _numbers(test: PartTest) -> str:
    return f"chi-squared {test.chi2:.4g} with {test.dof} degrees of freedom, p = {test.p_value:.2g}"


def _message(result: Recalibration) -> str:
    """What changed, in words."""
    n = len(result.images)
    words = [f"UPDATED: {Outcome.UPDATED.value} {n} images."]
    if result.before.ok:
        words.append("They agree with the old rig file as it is.")
    else:
        words.append("They contradict the old rig file.")
    changes = "; ".join(
        f"{row.name} {row.change:+.3g}{'' if row.unit == '1' else ' ' + row.unit} ({abs(row.sigmas):.1f} sigma)"
        for row in result.seen
    )
    words.append(f"Changed: {changes}.")
    if any(row.sigma_after > row.sigma_before > 0 for row in result.seen):
        words.append(
            "Unless something else says that the beam has moved, keep the old file, which knows some of these better, "
            "or allow for no move."
            if result.before.ok
            else "Some of these are known less well than they were calibrated: more images would help."
        )
    return " ".join(words)
