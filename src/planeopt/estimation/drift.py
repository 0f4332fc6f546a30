"""Is the rig still as calibrated? The self-tests of many images, taken together.

Each image leaves two numbers that no plane can change, ``t_i``, white of unit variance where rig and points are right
(docs/model.md, section 8). A rig that is off by ``deta`` from its file makes ``t_i = u_i - G_i deta``, and ``deta`` is
the same in every image: stacked, ``t`` has the covariance ``I + G Sigma G'``, whose second part is common to all, so
that the sum of the images' own chi-squareds is not chi-squared. With ``C = I + G Sigma G'``, ``t' C^-1 t`` is, with 2n
degrees of freedom. What the rig does to second order goes into each image's own variance
(`planeopt.estimation.second_order`): with a calibration that is too uncertain for spots so small the test is less
sharp, and says so. The statistic is split into three parts, independent where the rig is right:

- what a *shift* explains, the same change of the beam in every image;
- what a *trend* explains beyond it, a change of the beam that grows along the sequence;
- the *rest*, which no such change of the beam explains.

Of the beam, images see four numbers: its vanishing point, and its offset over its radius (two components).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.estimation.misfits import LEVEL, TEST_LEVEL, Change, Misfits, Part, PartTest
from planeopt.estimation.second_order import image_bends
from planeopt.rig import Rig
from planeopt.solution import Solution

Array = NDArray[np.float64]

BLIND = (
    "No image of a plane can test the focal length, the scale (radius and offset together), or the principal point "
    "apart from the beam's direction: for those, calibrate with a board."
)
"""What the test can never see (docs/model.md, section 8)."""


class State(Enum):
    """What the images say of the rig; the value is the sentence a user reads."""

    OK = "The images agree with the rig, as far as they can test it."
    DEGRADED = "The rig is not as calibrated, or the boundary points are not as good as their sigma says."
    UNTESTED = "No image could be used to test the rig."


_BLUNT = 1.0
"""Second order, in standard deviations of an image's own misfit, from which the test has lost sharpness."""


@dataclass(frozen=True, eq=False)
class Drift:
    """The rig against a batch of images.

    Attributes
    ----------
    state : State
    verdict : str
        ``OK``, ``DEGRADED`` or ``UNTESTED``, and why.
    tests : tuple of PartTest
        Pooled, shift, trend, rest: those that the number of images allows.
    shift, trend : tuple of Change
        Of the four numbers of the beam that images see: the truth minus the rig file, and how it changes from the first
        image to the last. Empty where the images do not fix all four.
    images : tuple of int
        Which of the given solutions were used, counted from 0.
    left_out : tuple of (int, str)
        Which could not be, and why.
    worst : tuple of int
        Images whose own test fails at `LEVEL` over their number, worst first.
    blind : str
        What no test of this kind can see.
    """

    state: State
    verdict: str
    tests: tuple[PartTest, ...]
    shift: tuple[Change, ...]
    trend: tuple[Change, ...]
    images: tuple[int, ...]
    left_out: tuple[tuple[int, str], ...]
    worst: tuple[int, ...]
    blind: str = BLIND

    @property
    def ok(self) -> bool:
        return self.state is State.OK

    @property
    def n_images(self) -> int:
        return len(self.images)

    @property
    def chi2(self) -> float | None:
        """Pooled: of all images, the rig's covariance being common to them."""
        return self.tests[0].chi2 if self.tests else None

    @property
    def dof(self) -> int:
        return self.tests[0].dof if self.tests else 0

    @property
    def p_value(self) -> float | None:
        return self.tests[0].p_value if self.tests else None


