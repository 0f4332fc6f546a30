"""Maximum likelihood for many sets of boundary points on the laser-parallel image plane: arrays in, arrays out."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.special
from numpy.typing import ArrayLike, NDArray

from planeopt import equations as eq
from planeopt.estimation import evidence
from planeopt.estimation.descent import Descent, Loss, at_planes, descend, solve_all, within_bounds
from planeopt.estimation.feet import Boundary
from planeopt.estimation.regular import FEW, Found, nearest_elsewhere, search
from planeopt.estimation.sets import Sets, Starts, closed_form_starts, direct_planes, untilted_planes
from planeopt.estimation.tangents import Cloud
from planeopt.formulations.bounds import FARTHEST, STEEPEST
from planeopt.solution import Status
from planeopt.spot.points import MIN_POINTS

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

CHUNK = 1 << 16
"""Points worked on at once: the arrays of one piece stay in the processor's cache."""

STATUSES = tuple(Status)
"""`PointsSolution.codes` count in it."""

DEFICIENT = 1e-13
"""Smallest eigenvalue of an information matrix scaled to ones on its diagonal that is more than rounding."""

# Bytes; less than the 32 MiB at which glibc stops to learn.
_KEPT = 24 << 20

# Longest over shortest row of a piece.
_ALIKE = 1.25

# Relative distance from the edge of what can be seen at which a plane counts as being on it.
_EDGE = 1e-6


@dataclass(frozen=True, eq=False)
class PointsSolution:
    """Maximum-likelihood planes, a row a spot; NaN where there is no number, and `codes` says why.

    Attributes
    ----------
    planes : (M, 3)
        ``(z_L, p, q)`` in the equations' sense (`z_L` the spot centre's z in the laser-parallel frame); mm, 1, 1.
    covariance : (M, 3, 3)
        Of the planes, to first order, from the points alone.
    cost : (M,)
        Sum of squared distances in standard deviations, weighted where robust: chi-squared with N - 3 degrees of
        freedom where the noise was given and right.
    chi2 : (M,)
        The part of it that another ellipse would explain and no plane does: chi-squared with 2 degrees of freedom, or
        twice an F variable with 2 and `scale_dof` where the scale was estimated; tests the rig.
    scale : (M,)
        What the given noise was multiplied by: 1, or its estimated scale (sigma in mm where no noise was given).
    scale_dof : (M,) of int
        Degrees of freedom behind an estimated scale; -1 where it was given.
    floored : (M,) of bool
        Whether the residuals were at rounding level and the noise was set to a floor.
    counts : (M,) of int
        Points of each row.
    codes : (M,) of int
        Index into `STATUSES`.
    steps : (M,) of int
        Of Gauss-Newton.
    """

    planes: Array
    covariance: Array
    cost: Array
    chi2: Array
    scale: Array
    scale_dof: NDArray[np.int64]
    floored: Bools
    counts: NDArray[np.int64]
    codes: NDArray[np.int64]
    steps: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.planes)

    @property
    def status(self) -> tuple[Status, ...]:
        """A status a row."""
        return tuple(STATUSES[code] for code in self.codes)

    @property
    def ok(self) -> Bools:
        """Where the plane was found and image and rig agree, (M,)."""
        return self.codes == STATUSES.index(Status.CONVERGED)


