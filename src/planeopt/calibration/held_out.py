"""Observations that had no say, predicted by the others: half of each view's corners, and whole views.

This tells what was fitted to noise and which views disagree. It cannot tell a bowed board or a wrong square size: both
halves are on the same board.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from planeopt.calibration.adjustment import Adjustment, refit
from planeopt.calibration.equations import AdjustmentError, Task, Weights, descend
from planeopt.calibration.model import Model
from planeopt.calibration.packed import Packed
from planeopt.calibration.per_view import weights_of
from planeopt.calibration.projection import Linear, linear_boundaries, linear_corners
from planeopt.calibration.start import LEAST_CORNERS
from planeopt.calibration.state import State
from planeopt.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_log = logging.getLogger(__name__)

FOLDS = 5
_LEAST_VIEWS = 6
_CHANCE = 1e-3
_HARMLESS = 0.02
"""Of a parameter's variance: where a fold should change it by even less, what is not linear would decide."""
_SYSTEMATIC = 0.1
"""Of the expected error: what may be more than noise without harm."""


@dataclass(frozen=True)
class Predicted:
    """Errors of predictions, and what they should be.

    Attributes
    ----------
    error_px : float
        RMS of each coordinate (of a boundary: across it); NaN where nothing was predicted.
    expected_px : float
        The same from the noise and from what the predictions are uncertain by.
    uncertainty : float
        Standard deviation of their ratio, if all is as it should be.
    count : int
        Numbers predicted.
    """

    error_px: float
    expected_px: float
    uncertainty: float
    count: int

    @property
    def ratio(self) -> float:
        """Error over what is expected."""
        return self.error_px / self.expected_px if self.count else float("nan")


@dataclass(frozen=True)
class Fold:
    """Views that were left out of a calibration, and predicted by it.

    Attributes
    ----------
    views : tuple of str
    error_px, expected_px : float
        Of half of their corners, the other half giving the poses.
    spots : Predicted
        Of their spots' boundaries; the poses by all corners.
    largest_shift : float
        Of a parameter from its value with all views, over the standard deviation of that difference.
    parameter : str
        Which one.
    """

    views: tuple[str, ...]
    error_px: float
    expected_px: float
    spots: Predicted
    largest_shift: float
    parameter: str


@dataclass(frozen=True)
class HeldOut:
    """How well parts of the observations predict others.

    Attributes
    ----------
    ok : bool
        Whether errors and shifts are as large as they should be.
    sentence : str
    error_px, expected_px : float
        Of the corners of one half of each view, predicted by this camera and a pose from the other half.
    halves : Predicted
        The same.
    folds : tuple of Fold
        Empty where there are too few views.
    """

    ok: bool
    sentence: str
    error_px: float
    expected_px: float
    halves: Predicted
    folds: tuple[Fold, ...]


def held_out(adjustment: Adjustment, *, seed: int = 0, folds: int = FOLDS) -> HeldOut | None:
    """Predict what had no say; None where no view has corners enough for two halves.

    Parameters
    ----------
    adjustment : Adjustment
    seed : int
        Of the choice of halves and folds.
    folds : int
        How many; at most the number of views.
    """
    packed = Packed.of(adjustment.observations)
    weights = weights_of(adjustment, packed)
    halves = _halves(weights.corners > 0, np.random.default_rng((seed, 1)))
    if not np.any(halves[0]):
        return None
    predicted = _pooled(
        [
            _predict_corners(packed, weights, adjustment.state, known, asked)[0]
            for known, asked in (halves, halves[::-1])
        ]
    )
    left_out = _folds(adjustment, folds, np.random.default_rng((seed, 2)))
    made = tuple(fold for rows in left_out if (fold := _fold(adjustment, packed, weights, halves, rows)) is not None)
    return _judged(adjustment, predicted, made, complete=len(made) == len(left_out))


@dataclass(frozen=True, eq=False)
class _Parts:
    """Squared errors, their expected values, and the variance of their sum: what sums up over views."""

    square: float
    expected: float
    spread: float
    count: int


