"""Where a board's points are in one image: a homography with a lens's radial distortion, fitted robustly to that image.

It is no calibration: it says where to look for a corner, how the board's edges run there and bend, and which points
cannot be the board's. One view tells little of a lens, so that its distortion is held near none.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MIN_POINTS = 4
_ROUNDS = 12
_PRIOR = 0.3  # of k1 and k2, at half the image's diagonal
_FLOOR = 2e-4  # of half the diagonal: less is not taken for the points' scatter
_NEAR = 0.5  # of a square: what lens and haste may put a point off a homography
_FITS = 0.2  # of a square: a point further off is another one
_INVERSIONS = 12
_STEP = 0.25  # of a square, for differences


@dataclass(frozen=True, eq=False)
class BoardImage:
    """The map from a board's plane to the pixels of one image.

    Parameters
    ----------
    homography : (3, 3) array
        From mm on the board to the image's coordinates about its middle, in half diagonals, without distortion; its
        third row is positive before the camera.
    distortion : (2,) array
        k1, k2 in these coordinates.
    middle : (2,) array
        Of the image, px.
    scale : float
        Half its diagonal, px.
    square : tuple of float
        Sides of a square, mm.
    """

    homography: Array
    distortion: Array
    middle: Array
    scale: float
    square: tuple[float, float]

    def __call__(self, points: Array) -> Array:
        """Return the pixels (N, 2) of points (N, 2), mm."""
        flat = _homogeneous(points, self.homography)
        square = (flat**2).sum(axis=1, keepdims=True)
        k1, k2 = self.distortion
        return self.middle + self.scale * flat * (1 + square * (k1 + square * k2))

    def places(self, pixels: Array) -> Array:
        """Return the points (N, 2), mm, whose images pixels (N, 2) are: to a thousandth of a square or so."""
        flat = (pixels - self.middle) / self.scale
        ideal, (k1, k2) = flat, self.distortion
        for _ in range(_INVERSIONS):
            square = (ideal**2).sum(axis=1, keepdims=True)
            ideal = flat / np.maximum(1 + square * (k1 + square * k2), 0.1)
        return _homogeneous(ideal, np.asarray(np.linalg.inv(self.homography), dtype=np.float64))

    @property
    def mirrored(self) -> bool:
        """Whether the board is seen from behind, as no camera sees it."""
        return bool(np.linalg.det(self.homography) < 0)

    def in_front(self, points: Array) -> Mask:
        """Return which points (N, 2) lie before the camera and where the distortion does not fold the image back."""
        depth = points @ self.homography[2, :2] + self.homography[2, 2]
        flat = _homogeneous(points, self.homography)
        square = (flat**2).sum(axis=1)
        k1, k2 = self.distortion
        return (depth > 0) & (1 + square * (3 * k1 + 5 * square * k2) > 0)

    def slopes(self, points: Array) -> tuple[Array, Array]:
        """Return the first (N, 2, 2) and second (N, 2, 2, 2) derivatives at points (N, 2): px per mm, px per mm^2."""
        a, b = np.array([_STEP * self.square[0], 0.0]), np.array([0.0, _STEP * self.square[1]])
        x, y = a[0], b[1]
        here, east, west, south, north = (self(points + shift) for shift in (0 * a, a, -a, b, -b))
        first = np.stack([(east - west) / (2 * x), (south - north) / (2 * y)], axis=2)
        corners = self(points + a + b) + self(points - a - b) - self(points + a - b) - self(points - a + b)
        mixed = corners / (4 * x * y)
        across, down = (east + west - 2 * here) / x**2, (south + north - 2 * here) / y**2
        return first, np.stack([np.stack([across, mixed], axis=2), np.stack([mixed, down], axis=2)], axis=3)

    def side(self, points: Array) -> Array:
        """Return the shorter side (N,) of a square as seen at points (N, 2), px: between its opposite edges."""
        first, _ = self.slopes(points)
        inverse = np.linalg.inv(first)
        return np.min(np.array(self.square) / np.linalg.norm(inverse, axis=2), axis=1)

    def fits(self, points: Array, pixels: Array) -> Mask:
        """Return which pixels (N, 2) may be the images of points (N, 2)."""
        return np.linalg.norm(self(points) - pixels, axis=1) < np.maximum(_FITS * self.side(points), 1.0)


def fit_board_image(
    points: Array, pixels: Array, image_size: tuple[int, int], square: tuple[float, float]
) -> BoardImage | None:
    """Fit the map to pairs of points, some of which may be wrong.

    Parameters
    ----------
    points : (N, 2) array
        mm, on the board.
    pixels : (N, 2) array
    image_size : tuple of int
        Width and height.
    square : tuple of float
        Sides of a square, mm.

    Returns
    -------
    BoardImage or None
        ``None`` if the pairs hold no map: too few, all on a line, or no four that agree with others.
    """
    if len(points) < _MIN_POINTS or _on_a_line(points) or _on_a_line(pixels):
        return None
    middle = (np.array(image_size, dtype=np.float64) - 1) / 2
    scale = float(np.hypot(*image_size)) / 2
    flat = (pixels - middle) / scale
    centre, spread = points.mean(axis=0), float(np.abs(points - points.mean(axis=0)).max())
    local = (points - centre) / spread
    side = _typical_side(points, flat, square)
    # Seeded: OpenCV's random choices would depend on what was done before.
    cv2.setRNGSeed(0)
    found, _ = cv2.findHomography(local, flat, cv2.RANSAC, _NEAR * side, maxIters=2000, confidence=0.9999)
    if found is None:
        return None
    parameters = _refined(np.asarray(found, dtype=np.float64), local, flat, side)
    if parameters is None:
        return None
    homography = np.append(parameters[:8], 1.0).reshape(3, 3)
    to_local = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, spread]]) / spread
    return BoardImage(homography @ to_local, parameters[8:], middle, scale, square)


def _refined(start: Array, points: Array, flat: Array, side: float) -> Array | None:
    """Return the homography's eight and the distortion's two numbers; Gauss-Newton with Cauchy's weights."""
    if abs(start[2, 2]) < 1e-9:
        return None
    values = np.append((start / start[2, 2]).ravel()[:8], [0.0, 0.0])
    scatter = _NEAR * side / 3
    for _ in range(_ROUNDS):
        misfit, jacobian = _misfit(values, points, flat)
        off = (misfit**2).sum(axis=1)
        weight = 1 / (1 + off / (2 * scatter) ** 2) / scatter**2
        rows = jacobian * np.sqrt(weight)[:, None, None]
        normal = np.einsum("nij,nik->jk", rows, rows)
        normal[[8, 9], [8, 9]] += _PRIOR**-2
        right = np.einsum("nij,ni,n->j", jacobian, misfit, weight)
        right[8:] -= values[8:] * _PRIOR**-2
        try:
            step = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            return None
        values = values + step
        misfit, _ = _misfit(values, points, flat)
        scatter = max(float(np.median(np.linalg.norm(misfit, axis=1))) / 1.18, _FLOOR)
    return values if np.all(np.isfinite(values)) else None


