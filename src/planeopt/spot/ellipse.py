"""The ellipse that guides the search: where to look for the boundary, and along which normals.

It is a reference only: it never ends up in a result. The estimate proper, with its covariance, is made from the points.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse in the image.

    Parameters
    ----------
    x, y : float
        Centre, px.
    a, b : float
        Semi-axes, px; ``a >= b``.
    angle : float
        Direction of the major axis from +x to +y, rad.
    """

    x: float
    y: float
    a: float
    b: float
    angle: float

    @property
    def size(self) -> float:
        """Radius of the circle of equal area, px."""
        return float(np.sqrt(self.a * self.b))

    @property
    def axes(self) -> Array:
        """(2, 2) array whose columns are the unit vectors of the major and of the minor axis."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    @property
    def extent(self) -> tuple[float, float]:
        """Half width and half height of the bounding box, px."""
        half = np.hypot(*(self.axes * [self.a, self.b]).T)
        return float(half[0]), float(half[1])

    def grown(self, factor: float) -> "Ellipse":
        """Return the ellipse with both semi-axes multiplied."""
        return Ellipse(self.x, self.y, self.a * factor, self.b * factor, self.angle)

    def local(self, points: Array) -> Array:
        """Return points (..., 2) in the frame of the axes."""
        return (points - [self.x, self.y]) @ self.axes

    def radius_of(self, points: Array) -> Array:
        """Return the factor by which the ellipse has to grow to pass through each of the points (..., 2)."""
        return np.hypot(*np.moveaxis(self.local(points) / [self.a, self.b], -1, 0))

    def distances(self, points: Array) -> Array:
        """Return signed distances (N,) of points (N, 2), px, positive outside (first order: Sampson's)."""
        q = self.local(points) / [self.a, self.b]
        value = (q**2).sum(axis=1) - 1
        slope = 2 * np.hypot(q[:, 0] / self.a, q[:, 1] / self.b)
        return value / np.maximum(slope, 1e-12)

    def normals_at(self, count: int) -> tuple[Array, Array, Array]:
        """Return points (N, 2) evenly spaced along the boundary, outward normals (N, 2) and curvatures (N,), 1/px."""
        fine = np.linspace(0, 2 * np.pi, 8 * count + 1)
        speed = np.hypot(self.a * np.sin(fine), self.b * np.cos(fine))
        length = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
        theta = np.interp(np.arange(count) / count * length[-1], length, fine)
        c, s = np.cos(theta), np.sin(theta)
        points = np.stack([self.a * c, self.b * s], axis=1) @ self.axes.T + [self.x, self.y]
        rate = np.hypot(self.a * s, self.b * c)
        normals = np.stack([self.b * c, self.a * s], axis=1) / rate[:, None] @ self.axes.T
        return points, normals, self.a * self.b / rate**3

    @property
    def perimeter(self) -> float:
        """Perimeter, px (Ramanujan's second approximation; exact to 1e-4 down to an axis ratio of 0.05)."""
        h = ((self.a - self.b) / (self.a + self.b)) ** 2
        return float(np.pi * (self.a + self.b) * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h))))


def from_moments(mean: Array, covariance: Array) -> Ellipse:
    """Return the ellipse whose filled area has this mean (2,) and covariance (2, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    b, a = 2 * np.sqrt(np.maximum(values, 0))
    return Ellipse(float(mean[0]), float(mean[1]), float(a), float(b), float(np.arctan2(vectors[1, 1], vectors[0, 1])))


def fit(points: Array, weights: Array, start: Ellipse) -> Ellipse | None:
    """Fit an ellipse to points by least squared Sampson distances, reweighted from a start.

    Parameters
    ----------
    points : (N, 2) array
        Pixels.
    weights : (N,) array
        One over the variance across the boundary; 0 leaves a point out.
    start : Ellipse
        Gives the frame in which the fit is well conditioned, and the first weights.

    Returns
    -------
    Ellipse or None
        ``None`` if the points do not determine an ellipse.
    """
    scale = start.size
    x, y = ((points - [start.x, start.y]) / scale).T
    # x^2 + y^2 + p0 (x^2 - y^2) + p1 2xy + p2 x + p3 y + p4 = 0: linear in p, regular at a circle.
    design = np.stack([x**2 - y**2, 2 * x * y, x, y, np.ones_like(x)], axis=1)
    squares = x**2 + y**2
    p = _parameters(start)
    for _ in range(4):
        gradient = np.hypot(2 * x * (1 + p[0]) + 2 * y * p[1] + p[2], 2 * y * (1 - p[0]) + 2 * x * p[1] + p[3])
        root = np.sqrt(weights) / np.maximum(gradient, 1e-6)
        p, _, rank, _ = np.linalg.lstsq(design * root[:, None], -squares * root, rcond=None)
        if rank < 5:
            return None
    quadratic = np.array([[1 + p[0], p[1]], [p[1], 1 - p[0]]])
    values, vectors = np.linalg.eigh(quadratic)
    if values[0] <= 1e-6:
        return None
    centre = -np.linalg.solve(quadratic, p[2:4]) / 2
    height = centre @ quadratic @ centre - p[4]
    if height <= 0:
        return None
    a, b = np.sqrt(height / values) * scale
    angle = np.arctan2(vectors[1, 0], vectors[0, 0])
    return Ellipse(start.x + scale * centre[0], start.y + scale * centre[1], float(a), float(b), float(angle))


def _parameters(ellipse: Ellipse) -> Array:
    """Return the five parameters of `fit` in the ellipse's own scaled frame."""
    quadratic = ellipse.axes @ np.diag([ellipse.b / ellipse.a, ellipse.a / ellipse.b]) @ ellipse.axes.T
    half = np.trace(quadratic) / 2
    return np.array([(quadratic[0, 0] - quadratic[1, 1]) / (2 * half), quadratic[0, 1] / half, 0.0, 0.0, -1 / half])
