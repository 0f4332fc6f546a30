"""The camera: OpenCV's pinhole model with five distortion coefficients, and its exact inverse."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.rig.checks import finite, positive

FloatArray = NDArray[np.float64]

_NEWTON_STEPS = 30
# Largest residual, in normalised units, of an inverse that counts as found: 1e-9 px at a focal length of 10,000 px.
_INVERSE_TOLERANCE = 1e-13
_RADIAL_GRID = 1025
# Steps of the quick search, and the length of one that leaves rounding: what is left is its square times the
# distortion's curvature, some per unit.
_NEAR_STEPS = 4
_NEAR = 3e-9
# Normalised radius (the tangent of the angle to the optical axis) beyond which no pinhole lens sees: 89.99 degrees.
_WIDEST = 1e4

_OTHER_MODELS = {
    4: "append k3 = 0 to OpenCV's four; a fisheye model is not supported",
    8: "OpenCV's rational model is not supported",
    12: "OpenCV's thin prism model is not supported",
    14: "OpenCV's tilted model is not supported",
}


def distort(x: Any, y: Any, k1: Any, k2: Any, p1: Any, p2: Any, k3: Any) -> tuple[Any, Any]:
    """Return normalised coordinates after distortion, OpenCV's model.

    Plain arithmetic only, so that it serves floats, NumPy arrays and CasADi expressions alike (hence `Any`).

    Parameters
    ----------
    x, y : float, array or expression
        Normalised coordinates X/Z, Y/Z in the camera frame.
    k1, k2, p1, p2, k3 : float, array or expression
        Radial and tangential coefficients, in OpenCV's order.

    Returns
    -------
    xd, yd
        Distorted normalised coordinates: the pixel is (fx xd + cx, fy yd + cy).
    """
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return xd, yd


@dataclass(frozen=True)
class Camera:
    """A calibrated camera; pixel centres are at integers.

    Parameters
    ----------
    image_size : tuple of int
        Width and height, px.
    fx, fy, cx, cy : float
        Focal lengths and principal point, px.
    distortion : tuple of float
        (k1, k2, p1, p2, k3), OpenCV's model and order.
    pixel_pitch_mm : float, optional
        Size of a pixel on the sensor along x, mm.

    Raises
    ------
    InputError
        If a value is not finite, or not positive where it must be, or the distortion is not five numbers.
    """

    image_size: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    pixel_pitch_mm: float | None = None

    def __post_init__(self) -> None:
        size = tuple(self.image_size)
        if len(size) != 2 or not all(float(n).is_integer() and n > 0 for n in size):
            raise InputError(f"camera.image_size must be two positive whole numbers [width, height], not {list(size)}")
        object.__setattr__(self, "image_size", (int(size[0]), int(size[1])))
        for name in ("fx", "fy"):
            object.__setattr__(self, name, positive(f"camera.{name}", getattr(self, name), "px"))
        for name in ("cx", "cy"):
            object.__setattr__(self, name, finite(f"camera.{name}", getattr(self, name)))
        count = len(self.distortion)
        if count != 5:
            hint = _OTHER_MODELS.get(count, "other models are not supported")
            raise InputError(f"camera.distortion must be the five numbers [k1, k2, p1, p2, k3], not {count}: {hint}")
        object.__setattr__(self, "distortion", tuple(finite("camera.distortion", k) for k in self.distortion))
        if self.pixel_pitch_mm is not None:
            object.__setattr__(self, "pixel_pitch_mm", positive("camera.pixel_pitch_mm", self.pixel_pitch_mm, "mm"))

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix (3, 3), px."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def invertible_radius(self) -> float:
        """Largest normalised radius up to which the radial distortion grows outward; `math.inf` if it always does.

        The first positive root of 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6, the growth of the distorted radius with r. Beyond
        it the image folds back over itself, and a pixel no longer tells which of two rays it came from.
        """
        k1, k2, _, _, k3 = self.distortion
        # In 1 / r^2, where the leading coefficient is 1 however small k3 is.
        roots = np.roots([1.0, 3 * k1, 5 * k2, 7 * k3])
        inverse_squares = roots.real[(roots.imag == 0) & (roots.real > _WIDEST**-2)]
        return 1 / math.sqrt(float(inverse_squares.max())) if inverse_squares.size else math.inf

    def project(self, normalised: ArrayLike) -> FloatArray:
        """Return the pixels (..., 2) of normalised coordinates (..., 2), which are (X/Z, Y/Z) in the camera frame.

        This is the bare formula: beyond `invertible_radius` it returns pixels that `normalise` would refuse.
        """
        points = _pairs("normalised coordinates", normalised)
        xd, yd = distort(points[..., 0], points[..., 1], *self.distortion)
        return np.stack([self.fx * xd + self.cx, self.fy * yd + self.cy], axis=-1)

    def normalise(self, px: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the undistorted, normalised coordinates of pixels and their Jacobian.

        Newton's method on OpenCV's distortion with its analytic Jacobian, started from the inverse of the radial part,
        to the limit of rounding.

        Parameters
        ----------
        px : array_like, shape (..., 2)
            Raw (distorted) pixels.

        Returns
        -------
        normalised : ndarray, shape (..., 2)
            (X/Z, Y/Z) of each pixel's ray in the camera frame.
        jacobian : ndarray, shape (..., 2, 2)
            d normalised / d px, per px.

        Raises
        ------
        InputError
            If a pixel is not finite, or lies where the distortion cannot be inverted; names the row, from 0.
        """
        pixels = _pairs("pixels", px)
        flat = pixels.reshape(-1, 2)
        _refuse_first(flat, ~np.all(np.isfinite(flat), axis=-1), "is not a finite number of pixels")
        # Pixels far outside may overflow on the way to being refused below.
        x, y, jacobian, good = self.normalise_components(flat[:, 0], flat[:, 1])
        _refuse_first(
            flat, ~good, "is where this camera's distortion cannot be inverted: check it against the image size"
        )
        shape = pixels.shape[:-1]
        return np.stack([x, y], axis=-1).reshape(*shape, 2), np.stack(jacobian, axis=-1).reshape(*shape, 2, 2)

    def normalise_components(
        self, u: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray], NDArray[np.bool_]]:
        """Return what `normalise` does by components, for arrays of pixels that may be too large to be walked twice.

        Parameters
        ----------
        u, v : ndarray, shape (...)
            Raw pixels.

        Returns
        -------
        x, y : ndarray, shape (...)
        jacobian : four ndarrays, shape (...)
            dx/du, dx/dv, dy/du, dy/dv.
        good : ndarray of bool, shape (...)
            False where a pixel is not finite or the distortion cannot be inverted; the numbers mean nothing there.
        """
        xd, yd = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        with np.errstate(all="ignore"):
            x, y, parts, good = self._nearby(xd, yd)
            if not np.all(good):
                lost = ~good
                points, good[lost] = self._undistort(np.stack([xd[lost], yd[lost]], axis=-1))
                x[lost], y[lost] = points.T
                for part, value in zip(parts, self.distortion_jacobian(points), strict=True):
                    part[lost] = value
            xx, xy, yy = parts
            inverse = 1 / (xx * yy - xy * xy)
            across = -xy
            across *= inverse
            yy *= inverse
            xx *= inverse
        return x, y, (yy / self.fx, across / self.fy, across / self.fx, xx / self.fy), good

    def _nearby(
        self, xd: FloatArray, yd: FloatArray
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray], NDArray[np.bool_]]:
        """Newton's method from the radial part's inverse, nearly: found at once where the lens distorts little.

        Returns the points, the distortion's Jacobian there, and which of them are found.
        """
        k1, k2, _, _, k3 = self.distortion
        r2 = xd * xd + yd * yd
        radial = _polynomial(r2, (1.0, k1, k2, k3))
        radial *= radial
        r2 /= radial
        np.divide(1.0, _polynomial(r2, (1.0, k1, k2, k3)), out=radial)
        x, y = xd * radial, yd * radial
        steps, widest2 = 0, min(self.invertible_radius, _WIDEST) ** 2
        while True:
            steps += 1
            moved, parts, found = self._correct(x, y, xd, yd, widest2)
            if steps == _NEAR_STEPS or np.max(moved, initial=0.0) < _NEAR**2:
                return x, y, parts, found & (moved < _NEAR**2)

    def _correct(
        self, x: FloatArray, y: FloatArray, xd: FloatArray, yd: FloatArray, widest2: float
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray], NDArray[np.bool_]]:
        """Move points (x, y) by a step of Newton's method for those that distort to (xd, yd), in place.

        Returns the steps' squared lengths, the distortion's Jacobian as `distortion_jacobian` has it, and where the
        distortion can be inverted, out to a squared radius; the Jacobian and that are of where the step began.
        """
        k1, k2, p1, p2, k3 = self.distortion
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        slope = _polynomial(r2, (2 * k1, 4 * k2, 6 * k3))
        bend = _polynomial(r2, (1.0, k1, k2, k3))
        along_x, along_y = (2 * p2) * x, (2 * p1) * y
        bend += along_x
        bend += along_y
        # `distort` is (x bend + p2 r^2, y bend + p1 r^2).
        dx, dy = x * bend, y * bend
        dx -= xd
        dy -= yd
        dx += p2 * r2
        dy += p1 * r2
        xx *= slope
        xx += bend
        along_x *= 2
        xx += along_x
        yy *= slope
        yy += bend
        along_y *= 2
        yy += along_y
        xy *= slope
        xy += (2 * p1) * x
        xy += (2 * p2) * y
        size = np.multiply(xx, yy, out=slope)
        part = np.multiply(xy, xy, out=bend)
        size -= part
        found = (size > 0) & (r2 < widest2)
        np.divide(1.0, size, out=size)
        step = np.multiply(yy, dx, out=along_x)
        step -= np.multiply(xy, dy, out=part)
        step *= size
        x -= step
        other = np.multiply(xx, dy, out=along_y)
        other -= np.multiply(xy, dx, out=part)
        other *= size
        y -= other
        # The next step would be of the order of the square of this one.
        step *= step
        other *= other
        step += other
        return step, (xx, xy, yy), found

    def _undistort(self, target: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the normalised points (N, 2) that distort to the target, and which of them hold."""
        limit = min(self.invertible_radius, _WIDEST)
        points = self._radial_start(target, limit)
        for _ in range(_NEWTON_STEPS):
            residual = self._residual(points, target)
            xx, xy, yy = self.distortion_jacobian(points)
            dx, dy = residual[:, 0], residual[:, 1]
            step = np.stack([yy * dx - xy * dy, xx * dy - xy * dx], axis=-1) / (xx * yy - xy * xy)[:, None]
            points = points - step
            if np.all(np.abs(step) <= np.spacing(1.0) * (1 + np.abs(points))):
                break
        xx, xy, yy = self.distortion_jacobian(points)
        error = np.max(np.abs(self._residual(points, target)), axis=-1, initial=0.0)
        reached = error <= _INVERSE_TOLERANCE * (1 + np.max(np.abs(target), axis=-1, initial=0.0))
        unfolded = (xx * yy - xy * xy > 0) & (np.hypot(points[:, 0], points[:, 1]) < limit)
        return points, reached & unfolded

    def _residual(self, points: FloatArray, target: FloatArray) -> FloatArray:
        xd, yd = distort(points[:, 0], points[:, 1], *self.distortion)
        return np.stack([xd, yd], axis=-1) - target

    def _radial_start(self, target: FloatArray, limit: float) -> FloatArray:
        """Return the inverse of the radial part alone, from a table: monotonic, so never on the wrong branch."""
        k1, k2, _, _, k3 = self.distortion
        distorted = np.hypot(target[:, 0], target[:, 1])
        furthest = float(np.max(distorted, initial=0.0))
        top = min(furthest, limit) if furthest > 0 else 1.0
        while top < limit and distort(top, 0.0, k1, k2, 0.0, 0.0, k3)[0] < furthest:
            top = min(2 * top, limit)
        # Denser near the axis, so that one pixel far outside does not spoil the start of the others.
        radius = top * np.linspace(0.0, 1.0, _RADIAL_GRID) ** 2
        grown, _ = distort(radius, 0.0, k1, k2, 0.0, 0.0, k3)
        ratio = np.interp(distorted, grown, radius) / np.where(distorted > 0, distorted, 1.0)
        return target * ratio[:, None]

    def distortion_jacobian(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return d xd/dx, d xd/dy (which is d yd/dx too) and d yd/dy at normalised points (..., 2), each (...)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = points[..., 0], points[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
        xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
        yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
        return xx, xy, yy


def _polynomial(x: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Return a polynomial's values, coefficients from the constant one on."""
    lower, last = coefficients[:-1], coefficients[-1]
    while lower and last == 0:
        lower, last = lower[:-1], lower[-1]
    made = np.full_like(x, last)
    for coefficient in reversed(lower):
        made *= x
        made += coefficient
    return made


def _pairs(what: str, values: ArrayLike) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise InputError(f"{what} must be an array of pairs, shape (..., 2), not {array.shape}")
    return array


def _refuse_first(pixels: FloatArray, bad: NDArray[np.bool_], reason: str) -> None:
    """Raise an `InputError` that names the first bad row, if there is one."""
    if np.any(bad):
        row = int(np.argmax(bad))
        u, v = pixels[row].tolist()
        raise InputError(f"point {row} (counted from 0) at ({u:.6g}, {v:.6g}) px {reason}")
