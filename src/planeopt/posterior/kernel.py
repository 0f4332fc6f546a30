"""Distances of all points from the ellipses of many planes at once.

(6) in slopes is a quadratic form in ``(z_L, p, q, 1)``. So are (16) at a point and its gradient: for N points and W
planes each is a product (W, 10) x (10, N). Where the rig is uncertain, each plane has points and a beam of its own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq

Array = NDArray[np.float64]

_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def monomials(planes: Array) -> Array:
    """The ten products (W, 10) of ``z_L, p, q, 1`` of each plane (W, 3)."""
    z_L, p, q = planes.T
    one = np.ones_like(z_L)
    return np.stack([z_L * z_L, p * p, q * q, one, z_L * p, z_L * q, z_L, p * q, p, q], axis=1)


def conic_by_monomials(setup: eq.Setup) -> Array:
    """Matrix (10, 6) with ``monomials @ matrix`` the coefficients ``b_0 ... b_5`` of (6) in slopes."""

    def form(numbers: Array) -> Array:
        # The 1 of (z_L, p, q, 1) stands with f, which makes the form homogeneous.
        z_L, p, q, one = numbers
        return np.array(
            eq.image_conic_in_slopes(np, eq.SlopeVariables(None, z_L, p, q), setup._replace(f=setup.f * one))
        )

    unit = np.eye(4)
    products = [(form(unit[i] + unit[j]) - form(unit[i] - unit[j])) / 2 for i, j in _PAIRS]
    return np.stack([*(form(row) for row in unit), *products])


@dataclass(frozen=True, eq=False)
class Kernel:
    """Whitened distances of fixed points from the image ellipses of planes.

    A point's distance is measured along the line of the ellipse's gradient at the point, in the metric of the point's
    noise: ``F - h d + a d^2 / 2 = 0`` with ``F`` the left side of (16), ``h`` the length of its gradient and ``a`` its
    second derivative along it, so that ``d = 2 F / (h + sqrt(h^2 - 2 a F))``. For a circle this is the distance; for an
    ellipse it differs from the orthogonal distance by terms of third order in noise over radius, the Sampson distance
    ``F/h`` of second.

    Attributes
    ----------
    forms : (10, 3 N)
        By monomial: (16) at the points, then the two parts of its gradient in units of each point's noise.
    quadratic : (10, 3)
        By monomial: ``b_0, b_1, b_2`` of (6).
    roots : (3, N)
        Lower triangles of the Cholesky factors of the points' covariances.
    """

    forms: Array
    quadratic: Array
    roots: Array

    @classmethod
    def of(cls, points: Array, noise: Array, setup: eq.Setup) -> "Kernel":
        """For points (N, 2) on the laser-parallel image plane with covariances (N, 2, 2)."""
        conic = conic_by_monomials(setup)
        value, g_x, g_y = _basis(points)
        root = np.asarray(np.linalg.cholesky(noise), dtype=float)
        xx, yx, yy = root[:, 0, 0], root[:, 1, 0], root[:, 1, 1]
        stacked = np.concatenate([value, xx * g_x + yx * g_y, yy * g_y], axis=1)
        return cls(conic @ stacked, conic[:, :3], np.stack([xx, yx, yy]))

    @property
    def n(self) -> int:
        """Number of points."""
        return self.roots.shape[1]

    def distances(self, planes: Array) -> tuple[Array, Array]:
        """Signed distances from planes (W, 3), positive outside, and the noise that (16) has from each point: (W, N).

        The distances are in standard deviations. Not finite where a plane has no image.
        """
        n, by_monomial = self.n, monomials(planes)
        values = by_monomial @ self.forms
        F, along, across = values[:, :n], values[:, n : 2 * n], values[:, 2 * n :]
        b_0, b_1, b_2 = (by_monomial @ self.quadratic).T[:, :, None]
        xx, yx, yy = self.roots
        x, y = xx * along, yx * along + yy * across
        height2 = along * along + across * across
        bent = 4 * F * (b_0 * (x * x) + y * (b_1 * x + b_2 * y)) / height2
        height = np.sqrt(height2)
        return 2 * F / (height + np.sqrt(np.maximum(height2 - bent, 0.0))), height


def _basis(points: Array) -> tuple[Array, Array, Array]:
    """By coefficient of (16), (6, N) each: its value at the points, its derivatives by x and y."""
    x, y = points.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    value = np.stack([x * x, x * y, y * y, x, y, one])
    by_x = np.stack([2 * x, y, zero, one, zero, zero])
    by_y = np.stack([zero, x, 2 * y, zero, one, zero])
    return value, by_x, by_y


@dataclass(frozen=True, eq=False)
class Moved:
    """Distances of points that have moved.

    Attributes
    ----------
    distance : (W, N)
        Signed, in standard deviations.
    derivatives : (5, W, N)
        By the point's x and y and by ``e_x, e_y, r``: those of (16) over the noise it has from the point, which are the
        distance's own on the ellipse.
    """

    distance: Array
    derivatives: Array


def moved_distances(planes: Array, f: float, points: Array, beams: Array, roots: Array) -> Moved:
    """As `Kernel.distances`, of other points and another beam for each plane.

    With ``l = f - p x - q y``, ``w = z_L - p e_x - q e_y``, ``a = w x - e_x l``, ``b = w y - e_y l`` the conic (6) is
    ``a^2 + b^2 - r^2 l^2``.

    Parameters
    ----------
    planes : (W, 3)
    f : float
    points : (2, W, N)
        x and y on the laser-parallel image plane.
    beams : (W, 3)
        ``e_x, e_y, r``.
    roots : (3, N)
        As in `Kernel`.
    """
    z_L, p, q = planes.T[:, :, None]
    e_x, e_y, r = beams.T[:, :, None]
    x, y = points
    w, r2 = z_L - p * e_x - q * e_y, r * r
    px, py, qx, qy = w + e_x * p, e_y * p, e_x * q, w + e_y * q
    level = f - p * x - q * y
    a, b = w * x - e_x * level, w * y - e_y * level
    F = a * a + b * b - r2 * (level * level)
    half_x = a * px + b * py + (r2 * p) * level
    half_y = a * qx + b * qy + (r2 * q) * level
    xx, yx, yy = roots
    along, across = 2 * (xx * half_x + yx * half_y), 2 * (yy * half_y)
    u, v = xx * along, yx * along + yy * across
    height2 = along * along + across * across
    b_0, b_1, b_2 = px * px + py * py - r2 * p * p, 2 * (px * qx + py * qy - r2 * p * q), qx * qx + qy * qy - r2 * q * q
    bent = 4 * F * (b_0 * (u * u) + v * (b_1 * u + b_2 * v)) / height2
    height = np.sqrt(height2)
    distance = 2 * F / (height + np.sqrt(np.maximum(height2 - bent, 0.0)))
    twice = 2 / height
    a, b = a * twice, b * twice
    turn = a * x + b * y
    derivatives = np.stack(
        [
            half_x * twice,
            half_y * twice,
            -(p * turn + a * level),
            -(q * turn + b * level),
            -(r * twice) * (level * level),
        ]
    )
    return Moved(distance, derivatives)