def drift(solutions: Iterable[Solution], rig: Rig, *, positions: ArrayLike | None = None) -> Drift:
    """Test a rig with images of whatever planes.

    Parameters
    ----------
    solutions : iterable of Solution
        Solved with this rig; a `BatchSolution` will do. What is refused, or has no noise scale, is left out.
    rig : Rig
    positions : (n,), optional
        When, or where in a sequence, each image was taken: for the trend. Their order unless given.

    Returns
    -------
    Drift

    Raises
    ------
    InputError
        If the positions are not one finite number for each solution.
    """
    given = list(solutions)
    along = np.arange(len(given), dtype=float) if positions is None else np.asarray(positions, dtype=float)
    if along.shape != (len(given),) or not np.isfinite(along).all():
        raise InputError(f"positions must be {len(given)} finite numbers, one for each image")
    usable, left_out = [], []
    for index, solution in enumerate(given):
        if solution.rig_test is None or solution.p_value is None or solution.status.record == "refused":
            left_out.append((index, solution.message))
        else:
            usable.append(index)
    if not usable:
        return Drift(State.UNTESTED, _untested(left_out), (), (), (), (), tuple(left_out), ())
    used = [given[index] for index in usable]
    evidence, bend = _evidence(used, rig, along[usable])
    tests = evidence.tests()
    shift, trend = evidence.changes(rig)
    p_values = np.array([solution.p_value for solution in used])
    order = np.argsort(p_values)
    worst = tuple(usable[row] for row in order if p_values[row] < LEVEL / len(used))
    state = State.OK if all(test.ok for test in tests) else State.DEGRADED
    verdict = _verdict(state, tests, shift, trend, worst, rig, blunt=bend > _BLUNT)
    return Drift(state, verdict, tests, shift, trend, tuple(usable), tuple(left_out), worst)


def _evidence(solutions: Sequence[Solution], rig: Rig, along: Array) -> tuple[Misfits, float]:
    """Return the images' misfits, and the largest second order of an image, in standard deviations."""
    parts = [solution.rig_test for solution in solutions if solution.rig_test is not None]
    scales = [_as_normal(solution) for solution in solutions]
    misfit, by_beam, by_rig = (
        np.concatenate([np.asarray(getattr(part, name)) * scale for part, scale in zip(parts, scales, strict=True)])
        for name in ("misfit", "by_beam", "by_rig")
    )
    sigma = rig.covariance_matrix
    if len(sigma) != by_rig.shape[1]:
        raise InputError(
            f"the images were solved with a rig of {by_rig.shape[1]} free parameters, and this rig has "
            f"{len(sigma)}: give the rig that they were solved with"
        )
    bends = image_bends(by_rig, sigma, np.array([part.fineness for part in parts]))
    own = np.sqrt(1 + bends**2)
    return Misfits.of(misfit, by_beam, by_rig, sigma, along, own), float(bends.max())


def _as_normal(solution: Solution) -> float:
    """Factor for a misfit over an estimated scale, whose square follows F: with it, chi-squared has the same p-value.

    It is 1 where the scale was given.
    """
    chi2, p_value = solution.chi2 or 0.0, solution.p_value or 0.0
    if chi2 == 0 or p_value < _UNDERFLOW:
        return 1.0
    return float(np.sqrt(scipy.stats.chi2.isf(p_value, 2) / chi2))


_UNDERFLOW = 1e-300


def _untested(left_out: list[tuple[int, str]]) -> str:
    why = f" The first: {left_out[0][1]}" if left_out else ""
    return f"{State.UNTESTED.name}: {State.UNTESTED.value}{why}"


def _verdict(
    state: State,
    tests: tuple[PartTest, ...],
    shift: tuple[Change, ...],
    trend: tuple[Change, ...],
    worst: tuple[int, ...],
    rig: Rig,
    *,
    blunt: bool,
) -> str:
    pooled, *parts = tests
    words = [f"{state.name}: {state.value}", f"Pooled: {_numbers(pooled)}."]
    for test in parts:
        if not test.ok:
            change = {Part.SHIFT: shift, Part.TREND: trend}.get(test.part, ())
            listed = f": {'; '.join(map(_in_words, change))}" if change else ""
            words.append(f"{test.part.value.removesuffix('.')} ({_numbers(test)}){listed}.")
    if worst:
        words.append(f"Worst: image {', '.join(str(index + 1) for index in worst)} (counted from 1).")
    if state is State.DEGRADED and rig.covariance is None:
        words.append("The rig file has no covariance: an error that the calibration itself left counts as a change.")
    if blunt:
        words.append("The calibration is too uncertain for spots so small to be tested sharply with them.")
    elif pooled.p_value > 1 - TEST_LEVEL:
        words.append("The misfits are smaller than chance leaves them: sigma_px is too large, and the test the weaker.")
    return " ".join(words)


def _numbers(test: PartTest) -> str:
    p_value = f"p = {test.p_value:.2g}" if test.p_value > _UNDERFLOW else f"p < {_UNDERFLOW}"
    return f"chi-squared {test.chi2:.4g} with {test.dof} degrees of freedom, {p_value}"


def _in_words(change: Change) -> str:
    unit = "" if change.unit == "1" else f" {change.unit}"
    return f"{change.name} by {change.value:+.3g} +- {change.sigma:.2g}{unit}"
