"""Orthogonal distances of boundary points from the image of a plane's spot, and their derivatives by the plane."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.estimation.feet import FOOT_TOLERANCE, Boundary, Conics, Feet, feet, monomials_at_feet

Array = NDArray[np.float64]


def seen(planes: Array, setup: eq.Setup) -> NDArray[np.bool_]:
    """Whether the whole spot is before the camera, ``z_L > r |n|``, and its lit side faces it, ``c > 0``; (...)."""
    v = eq.SlopeVariables(None, planes[..., 0], planes[..., 1], planes[..., 2])
    ahead = (planes[..., 0] > 0) & (eq.in_front_in_slopes(np, v, setup) > 0)
    return np.asarray(ahead & (eq.lit_side_in_slopes(np, v, setup) > 0))


def distances(planes: ArrayLike, points: ArrayLike, noise: ArrayLike, setup: eq.Setup) -> Array:
    """Signed orthogonal distances of points from the image ellipses of planes, in standard deviations.

    Parameters
    ----------
    planes : (..., 3)
        ``(z_L, p, q)`` in the equations' sense (`z_L` the spot centre's z in the laser-parallel frame).
    points : (..., N, 2)
        On the laser-parallel image plane, mm. Leading dimensions broadcast with the planes'.
    noise : scalar, (..., N) or (..., N, 2, 2)
        Standard deviations (mm) or covariances (mm^2) of the points.
    setup : Setup

    Returns
    -------
    (..., N)
        Positive outside the ellipse; infinite for a plane whose spot is not wholly before the camera, or that shows
        it its dark side.
    """
    return distances_from(planes, Boundary.of(_points(points), noise), setup)


def distances_from(planes: ArrayLike, boundary: Boundary, setup: eq.Setup, tolerance: float = FOOT_TOLERANCE) -> Array:
    """As `distances`, from points prepared once for many calls, to a tolerance as of `feet`."""
    (_, found), visible = _feet_of_seen(_planes(planes), boundary, setup, tolerance)
    return np.where(visible[..., None], found.distance, np.inf)


def distances_and_derivatives(
    planes: ArrayLike, points: ArrayLike, noise: ArrayLike, setup: eq.Setup
) -> tuple[Array, Array]:
    """`distances` (..., N), and their exact derivatives (..., N, 3) by ``(z_L, p, q)``; NaN where they are infinite."""
    boundary, wanted = Boundary.of(_points(points), noise), _planes(planes)
    (conics, found), visible = _feet_of_seen(wanted, boundary, setup)
    rows = (conics.by_plane @ monomials_at_feet(found, boundary)) * found.rate[..., None, :]
    derivative = np.where(visible[..., None, None], np.swapaxes(rows, -1, -2), np.nan)
    return np.where(visible[..., None], found.distance, np.inf), derivative


def _feet_of_seen(
    planes: Array, boundary: Boundary, setup: eq.Setup, tolerance: float = FOOT_TOLERANCE
) -> tuple[tuple[Conics, Feet], NDArray[np.bool_]]:
    """Feet on the ellipses of planes; where a plane is not seen, on another's in its place."""
    visible = seen(planes, setup)
    harmless = np.array([setup.f * setup.r, 0.0, 0.0])
    conics = Conics.of(np.where(visible[..., None], planes, harmless), setup, boundary)
    with np.errstate(all="ignore"):  # a foot at a centre of curvature divides zero by zero
        return (conics, feet(conics, boundary, tolerance=tolerance)), visible


def _planes(values: ArrayLike) -> Array:
    planes = np.asarray(values, dtype=float)
    if planes.ndim == 0 or planes.shape[-1] != 3:
        raise InputError(f"planes must be (z_L, p, q), of shape (..., 3), not {planes.shape}")
    return planes


def _points(values: ArrayLike) -> Array:
    points = np.asarray(values, dtype=float)
    if points.ndim < 2 or points.shape[-1] != 2:
        raise InputError(f"points must have shape (..., N, 2), not {points.shape}")
    return points
