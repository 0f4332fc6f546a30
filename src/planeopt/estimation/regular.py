"""Maximum likelihood for regular spots, fast: an ellipse that stands out from its noise, in points that say where.

The points are gone through four or five times. First for an algebraic fit, ``sum w F^2`` over conics whose quadratic
part has the trace 1; it gives the ellipse at whose tangents they are seen next. There the sum of squared distances is a
quadratic function of the coefficients of any ellipse nearby, and so by their 21 sums a function of the plane: its least
value is found without the points, from the closed form of its free minimum. From then on the plane's own ellipse gives
the tangents, until a step is short.

Whether a spot was regular is told at the end, by what was found. The others are searched for by
`planeopt.estimation.descent`, which takes nothing for granted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.closed_form import solve_both
from planeopt.conic.transport import conic_from_local
from planeopt.estimation.descent import share_within, within_bounds
from planeopt.estimation.images import SPAN, TRACE_ONE, Images, conics_at
from planeopt.estimation.small_systems import positive_solved
from planeopt.estimation.tangents import Cloud, Tangents, products, tangents

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

STEP_TOLERANCE = 1e-3
"""A step of the plane below this many of its standard deviations is the last. It leaves that times what the tangents of
`CURVED` and `SLOPE_SIGMA` leave undone, below a thousandth."""

MAX_ROUNDS = 5
"""Looks at the points from the tangents of a plane's ellipse; two or three are usual."""

CURVED = 0.2
"""Largest distance of a point over the radius of curvature, both in the metric of its noise, of a regular spot."""

SLOPE_SIGMA = 0.2
"""Largest standard deviation of a slope of a regular spot."""

NARROW = 5.0
"""RMS distance from their line of best fit, in standard deviations, that points of a regular spot exceed."""

WEAK = 1e-8
"""Least eigenvalue of the information on an ellipse, scaled to ones on its diagonal, of a regular spot. The sums of
squares carry it to half the digits of the points; below, `planeopt.estimation.descent` does."""

FEW = 8
"""A regular spot has as many points."""

# Looks at the sums alone, for the plane of least cost from the closed form: it is as far as 100 standard deviations.
_INNER = 4

# As many for a plane from elsewhere.
_INNER_FAR = 12


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Sums of squared distances of M spots' points as functions of an ellipse near one.

    ``cost + 2 score' d + d' information d`` for a change ``d`` of the five coordinates of a conic of trace 1
    (`coordinates`).
    """

    at: Array
    """(M, 5)"""
    cost: Array
    score: Array
    information: Array

    @classmethod
    def of(cls, seen: Tangents, at: Array) -> "Quadratic":
        """From the points seen from the tangents of conics (M, 5)."""
        sums = seen.sums()
        return cls(at, seen.cost(), sums[:, :, 6] @ SPAN, SPAN.T @ sums[:, :, :6] @ SPAN)

    def take(self, rows: NDArray[np.intp]) -> "Quadratic":
        """Return some of the spots'."""
        return Quadratic(self.at[rows], self.cost[rows], self.score[rows], self.information[rows])

    def put(self, rows: NDArray[np.intp], values: "Quadratic") -> None:
        """Write those of some of the spots."""
        self.at[rows], self.cost[rows] = values.at, values.cost
        self.score[rows], self.information[rows] = values.score, values.information

    def free_minimum(self) -> Array:
        """Coordinates (M, 5) of the conics of least cost."""
        return self.at - _solve(self.information, self.score)

    def moved(self, to: Array) -> "Quadratic":
        """The same functions about other conics (M, 5)."""
        change = to - self.at
        turn = (self.information @ change[..., None])[..., 0]
        cost = self.cost + np.einsum("mk,mk->m", change, 2 * self.score + turn)
        return Quadratic(to, cost, self.score + turn, self.information)


@dataclass(frozen=True, eq=False)
class Found:
    """Where the search of M spots ended.

    Attributes
    ----------
    planes : (M, 3)
    regular : (M,) of bool
        Whether that is the maximum-likelihood plane; where it is not, nothing here means anything.
    rounds : (M,) of int
        Looks at the points from tangents of a plane's ellipse.
    quadratic : Quadratic
        About the planes' ellipses.
    by_plane : (M, 5, 3)
        Derivative of these ellipses by the planes.
    tangents : Tangents
        The points as they were seen before the last step.
    """

    planes: Array
    regular: Bools
    rounds: NDArray[np.int64]
    quadratic: Quadratic
    by_plane: Array
    tangents: Tangents


