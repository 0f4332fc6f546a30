"""Many sets of boundary points, checked, and the planes from which their searches begin."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt import equations as eq
from planeopt.closed_form import solve_both
from planeopt.conic import Verdict, fit_conic, is_ellipse
from planeopt.conic.estimators import taubin
from planeopt.conic.fits import scaled
from planeopt.conic.refusals import line_explains
from planeopt.conic.sample import prepare
from planeopt.conic.transport import conic_from_local
from planeopt.errors import InputError
from planeopt.estimation.descent import within_bounds
from planeopt.formulations.bounds import FARTHEST
from planeopt.formulations.problem import NOISE_FLOOR
from planeopt.spot.points import MIN_POINTS

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

START_POINTS = 32
"""Points of each spot that the start is made from."""

_UNUSABLE = (Verdict.NOT_FINITE, Verdict.BAD_NOISE, Verdict.TOO_FEW, Verdict.LINE, Verdict.LINE_PAIR)

# Of `taubin`'s spread: below it a family of conics passes through the points, to rounding far from the origin.
_UNDETERMINED = 1e-10

# Tried for an untilted plane.
_DEPTHS = 16


def check_robust(robust: float | None) -> None:
    """Refuse what are no degrees of freedom of Student's t.

    Raises
    ------
    InputError
        If they are not positive and finite.
    """
    if robust is not None and not 0 < robust < np.inf:
        raise InputError(f"robust must be a positive number of degrees of freedom, not {robust!r}")


@dataclass(frozen=True, eq=False)
class Sets:
    """Sets of boundary points, one a row, with all that is known of each."""

    points: Array
    noise: Array
    """(M, 1), (M, N) or (M, N, 2, 2)."""
    setup: eq.Setup
    counts: NDArray[np.int64]
    start: Array
    robust: float | None
    known: Bools
    factor: Array
    """What the noise was multiplied by, (M,)."""

    @classmethod
    def of(
        cls,
        points: ArrayLike,
        noise: ArrayLike | None,
        setup: eq.Setup,
        counts: ArrayLike | None,
        start: ArrayLike | None,
        robust: float | None,
        scale_known: ArrayLike,
    ) -> "Sets":
        xy = np.asarray(points, dtype=float)
        if xy.ndim != 3 or xy.shape[2] != 2:
            raise InputError(f"points must have shape (M, N, 2), mm, not {xy.shape}")
        check_robust(robust)
        m, n = xy.shape[:2]
        sigma = np.asarray(1.0 if noise is None else noise, dtype=float)
        if sigma.shape not in ((), (m, n), (m, n, 2, 2)):
            raise InputError(f"noise must be one sigma, or of shape {(m, n)} or {(m, n, 2, 2)}, not {sigma.shape}")
        known = np.broadcast_to(np.asarray(scale_known, dtype=bool) & (noise is not None), (m,))
        used = np.full(m, n) if counts is None else np.asarray(counts, dtype=int)
        if used.shape != (m,) or np.any(used < 0) or np.any(used > n):
            raise InputError(f"counts must be {m} whole numbers from 0 to {n}")
        first = np.full((m, 3), np.nan) if start is None else np.asarray(start, dtype=float)
        if first.shape != (m, 3):
            raise InputError(f"start must have shape {(m, 3)}, not {first.shape}")
        sigma = np.broadcast_to(sigma, (m, 1)) if sigma.ndim == 0 else sigma
        return cls(xy, sigma, setup, used, first, robust, known, np.ones(m))

    def take(self, rows: NDArray[np.intp]) -> "Sets":
        """Some rows, no longer than they need to be."""
        n = int(np.max(self.counts[rows], initial=0))
        return Sets(
            self.points[rows, :n],
            self.noise[rows, :n] if self.noise.shape[1] > 1 else self.noise[rows],
            self.setup,
            self.counts[rows],
            self.start[rows],
            self.robust,
            self.known[rows],
            self.factor[rows],
        )

    def filled(self) -> "Sets":
        """With each row's own points, repeated, where it has none."""
        n = self.points.shape[1]
        if np.all(self.counts == n):
            return self
        index = np.arange(n) % np.maximum(self.counts, 1)[:, None]
        rows = np.arange(len(index))[:, None]
        noise = self.noise[rows, index] if self.noise.shape[1] > 1 else self.noise
        return replace(self, points=self.points[rows, index], noise=noise)

    def floored(self) -> "Sets":
        """With the noise at the floor where its scale is unknown, and not below it where it was given.

        As `planeopt.formulations.Problem.from_points` has it.
        """
        factor = self.floor()[0]
        size = factor**2 if self.noise.ndim == 4 else factor
        return replace(self, noise=self.noise * size.reshape(-1, *[1] * (self.noise.ndim - 1)), factor=factor)

    def floor(self) -> tuple[Array, Array]:
        """What `floored` multiplies sigmas by (M,), and the typical sigma (M,) before, mm."""
        typical = medians(self.variance, self.counts)
        floors = NOISE_FLOOR**2 * np.maximum(self.spread2, 0.0) / typical
        return np.sqrt(np.where(self.known, np.maximum(1.0, floors), floors)), np.sqrt(typical)

    @property
    def variance(self) -> Array:
        """Mean variance of the points, (M, N) or (M, 1), mm^2."""
        if self.noise.ndim == 4:
            return (self.noise[..., 0, 0] + self.noise[..., 1, 1]) / 2
        return self.noise**2

    def usable(self) -> Bools:
        """Rows (M,) of at least five finite points whose noise is a noise."""
        if self.noise.ndim == 4:
            xx, xy, yy = self.noise[..., 0, 0], self.noise[..., 0, 1], self.noise[..., 1, 1]
            product = xx * yy
            positive = (xx > 0) & (yy > 0) & (product > xy * xy) & np.isfinite(product)
        else:
            variance = self.variance
            positive = (self.noise > 0) & (variance > 0) & np.isfinite(variance)
        return np.isfinite(self.spread2) & positive.all(axis=1) & (self.counts >= MIN_POINTS)

    @property
    def spread2(self) -> Array:
        """Mean squared distance (M,) of the points from their mean, mm^2; not finite where a point is not."""
        x, y = self.points[..., 0], self.points[..., 1]
        mean2 = np.mean(x, axis=1) ** 2 + np.mean(y, axis=1) ** 2
        return (np.einsum("mn,mn->m", x, x) + np.einsum("mn,mn->m", y, y)) / x.shape[1] - mean2


