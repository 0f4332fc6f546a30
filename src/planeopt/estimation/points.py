"""Maximum likelihood for many sets of boundary points on the laser-parallel image plane: arrays in, arrays out."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
from numpy.typing import ArrayLike, NDArray

from planeopt import equations as eq
from planeopt.estimation import evidence
from planeopt.estimation.descent import Descent, Loss, at_planes, descend, within_bounds
from planeopt.estimation.feet import Boundary
from planeopt.estimation.judged import (
    NOWHERE,
    POOR,
    PointsSolution,
    Sums,
    blank,
    concluded,
    put,
    rows_of,
)
from planeopt.estimation.regular import FEW, Found, nearest_elsewhere, search
from planeopt.estimation.sets import Sets, Starts, closed_form_starts, direct_planes, untilted_planes
from planeopt.estimation.tangents import Cloud
from planeopt.spot.points import MIN_POINTS

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

CHUNK = 1 << 16
"""Points worked on at once: what operations cost beside their arithmetic is shared, and the caches hold the arrays.

Twice as many are faster where all spots stay in the caches, and slower by a third where there are ten thousand.
"""

# Bytes; less than the 32 MiB at which glibc stops to learn.
_KEPT = 24 << 20

# Longest over shortest row of a piece.
_ALIKE = 1.25


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
        If a shape does not fit, or `robust` is not positive and finite.
    """
    given = Sets.of(points, noise, setup, counts, start, robust, scale_known)
    keep_memory()
    found = blank(len(given.counts), given.counts)
    for rows, _ in alike(given.counts, CHUNK):
        put(found, rows, solve_piece(given.take(rows).filled()).solution)
    return found


def keep_memory() -> None:
    """Have glibc keep the memory of arrays up to some size, instead of returning it page by page after each piece.

    It does so once a larger array was freed; more than half the time went there. Elsewhere this does nothing, and it
    touches no memory.
    """
    np.empty(_KEPT, dtype=np.uint8)


