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
from planeopt.estimation.rig_part import SEEN
from planeopt.estimation.second_order import bend
from planeopt.rig import Rig
from planeopt.solution import Solution

Array = NDArray[np.float64]

LEVEL = 1e-3
"""How often a rig that is as calibrated is called degraded."""

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


class Part(Enum):
    """What is tested; the value says what it means where it fails."""

    POOLED = "The images together contradict the rig."
    SHIFT = "The beam is not where the rig file has it."
    TREND = "The beam moves along the sequence."
    REST = "There are misfits that no change of the beam explains: the lens, the boundary points, or their sigma."


_BLUNT = 1.0
"""Second order, in standard deviations of an image's own misfit, from which the test has lost sharpness."""

TEST_LEVEL = LEVEL / len(Part)
"""Of each part: together they are wrong no more often than `LEVEL`."""


@dataclass(frozen=True)
class PartTest:
    """One part of the evidence; ``p_value`` is how often a right rig does worse."""

    part: Part
    chi2: float
    dof: int
    p_value: float

    @property
    def ok(self) -> bool:
        return self.p_value >= TEST_LEVEL


@dataclass(frozen=True)
class Change:
    """How far something the images see is from the rig file; ``sigma`` has the calibration's own share in it."""

    name: str
    unit: str
    value: float
    sigma: float


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
    evidence = _Evidence.of(used, rig, along[usable])
    tests = evidence.tests()
    shift, trend = evidence.changes(rig)
    p_values = np.array([solution.p_value for solution in used])
    order = np.argsort(p_values)
    worst = tuple(usable[row] for row in order if p_values[row] < LEVEL / len(used))
    state = State.OK if all(test.ok for test in tests) else State.DEGRADED
    verdict = _verdict(state, tests, shift, trend, worst, rig, blunt=evidence.bend > _BLUNT)
    return Drift(state, verdict, tests, shift, trend, tuple(usable), tuple(left_out), worst)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Whitened by ``C``: misfits (2n,), what a change of the beam makes of them (2n, 4), and of one that grows.

    ``trend`` has no columns where there is nothing for a trend to be seen in.
    """

    misfit: Array
    shift: Array
    trend: Array
    bend: float
    """Largest second order of an image, in standard deviations."""

    @classmethod
    def of(cls, solutions: Sequence[Solution], rig: Rig, along: Array) -> "_Evidence":
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
        place = along - along.mean()
        extent = float(np.ptp(along))
        growing = by_beam * np.repeat(place / extent, 2)[:, None] if extent > 0 and len(along) > 2 else by_beam[:, :0]
        fine = np.array([part.fineness for part in parts])
        bends = _bends(by_rig, sigma, fine)
        own = np.repeat(np.sqrt(1 + bends**2), 2)[:, None]
        whitened = _whitened(
            np.column_stack([misfit, by_beam, growing]) / own, by_rig @ np.linalg.cholesky(sigma) / own
        )
        return cls(whitened[:, 0], whitened[:, 1:5], whitened[:, 5:], float(bends.max()))

    def tests(self) -> tuple[PartTest, ...]:
        """Pooled, and its independent parts."""
        shift = _basis(self.shift)
        trend = _basis(self.trend - shift @ (shift.T @ self.trend))
        total = float(self.misfit @ self.misfit)
        by_shift, by_trend = (float(np.sum((basis.T @ self.misfit) ** 2)) for basis in (shift, trend))
        dof = len(self.misfit)
        parts = [
            (Part.POOLED, total, dof),
            (Part.SHIFT, by_shift, shift.shape[1]),
            (Part.TREND, by_trend, trend.shape[1]),
            (Part.REST, max(total - by_shift - by_trend, 0.0), dof - shift.shape[1] - trend.shape[1]),
        ]
        return tuple(
            PartTest(part, chi2, n, float(scipy.stats.chi2.sf(chi2, n)))
            for part, chi2, n in parts
            if n > 0 and not (part is Part.SHIFT and n == dof)
        )

    def changes(self, rig: Rig) -> tuple[tuple[Change, ...], tuple[Change, ...]]:
        """Shift, and trend from the first image to the last, where all four numbers are fixed."""
        if _basis(self.shift).shape[1] < len(SEEN):
            return (), ()
        to_seen = _seen_by_beam(rig)
        shift = _changes(self.shift, self.misfit, to_seen)
        both = np.column_stack([self.shift, self.trend])
        if not self.trend.shape[1] or _basis(both).shape[1] < both.shape[1]:
            return shift, ()
        return shift, _changes(both, self.misfit, np.column_stack([np.zeros((4, 4)), to_seen]))


_NAMES = (
    ("vanishing point x", "px"),
    ("vanishing point y", "px"),
    ("offset over radius, x", "1"),
    ("offset over radius, y", "1"),
)


def _changes(columns: Array, misfit: Array, to_seen: Array) -> tuple[Change, ...]:
    """Least squares of ``misfit = -columns @ change``, carried to the four numbers."""
    size = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.pinv(columns / size) / size[:, None]
    carried = to_seen @ inverse
    values, sigmas = -carried @ misfit, np.linalg.norm(carried, axis=1)
    return tuple(
        Change(name, unit, float(value), float(sigma))
        for (name, unit), value, sigma in zip(_NAMES, values, sigmas, strict=True)
    )


def _seen(rig: Rig) -> Array:
    """Vanishing point in an undistorted image, px, and offset over radius in the laser-parallel frame."""
    beam, camera = rig.require_beam(), rig.camera
    l_x, l_y, l_z = beam.direction
    offset = np.array(rig.laser_offset) / beam.radius
    return np.array([camera.cx + camera.fx * l_x / l_z, camera.cy + camera.fy * l_y / l_z, *offset])


def _seen_by_beam(rig: Rig) -> Array:
    """Derivative (4, 4) of `_seen` by `SEEN`, by central differences: the functions are smooth and of size 1."""
    columns = []
    for name in SEEN:
        value = rig.parameter(name)
        step = 1e-5 * (1.0 if name.startswith("direction") else rig.require_beam().radius)
        ahead, behind = (rig.with_parameters({name: value + sign * step}) for sign in (1, -1))
        columns.append((_seen(ahead) - _seen(behind)) / (2 * step))
    return np.stack(columns, axis=1)


def _as_normal(solution: Solution) -> float:
    """Factor for a misfit over an estimated scale, whose square follows F: with it, chi-squared has the same p-value.

    It is 1 where the scale was given.
    """
    chi2, p_value = solution.chi2 or 0.0, solution.p_value or 0.0
    if chi2 == 0 or p_value < _UNDERFLOW:
        return 1.0
    return float(np.sqrt(scipy.stats.chi2.isf(p_value, 2) / chi2))


_UNDERFLOW = 1e-300


def _bends(by_rig: Array, sigma: Array, fine: Array) -> Array:
    """Second order (n,) of the rig's effect on each image's misfits, whose derivatives are (2n, k)."""
    moved = np.einsum("ik,kl,il->i", by_rig, sigma, by_rig).reshape(-1, 2).sum(axis=1)
    return bend(moved, fine)


def _whitened(columns: Array, common: Array) -> Array:
    """``C^-1/2`` times columns, ``C = I + common common'``."""
    if not common.shape[1]:
        return columns
    left, size, _ = np.linalg.svd(common, full_matrices=False)
    return columns + left @ ((1 / np.sqrt(1 + size**2) - 1)[:, None] * (left.T @ columns))


def _basis(columns: Array) -> Array:
    """Orthonormal basis (m, rank) of what columns of any unit span."""
    size = np.linalg.norm(columns, axis=0)
    if not columns.shape[1] or not size.any():
        return columns[:, :0]
    left, values, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return left[:, values > _DEFICIENT * values[0]]


_DEFICIENT = 1e-6
"""Singular values below this share of the largest are rounding: columns have unit length."""


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