def _halves(used: Mask, rng: np.random.Generator) -> tuple[Mask, Mask]:
    """Return two halves of each view's corners (V, K) each; neither of a view with too few."""
    order = np.argsort(np.where(used, rng.random(used.shape), np.inf), axis=1)
    rank = np.argsort(order, axis=1)
    counts = np.count_nonzero(used, axis=1)
    enough = (counts >= 2 * LEAST_CORNERS)[:, None]
    first = used & (rank < counts[:, None] // 2) & enough
    return first, used & ~first & enough


def _predict_corners(
    packed: Packed, weights: Weights, state: State, known: Mask, asked: Mask, of_rig: tuple[Array, Array] | None = None
) -> tuple[_Parts, State]:
    """Return the errors of the corners that are asked for, with poses from those that are known.

    Parameters
    ----------
    of_rig : (17, g) and (g, g) arrays, optional
        Free parameters and their covariance, where the rig is not from these views.
    """
    rows = np.flatnonzero(known.any(axis=1) & asked.any(axis=1))
    some, part = packed.some(rows), state.some(rows)
    task = Task(some, Model(camera=False, warp=False, beam="none"), with_spots=False)
    given = np.where(known[rows], weights.corners[rows], 0.0)
    placed = descend(task, part, Weights(given, np.zeros_like(weights.boundary[rows]))).here
    linear = linear_corners(some.board, some.corners, placed.state)
    weight = np.repeat(given, 2, axis=1)
    noise = np.where(
        np.repeat(asked[rows], 2, axis=1),
        1 / np.where(weights.corners[rows] > 0, weights.corners[rows], 1.0).repeat(2, axis=1),
        0.0,
    )
    return _parts(linear, linear, weight, np.repeat(asked[rows], 2, axis=1), noise, of_rig), placed.state


def _parts(
    asked_of: Linear, known_from: Linear, weight: Array, asked: Mask, noise: Array, of_rig: tuple[Array, Array] | None
) -> _Parts:
    """Return errors and what they should be: noise, and the uncertainty of pose and rig carried to each number."""
    below = np.swapaxes(known_from.pose * weight[..., None], -1, -2)
    pose = np.linalg.inv(below @ known_from.pose)
    factors = [asked_of.pose @ np.linalg.cholesky(pose)]
    if of_rig is not None:
        selection, covariance = of_rig
        moved = asked_of.shared @ selection - asked_of.pose @ (pose @ (below @ (known_from.shared @ selection)))
        factors.append(moved @ _root(covariance))
    spread = np.concatenate(factors, axis=-1) * asked[..., None]
    variance = noise + np.sum(spread**2, axis=-1)
    # Twice the squared covariance's trace is the variance of the sum of squares.
    gram = np.swapaxes(spread, -1, -2) @ spread
    mixed = np.sum(noise * np.sum(spread**2, axis=-1))
    both = float(np.sum(noise**2) + 2 * mixed + np.sum(gram**2))
    return _Parts(
        float(np.sum(asked_of.residual**2 * asked)),
        float(variance[asked].sum()),
        2 * both,
        int(np.count_nonzero(asked)),
    )


def _root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _pooled(parts: Sequence[_Parts]) -> Predicted:
    square, expected = sum(part.square for part in parts), sum(part.expected for part in parts)
    count = sum(part.count for part in parts)
    if not count:
        return Predicted(float("nan"), float("nan"), float("nan"), 0)
    spread = np.sqrt(sum(part.spread for part in parts)) / expected / 2
    return Predicted(float(np.sqrt(square / count)), float(np.sqrt(expected / count)), float(spread), count)


def _folds(adjustment: Adjustment, folds: int, rng: np.random.Generator) -> list[NDArray[np.intp]]:
    """Return the views of each fold; those with a spot are spread evenly."""
    views = len(adjustment.observations.views)
    if views < _LEAST_VIEWS:
        return []
    order = rng.permutation(views)
    order = order[np.argsort(~adjustment.spot_used[order], kind="stable")]
    return [np.sort(order[first :: min(folds, views)]) for first in range(min(folds, views))]


def _fold(
    adjustment: Adjustment, packed: Packed, weights: Weights, halves: tuple[Mask, Mask], rows: NDArray[np.intp]
) -> Fold | None:
    """Return what a calibration without some views says of them; None where there is none."""
    views = adjustment.observations.views
    kept = np.setdiff1d(np.arange(len(views)), rows)
    # With the same weights, outliers left out the same: the estimates are nested.
    fewer = replace(
        adjustment,
        observations=replace(adjustment.observations, views=tuple(views[row] for row in kept)),
        state=adjustment.state.some(kept),
        corner_used=tuple(adjustment.corner_used[row] for row in kept),
        spot_used=adjustment.spot_used[kept],
    )
    try:
        fit = refit(fewer, adjustment.model)
    except (AdjustmentError, InputError) as error:
        _log.debug("no calibration without %s: %s", ", ".join(views[row].name for row in rows), error)
        return None
    of_rig = adjustment.model.selection, fit.covariance
    part, seen = packed.some(rows), weights.some(rows)
    state = replace(adjustment.state.some(rows), values=fit.state.values)
    corners, spots = [], []
    for known, asked in (halves, halves[::-1]):
        if np.any(known[rows]):
            corners.append(_predict_corners(part, seen, state, known[rows], asked[rows], of_rig)[0])
    lit = np.flatnonzero(seen.boundary.any(axis=1))
    if lit.size:
        spots.append(_predict_spots(part.some(lit), seen.some(lit), state.some(lit), of_rig))
    found = _pooled(corners)
    shift, name = _largest_shift(adjustment, fit)
    return Fold(tuple(views[row].name for row in rows), found.error_px, found.expected_px, _pooled(spots), shift, name)


def _predict_spots(packed: Packed, weights: Weights, state: State, of_rig: tuple[Array, Array]) -> _Parts:
    task = Task(packed, Model(camera=False, warp=False, beam="none"), with_spots=False)
    placed = descend(task, state, Weights(weights.corners, np.zeros_like(weights.boundary))).here
    corners = linear_corners(packed.board, packed.corners, placed.state)
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, placed.state).linear
    asked = weights.boundary > 0
    noise = np.where(asked, 1 / np.where(asked, weights.boundary, 1.0), 0.0)
    return _parts(found, corners, np.repeat(weights.corners, 2, axis=1), asked, noise, of_rig)