def alike(counts: NDArray[np.int64], chunk: int) -> Iterator[tuple[NDArray[np.intp], int]]:
    """Rows (K,) of nearly the same length and the longest, piece by piece, so that little of a piece is padding.

    Pieces have about `chunk` points at most, and where rows are of one length equally many: small ones cost more.
    """
    order = np.argsort(counts, kind="stable")
    lengths = np.maximum(counts[order], 1)
    begin = 0
    while begin < len(order):
        end = int(np.searchsorted(lengths, _ALIKE * lengths[begin], side="right"))
        pieces = -(-(end - begin) * int(lengths[end - 1]) // chunk)
        end = begin - (begin - end) // pieces
        yield order[begin:end], int(lengths[end - 1])
        begin = end


@dataclass(frozen=True, eq=False)
class Piece:
    """Spots solved together.

    Attributes
    ----------
    solution : PointsSolution
    cloud : Cloud or None
        Their points, where any row could be used.
    found : Found or None
        From the quick search, likewise; what it says of rows that `regular` leaves out means nothing.
    regular : (M,) of bool
    factor : (M,)
        What the cloud's noise is of the given one.
    sigma : (M,)
        Typical standard deviation of the points as given, mm; NaN where none is usable.
    """

    solution: PointsSolution
    cloud: Cloud | None
    found: Found | None
    regular: Bools
    factor: Array
    sigma: Array


def solve_piece(given: Sets) -> Piece:
    """Solve rows filled up to one length, some hundred thousand points: quickly where they are regular."""
    m, n = given.points.shape[:2]
    found, nan = blank(m, given.counts), np.full(m, np.nan)
    none = Piece(blank(m, given.counts), None, None, np.zeros(m, dtype=bool), np.ones(m), nan)
    if n < MIN_POINTS:
        return none
    with np.errstate(all="ignore"):  # of rows that are not usable
        usable = given.usable()
        if not np.any(usable):
            return none
        factor, typical = given.floor()
    if given.robust is not None or n < FEW or np.isfinite(given.start).any():
        rows = np.flatnonzero(usable)
        put(found, rows, _solve_rows(given if len(rows) == m else given.take(rows).filled()))
        return replace(none, solution=found, sigma=typical)
    used = None if np.all(given.counts == n) else np.arange(n) < given.counts[:, None]
    with np.errstate(all="ignore"):
        cloud = Cloud.of(given.points, given.noise, factor, used)
    fast = search(cloud, given.setup, given.counts, given.known)
    judged = _of_regular(fast, replace(given, factor=factor))
    put(found, np.arange(m), judged)
    regular = fast.regular & usable & ~np.isin(judged.codes, NOWHERE)
    doubtful = np.flatnonzero(regular & (np.isin(judged.codes, POOR) | _scattered(judged, given)))
    if len(doubtful):
        regular[doubtful[_is_lower_elsewhere(fast, doubtful, cloud, given.setup)]] = False
    others = np.flatnonzero(usable & ~regular)
    if len(others):
        put(found, others, _solve_rows(given.take(others).filled()))
    lost = np.flatnonzero(~usable)
    if len(lost):
        put(found, lost, rows_of(none.solution, lost))
    return Piece(found, cloud, fast, regular, factor, typical)


def _is_lower_elsewhere(fast: Found, rows: NDArray[np.intp], cloud: Cloud, setup: eq.Setup) -> Bools:
    """Whether a search for some rows ends nearer to the points if it starts untilted, or tilted to the other side."""
    planes, twice = fast.planes[rows], np.tile(rows, 2)
    starts = np.concatenate([planes * [1.0, slopes, slopes] for slopes in (0.0, -1.0)])
    starts = np.where(within_bounds(starts, setup)[:, None], starts, np.tile(planes * [1.0, 0.0, 0.0], (2, 1)))
    lower = nearest_elsewhere(fast, twice, starts, setup, cloud.origin)
    return lower[: len(rows)] | lower[len(rows) :]


def _of_regular(fast: Found, given: Sets) -> PointsSolution:
    """Covariances, evidence and statuses of planes by the sums over their points."""
    by_plane, quadratic = fast.by_plane, fast.quadratic
    with np.errstate(all="ignore"):  # what is not regular is done again
        information = np.swapaxes(by_plane, 1, 2) @ quadratic.information @ by_plane
        sums = Sums(information, quadratic.information, quadratic.score, quadratic.cost)
        return concluded(fast.planes, sums, given, fast.regular, fast.rounds, np.ones(len(given.counts)), 1.0)


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
    doubtful = np.flatnonzero(~(starts.sure | told) | np.isin(best.codes, POOR) | _scattered(best, given))
    if len(doubtful):
        part = given.take(doubtful).filled()
        for other in (direct_planes(part), untilted_planes(part), starts.planes[doubtful]):
            _keep_nearer(best, doubtful, _solve_from(other, part))
    put(found, rows, best)
    return found


def _scattered(solution: PointsSolution, given: Sets) -> Bools:
    """Where the points scatter about the plane's ellipse by more than their given noise."""
    excess = scipy.special.chdtrc(np.maximum(solution.counts - 3, 1), solution.cost) < evidence.IMPROBABLE
    return given.known & excess & (given.robust is None)


def _keep_nearer(best: PointsSolution, rows: NDArray[np.intp], other: PointsSolution) -> None:
    """Write those of the other answers to some rows that are nearer to the points than the best so far."""
    reached = ~np.isin(other.codes, NOWHERE)
    nearer = other.cost * other.scale**2 < best.cost[rows] * best.scale[rows] ** 2 * (1 - 1e-9)
    better = np.flatnonzero(reached & (np.isin(best.codes[rows], NOWHERE) | nearer))
    put(best, rows[better], rows_of(other, better))


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
        sums = Sums(products[:, :3, :3], products[:, 3:8, 3:8], score, cost)
        return concluded(ended.planes, sums, given, ended.converged, ended.steps, scale, loss.information)
