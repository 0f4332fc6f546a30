"""Where a scene's spot lies in the image: exact, from the rig and the plane alone.

A pixel's ray meets the plane in a point; `xi` is where that point lies in the beam's cross-section, in radii from its
axis, along the laser-parallel frame's x and y, and `rho = |xi|`. The true boundary is `rho = 1`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from planeopt.errors import InputError
from planeopt.rig import distort
from planeopt.simulation.scene import Scene

Array = NDArray[np.float64]

FAR = 1e6
"""`xi` of rays that do not meet the plane in front of the camera, radii."""

_TABLE = 720
_NEWTON_STEPS = 50
# Complex steps have no cancellation: any step that does not underflow gives derivatives to rounding.
_COMPLEX_STEP = 1e-30


@dataclass(frozen=True, eq=False)
class View:
    """The geometry of one scene.

    Attributes
    ----------
    scene : Scene
    homography : (3, 3) ndarray
        Takes (x, y, 1), the normalised coordinates of a ray, to (xi_1 w, xi_2 w, w), with w > 0 before the plane.
    centre, cosine_axis, sine_axis : (3,) ndarray
        The spot's outline is `centre + cos(theta) cosine_axis + sin(theta) sine_axis`, mm, camera frame.
    """

    scene: Scene
    homography: Array
    centre: Array
    cosine_axis: Array
    sine_axis: Array

    def xi(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return where rays with normalised coordinates x, y meet the beam's cross-section, and the homography's w."""
        (a, b, c), (d, e, f), (g, h, i) = self.homography.tolist()
        w = g * x + h * y + i
        before = w > 0
        inverse = 1 / np.where(before, w, 1.0)
        first, second = (a * x + b * y + c) * inverse, (d * x + e * y + f) * inverse
        return np.where(before, first, FAR), np.where(before, second, FAR), w

    def level(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return (rho^2 - 1) / 2 of rays with normalised coordinates x, y, and its derivatives with x and y.

        It is smooth everywhere, the axis included, and on the boundary its slope is that of `rho`.
        """
        (a, b, _), (d, e, _), (g, h, _) = self.homography.tolist()
        first, second, w = self.xi(x, y)
        scale = 1 / np.where(w > 0, w, 1.0)
        squares = first * first + second * second
        by_x = (first * a + second * d - squares * g) * scale
        by_y = (first * b + second * e - squares * h) * scale
        return 0.5 * (squares - 1), by_x, by_y

    def outline(self, theta: Array, radii: float = 1.0) -> Array:
        """Return the raw pixels (N, 2) of the circle `rho = radii` at angles (N,) in the cross-section."""
        return self._trace(theta, radii)[0]

    def _trace(self, theta: Array, radii: float = 1.0) -> tuple[Array, Array, Array]:
        """Return pixels (N, 2) of the outline, and their first and (nearly) second derivative with theta."""
        c, s = np.cos(theta)[:, None] * radii, np.sin(theta)[:, None] * radii
        X0 = self.centre + c * self.cosine_axis + s * self.sine_axis
        X1 = c * self.sine_axis - s * self.cosine_axis
        X2 = self.centre - X0
        Z = X0[:, 2:]
        x0 = X0[:, :2] / Z
        x1 = (X1[:, :2] - x0 * X1[:, 2:]) / Z
        x2 = (X2[:, :2] - 2 * x1 * X1[:, 2:] - x0 * X2[:, 2:]) / Z
        return self.scene.rig.camera.project(x0), self._through_lens(x0, x1), self._through_lens(x0, x2)

    def _through_lens(self, at: Array, direction: Array) -> Array:
        """Return the derivative of the pixel in a direction at normalised points, both (N, 2)."""
        camera = self.scene.rig.camera
        x, y = (at + 1j * _COMPLEX_STEP * direction).T
        xd, yd = distort(x, y, *camera.distortion)
        return np.stack([camera.fx * xd.imag, camera.fy * yd.imag], axis=-1) / _COMPLEX_STEP

    def sharpest(self, count: int = 1440) -> float:
        """Return the boundary's largest curvature in the image, 1/px (the lens taken as linear round each point)."""
        _, first, second = self._trace(np.linspace(0, math.tau, count, endpoint=False))
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        return float(np.max(np.abs(cross) / np.linalg.norm(first, axis=1) ** 3))

    def in_image(self, px: Array) -> NDArray[np.bool_]:
        """Whether pixels (N, 2) lie on the sensor."""
        width, height = self.scene.rig.camera.image_size
        x, y = px[:, 0], px[:, 1]
        return (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)


def view(scene: Scene) -> View:
    """Return the geometry of a scene.

    Raises
    ------
    InputError
        If the camera cannot see the spot: part of it is behind the camera or where the lens's distortion folds over,
        the lit side is turned away, or all of the boundary is outside of the image.
    """
    rig, pose = scene.rig, scene.pose
    beam = rig.require_beam()
    plane = scene.true_plane
    Q = rig.Q
    reach = float(plane.normal @ plane.point)
    if pose.z_L <= 0:
        raise InputError(f"plane: z_L is {pose.z_L:.6g} mm: the beam meets the plane behind the camera, not before it")
    if reach <= 0:
        raise InputError("plane: the camera is behind the plane and cannot see its lit side; tilt it less")
    offset = np.array([*beam.offset, 0.0])
    homography = np.vstack([(reach * Q[:2] - np.outer((Q @ offset)[:2], plane.normal)) / beam.radius, plane.normal])
    p, q = pose.slopes
    axes = beam.radius * (np.array([[1.0, 0.0, p], [0.0, 1.0, q]]) @ Q)
    found = View(scene, homography, plane.point, axes[0], axes[1])
    _refuse_unseen(found)
    return found


def _refuse_unseen(view: View) -> None:
    nearest = view.centre[2] - math.hypot(view.cosine_axis[2], view.sine_axis[2])
    if nearest <= 0:
        raise InputError("plane: part of the spot lies behind the camera; move the plane away or tilt it less")
    theta = np.linspace(0, math.tau, _TABLE, endpoint=False)
    points = view.centre + np.outer(np.cos(theta), view.cosine_axis) + np.outer(np.sin(theta), view.sine_axis)
    radius = np.hypot(points[:, 0], points[:, 1]) / points[:, 2]
    if np.any(radius >= view.scene.rig.camera.invertible_radius):
        raise InputError("plane: part of the spot lies where the lens's distortion folds over")
    if not np.any(view.in_image(view.outline(theta))):
        x, y = view.outline(theta).mean(axis=0)
        width, height = view.scene.rig.camera.image_size
        raise InputError(
            f"plane: the spot's boundary lies outside of the image (round ({x:.0f}, {y:.0f}) px of {width} x {height})"
        )


def arc_points(view: View, count: int = _TABLE) -> Array:
    """Return points (count, 2) of the boundary, raw px, equally spaced by length in the image (to 1e-3 of a step)."""
    theta = np.linspace(0, math.tau, 8 * count + 1)
    steps = np.linalg.norm(np.diff(view.outline(theta), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = (np.arange(count) + 0.5) * (length[-1] / count)
    return view.outline(np.interp(wanted, length, theta))


def boundary_distances(scene: Scene, points: ArrayLike) -> Array:
    """Return the signed distances (N,) of points (N, 2) from the true boundary, raw px, positive outside.

    The boundary is the image, through the lens with its distortion, of the beam's circle on the plane: where a disc's
    irradiance is half of its plateau (a Gaussian's its stated level), a ring's ridge. Blur, noise and the pixels have
    no part in it. Exact to rounding, except near the medial axis of the outline, where the nearest of two points of the
    boundary is taken from a table of 720.

    Raises
    ------
    InputError
        If the points are not finite pairs, or as for `render`.
    """
    px = np.asarray(points, dtype=np.float64)
    if px.ndim != 2 or px.shape[1] != 2 or not np.all(np.isfinite(px)):
        raise InputError(f"points must be finite pairs of pixels, shape (N, 2), not {px.shape}")
    return view_distances(view(scene), px)


def view_distances(view: View, px: Array) -> Array:
    """Return the signed distances of `boundary_distances` in a geometry that is there already."""
    theta = np.linspace(0, math.tau, _TABLE, endpoint=False)
    table = view.outline(theta)
    nearest = _nearest(table, px)
    at = theta[nearest]
    for _ in range(_NEWTON_STEPS):
        c0, c1, c2 = view._trace(at)
        residual = c0 - px
        speed = np.sum(c1 * c1, axis=1)
        curvature = speed + np.sum(residual * c2, axis=1)
        # Far inside the second derivative may vanish: there the speed alone still leads downhill.
        step = np.sum(residual * c1, axis=1) / np.where(curvature > 0.1 * speed, curvature, speed)
        step = np.clip(step, -math.tau / _TABLE, math.tau / _TABLE)
        at = at - step
        if np.max(np.abs(step), initial=0.0) < 1e-14:
            break
    c0, c1, _ = view._trace(at)
    x, y = table.T
    turn = np.sign(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    outward = turn * np.stack([c1[:, 1], -c1[:, 0]], axis=1)
    side = np.sign(np.sum((px - c0) * outward, axis=1))
    return side * np.linalg.norm(px - c0, axis=1)


def _nearest(table: Array, px: Array) -> NDArray[np.intp]:
    return np.asarray(KDTree(table).query(px)[1], dtype=np.intp)
