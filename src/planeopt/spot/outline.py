"""The ellipse that guides the search: where to look for the boundary, and along which normals.

It never ends up in a result: the estimate proper, with its covariance, is made from the points.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.conic import conic_from_geometric

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


_CONVERGING = 1e-5  # rad: a turn that moves less leaves an error of less than its square


@dataclass(frozen=True, slots=True)
class Outline:
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

    @property
    def conic(self) -> Array:
        """Coefficients (5,) of the conic (16), px."""
        return np.asarray(conic_from_geometric([self.x, self.y], [self.a, self.b], self.angle), dtype=np.float64)

    def grown(self, factor: float) -> "Outline":
        """Return the ellipse with both semi-axes multiplied."""
        return Outline(self.x, self.y, self.a * factor, self.b * factor, self.angle)

    def moved(self, by: Array) -> "Outline":
        """Return the ellipse moved by (2,), px."""
        return Outline(self.x + float(by[0]), self.y + float(by[1]), self.a, self.b, self.angle)

    def distance_to(self, other: "Outline") -> float:
        """Return the largest difference of the centres' places and of the semi-axes, px."""
        return max(abs(self.x - other.x), abs(self.y - other.y), abs(self.a - other.a), abs(self.b - other.b))

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

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Return signed distances (N,) of points (N, 2), px, positive outside, and where the nearest points are.

        The latter by cosine and sine (2, N) of their eccentric angles. By the circle of curvature at the current point,
        which converges from any start (Wang, Robust point to ellipse distance, 2017); at the boundary to rounding, at
        20 px from it to 1e-6 px.
        """
        local = self.local(points)
        x, y = np.abs(local[:, 0]), np.abs(local[:, 1])
        a, b = self.a, self.b
        c, s = _unit(x / a, y / b)
        focal = a * a - b * b
        for _ in range(4):
            # Roots of sums of squares: several times as fast as `hypot`, and nothing here overflows.
            evolute_x, evolute_y = (focal / a) * (c * c * c), (-focal / b) * (s * s * s)
            px, py = x - evolute_x, y - evolute_y
            radius = (a * c - evolute_x) ** 2 + (b * s - evolute_y) ** 2
            stretch = np.sqrt(radius / np.maximum(px * px + py * py, 1e-24))
            before = c, s
            c = np.clip((px * stretch + evolute_x) / a, 0.0, 1.0)
            s = np.clip((py * stretch + evolute_y) / b, 0.0, 1.0)
            c, s = _unit(c, s)
            if np.abs(c * before[1] - s * before[0]).max(initial=0.0) < _CONVERGING:
                break
        distance = np.sqrt((x - a * c) ** 2 + (y - b * s) ** 2)
        outside = (x / a) ** 2 + (y / b) ** 2 > 1
        turn = np.stack([np.copysign(c, local[:, 0]), np.copysign(s, local[:, 1])])
        return np.where(outside, distance, -distance), turn

    def spaced(self, count: int) -> Array:
        """Return the eccentric angles (N,) of points evenly spaced along the boundary, from 0 to 2 pi."""
        fine, length = self._arc(8 * count)
        return np.interp(np.arange(count) / count, length, fine)

    def _arc(self, count: int) -> tuple[Array, Array]:
        """Return eccentric angles (N + 1,) from 0 to 2 pi, and the share of the perimeter that lies before each."""
        fine = np.linspace(0, 2 * np.pi, count + 1)
        speed = np.hypot(self.a * np.sin(fine), self.b * np.cos(fine))
        length = np.concatenate([[0.0], np.cumsum(speed[1:] + speed[:-1])])
        return fine, length / length[-1]

    def share_before(self, theta: Array) -> Array:
        """Return the share (N,) of the perimeter, from 0 to 1, between eccentric angle 0 and `theta` (N,)."""
        count = max(256, int(4 * self.perimeter))
        _, length = self._arc(count)
        # Linear interpolation in a table of even steps.
        place = np.mod(theta * (count / (2 * np.pi)), count)
        step = np.minimum(place.astype(np.intp), count - 1)
        before = length[step]
        return before + (place - step) * (length[step + 1] - before)

    def carried(self, marks: Mask, to: "Outline") -> Mask:
        """Return which pieces (N,) of another ellipse near this one are marked, of N equal ones, by this one's (N,).

        By where they lie: they are counted from the major axis, which of a nearly round ellipse may be any.
        """
        middle, _, _ = to.at(to.spaced(2 * len(marks))[1::2])
        x, y = (self.local(middle) / [self.a, self.b]).T
        place = (self.share_before(np.arctan2(y, x)) * len(marks)).astype(np.intp)
        return marks[np.minimum(place, len(marks) - 1)]

    def at(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return the points (N, 2) at eccentric angles (N,), outward normals (N, 2) and curvatures (N,), 1/px."""
        turn = np.stack([np.cos(theta), np.sin(theta)])
        points = (turn.T * [self.a, self.b]) @ self.axes.T + [self.x, self.y]
        normals, curvature = self.bearing(turn)
        return points, normals.T, curvature

    def bearing(self, turn: Array) -> tuple[Array, Array]:
        """Return outward normals (2, N) and curvatures (N,), 1/px, where cosine and sine (2, N) of the angle are."""
        across = np.stack([self.b * turn[0], self.a * turn[1]])
        rate = np.sqrt(across[0] ** 2 + across[1] ** 2)
        return self.axes @ (across / rate), self.a * self.b / (rate * rate * rate)

    @property
    def perimeter(self) -> float:
        """Perimeter, px (Ramanujan's second approximation; exact to 1e-4 down to an axis ratio of 0.05)."""
        h = ((self.a - self.b) / (self.a + self.b)) ** 2
        return float(np.pi * (self.a + self.b) * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h))))