def solve_points(
    points: ArrayLike,
    noise: ArrayLike | None,
    setup: eq.Setup,
    *,
    counts: ArrayLike | None = None,
    start: ArrayLike | None = None,
    robust: float | None = None,
    scale_known: ArrayLike = True,
) -> PointsSolution:
    """Find the planes whose spots' images lie nearest to the points, many at once.

    Parameters
    ----------
    points : (M, N, 2)
        On the laser-parallel image plane, mm.
    noise : scalar, (M, N) or (M, N, 2, 2), or None
        Standard deviations (mm) or covariances (mm^2). None: equal and isotropic, with an unknown scale.
    setup : Setup
        ``f, e_x, e_y, r``, mm.
    counts : (M,) of int, optional
        The first so many points of each row are used; all unless given.
    start : (M, 3), optional
        Planes to begin with, NaN for the closed form; rows that get nowhere begin again from the closed form.
    robust : float, optional
        Degrees of freedom of Student's t, whose scale is the noise. The covariance is then that of this model.
    scale_known : bool or (M,) of bool
        False where the noise is right only up to a common factor, estimated from the residuals.

    Returns
    -------
    PointsSolution
        What is wrong with a row costs that row only.

    Raises
    ------
    InputError
        If a shape does not fit, or `robust` is not positive.
    """
    given = Sets.of(points, noise, setup, counts, start, robust, scale_known)
    keep_memory()
    found = blank(len(given.counts), given.counts)
    for rows, _ in alike(given.counts, CHUNK):
        _put(found, rows, solve_piece(given.take(rows)).solution)
    return found


def keep_memory() -> None:
    """Have glibc keep the memory of arrays up to some size, instead of returning it page by page after each piece.

    It does so once a larger array was freed; more than half the time went there. Elsewhere this does nothing, and it
    touches no memory.
    """
    np.empty(_KEPT, dtype=np.uint8)


