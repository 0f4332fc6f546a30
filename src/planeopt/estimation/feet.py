"""Feet of boundary points on the image of a plane's spot, many planes and points at once.

The image ellipse of a plane is the zero set of ``F(x; z_L, p, q)``, (6) in slopes. A point's foot is the point of the
ellipse nearest to it in the metric of its own noise ``V``; its distance ``d`` is counted in standard deviations and is
positive outside. With ``F = 0`` and ``x - foot = m V grad F(foot)``, the foot hangs on one number ``m``, whose Newton
iteration begins at 0, so that its first step is the Sampson distance. The distance's exact derivative is Sampson's,
taken at the foot: ``d(d)/d plane = (dF/d plane) / sqrt(grad F' V grad F)``.

Everything runs in coordinates centred on the points and scaled to their size, where nothing cancels, and F, its
gradient and its derivatives by the plane are matrix products with the monomials of the points.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt import equations as eq

Array = NDArray[np.float64]

FOOT_TOLERANCE = 1e-10
"""How far a distance may be off, in standard deviations."""

MAX_FOOT_STEPS = 40
"""One to three are usual; points near the centre of an ellipse need most."""

# Newton's step on an inverse square leaves this times its square over the distance from the pole.
_QUADRATIC = 1.5


@dataclass(frozen=True)
class Boundary:
    """Boundary points with their noise, ready for distances from any number of planes.

    Attributes
    ----------
    origin : (..., 2)
        Of the local coordinates, mm.
    unit : (...)
        Of the local coordinates, mm.
    monomials : (..., 6, N)
        ``x^2, xy, y^2, x, y, 1`` of the points, local.
    covariance : three arrays broadcasting to (..., N)
        xx, xy, yy of the points' noise in local units; the identity where it is isotropic.
    precision : three arrays broadcasting to (..., N)
        Its inverse.
    weight : array broadcasting to (..., N)
        What distances in this metric are multiplied by: 1, or one over sigma where noise is isotropic; 0 for padding.
    """

    origin: Array
    unit: Array
    monomials: Array
    covariance: tuple[Array, Array, Array]
    precision: tuple[Array, Array, Array]
    weight: Array

    @classmethod
    def of(cls, points: ArrayLike, noise: ArrayLike, used: NDArray[np.bool_] | None = None) -> "Boundary":
        """Prepare points; nothing is checked, so that batches can mark their bad rows themselves.

        Parameters
        ----------
        points : (..., N, 2)
            On the laser-parallel image plane, mm.
        noise : scalar, (..., N) or (..., N, 2, 2)
            Standard deviations (mm), or covariances (mm^2).
        used : (..., N) of bool, optional
            False for padding, which must be finite and near the points.
        """
        xy, given = np.asarray(points, dtype=float), np.asarray(noise, dtype=float)
        x, y = xy[..., 0], xy[..., 1]
        origin = np.stack([np.mean(x, axis=-1), np.mean(y, axis=-1)], axis=-1)
        x, y = x - origin[..., :1], y - origin[..., 1:]
        unit = np.sqrt((np.einsum("...i,...i", x, x) + np.einsum("...i,...i", y, y)) / x.shape[-1])
        unit = np.where(unit > 0, unit, 1.0)
        x, y = x / unit[..., None], y / unit[..., None]
        one = np.ones(())
        if given.ndim >= 3 and given.shape[-2:] == (2, 2):
            xx, xy_, yy = (given[..., i, j] / unit[..., None] ** 2 for i, j in ((0, 0), (0, 1), (1, 1)))
            size = xx * yy - xy_ * xy_
            covariance, precision, weight = (xx, xy_, yy), (yy / size, -xy_ / size, xx / size), one
        else:
            covariance = precision = (one, np.zeros(()), one)
            weight = unit[..., None] / given
        if used is not None:
            weight = np.where(used, weight, 0.0)
        return cls(origin, unit, _monomials(x, y), covariance, precision, weight)

    def __getitem__(self, rows: Any) -> "Boundary":
        """Return some rows of the leading dimension."""
        return Boundary(
            self.origin[rows],
            self.unit[rows],
            self.monomials[rows],
            _some(self.covariance, rows),
            _some(self.precision, rows),
            self.weight[rows] if self.weight.ndim > 1 else self.weight,
        )

    def for_several_planes(self) -> "Boundary":
        """The same with an axis before that of the points, for several planes to each row."""
        return Boundary(
            self.origin[..., None, :],
            self.unit[..., None],
            self.monomials[..., None, :, :],
            _some(self.covariance, np.s_[..., None, :]),
            _some(self.precision, np.s_[..., None, :]),
            self.weight[..., None, :] if self.weight.ndim > 1 else self.weight,
        )

    @property
    def x(self) -> Array:
        """Local coordinate, (..., N)."""
        return self.monomials[..., 3, :]

    @property
    def y(self) -> Array:
        """Local coordinate, (..., N)."""
        return self.monomials[..., 4, :]


def _some(parts: tuple[Array, Array, Array], rows: Any) -> tuple[Array, Array, Array]:
    first, second, third = (part[rows] if part.ndim > 1 else part for part in parts)
    return first, second, third


def _monomials(x: Array, y: Array, made: Array | None = None) -> Array:
    if made is None:
        made = np.empty((*x.shape[:-1], 6, x.shape[-1]))
    np.multiply(x, x, out=made[..., 0, :])
    np.multiply(x, y, out=made[..., 1, :])
    np.multiply(y, y, out=made[..., 2, :])
    made[..., 3, :], made[..., 4, :], made[..., 5, :] = x, y, 1.0
    return made


@dataclass(frozen=True)
class Conics:
    """Image ellipses of planes in local coordinates: coefficients over `Boundary.monomials`.

    Attributes
    ----------
    value : (..., 3, 6)
        Of F and of the two components of its gradient.
    by_plane : (..., 3, 6)
        Of the derivatives of F by ``z_L``, ``p``, ``q``.
    """

    value: Array
    by_plane: Array

    @classmethod
    def of(cls, planes: Array, setup: eq.Setup, boundary: Boundary) -> "Conics":
        """Coefficients for planes (..., 3) in the coordinates of the points.

        ``F = a_1^2 + a_2^2 - r^2 l^2`` with the linear forms ``l = f - p x - q y``, ``a = w (x, y) - e l``,
        ``w = z_L - p e_x - q e_y``. With ``s = e_y x - e_x y`` its derivatives are ``2 (a_1 x + a_2 y)``,
        ``2 (a_2 s + r^2 l x)`` and ``2 (-a_1 s + r^2 l y)``.
        """
        z_L, p, q = planes[..., 0], planes[..., 1], planes[..., 2]
        f, e_x, e_y, r = setup
        ox, oy, unit = boundary.origin[..., 0], boundary.origin[..., 1], boundary.unit
        w = z_L - p * e_x - q * e_y
        x = np.zeros((3, *np.broadcast_shapes(w.shape, unit.shape)))
        y, level = np.zeros_like(x), np.empty_like(x)
        x[0], x[2], y[1], y[2] = unit, ox, unit, oy
        level[0], level[1], level[2] = -p * unit, -q * unit, f - p * ox - q * oy
        a1, a2, turn = w * x - e_x * level, w * y - e_y * level, e_y * x - e_x * y
        made = np.zeros((6, 6, *x.shape[1:]))
        _add_products(made[0], (a1, a1), (a2, a2), (-(r**2) * level, level))
        made[1, 3], made[1, 4], made[1, 5] = 2 * made[0, 0], made[0, 1], made[0, 3]
        made[2, 3], made[2, 4], made[2, 5] = made[0, 1], 2 * made[0, 2], made[0, 4]
        _add_products(made[3], (2 * a1, x), (2 * a2, y))
        _add_products(made[4], (2 * a2, turn), (2 * r**2 * level, x))
        _add_products(made[5], (-2 * a1, turn), (2 * r**2 * level, y))
        coefficients = np.ascontiguousarray(np.moveaxis(made, (0, 1), (-2, -1)))
        return cls(coefficients[..., :3, :], coefficients[..., 3:, :])


def _add_products(to: Array, *pairs: tuple[Array, Array]) -> None:
    """Add the coefficients (6, ...) of products of linear forms in ``(x, y, 1)``."""
    for one, other in pairs:
        to[0] += one[0] * other[0]
        to[1] += one[0] * other[1] + one[1] * other[0]
        to[2] += one[1] * other[1]
        to[3] += one[0] * other[2] + one[2] * other[0]
        to[4] += one[1] * other[2] + one[2] * other[1]
        to[5] += one[2] * other[2]


@dataclass(frozen=True)
class Feet:
    """The points' feet on their ellipses.

    Attributes
    ----------
    multiplier : (..., N)
        ``m``: where the next search may begin.
    distance : (..., N)
        Signed, in standard deviations; 0 for padding.
    dx, dy : (..., N)
        Point minus foot, local.
    rate : (..., N)
        By how much the distance changes with F at the foot: weight over ``sqrt(grad F' V grad F)``; 0 for padding.
    """

    multiplier: Array
    distance: Array
    dx: Array
    dy: Array
    rate: Array


def feet(conics: Conics, boundary: Boundary, start: Array | None = None, tolerance: float = FOOT_TOLERANCE) -> Feet:
    """Find the nearest points of the ellipses.

    Parameters
    ----------
    conics : Conics
        Ellipses; leading dimensions broadcast with the boundary's.
    boundary : Boundary
    start : (..., N), optional
        Multipliers to begin with; 0 unless given.
    tolerance : float
        Of the distances, as `FOOT_TOLERANCE`.

    Notes
    -----
    Below the pole lie the farthest points of the ellipse; above it F falls and is convex: a step that is kept from
    the pole comes to lie left of the root, and Newton's steps come back from there without fail. What is left after the
    last is added along the normal, which is of the same order as another step.
    """
    quadratic = conics.value[..., 0, :3]
    axx, axy, ayy = quadratic[..., :1], quadratic[..., 1:2] / 2, quadratic[..., 2:]
    pole = _pole(axx, axy, ayy, boundary)
    search = _isotropic_feet if boundary.precision[0].ndim == 0 else _general_feet
    return search(conics, boundary, (axx, axy, ayy), pole, start, tolerance)


def _isotropic_feet(
    conics: Conics, boundary: Boundary, quadratic: tuple[Array, ...], pole: Array, start: Array | None, tolerance: float
) -> Feet:
    """`feet` along the axes of the ellipse, where ``V^-1 + 2 m A`` is diagonal; in place: this is where time goes."""
    axx, axy, ayy = quadratic
    angle = np.arctan2(axy, (axx - ayy) / 2) / 2
    cos, sin = np.cos(angle), np.sin(angle)
    spread = np.hypot((axx - ayy) / 2, axy)
    first, second = (axx + ayy) / 2 + spread, (axx + ayy) / 2 - spread
    turned = conics.value.copy()
    turned[..., 1, :] = cos * conics.value[..., 1, :] + sin * conics.value[..., 2, :]
    turned[..., 2, :] = cos * conics.value[..., 2, :] - sin * conics.value[..., 1, :]
    at_point = turned @ boundary.monomials
    value, g1, g2 = at_point[..., 0, :], at_point[..., 1, :], at_point[..., 2, :]
    m = np.zeros_like(value) if start is None else np.maximum(start, 0.5 * pole)
    weight = boundary.weight
    steps = 0
    while True:
        steps += 1
        s1, s2 = m * (2 * first), m * (2 * second)
        s1 += 1
        s2 += 1
        u1, u2 = g1 / s1, g2 / s2
        slope, other = u1 * u1, u2 * u2
        steepness = slope + other
        slope /= s1
        other /= s2
        slope += other
        left = u1 * g1
        left += np.multiply(u2, g2, out=other)
        left += steepness
        left *= m
        left *= -0.5
        left += value
        step = np.divide(left, slope, out=slope)
        room = np.subtract(pole, m, out=s1)
        np.maximum(step, np.multiply(room, 0.5, out=other), out=step)
        height = np.sqrt(steepness)
        rest = np.multiply(step, step, out=other)
        rest *= height
        rest *= weight
        room *= -tolerance / _QUADRATIC
        if steps == MAX_FOOT_STEPS or not np.any(rest > room):
            break
        m = m + step
    left /= steepness
    left += m
    u1 *= left
    u2 *= left
    left *= height
    left *= weight
    return Feet(np.add(m, step, out=step), left, cos * u1 - sin * u2, sin * u1 + cos * u2, weight / height)


def _general_feet(
    conics: Conics, boundary: Boundary, quadratic: tuple[Array, ...], pole: Array, start: Array | None, tolerance: float
) -> Feet:
    """`feet` in each point's own metric."""
    axx, axy, ayy = quadratic
    at_point = conics.value @ boundary.monomials
    value, gx, gy = at_point[..., 0, :], at_point[..., 1, :], at_point[..., 2, :]
    wxx, wxy, wyy = boundary.precision
    m = np.zeros_like(value) if start is None else np.maximum(start, 0.5 * pole)
    weight = boundary.weight
    steps = 0
    while True:
        steps += 1
        # S = V^-1 + 2 m A, u = S^-1 grad F(point); h = V^-1 u is the gradient where the search stands.
        twice = m + m
        sxx, sxy, syy = wxx + twice * axx, wxy + twice * axy, wyy + twice * ayy
        size = 1 / (sxx * syy - sxy * sxy)
        ux, uy = (syy * gx - sxy * gy) * size, (sxx * gy - sxy * gx) * size
        hx, hy = wxx * ux + wxy * uy, wxy * ux + wyy * uy
        steepness = ux * hx + uy * hy
        left = value - 0.5 * m * (ux * (gx + hx) + uy * (gy + hy))
        room = pole - m
        step = np.maximum(left / ((syy * hx * hx - 2 * sxy * hx * hy + sxx * hy * hy) * size), 0.5 * room)
        height = np.sqrt(steepness)
        if steps == MAX_FOOT_STEPS or not np.any(step * step * height * weight > -tolerance / _QUADRATIC * room):
            break
        m = m + step
    reach = m + left / steepness
    return Feet(m + step, reach * height * weight, reach * ux, reach * uy, weight / height)


def _pole(axx: Array, axy: Array, ayy: Array, boundary: Boundary) -> Array:
    """Below which the foot would be a farthest point: minus one over twice the largest eigenvalue of ``V A``."""
    cxx, cxy, cyy = boundary.covariance
    half = (cxx * axx + 2 * cxy * axy + cyy * ayy) / 2
    size = (cxx * cyy - cxy * cxy) * (axx * ayy - axy * axy)
    return -0.5 / (half + np.sqrt(np.maximum(half * half - size, 0.0)))


def monomials_at_feet(found: Feet, boundary: Boundary, out: Array | None = None) -> Array:
    """Local monomials (..., 6, N) of the feet, written to `out` if that is given."""
    return _monomials(boundary.x - found.dx, boundary.y - found.dy, out)
