"""Distances of many boundary points from ellipses near them, by tangents at feet that are known nearly.

A point ``x`` with the noise ``V`` has on the ellipse ``F = 0`` a foot ``y``, where ``x - y = m V grad F(y)``. From a
guess of it the tangent there gives

    m = (F(y) + grad F(y)' (x - y)) / (grad F' V grad F),    y' = x - m V grad F(y):

what ``y'`` is off along the curve is the guess's own error times the distance over the curve's radius. Where that ratio
is small two rounds find the foot to rounding, and the points themselves will do as the first guess: the first distance
is Sampson's.

All that Gauss-Newton needs of the points are then sums of products of the feet's monomials, since the distance's
derivative by a conic's coefficients is the monomials over ``sqrt(grad F' V grad F)``. Arrays have the points' part
first and the spots next, so that operations run over whole pieces.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


BLOCK = 1 << 14
"""Points whose arrays the nearest cache holds together."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Boundary points of M spots, centred.

    Attributes
    ----------
    x, y : (M, N)
        From the origin, mm.
    origin : (M, 2)
        In the coordinates of the laser-parallel image plane, mm.
    xx, xy, yy : (M, N) or (M, 1)
        Covariances of the points, mm^2; xy and yy None where the noise is isotropic, with the variance xx.
    used : (M, N) of bool or None
        False for padding, which must be finite and near the points; None where there is none.
    """

    x: Array
    y: Array
    origin: Array
    xx: Array
    xy: Array | None
    yy: Array | None
    used: NDArray[np.bool_] | None

    @classmethod
    def of(cls, points: Array, noise: Array, factor: Array, used: NDArray[np.bool_] | None) -> "Cloud":
        """Centre points (M, N, 2) with sigmas (M, N) or (M, 1), or covariances (M, N, 2, 2), times factors (M,)."""
        x, y = np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])
        origin = np.stack([np.mean(x, axis=1), np.mean(y, axis=1)], axis=1)
        x, y = x - origin[:, :1], y - origin[:, 1:]
        if noise.ndim < 4:
            noise = noise * factor[:, None]
            return cls(x, y, origin, noise * noise, None, None, used)
        xx, xy, yy = (np.ascontiguousarray(noise[..., i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        if np.any(factor != 1):
            xx, xy, yy = (part * (factor**2)[:, None] for part in (xx, xy, yy))
        return cls(x, y, origin, xx, xy, yy, used)

    def take(self, rows: NDArray[np.intp]) -> "Cloud":
        """Return some of the spots."""
        xy, yy = (None if part is None else part[rows] for part in (self.xy, self.yy))
        used = None if self.used is None else self.used[rows]
        return Cloud(self.x[rows], self.y[rows], self.origin[rows], self.xx[rows], xy, yy, used)

    @property
    def trace(self) -> Array:
        """Trace of the covariances, (M, N) or (M, 1)."""
        return 2 * self.xx if self.yy is None else self.xx + self.yy

    def monomials(self) -> Array:
        """Return those of the points, a first guess of their feet; (6, M, N)."""
        made = np.empty((6, *self.x.shape))
        made[3], made[4], made[5] = self.x, self.y, 1.0
        complete(made)
        return made

    def carry(self, gx: Array, gy: Array, rows: slice) -> tuple[Array, Array]:
        """Return V times vectors, of some of the spots."""
        xx = self.xx[rows]
        x = xx * gx
        if self.xy is None or self.yy is None:
            return x, xx * gy
        xy, y = self.xy[rows], self.yy[rows] * gy
        part = xy * gy
        x += part
        y += np.multiply(xy, gx, out=part)
        return x, y


def complete(monomials: Array) -> None:
    """Write the products of ``x`` and ``y`` into monomials (6, ...)."""
    x, y = monomials[3], monomials[4]
    np.multiply(x, x, out=monomials[0])
    np.multiply(x, y, out=monomials[1])
    np.multiply(y, y, out=monomials[2])


@dataclass(frozen=True, eq=False)
class Tangents:
    """Points seen from the tangents at their feet.

    Attributes
    ----------
    monomials : (6, M, N)
        ``x^2, xy, y^2, x, y, 1`` of the new feet, centred.
    weighted : (7, M, N)
        The monomials over ``grad F' V grad F``, then ``m``; 0 for padding. The last but one is the weight itself.
    left : (M, N)
        ``m grad F' V grad F``.
    gradient, carried : pairs of (M, N)
        ``grad F`` and ``V grad F``.
    products : (M, 6, 7)
        Sums of products of the monomials with what is weighted.
    """

    monomials: Array
    weighted: Array
    left: Array
    gradient: tuple[Array, Array]
    carried: tuple[Array, Array]
    products: Array

    @property
    def multiplier(self) -> Array:
        """``m``, (M, N)."""
        return self.weighted[6]

    @property
    def weight(self) -> Array:
        """One over ``grad F' V grad F``, (M, N)."""
        return self.weighted[5]

    def put(self, rows: NDArray[np.intp], values: "Tangents") -> None:
        """Write those of some of the spots."""
        self.monomials[:, rows], self.weighted[:, rows] = values.monomials, values.weighted
        self.left[rows], self.products[rows] = values.left, values.products
        for ours, theirs in zip((*self.gradient, *self.carried), (*values.gradient, *values.carried), strict=True):
            ours[rows] = theirs

    def sums(self) -> Array:
        """Return the sums (M, 6, 7) of squares and products of the distances' derivatives, and with the distances."""
        return self.products

    def cost(self) -> Array:
        """Return the sums of the squared distances, (M,)."""
        return np.einsum("mi,mi->m", self.multiplier, self.left)