def alike(counts: NDArray[np.int64], chunk: int) -> Iterator[tuple[NDArray[np.intp], int]]:
    """Rows (K,) of nearly the same length and the longest, piece by piece, so that little of a piece is padding."""
    order = np.argsort(counts, kind="stable")
    lengths = np.maximum(counts[order], 1)
    begin = 0
    while begin < len(order):
        end = int(np.searchsorted(lengths, _ALIKE * lengths[begin], side="right"))
        end = min(end, begin + max(1, chunk // int(lengths[end - 1])))
        yield order[begin:end], int(lengths[end - 1])
        begin = end


def improbability(chi2: Array, scale_dof: NDArray[np.int64]) -> Array:
    """p-value (M,) of `PointsSolution.chi2`: of chi-squared with 2 degrees of freedom, or of its F counterpart."""
    dof = np.maximum(scale_dof, 1)
    return np.where(scale_dof < 0, np.exp(-chi2 / 2), (1 + chi2 / dof) ** (-dof / 2))


def blank(m: int, counts: NDArray[np.int64]) -> PointsSolution:
    """Rows of which nothing can be said."""
    nan = np.full(m, np.nan)
    return PointsSolution(
        planes=np.full((m, 3), np.nan),
        covariance=np.full((m, 3, 3), np.nan),
        cost=nan.copy(),
        chi2=nan.copy(),
        scale=nan.copy(),
        scale_dof=np.full(m, -1),
        floored=np.zeros(m, dtype=bool),
        counts=counts,
        codes=np.full(m, STATUSES.index(Status.UNUSABLE)),
        steps=np.zeros(m, dtype=np.int64),
    )


def _put(into: PointsSolution, rows: NDArray[np.intp], values: PointsSolution) -> None:
    for field in fields(PointsSolution):
        getattr(into, field.name)[rows] = getattr(values, field.name)


@dataclass(frozen=True, eq=False)
class Piece:
    """Spots solved together.

    Attributes
    ----------
    solution : PointsSolution
    cloud : Cloud or None
        Their points, where any row could be used.
    feet : (6, M, N) array
        Monomials of the points' feet on the planes' ellipses, about the cloud's origins; not for rows that `regular`
        leaves out.
    regular : (M,) of bool
    factor : (M,)
        What the cloud's noise is of the given one.
    sigma : (M,)
        Typical standard deviation of the points as given, mm; NaN where none is usable.
    """

    solution: PointsSolution
    cloud: Cloud | None
    feet: Array
    regular: Bools
    factor: Array
    sigma: Array

    def take(self, rows: NDArray[np.intp]) -> "Piece":
        """Return some of the spots."""
        cloud = None if self.cloud is None else self.cloud.take(rows)
        feet = self.feet if self.cloud is None else self.feet[:, rows]
        solution = _rows(self.solution, rows)
        return Piece(solution, cloud, feet, self.regular[rows], self.factor[rows], self.sigma[rows])


def solve_piece(given: Sets) -> Piece:
    """Solve rows of nearly the same length, some ten thousand points: quickly where they are regular."""
    m, n = given.points.shape[:2]
    found, nan = blank(m, given.counts), np.full(m, np.nan)
    none = Piece(blank(m, given.counts), None, np.empty((6, 0, 0)), np.zeros(m, dtype=bool), np.ones(m), nan)
    if n < MIN_POINTS:
        return none
    given = given.filled()
    usable = given.usable()
    if not np.any(usable):
        return none
    with np.errstate(all="ignore"):  # of rows that are not usable
        factor, typical = given.floor()
    if given.robust is not None or n < FEW or np.isfinite(given.start).any():
        rows = np.flatnonzero(usable)
        _put(found, rows, _solve_rows(given if len(rows) == m else given.take(rows).filled()))
        return replace(none, solution=found, sigma=typical)
    used = None if np.all(given.counts == n) else np.arange(n) < given.counts[:, None]
    cloud = Cloud.of(given.points, given.noise, factor, used)
    fast = search(cloud, given.setup, given.counts, given.known)
    judged = _of_regular(fast, replace(given, factor=factor))
    _put(found, np.arange(m), judged)
    regular = fast.regular & usable & ~np.isin(judged.codes, _NOWHERE)
    doubtful = np.flatnonzero(regular & (np.isin(judged.codes, _POOR) | _scattered(judged, given)))
    if len(doubtful):
        regular[doubtful[_is_lower_elsewhere(fast, doubtful, cloud, given.setup)]] = False
    others = np.flatnonzero(usable & ~regular)
    if len(others):
        _put(found, others, _solve_rows(given.take(others).filled()))
    lost = np.flatnonzero(~usable)
    if len(lost):
        _put(found, lost, _rows(none.solution, lost))
    return Piece(found, cloud, fast.feet, regular, factor, typical)


def _is_lower_elsewhere(fast: Found, rows: NDArray[np.intp], cloud: Cloud, setup: eq.Setup) -> Bools:
    """Whether a search for some rows ends nearer to the points if it starts untilted, or tilted to the other side."""
    planes = fast.planes[rows]
    lower = np.zeros(len(rows), dtype=bool)
    for slopes in (0.0, -1.0):
        starts = planes * [1.0, slopes, slopes]
        starts = np.where(within_bounds(starts, setup)[:, None], starts, planes * [1.0, 0.0, 0.0])
        lower |= nearest_elsewhere(fast, rows, starts, setup, cloud.origin)
    return lower


def _of_regular(fast: Found, given: Sets) -> PointsSolution:
    """Covariances, evidence and statuses of planes by the sums over their points."""
    by_plane, quadratic = fast.by_plane, fast.quadratic
    with np.errstate(all="ignore"):  # what is not regular is done again
        information = np.swapaxes(by_plane, 1, 2) @ quadratic.information @ by_plane
        sums = _Sums(information, quadratic.information, quadratic.score, quadratic.cost)
        return _concluded(fast.planes, sums, given, fast.regular, fast.rounds, np.ones(len(given.counts)), 1.0)


def _solve_rows(given: Sets) -> PointsSolution:
    """Solve rows of which nothing is taken for granted but that their numbers are numbers."""
    found = blank(len(given.counts), given.counts)
    rows = np.arange(len(found))
    given = given.floored()
    starts = closed_form_starts(given)
    kept = np.flatnonzero(~starts.straight)
    if len(kept) < len(rows):
        rows, given = rows[kept], given.take(kept).filled()
        starts = Starts(starts.planes[kept], starts.sure[kept], starts.straight[kept])
    if not len(rows):
        return found
    told = within_bounds(given.start, given.setup)
    best = _solve_from(np.where(told[:, None], given.start, starts.planes), given)
    # Which may be a local minimum: the others are looked for.
    doubtful = np.flatnonzero(~(starts.sure | told) | np.isin(best.codes, _POOR) | _scattered(best, given))
    if len(doubtful):
        part = given.take(doubtful).filled()
        for other in (direct_planes(part), untilted_planes(part), starts.planes[doubtful]):
            _keep_nearer(best, doubtful, _solve_from(other, part))
    _put(found, rows, best)
    return found


def _scattered(solution: PointsSolution, given: Sets) -> Bools:
    """Where the points scatter about the plane's ellipse by more than their given noise."""
    excess = scipy.special.chdtrc(np.maximum(solution.counts - 3, 1), solution.cost) < evidence.IMPROBABLE
    return given.known & excess & (given.robust is None)


def _keep_nearer(best: PointsSolution, rows: NDArray[np.intp], other: PointsSolution) -> None:
    """Write those of the other answers to some rows that are nearer to the points than the best so far."""
    reached = ~np.isin(other.codes, _NOWHERE)
    nearer = other.cost * other.scale**2 < best.cost[rows] * best.scale[rows] ** 2 * (1 - 1e-9)
    better = np.flatnonzero(reached & (np.isin(best.codes[rows], _NOWHERE) | nearer))
    _put(best, rows[better], _rows(other, better))


def _code(status: Status) -> int:
    return STATUSES.index(status)


_NOWHERE = [_code(status) for status in (Status.NOT_CONVERGED, Status.AT_BOUND, Status.UNIDENTIFIABLE)]
_POOR = [*_NOWHERE, _code(Status.INCONSISTENT)]


def _rows(solution: PointsSolution, rows: NDArray[np.intp]) -> PointsSolution:
    return PointsSolution(*(getattr(solution, field.name)[rows] for field in fields(PointsSolution)))


def _solve_from(start: Array, given: Sets) -> PointsSolution:
    n = given.points.shape[1]
    used = None if np.all(given.counts == n) else np.arange(n) < given.counts[:, None]
    boundary = Boundary.of(given.points, given.noise, used)
    loss = Loss(given.robust, ~given.known)
    return _judged(descend(boundary, given.setup, start, given.counts, loss), boundary, loss, given)


def _judged(ended: Descent, boundary: Boundary, loss: Loss, given: Sets) -> PointsSolution:
    """Covariances, evidence and statuses at the planes where the rows ended."""
    counts = given.counts
    with np.errstate(all="ignore"):  # rows that got nowhere say so by their status
        conics, found, monomials = at_planes(ended.planes, boundary, given.setup, ended.multiplier)
        rows = np.empty((len(counts), 9, found.distance.shape[-1]))
        np.matmul(conics.by_plane, monomials, out=rows[:, :3])
        rows[:, 3:8] = monomials[:, 1:]
        rows[:, :8] *= found.rate[:, None, :]
        scale = loss.scale(found.distance, counts, ended.scale)
        rows[:, 8] = found.distance
        products = rows @ np.swapaxes(rows, -1, -2)
        cost = products[:, 8, 8]
        score = products[:, 3:8, 8]
        if loss.robust is not None:
            weighted = loss.weights(found.distance, scale) * scale[:, None] ** 2 * found.distance
            cost = np.einsum("mi,mi->m", weighted, found.distance)
            score = np.einsum("mki,mi->mk", rows[:, 3:8], weighted)
        sums = _Sums(products[:, :3, :3], products[:, 3:8, 3:8], score, cost)
        return _concluded(ended.planes, sums, given, ended.converged, ended.steps, scale, loss.information)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over the points of squares and products of the distances, in standard deviations, and their derivatives."""

    by_plane: Array
    """(M, 3, 3), by planes with planes."""
    by_ellipse: Array
    """(M, 5, 5), by five coordinates of an ellipse."""
    score: Array
    """(M, 5), distances with derivatives by these."""
    cost: Array
    """(M,), distances squared."""


def _concluded(
    planes: Array,
    sums: _Sums,
    given: Sets,
    converged: Bools,
    steps: NDArray[np.int64],
    scale: Array,
    information: float,
) -> PointsSolution:
    """Covariances, evidence and statuses; `scale` and `information` are of the loss."""
    counts = given.counts
    chi2 = _explained(sums.by_ellipse, sums.score) / information
    inverse, weakest = _inverse(sums.by_plane)
    scale_dof = np.where(given.known, -1, counts - 5)
    if given.robust is None:
        free2 = np.maximum(1.0, (sums.cost - chi2) / np.maximum(scale_dof, 1))
    else:
        free2 = np.maximum(1.0, scale**2 * counts / np.maximum(counts - 3, 1))
    scale2 = np.where(scale_dof > 0, free2, 1.0)
    solution = PointsSolution(
        planes=planes,
        covariance=inverse * (scale2 / information)[:, None, None],
        cost=sums.cost / scale2,
        chi2=chi2 / scale2,
        scale=given.factor * np.sqrt(scale2),
        scale_dof=scale_dof,
        floored=np.where(given.known, given.factor > 1, (scale_dof > 0) & (scale2 == 1)),
        counts=counts,
        codes=np.full(len(counts), _code(Status.CONVERGED)),
        steps=steps,
    )
    _judge(solution, converged, weakest, given.setup)
    return solution


def _explained(information: Array, score: Array) -> Array:
    """``score' information^-1 score`` (M,)."""
    size = np.sqrt(np.einsum("mii->mi", information))
    normed = _regular(information / (size[:, :, None] * size[:, None, :]))
    right = np.nan_to_num(score / size)
    return np.sum(solve_all(normed, right) * right, axis=-1)


def _inverse(information: Array) -> tuple[Array, Array]:
    """Inverses (M, 3, 3), and the smallest eigenvalues (M,) of the matrices scaled to ones on the diagonal."""
    size = np.sqrt(np.einsum("mii->mi", information))
    normed = _regular(information / (size[:, :, None] * size[:, None, :]))
    weakest = np.asarray(np.linalg.eigvalsh(normed)[:, 0], dtype=float)
    normed = np.where((weakest > DEFICIENT)[:, None, None], normed, np.eye(3))
    inverse = np.asarray(np.linalg.inv(normed), dtype=float)
    return inverse / (size[:, :, None] * size[:, None, :]), weakest


def _regular(matrices: Array) -> Array:
    """The matrices with the identity in place of what is not finite, and all of them kept invertible."""
    eye = np.eye(matrices.shape[-1])
    finite = np.isfinite(matrices).all(axis=(-1, -2), keepdims=True)
    return np.where(finite, matrices, eye) + 1e-15 * eye


def _judge(solution: PointsSolution, converged: Bools, weakest: Array, setup: eq.Setup) -> None:
    """Write the codes, and NaN where there is no pose or no covariance."""
    z_L, p, q = solution.planes.T
    slope = np.hypot(p, q)
    lit = z_L - p * setup.e_x - q * setup.e_y
    edge = (z_L - setup.r * slope < _EDGE * z_L) | (lit < _EDGE * z_L)
    edge |= (z_L > FARTHEST * setup.r * (1 - _EDGE)) | (slope > np.tan(STEEPEST) * (1 - _EDGE))
    codes = solution.codes
    codes[solution.scale_dof == 0] = _code(Status.NO_NOISE_SCALE)
    known = solution.scale_dof != 0
    improbable = ~(improbability(solution.chi2, solution.scale_dof) >= evidence.IMPROBABLE)
    codes[known & improbable] = _code(Status.INCONSISTENT)
    codes[~(weakest > DEFICIENT)] = _code(Status.UNIDENTIFIABLE)
    codes[~converged] = _code(Status.NOT_CONVERGED)
    codes[edge] = _code(Status.AT_BOUND)
    nowhere = np.isin(codes, _NOWHERE)
    solution.planes[nowhere & ~edge] = np.nan
    solution.covariance[nowhere | ~known] = np.nan
    for values in (solution.chi2, solution.cost):
        values[~known] = np.nan
