"""Distances of all points from the ellipses of many planes at once, by one matrix product.

(6) in slopes is a quadratic form in ``(z_L, p, q, 1)``. So are (16) at a point, its gradient and its derivatives by the
beam's offset and radius: for N points and W planes each is a product (W, 10) x (10, N).
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


def rig_forms(points: Array, setup: eq.Setup, points_by_rig: Array, setup_by_rig: Array) -> Array:
    """Derivatives of (16) at the points by k parameters of the rig, by monomial of the plane.

    Parameters
    ----------
    points : (N, 2)
    setup : Setup
    points_by_rig : (N, 2, k)
        How the points move on the laser-parallel image plane, their raw pixels held fixed.
    setup_by_rig : (3, k)
        How ``e_x, e_y, r`` move.

    Returns
    -------
    (10, N, k)
    """
    conic = conic_by_monomials(setup)
    value, g_x, g_y = _basis(points)
    forms = (conic @ g_x)[:, :, None] * points_by_rig[:, 0] + (conic @ g_y)[:, :, None] * points_by_rig[:, 1]
    # (6) is of second degree in e_x, e_y and r: a central difference is exact, and a step of 1 mm loses no digit.
    for column, name in enumerate(("e_x", "e_y", "r")):
        at = getattr(setup, name)
        ahead, behind = (conic_by_monomials(setup._replace(**{name: at + step})) for step in (1.0, -1.0))
        forms += (((ahead - behind) / 2) @ value)[:, :, None] * setup_by_rig[column]
    return forms