def products(rows: Array, others: Array) -> Array:
    """Return sums over the points of products of rows (k, M, N) and others (l, M, N): (M, k, l)."""
    return rows.transpose(1, 0, 2) @ others.transpose(1, 2, 0)


def combinations(coefficients: Array, rows: Array) -> Array:
    """Return combinations (k, M, N) of rows (l, M, N) with coefficients (M, k, l)."""
    made = np.empty((coefficients.shape[1], *rows.shape[1:]))
    np.matmul(coefficients, rows.transpose(1, 0, 2), out=made.transpose(1, 0, 2))
    return made


def tangents(cloud: Cloud, conics: Array, guess: Array) -> Tangents:
    """Take the tangents at guessed feet.

    Parameters
    ----------
    cloud : Cloud
    conics : (M, 6)
        Coefficients over the centred monomials.
    guess : (6, M, N)
        Monomials of the feet to begin with; overwritten with those of the new ones.
    """
    m, n = cloud.x.shape
    made = Tangents(
        guess,
        np.empty((7, m, n)),
        np.empty((m, n)),
        (np.empty((m, n)), np.empty((m, n))),
        (np.empty((m, n)), np.empty((m, n))),
        np.empty((m, 6, 7)),
    )
    coefficients = value_and_gradient(conics)
    size = max(1, BLOCK // n)
    for begin in range(0, m, size):
        rows = slice(begin, begin + size)
        _look(cloud, coefficients[rows], made, rows)
    return made


def _look(cloud: Cloud, coefficients: Array, made: Tangents, rows: slice) -> None:
    """Take the tangents of some rows."""
    guess, weighted = made.monomials[:, rows], made.weighted[:, rows]
    value, gx, gy = combinations(coefficients, guess)
    x, y = cloud.x[rows], cloud.y[rows]
    ax, ay = cloud.carry(gx, gy, rows)
    weight, multiplier = weighted[5], weighted[6]
    size, part = gx * ax, gy * ay
    size += part
    value += np.multiply(np.subtract(x, guess[3], out=part), gx, out=part)
    value += np.multiply(np.subtract(y, guess[4], out=part), gy, out=part)
    np.divide(1.0, size, out=weight)
    if cloud.used is not None:
        weight *= cloud.used[rows]
    np.multiply(value, weight, out=multiplier)
    np.subtract(x, np.multiply(multiplier, ax, out=part), out=guess[3])
    np.subtract(y, np.multiply(multiplier, ay, out=part), out=guess[4])
    complete(guess)
    np.multiply(guess[:5], weight, out=weighted[:5])
    made.products[rows] = products(guess, weighted)
    made.left[rows] = value
    made.gradient[0][rows], made.gradient[1][rows] = gx, gy
    made.carried[0][rows], made.carried[1][rows] = ax, ay


def value_and_gradient(conics: Array) -> Array:
    """Return coefficients (M, 3, 6) of F and of the components of its gradient, from those of F (M, 6)."""
    made = np.zeros((len(conics), 3, 6))
    made[:, 0] = conics
    made[:, 1, 3], made[:, 1, 4], made[:, 1, 5] = 2 * conics[:, 0], conics[:, 1], conics[:, 3]
    made[:, 2, 3], made[:, 2, 4], made[:, 2, 5] = conics[:, 1], 2 * conics[:, 2], conics[:, 4]
    return made