def search(cloud: Cloud, setup: eq.Setup, counts: NDArray[np.int64], known: Bools) -> Found:
    """Find the planes of regular spots, and tell which these are.

    Parameters
    ----------
    cloud : Cloud
        M spots.
    setup : Setup
    counts : (M,)
        Points of each, padding left out.
    known : (M,) of bool
        Whether the noise is the points' own, and not only up to a factor.
    """
    images = Images.of(setup)
    with np.errstate(all="ignore"):  # what is not finite is not regular
        monomials, trace = cloud.monomials(), cloud.trace
        at, width2 = _algebraic(cloud, monomials, trace)
        seen = tangents(cloud, conics_at(at), monomials)
        first = Quadratic.of(seen, at)
        planes, inside = _closed_form(first.free_minimum(), cloud.origin, setup)
        for _ in range(_INNER):
            planes += _step_on(first, planes, images, cloud.origin)[0]
        found = _rounds(cloud, images, planes, seen.monomials, counts, CURVED / (2 * np.max(trace, axis=1)))
        scale2 = found.quadratic.cost / np.maximum(counts - 5, 1)
        scale2 = np.where(known, np.maximum(1.0, scale2), scale2)
        good = (width2 > NARROW**2 * scale2) & (_slope_variance(found) * scale2 < SLOPE_SIGMA**2)
        good &= inside & within_bounds(found.planes, setup) & (counts >= FEW)
        found.regular[:] &= good & _well_known(found.quadratic.information)
    return found


def _algebraic(cloud: Cloud, monomials: Array, trace: Array) -> tuple[Array, Array]:
    """Coordinates (M, 5) of conics of least ``sum w F^2``, and the points' mean squared distances (M,) from lines.

    The distances are from their line of best fit, in standard deviations.
    """
    weighted = np.empty_like(monomials)
    np.divide(1.0, trace, out=weighted[5])
    if cloud.used is not None:
        weighted[5] *= cloud.used
    np.multiply(monomials[:5], weighted[5], out=weighted[:5])
    sums = products(monomials, weighted)
    score = (sums @ TRACE_ONE) @ SPAN
    at = -_solve(SPAN.T @ sums @ SPAN, score)
    # Weights are one over twice the variance: the sums are squares in standard deviations.
    n = cloud.x.shape[1] if cloud.used is None else np.sum(cloud.used, axis=1)
    means = sums[:, 3:5, 5] / sums[:, 5, 5, None]
    xx, xy, yy = (
        sums[:, i, j] - means[:, i - 3] * means[:, j - 3] * sums[:, 5, 5] for i, j in ((3, 3), (3, 4), (4, 4))
    )
    return at, (xx + yy - np.hypot(xx - yy, 2 * xy)) / n


def _closed_form(at: Array, origin: Array, setup: eq.Setup) -> tuple[Array, Bools]:
    """Planes (M, 3) of conics (M, 5) by the closed form, and where they can be seen; some other plane elsewhere."""
    conics = conics_at(at)
    B = conic_from_local(conics[:, 1:] / conics[:, :1], origin, np.ones(len(at)))
    planes = solve_both(B, setup).visible
    inside = within_bounds(planes, setup)
    return np.where(inside[:, None], planes, [setup.f * setup.r, 0.0, 0.0]), inside


def _step_on(function: Quadratic, planes: Array, images: Images, origin: Array) -> tuple[Array, Array, Array]:
    """Gauss-Newton's step (M, 3) on the function alone, its squared length (M,), and the cost (M,) before it.

    The length is in standard deviations of the plane.
    """
    at, by_plane = images.coordinates(planes, origin)
    here = function.moved(at)
    return *_step(here, by_plane), here.cost


def _step(here: Quadratic, by_plane: Array) -> tuple[Array, Array]:
    transposed = np.swapaxes(by_plane, 1, 2)
    gradient = (transposed @ here.score[..., None])[..., 0]
    step = -positive_solved(transposed @ here.information @ by_plane, gradient)
    return step, -np.einsum("mi,mi->m", step, gradient)


def _solve(matrices: Array, right: Array) -> Array:
    """Solutions (M, k); of what is singular or not finite some that are no use."""
    try:
        return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0], dtype=float)
    except np.linalg.LinAlgError:
        size = np.trace(matrices, axis1=1, axis2=2)
        poor = ~np.isfinite(size) | (np.linalg.matrix_rank(np.nan_to_num(matrices)) < matrices.shape[-1])
        harmless = np.where(poor[:, None, None], np.eye(matrices.shape[-1]), matrices)
        return np.where(poor[:, None], np.nan, np.linalg.solve(harmless, right[..., None])[..., 0])