def _unit(x: Array, y: Array) -> tuple[Array, Array]:
    size = np.maximum(np.sqrt(x * x + y * y), 1e-12)
    return x / size, y / size


def fit(points: Array, sigma: Array, start: Outline | None = None, turns: int = 3) -> Outline | None:
    """Fit an ellipse to points (N, 2) with standard deviations (N,), px; ``None`` if they do not determine one.

    By linear least squares on the conic's equation over the length of its gradient, which is the distance to first
    order (Sampson's), at the ellipse before: three turns bring it to the least sum of squares.

    Parameters
    ----------
    points, sigma : arrays
    start : Outline, optional
        Saves the first turn, whose gradient is that of a circle.
    turns : int
        After the first.
    """
    if len(points) < 8:  # three more than an ellipse has parameters: else there is no scatter to speak of
        return None
    found = start
    for _ in range(turns if start is not None else turns + 1):
        found = _reweighted(points, sigma, found)
        if found is None:
            return None
    return found


def _reweighted(points: Array, sigma: Array, before: Outline | None) -> Outline | None:
    centre = points.mean(axis=0) if before is None else np.array([before.x, before.y])
    unit = float(np.abs(points - centre).max())
    x, y = ((points - centre) / max(unit, 1e-12)).T
    slope = np.ones(len(x))
    if before is not None:
        p, q = before.local(points).T
        slope = np.hypot(p / before.a**2, q / before.b**2)
    design = np.stack([x * x, x * y, y * y, x, y], axis=1) / (slope * sigma)[:, None]
    size = np.linalg.norm(design, axis=0)
    normal = (design / size).T @ (design / size)
    try:
        A, B, C, D, E = np.linalg.solve(normal, (design / size).T @ (1 / (slope * sigma))) / size
        matrix = np.array([[A, B / 2], [B / 2, C]])
        middle = np.linalg.solve(matrix, [-D / 2, -E / 2])
    except np.linalg.LinAlgError:
        return None
    height = 1 + float(middle @ matrix @ middle)
    values, vectors = np.linalg.eigh(matrix / height)
    if not (np.all(np.isfinite(values)) and values[0] > 0):
        return None
    a, b = unit / np.sqrt(values)
    x, y = centre + unit * middle
    return Outline(float(x), float(y), float(a), float(b), float(np.arctan2(vectors[1, 0], vectors[0, 0])))
