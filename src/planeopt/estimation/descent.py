"""Levenberg-damped Gauss-Newton on the orthogonal distances of many spots at once, one row a spot.

The rows share array operations, nothing else: each has its own damping and stops by itself. What they minimise is the
sum of squared distances, or with ``robust`` degrees of freedom Student's t negative log-likelihood (times two), whose
weights are iterated (Lange, Little & Taylor 1989).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation.distances import seen
from planeopt.estimation.feet import FOOT_TOLERANCE, Boundary, Conics, Feet, feet, monomials_at_feet
from planeopt.formulations.bounds import FARTHEST, STEEPEST

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

STEP_TOLERANCE = 1e-5
"""A Gauss-Newton step below this many standard deviations of the plane is the last. What it leaves is smaller by the
noise over the spot's size."""

MAX_STEPS = 100
"""Three to five are usual."""

LOOSE_FEET = 1e-6
"""Tolerance of the feet on the way, as `FOOT_TOLERANCE`; each search begins where the last one ended."""

NEGLIGIBLE = 1e-6
"""Damping below which none is left."""

HOPELESS = 1e10
"""Damping at which steps no longer change anything."""

SCALE_ROUNDS = 5
"""Rounds of the scale's iteration in a step of the plane's."""


@dataclass(frozen=True)
class Loss:
    """How distances are counted: squared, or by Student's t.

    Parameters
    ----------
    robust : float or None
        Degrees of freedom of Student's t.
    scale_free : (M,) of bool
        Where the scale of the noise is estimated together with the plane; only Student's t needs to.
    """

    robust: float | None
    scale_free: NDArray[np.bool_]

    def take(self, rows: NDArray[np.intp]) -> "Loss":
        """Return the loss of some rows."""
        return Loss(self.robust, self.scale_free[rows])

    def scale(self, distance: Array, counts: Counts, scale: Array) -> Array:
        """Maximum-likelihood scale of the noise (M,), from the one before."""
        if self.robust is None or not np.any(self.scale_free):
            return scale
        squared = distance * distance
        for _ in range(SCALE_ROUNDS):
            weight = (self.robust + 1) / (self.robust + squared / scale[:, None] ** 2)
            again = np.sqrt(np.sum(weight * squared, axis=-1) / counts)
            scale = np.where(self.scale_free, np.maximum(again, np.finfo(float).tiny), scale)
        return scale

    def cost(self, distance: Array, scale: Array) -> Array:
        """Twice the negative log-likelihood (M,), but for constants; padding's distance 0 adds nothing."""
        if self.robust is None:
            return np.einsum("mi,mi->m", distance, distance)
        return (self.robust + 1) * np.sum(np.log1p((distance / scale[:, None]) ** 2 / self.robust), axis=-1)

    def weights(self, distance: Array, scale: Array) -> Array:
        """Weights (M, N) of the squared distances."""
        assert self.robust is not None
        return (self.robust + 1) / (self.robust * scale[:, None] ** 2 + distance * distance)

    @property
    def information(self) -> float:
        """Fisher information of a location over that of normal noise of the same scale."""
        return 1.0 if self.robust is None else (self.robust + 1) / (self.robust + 3)


@dataclass(frozen=True)
class Descent:
    """Where the rows ended.

    Attributes
    ----------
    planes : (M, 3)
    multiplier : (M, N)
        Of the feet, to begin with.
    scale : (M,)
        Of the noise, 1 where it was given.
    converged : (M,) of bool
    steps : (M,) of int
    """

    planes: Array
    multiplier: Array
    scale: Array
    converged: NDArray[np.bool_]
    steps: Counts


@dataclass(frozen=True)
class _Point:
    """The rows at their present planes."""

    planes: Array
    multiplier: Array
    distance: Array
    rows: Array
    """(M, 4, N): derivatives of the distance by the plane, then the distance."""

    def take(self, keep: NDArray[np.bool_]) -> "_Point":
        return _Point(self.planes[keep], self.multiplier[keep], self.distance[keep], self.rows[keep])

    def replaced(self, by: "_Point", where: NDArray[np.bool_]) -> "_Point":
        if np.all(where):
            return by
        return _Point(
            np.where(where[:, None], by.planes, self.planes),
            np.where(where[:, None], by.multiplier, self.multiplier),
            np.where(where[:, None], by.distance, self.distance),
            np.where(where[:, None, None], by.rows, self.rows),
        )


def at_planes(
    planes: Array, boundary: Boundary, setup: eq.Setup, start: Array | None = None, tolerance: float = FOOT_TOLERANCE
) -> tuple[Conics, Feet, Array]:
    """Ellipses, feet, and the monomials (M, 6, N) of the feet."""
    conics = Conics.of(planes, setup, boundary)
    found = feet(conics, boundary, start, tolerance)
    return conics, found, monomials_at_feet(found, boundary)


class _Space:
    """Memory of the large arrays, used again at every step: fresh pages would cost as much as the arithmetic."""

    def __init__(self, m: int, n: int) -> None:
        self.monomials = np.empty((m, 6, n))
        self.rows = (np.empty((m, 4, n)), np.empty((m, 4, n)))

    def rows_beside(self, used: Array | None, m: int) -> Array:
        """Room for M rows that does not hold those in use."""
        one, other = self.rows
        return (other if used is not None and used.base is one else one)[:m]


def _evaluate(
    planes: Array, boundary: Boundary, setup: eq.Setup, start: Array | None, space: _Space, used: Array | None = None
) -> _Point:
    m = len(planes)
    conics = Conics.of(planes, setup, boundary)
    found = feet(conics, boundary, start, LOOSE_FEET)
    monomials = monomials_at_feet(found, boundary, space.monomials[:m])
    rows = space.rows_beside(used, m)
    np.matmul(conics.by_plane, monomials, out=rows[:, :3])
    rows[:, :3] *= found.rate[:, None, :]
    rows[:, 3] = found.distance
    return _Point(planes, found.multiplier, found.distance, rows)