def medians(rows: Array, counts: NDArray[np.int64]) -> Array:
    """Medians (M,) of the first so many of rows (M, N), or of one number for all, (M, 1); with no loop over rows."""
    n = rows.shape[1]
    if n == 1 or np.all(counts == n):
        # `numpy.median` takes three times as long.
        ordered = np.partition(rows, n // 2, axis=1)
        upper = ordered[:, n // 2]
        return upper if n % 2 else (upper + np.max(ordered[:, : n // 2], axis=1)) / 2
    ordered = np.sort(np.where(np.arange(n) < counts[:, None], rows, np.inf), axis=1)
    middle = np.stack([np.maximum(counts - 1, 0) // 2, counts // 2], axis=1)
    return np.mean(np.take_along_axis(ordered, middle, axis=1), axis=1)


@dataclass(frozen=True, eq=False)
class Starts:
    """Where searches begin.

    Attributes
    ----------
    planes : (M, 3)
        Within the bounds.
    sure : (M,) of bool
        Whether they are the closed form of a sound ellipse; others may lead to a local minimum.
    straight : (M,) of bool
        Whether the points lie on lines: there is nothing to search.
    """

    planes: Array
    sure: Bools
    straight: Bools


def closed_form_starts(given: Sets) -> Starts:
    """Closed form of Taubin's ellipse through some of each row's points."""
    m, n = given.points.shape[:2]
    points, noise = given.points, given.noise
    if n > START_POINTS:
        # Rows of a piece are of about one length: what is past the end of one is its own points again.
        some = np.arange(START_POINTS) * n // START_POINTS
        points = points[:, some]
        noise = noise[:, some] if noise.shape[1] > 1 else noise
    sample, verdict, _ = prepare(points, noise)
    theta, spread = taubin(sample)
    local = scaled(theta)
    sound = (verdict == Verdict.OK) & is_ellipse(local) & (spread > _UNDETERMINED)
    sound &= ~line_explains(sample, local, scale_unknown=False)
    with np.errstate(all="ignore"):  # what is unsound is tried again below
        planes = solve_both(conic_from_local(local, sample.origin, sample.unit), given.setup).visible
    sure = sound & within_bounds(planes, given.setup)
    straight = np.zeros(m, dtype=bool)
    lost = np.flatnonzero(~sure)
    if len(lost):
        planes[lost], straight[lost] = _direct(given.take(lost).filled())
    return Starts(planes, sure, straight)


def direct_planes(given: Sets) -> Array:
    """Closed form (M, 3) of the direct fit to all points: always an ellipse, though too small on short arcs."""
    return _direct(given)[0]


def _direct(given: Sets) -> tuple[Array, Bools]:
    """`direct_planes`, and which rows' points lie on lines."""
    fit = fit_conic(given.points, given.noise, "direct", check=False)
    planes = solve_both(fit.B, given.setup).visible
    good = within_bounds(planes, given.setup)
    planes = planes if np.all(good) else np.where(good[:, None], planes, untilted_planes(given))
    return planes, np.isin(fit.verdict, _UNUSABLE)


def untilted_planes(given: Sets) -> Array:
    """Untilted planes (M, 3), the best of some depths: their images are circles about ``e f/z`` of radius ``r f/z``.

    Points of an arc scatter less than those of the whole ellipse, by as much as ten times.
    """
    f, e_x, e_y, r = given.setup
    x, y = given.points[..., 0], given.points[..., 1]
    size = np.sqrt(np.maximum(given.spread2, np.finfo(float).tiny))
    best, planes = np.full(len(size), np.inf), np.zeros((len(size), 3))
    for share in np.geomspace(0.5, 10.0, _DEPTHS):
        scale = np.clip(share * size / r, 2 * f / (FARTHEST * r), np.inf)
        away = np.hypot(x - scale[:, None] * e_x, y - scale[:, None] * e_y) - scale[:, None] * r
        misfit = np.einsum("mi,mi->m", away, away)
        better = misfit < best
        best, planes[:, 0] = np.where(better, misfit, best), np.where(better, f / scale, planes[:, 0])
    return planes