def _rounds(
    cloud: Cloud, images: Images, planes: Array, feet: Array, counts: NDArray[np.int64], farthest: Array
) -> Found:
    """Look at the points from the planes' ellipses until a step is short; only at those for which it is not.

    No multiplier of a regular spot is over `farthest`, (M,).
    """
    m = len(planes)
    done, rounds = np.zeros(m, dtype=bool), np.zeros(m, dtype=np.int64)
    at, by_plane = images.coordinates(planes, cloud.origin)
    seen = tangents(cloud, conics_at(at), feet)
    total = here = Quadratic.of(seen, at)
    rows, part, now = np.arange(m), cloud, seen
    for count in range(1, MAX_ROUNDS + 1):
        step, squared = _step(here, by_plane)
        planes[rows] += step
        short = squared <= STEP_TOLERANCE**2 * np.maximum(1.0, here.cost / counts[rows])
        multiplier = np.maximum(np.max(now.multiplier, axis=1), -np.min(now.multiplier, axis=1))
        # No point is as far from its foot as its ellipse bends: the largest eigenvalue of 2 m V A, by traces.
        done[rows], rounds[rows] = short & (multiplier < farthest[rows]), count
        more = np.flatnonzero(~short & np.isfinite(squared))
        if not len(more) or count == MAX_ROUNDS:
            break
        if len(more) < len(rows):
            rows, part, feet = rows[more], part.take(more), now.monomials[:, more]
        at, by_plane = images.coordinates(planes[rows], part.origin)
        now = tangents(part, conics_at(at), feet)
        here = Quadratic.of(now, at)
        if len(rows) == m:
            total, seen = here, now
        else:
            total.put(rows, here)
            seen.put(rows, now)
    at, by_plane = images.coordinates(planes, cloud.origin)
    return Found(planes, done, rounds, total.moved(at), by_plane, seen)


def _slope_variance(found: Found) -> Array:
    """Largest variance (M,) of a slope in any direction, from the points' noise as it was given."""
    information = np.swapaxes(found.by_plane, 1, 2) @ found.quadratic.information @ found.by_plane
    a, b, c = information[:, 0, 0], information[:, 0, 1:], information[:, 1:, 1:]
    slopes = c - b[:, :, None] * b[:, None, :] / a[:, None, None]
    xx, xy, yy = slopes[:, 0, 0], slopes[:, 0, 1], slopes[:, 1, 1]
    return 2 / (xx + yy - np.hypot(xx - yy, 2 * xy))


def _well_known(information: Array) -> Bools:
    """Where the points tell all five numbers of an ellipse, far from rounding."""
    size = np.sqrt(np.einsum("mii->mi", information))
    normed = information / (size[:, :, None] * size[:, None, :])
    finite = np.isfinite(normed).all(axis=(1, 2))
    normed = np.where(finite[:, None, None], normed, np.eye(5))
    try:
        # Positive definite, all of them, as nearly always: told in a sixth of the time.
        np.linalg.cholesky(normed - WEAK * np.eye(5))
    except np.linalg.LinAlgError:
        return finite & (np.linalg.eigvalsh(normed)[:, 0] > WEAK)
    return finite


def nearest_elsewhere(found: Found, rows: NDArray[np.intp], starts: Array, setup: eq.Setup, origin: Array) -> Bools:
    """Where (K,) a search on the sums from other planes (K, 3) ends at a lower cost than the one found.

    For spots (K,) whose answer is doubtful: the sums tell the costs of all ellipses near the points.
    """
    function, images, planes = found.quadratic.take(rows), Images.of(setup), starts
    origin = origin[rows]
    with np.errstate(all="ignore"):
        for _ in range(_INNER_FAR):
            step, squared, cost = _step_on(function, planes, images, origin)
            if np.all(squared < 1e-6 * np.maximum(1.0, cost)):
                break
            step = np.where(np.isfinite(step), step, 0.0)
            planes = planes + step * share_within(planes, step, setup)[:, None]
        _, squared, cost = _step_on(function, planes, images, origin)
    # A lower cost on the way down is a lower cost, settled or not.
    return ~(np.isfinite(squared) & (cost >= function.cost * (1 - 1e-6)))
