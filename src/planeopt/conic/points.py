"""What can be said about points and an ellipse: signed distances, angles round it, how much of it they cover."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ellipeinc

from planeopt.conic.ellipse import FloatArray, as_coefficients, geometric_from_conic
from planeopt.errors import InputError

GAP_IN_SPACINGS = 3.0
"""A gap between neighbouring points wider than this many typical spacings counts as uncovered."""

SPACING_QUANTILE = 0.8
"""Quantile of the gaps, the widest left aside, that is called the typical spacing."""

# Relative. Of evenly spaced points with two missing the gap is three spacings, but for rounding, which must not decide.
_TIE = 1e-6

# Longest arc, rad, whose length is taken by a rule; SciPy's integral takes twenty times as long.
_SHORT = 0.2


def as_points(points: ArrayLike) -> FloatArray:
    """Return points as an array (..., N, 2), or say what shape was given instead.

    Raises
    ------
    InputError
        The array has no axis of points, or the points do not have two coordinates.
    """
    array = np.asarray(points, dtype=float)
    if array.ndim < 2 or array.shape[-1] != 2:
        raise InputError(f"points must have shape (..., N, 2); it is {array.shape}")
    return array


def sampson_distances(B: ArrayLike, points: ArrayLike, point_covariance: ArrayLike | None = None) -> FloatArray:
    """Return signed first-order distances of points from a conic, negative inside an ellipse.

    `Q / sqrt(g' V g)`, Q the left side of (16) at the point, g its gradient, V the point's covariance.

    Parameters
    ----------
    B : (..., 5) array
        Conics.
    points : (..., N, 2) array
        Points.
    point_covariance : (..., N, 2, 2) array, optional
        Covariance of each point; leading dimensions and N broadcast.

    Returns
    -------
    (..., N) array
        In standard deviations of that distance if `point_covariance` is given, else in the unit of the points.
    """
    B, points = as_coefficients(B)[..., None, :], as_points(points)
    x, y = points[..., 0], points[..., 1]
    value = x * (x + B[..., 0] * y + B[..., 2]) + y * (B[..., 1] * y + B[..., 3]) + B[..., 4]
    gx = 2 * x + B[..., 0] * y + B[..., 2]
    gy = B[..., 0] * x + 2 * B[..., 1] * y + B[..., 3]
    if point_covariance is None:
        return value / np.hypot(gx, gy)
    V = np.asarray(point_covariance, dtype=float)
    return value / np.sqrt(V[..., 0, 0] * gx**2 + 2 * V[..., 0, 1] * gx * gy + V[..., 1, 1] * gy**2)


def eccentric_angles(B: ArrayLike, points: ArrayLike) -> FloatArray:
    """Return the eccentric angle, shape (..., N), rad in (-pi, pi], of each point, from the major axis.

    The ellipse is `centre + a cos(t) u + b sin(t) v`, u along the major axis and v a quarter turn from it (x to y).

    Raises
    ------
    InputError
        A conic is not a real ellipse.
    """
    ellipse, points = geometric_from_conic(B), as_points(points)
    # Coordinate by coordinate: side by side they would be walked with gaps.
    x, y = points[..., 0] - ellipse.centre[..., :1], points[..., 1] - ellipse.centre[..., 1:]
    cos, sin = np.cos(ellipse.angle)[..., None], np.sin(ellipse.angle)[..., None]
    major, minor = ellipse.semi_axes[..., :1], ellipse.semi_axes[..., 1:]
    along = x * (cos / major)
    along += y * (sin / major)
    across = y * (cos / minor)
    across -= x * (sin / minor)
    return np.arctan2(across, along)


def arc_fraction(B: ArrayLike, points: ArrayLike, counts: ArrayLike | None = None) -> FloatArray:
    """Return the fraction, shape (...), of the ellipse in eccentric angle that the points cover.

    Neighbouring points cover what lies between them unless the gap is wider than three typical spacings, measured both
    as eccentric angle and as length along the ellipse (evenly spaced points of a long ellipse are even in one of the
    two only). The typical spacing is the 80 % quantile of the gaps, the widest left aside: repeated points and a few
    missing stretches do not move it, and points placed at random lose about 5 %. Points that reach all round give 1;
    five points on one arc give the arc between the first and the last.

    Parameters
    ----------
    B : (..., 5) array
        Ellipses.
    points : (..., N, 2) array
        Points.
    counts : (...) array of int, optional
        How many of them count, where rows were filled up by repeating some of their points; all unless given.

    Raises
    ------
    InputError
        A conic is not a real ellipse, or there are fewer than 5 points.
    """
    points = as_points(points)
    own = np.asarray(points.shape[-2] if counts is None else counts, dtype=int)
    fewest = int(np.min(own, initial=points.shape[-2]))
    if fewest < 5:
        raise InputError(f"{fewest} points given; 5 are needed to say how much of an ellipse they cover")
    angles = np.sort(eccentric_angles(B, points), axis=-1)
    gaps = np.empty_like(angles)
    np.subtract(angles[..., 1:], angles[..., :-1], out=gaps[..., :-1])
    gaps[..., -1] = angles[..., 0] + 2 * np.pi - angles[..., -1]
    wide = _is_wide(gaps, own)
    covered = np.ones(wide.shape[:-1])
    # Where no gap is wide in angle, lengths do not matter.
    some = np.any(wide, axis=-1)
    if not np.any(some):
        return covered
    semi_axes = np.broadcast_to(geometric_from_conic(B).semi_axes, (*some.shape, 2))[some]
    begin, gap = angles[some], gaps[some]
    lengths = _arc_lengths(begin, gap, 1 - (semi_axes[:, 1:] / semi_axes[:, :1]) ** 2)
    uncovered = wide[some] & _is_wide(lengths, np.broadcast_to(own, some.shape)[some])
    covered[some] = 1 - np.sum(np.where(uncovered, gap, 0.0), axis=-1) / (2 * np.pi)
    return covered


def _is_wide(gaps: FloatArray, counts: np.ndarray) -> np.ndarray:
    """Tell gaps (..., N) wider than some typical ones; the widest is left aside for the quantile.

    Points in excess of counts, (...) or one for all, are repeated: their gaps are zero, and the first in order.
    """
    ranks = gaps.shape[-1] - counts + (SPACING_QUANTILE * (counts - 2)).astype(int)
    places = np.unique(ranks)
    if len(places) == 1:
        typical = np.partition(gaps, places[0], axis=-1)[..., places[0], None]
    else:
        ranks = np.broadcast_to(ranks, gaps.shape[:-1])
        typical = np.take_along_axis(np.sort(gaps, axis=-1), ranks[..., None], axis=-1)
    return gaps > GAP_IN_SPACINGS * (1 + _TIE) * typical


def _arc_lengths(begin: FloatArray, gap: FloatArray, modulus: FloatArray) -> FloatArray:
    """Return lengths (K, N) of arcs from eccentric angles on, in major semi-axes; modulus (K, 1) of the ellipses.

    Short arcs by Gauss's rule of two points: of the fifth order in the gap.
    """
    lengths = np.zeros_like(gap)
    for place in (0.5 - 0.75**0.5 / 3, 0.5 + 0.75**0.5 / 3):
        lengths += np.sqrt(1 - modulus * np.cos(begin + place * gap) ** 2)
    lengths *= gap / 2
    long = gap > _SHORT
    m = np.broadcast_to(modulus, gap.shape)[long]
    start, end = begin[long], begin[long] + gap[long]
    lengths[long] = ellipeinc(np.pi / 2 - start, m) - ellipeinc(np.pi / 2 - end, m)
    return lengths
