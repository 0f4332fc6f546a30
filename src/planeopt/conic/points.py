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
    offset = points - ellipse.centre[..., None, :]
    cos, sin = np.cos(ellipse.angle)[..., None], np.sin(ellipse.angle)[..., None]
    along = (cos * offset[..., 0] + sin * offset[..., 1]) / ellipse.semi_axes[..., :1]
    across = (cos * offset[..., 1] - sin * offset[..., 0]) / ellipse.semi_axes[..., 1:]
    return np.arctan2(across, along)


def arc_fraction(B: ArrayLike, points: ArrayLike) -> FloatArray:
    """Return the fraction, shape (...), of the ellipse in eccentric angle that the points cover.

    Neighbouring points cover what lies between them unless the gap is wider than three typical spacings, measured both
    as eccentric angle and as length along the ellipse (evenly spaced points of a long ellipse are even in one of the
    two only). The typical spacing is the 80 % quantile of the gaps, the widest left aside: repeated points and a few
    missing stretches do not move it, and points placed at random lose about 5 %. Points that reach all round give 1;
    five points on one arc give the arc between the first and the last.

    Raises
    ------
    InputError
        A conic is not a real ellipse, or there are fewer than 5 points.
    """
    points = as_points(points)
    if points.shape[-2] < 5:
        raise InputError(f"{points.shape[-2]} points given; 5 are needed to say how much of an ellipse they cover")
    ellipse = geometric_from_conic(B)
    angles = np.sort(eccentric_angles(B, points), axis=-1)
    closed = np.concatenate([angles, angles[..., :1] + 2 * np.pi], axis=-1)
    gaps = np.diff(closed, axis=-1)
    modulus = 1 - (ellipse.semi_axes[..., 1:] / ellipse.semi_axes[..., :1]) ** 2
    lengths = np.diff(-ellipeinc(np.pi / 2 - closed, modulus), axis=-1)
    uncovered = _is_wide(gaps) & _is_wide(lengths)
    return 1 - np.sum(np.where(uncovered, gaps, 0.0), axis=-1) / (2 * np.pi)


def _is_wide(gaps: FloatArray) -> np.ndarray:
    others = np.sort(gaps, axis=-1)[..., :-1]
    typical = np.quantile(others, SPACING_QUANTILE, axis=-1, method="lower", keepdims=True)
    return gaps > GAP_IN_SPACINGS * typical
