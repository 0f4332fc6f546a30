"""Boundary points and their noise, checked and brought to the coordinates in which the fits compute."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from planeopt.conic.ellipse import BoolArray, FloatArray
from planeopt.conic.points import as_points
from planeopt.errors import InputError

EPS = float(np.finfo(float).eps)

FLATTEST = 1e-7
"""Points narrower than this fraction of their length are on a line: an ellipse so long has no width in doubles."""

SYMMETRY_TOLERANCE = 1e-9
"""Covariances carried through Jacobians are symmetric up to rounding; more than this is a mistake."""


class Verdict(IntEnum):
    """What became of one set of points; only `OK` has an ellipse."""

    OK = 0
    NOT_FINITE = 1
    BAD_NOISE = 2
    TOO_FEW = 3
    LINE = 4
    LINE_PAIR = 5
    HYPERBOLA = 6
    PARABOLA = 7
    IMAGINARY = 8
    NOT_CONVERGED = 9


@dataclass(frozen=True, slots=True)
class Sample:
    """K sets of N points in local coordinates `u = (x - origin) / unit`.

    Attributes
    ----------
    u : (K, N, 2) array
        Points.
    cxx, cxy, cyy : (K, N) or (K, 1) arrays
        Their covariances.
    origin, unit : (K, 2) and (K,) arrays
        Centroid and a power of two near the points' RMS radius over sqrt(2).
    """

    u: FloatArray
    cxx: FloatArray
    cxy: FloatArray
    cyy: FloatArray
    origin: FloatArray
    unit: FloatArray

    def take(self, selection: slice | np.ndarray) -> "Sample":
        """Return the sets that `selection` picks."""
        fields = (self.u, self.cxx, self.cxy, self.cyy, self.origin, self.unit)
        return Sample(*(field[selection] for field in fields))


def _flat_noise(noise: ArrayLike | None, lead: tuple[int, ...], n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return cxx, cxy, cyy, each (K, N) or (K, 1) (views where the noise is shared), from sigma or covariances."""
    sets = int(np.prod(lead, dtype=int))
    given = np.asarray(1.0 if noise is None else noise, dtype=float)
    full = given.ndim >= 3 and given.shape[-2:] == (2, 2)
    parts = (given[..., 0, 0], given[..., 0, 1], given[..., 1, 1]) if full else (given,)
    columns = 1 if parts[0].ndim == 0 else n
    try:
        parts = tuple(np.broadcast_to(part, (*lead, columns)).reshape(sets, columns) for part in parts)
    except ValueError:
        raise InputError(
            f"noise must be a sigma, sigmas of shape (..., {n}) or covariances of shape (..., {n}, 2, 2) to match the "
            f"points; its shape is {given.shape}"
        ) from None
    if full:
        with np.errstate(over="ignore", invalid="ignore"):  # of infinite ones, refused set by set
            asymmetry = np.abs(given[..., 0, 1] - given[..., 1, 0])
            skew = np.any(asymmetry > SYMMETRY_TOLERANCE * np.abs(given[..., 0, 0] + given[..., 1, 1]))
        if skew:
            raise InputError("the points' covariances must be symmetric")
        return parts[0], parts[1], parts[2]
    with np.errstate(over="ignore"):
        variance = np.where(parts[0] > 0, parts[0] ** 2, np.nan)
    return variance, np.zeros_like(variance), variance


def prepare(points: ArrayLike, noise: ArrayLike | None) -> tuple[Sample, np.ndarray, tuple[int, ...]]:
    """Check points and noise, flatten the leading dimensions and go to local coordinates.

    Sets that cannot be used get a verdict, and evenly spaced points of a circle in place of theirs, so that the
    arithmetic of the others can run on whole arrays.

    Returns
    -------
    sample : Sample
        K sets.
    verdict : (K,) array of int
        `OK`, `NOT_FINITE`, `BAD_NOISE` or `LINE`.
    lead : tuple
        The leading dimensions, whose product is K.

    Raises
    ------
    InputError
        A shape is wrong or there are fewer than 5 points in every set.
    """
    array = as_points(points)
    lead, n = array.shape[:-2], array.shape[-2]
    if n < 5:
        raise InputError(f"{n} points given; an ellipse needs at least 5")
    x = array.reshape(-1, n, 2)
    cxx, cxy, cyy = _flat_noise(noise, lead, n)
    verdict = np.zeros(len(x), dtype=int)
    # NaN compares false, so that it is refused here too; so is what is too large to be multiplied.
    with np.errstate(over="ignore", invalid="ignore"):
        product = cxx * cyy
        positive = (cxx > 0) & (cyy > 0) & (product - cxy * cxy > 4 * EPS * product) & np.isfinite(cxx + cyy)
    verdict[~np.all(positive, axis=-1)] = Verdict.BAD_NOISE
    verdict[~np.all(np.isfinite(x), axis=(-1, -2))] = Verdict.NOT_FINITE
    sample = replace_unusable(_localise(x, cxx, cxy, cyy, verdict == 0), verdict != 0)
    # Compare widths, not their squares, with the flattest: the small eigenvalue of the scatter drowns in rounding.
    narrow = rms_width(sample.u) <= FLATTEST * np.sqrt(np.mean(np.sum(sample.u**2, axis=-1), axis=-1))
    verdict[narrow] = Verdict.LINE
    return replace_unusable(sample, narrow), verdict, lead


def _localise(x: FloatArray, cxx: FloatArray, cxy: FloatArray, cyy: FloatArray, usable: BoolArray) -> Sample:
    if not np.all(usable):
        x = np.where(usable[:, None, None], x, 0.0)
    origin = np.mean(x, axis=1)
    shifted = x - origin[:, None, :]
    radius = np.sqrt(np.mean(np.sum(shifted**2, axis=-1), axis=-1) / 2)
    # A power of two: scaling by it, and undoing it, rounds nothing.
    unit = np.ldexp(1.0, np.frexp(np.where(radius > 0, radius, 1.0))[1])
    scale = 1 / (unit * unit)[:, None]
    return Sample(shifted / unit[:, None, None], cxx * scale, cxy * scale, cyy * scale, origin, unit)


def replace_unusable(sample: Sample, unusable: BoolArray) -> Sample:
    """Return the sample with a unit circle of unit noise in place of the sets marked unusable, (K,)."""
    if not np.any(unusable):
        return sample
    angles = 2 * np.pi * np.arange(sample.u.shape[1]) / sample.u.shape[1]
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    mark = unusable[:, None]
    return Sample(
        np.where(mark[..., None], circle, sample.u),
        np.where(mark, 1.0, sample.cxx),
        np.where(mark, 0.0, sample.cxy),
        np.where(mark, 1.0, sample.cyy),
        sample.origin,
        sample.unit,
    )


def line_offsets(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points' distances (K, N) from their orthogonal line of best fit, and its normals (K, 2)."""
    x, y = u[..., 0], u[..., 1]
    sxx, sxy, syy = np.mean(x * x, axis=-1), np.mean(x * y, axis=-1), np.mean(y * y, axis=-1)
    direction = np.arctan2(2 * sxy, sxx - syy) / 2
    normal = np.stack([-np.sin(direction), np.cos(direction)], axis=-1)
    return x * normal[:, :1] + y * normal[:, 1:], normal


def rms_width(u: FloatArray) -> FloatArray:
    """Return the RMS distance (K,) of the points from their line of best fit."""
    offsets, _ = line_offsets(u)
    return np.sqrt(np.mean(offsets * offsets, axis=-1))