def _largest_shift(adjustment: Adjustment, fit: Adjustment) -> tuple[float, str]:
    """Return the largest difference of a parameter over its standard deviation, and the parameter's name.

    The variance of the difference of two estimates of which one has the other's observations and more is the difference
    of their variances.
    """
    more = np.diagonal(fit.covariance) - np.diagonal(adjustment.covariance)
    sigma = np.sqrt(np.maximum(more, _HARMLESS * np.diagonal(fit.covariance)))
    shifts = np.abs(fit.values - adjustment.values) / sigma
    row = int(np.argmax(shifts))
    return float(shifts[row]), adjustment.names[row]


def _judged(adjustment: Adjustment, halves: Predicted, folds: tuple[Fold, ...], *, complete: bool) -> HeldOut:
    # Of the sigmas that were found, so that misfits that both halves share do not show.
    reach = float(norm.isf(_CHANCE))
    fits = halves.ratio <= 1 + max(_SYSTEMATIC, reach * halves.uncertainty)
    told = (
        f"Corners that had no say in their view's pose are predicted with an error of {halves.error_px:.3f} px; "
        f"{halves.expected_px:.3f} px is expected"
    )
    if not folds:
        more = (
            ", and there are too few views to leave some out."
            if complete
            else ", but without some views none is found."
        )
        return HeldOut(fits and complete, told + more, halves.error_px, halves.expected_px, halves, ())
    tests = len(folds) * len(adjustment.names)
    limit = float(norm.isf(_CHANCE / 2 / tests))
    worst = max(folds, key=lambda fold: fold.largest_shift)
    steady = worst.largest_shift <= limit
    shift = (
        f"Left out in {len(folds)} parts in turn, the views move no parameter by more than {worst.largest_shift:.1f} "
        f"of the standard deviations that such differences have ({worst.parameter})"
    )
    if not steady:
        shift += f": more than the {limit:.1f} that chance allows, when {', '.join(worst.views)} are left out"
    whole = "" if complete else " Without some of the views there is no calibration at all."
    sentence = f"{told}{'' if fits else ', so something in the views is not described'}. {shift}.{whole}"
    return HeldOut(fits and steady and complete, sentence, halves.error_px, halves.expected_px, halves, folds)