def _misfit(values: Array, points: Array, flat: Array) -> tuple[Array, Array]:
    """Return observed less predicted (N, 2) and the derivatives of the prediction (N, 2, 10)."""
    homography = np.append(values[:8], 1.0).reshape(3, 3)
    depth = points @ homography[2, :2] + 1.0
    ideal = (points @ homography[:2, :2].T + homography[:2, 2]) / depth[:, None]
    square = (ideal**2).sum(axis=1)
    k1, k2 = values[8:]
    factor = 1 + square * (k1 + square * k2)
    # Of the distorted point by the ideal one.
    bend = factor[:, None, None] * np.eye(2) + np.einsum("ni,nj,n->nij", ideal, ideal, 2 * (k1 + 2 * square * k2))
    rows = np.concatenate([points, np.ones((len(points), 1))], axis=1) / depth[:, None]
    inner = np.zeros((len(points), 2, 8))
    inner[:, 0, :3] = inner[:, 1, 3:6] = rows
    inner[:, :, 6:] = -ideal[:, :, None] * rows[:, None, :2]
    outer = np.stack([ideal * square[:, None], ideal * square[:, None] ** 2], axis=2)
    return flat - ideal * factor[:, None], np.concatenate([bend @ inner, outer], axis=2)


def _homogeneous(points: Array, homography: Array) -> Array:
    image = points @ homography[:, :2].T + homography[:, 2]
    return image[:, :2] / image[:, 2:]


def _on_a_line(points: Array) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 1e-3 * spread[0] or spread[0] == 0)


def _typical_side(points: Array, flat: Array, square: tuple[float, float]) -> float:
    """Return about how large a square is in the image: by the areas that the points cover."""
    areas = [float(np.sqrt(max(np.linalg.det(np.cov(values.T)), 1e-30))) for values in (points, flat)]
    return float(np.sqrt(square[0] * square[1] * areas[1] / areas[0]))