def descend(boundary: Boundary, setup: eq.Setup, start: Array, counts: Counts, loss: Loss) -> Descent:
    """Minimise from a start that is seen.

    Parameters
    ----------
    boundary : Boundary
        M rows of N points.
    setup : Setup
    start : (M, 3)
        ``(z_L, p, q)`` for which `planeopt.estimation.distances.seen` holds.
    counts : (M,)
        Points of each row, padding left out.
    loss : Loss
    """
    ended = Descent(
        start.copy(),
        np.zeros(boundary.x.shape),
        np.ones(len(start)),
        np.zeros(len(start), dtype=bool),
        np.zeros(len(start), dtype=np.int64),
    )
    index, damping, scale = np.arange(len(start)), np.zeros(len(start)), np.ones(len(start))
    with np.errstate(all="ignore"):  # a step too far is refused below, not reported
        space = _Space(*boundary.x.shape)
        now = _evaluate(start, boundary, setup, None, space)
        if loss.robust is not None:
            rms = np.sqrt(np.einsum("mi,mi->m", now.distance, now.distance) / counts)
            scale = np.where(loss.scale_free, np.maximum(rms, np.finfo(float).tiny), scale)
        for step_number in range(1, MAX_STEPS + 1):
            scale = loss.scale(now.distance, counts, scale)
            cost = loss.cost(now.distance, scale)
            step, decrement = _step(now, loss, scale, damping)
            step *= share_within(now.planes, step, setup)[:, None]
            target = now.planes + step
            done = (decrement <= STEP_TOLERANCE**2 * np.maximum(1.0, cost / counts)) & (damping <= NEGLIGIBLE)
            done |= np.all(np.abs(step) <= 4 * np.finfo(float).eps * _size(now.planes), axis=-1)
            gone = done | (damping > HOPELESS)
            if np.any(gone):
                _put(ended, index[gone], np.where(done[:, None], target, now.planes)[gone], now.multiplier[gone])
                ended.scale[index[gone]], ended.converged[index[gone]] = scale[gone], done[gone]
                ended.steps[index[gone]] = step_number
                stay = ~gone
                if not np.any(stay):
                    break
                index, boundary, loss = index[stay], boundary[stay], loss.take(np.flatnonzero(stay))
                counts, now, target = counts[stay], now.take(stay), target[stay]
                damping, scale, cost = damping[stay], scale[stay], cost[stay]
            trial = _evaluate(target, boundary, setup, now.multiplier, space, now.rows)
            better = loss.cost(trial.distance, scale) <= cost * (1 + 1e-9)  # false for NaN
            damping = np.where(
                better, np.where(damping > NEGLIGIBLE, damping / 10, 0.0), np.maximum(10 * damping, 1e-3)
            )
            now = now.replaced(trial, better)
        else:
            _put(ended, index, now.planes, now.multiplier)
            ended.scale[index], ended.steps[index] = scale, MAX_STEPS
    return ended


def _put(ended: Descent, index: NDArray[np.intp], planes: Array, multiplier: Array) -> None:
    ended.planes[index], ended.multiplier[index] = planes, multiplier


def _size(planes: Array) -> Array:
    """Sizes (M, 3) to which a step compares."""
    tilt = np.sqrt(1 + planes[:, 1] ** 2 + planes[:, 2] ** 2)
    return np.stack([planes[:, 0], tilt, tilt], axis=-1)


def _step(now: _Point, loss: Loss, scale: Array, damping: Array) -> tuple[Array, Array]:
    """The damped Gauss-Newton step (M, 3), and its squared length (M,) in standard deviations of the plane."""
    rows = now.rows
    if loss.robust is not None:
        rows = rows * np.sqrt(loss.weights(now.distance, scale))[:, None, :]
    products = rows @ np.swapaxes(rows, -1, -2)
    information, gradient = products[:, :3, :3], products[:, :3, 3]
    size = np.sqrt(np.einsum("mii->mi", information))
    size = np.where(size > 0, size, 1.0)
    normed = information / (size[:, :, None] * size[:, None, :])
    # The constant part keeps it invertible; it slows a step by 1e-13 and does not move the minimum.
    normed = normed + (damping + 1e-13)[:, None, None] * np.eye(3)
    usable = np.asarray(np.isfinite(products).all(axis=(-1, -2)))
    normed = np.where(usable[:, None, None], normed, np.eye(3))
    right = np.where(usable[:, None], gradient / size, np.nan)
    solved = solve_all(normed, right)
    return -solved / size, np.sum(solved * right, axis=-1)


def solve_all(matrices: Array, right: Array) -> Array:
    """Solutions (M, k) of symmetric systems; of least length where one is singular, which must not cost the others."""
    try:
        return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0], dtype=float)
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(matrices, hermitian=True) @ right[..., None])[..., 0], dtype=float)


def within_bounds(planes: Array, setup: eq.Setup) -> NDArray[np.bool_]:
    """Whether planes (..., 3) are seen, not beyond the farthest depth, and not too edge-on to be measured."""
    slope = np.hypot(planes[..., 1], planes[..., 2])
    return seen(planes, setup) & (planes[..., 0] < FARTHEST * setup.r) & (slope < np.tan(STEEPEST))


def share_within(planes: Array, step: Array, setup: eq.Setup) -> Array:
    """The largest power of 1/2 (M,) by which a step ends within the bounds."""
    share = np.ones(len(planes))
    for _ in range(50):
        outside = ~within_bounds(planes + share[:, None] * step, setup)
        if not np.any(outside):
            break
        share[outside] /= 2
    return share
