"""A spot beside the ellipse through its points: what the picture of it draws."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.rig import Camera
from planeopt.spot import Spot
from planeopt.spot.fitted import fit_ellipse

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judged:
    """N points, and M that were left out.

    Parameters
    ----------
    curve : (L, 2) array
        The ellipse in the image, raw pixels.
    residuals, rejected_residuals : (N,), (M,) arrays
        Signed distances from it, px of the image, positive outside.
    normals : (N, 2) array
        Outward unit normals at the points.
    angles, rejected_angles : (N,), (M,) arrays
        Round the ellipse's centre, from +x to +y, degrees from 0 to 360.
    """

    curve: Array
    residuals: Array
    normals: Array
    angles: Array
    rejected_residuals: Array
    rejected_angles: Array


def judge(spot: Spot, camera: Camera | None = None) -> Judged | None:
    """Fit an ellipse to a spot's points, with a camera to the undistorted ones; None where they are on none."""
    points, stretch = _straight(spot.points, camera)
    fitted = fit_ellipse(points, None if spot.sigma is None else spot.sigma * stretch)
    if fitted is None:
        return None
    rejected, rejected_stretch = _straight(spot.rejected, camera)
    curve, centre = _bent(fitted.curve(721), camera), _bent(fitted.centre[None], camera)
    return Judged(
        curve,
        fitted.distances(points) / stretch,
        fitted.normals(points),
        _angles(spot.points - centre),
        fitted.distances(rejected) / rejected_stretch,
        _angles(spot.rejected - centre),
    )


def _straight(points: Array, camera: Camera | None) -> tuple[Array, Array]:
    """Return the points (N, 2) without distortion, px of the same camera, and by how much lengths grow there (N,)."""
    if camera is None or not len(points):
        return points, np.ones(len(points))
    normalised, jacobian = camera.normalise(points)
    focal = np.array([camera.fx, camera.fy])
    stretch = np.sqrt(np.abs(np.linalg.det(jacobian)) * focal.prod())
    return np.asarray(normalised * focal + [camera.cx, camera.cy], dtype=np.float64), stretch


def _bent(points: Array, camera: Camera | None) -> Array:
    """Undo `_straight`."""
    if camera is None:
        return points
    normalised = (points - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.asarray(camera.project(normalised), dtype=np.float64)


def _angles(offsets: Array) -> Array:
    return np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360
