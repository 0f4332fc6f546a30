"""How well the points could fix the plane at all, and whether maximum likelihood gets there.

The Cramér-Rao bound is the inverse of the expected information ``sum_i j_i j_i'``, ``j_i`` the change of the boundary
along its normal at point i, in its standard deviations, per unit of the plane. It is reached where the image is linear
in the plane over the plane's own uncertainty and the noise is small against the spot (docs/model.md, section 9);
elsewhere errors are larger than the bound, and intervals of first order too short.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.conic import geometric_from_conic, is_ellipse
from planeopt.estimation.descent import at_planes, within_bounds
from planeopt.estimation.feet import Boundary
from planeopt.estimation.images import SPAN, Images, conics_at
from planeopt.estimation.regular import Quadratic
from planeopt.estimation.reservations import slope_sigmas
from planeopt.estimation.second_order import typical_sigma
from planeopt.estimation.tangents import (
    BLOCK,
    Cloud,
    Tangents,
    combinations,
    complete,
    products,
    tangents,
    value_and_gradient,
)
from planeopt.formulations.problem import Problem

Array = NDArray[np.float64]

NOISE_SHARE = 0.02
"""Noise over the image ellipse's minor semi-axis up to which the bound is reached."""

CURVATURE = 0.01
"""Tangential curvature up to which the bound is reached."""

SLOPE_SIGMA = 0.2
"""Standard deviation of a slope up to which the bound is reached."""


@dataclass(frozen=True, eq=False)
class Reach:
    """What decides whether the bound can be reached, for M planes; NaN where it is not known.

    Attributes
    ----------
    sigma_over_axis : (M,)
        Median standard deviation of the points over the minor semi-axis of the image ellipse.
    curvature : (M,)
        ``K = max |P_T (g(u + d) + g(u - d) - 2 g(u))|``, to second order, over one-sigma steps ``d`` along the
        eigenvectors of the covariance of ``u = (log z_L, p, q)``; ``g`` the boundary in standard deviations of the
        points, ``P_T`` the projection on what a plane can change to first order. Infinite where a step leaves what can
        be seen.
    slope_sigma : (M,)
        Largest standard deviation of a slope in any direction.
    """

    sigma_over_axis: Array
    curvature: Array
    slope_sigma: Array

    @property
    def excess(self) -> Array:
        """By what factor (M,) the worst of the three is over its limit."""
        shares = (self.sigma_over_axis / NOISE_SHARE, self.curvature / CURVATURE, self.slope_sigma / SLOPE_SIGMA)
        return np.max(shares, axis=0)

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Where the bound can be reached, (M,)."""
        return self.excess <= 1


def bound(problem: Problem, plane: Array) -> Array:
    """Cramér-Rao bound (3, 3) of ``(z_L, p, q)`` at a plane, for the problem's points and their noise.

    Parameters
    ----------
    problem : Problem
        With points.
    plane : (3,)
        In the equations' sense.

    Raises
    ------
    ValueError
        If the problem has no points.
    """
    points, noise = _points(problem)
    return bounds(problem.setup, np.asarray(plane, dtype=float)[None], Boundary.of(points[None], noise[None]))[0]


def bounds(setup: eq.Setup, planes: Array, boundary: Boundary) -> Array:
    """Cramér-Rao bounds (M, 3, 3) of planes (M, 3), each for the points of its row, put on the boundary."""
    rows = _tangents(setup, planes, boundary)
    triangle = np.linalg.qr(np.swapaxes(rows, -1, -2), mode="r")
    inverse = np.linalg.inv(triangle)
    return inverse @ np.swapaxes(inverse, -1, -2)


def within_reach(problem: Problem, plane: Array, covariance: Array | None = None) -> Reach:
    """Whether the bound can be reached at a plane; arrays of one.

    Parameters
    ----------
    problem : Problem
        With points.
    plane : (3,)
        In the equations' sense.
    covariance : (3, 3), optional
        Of the plane, from the points' noise; the bound unless given.

    Raises
    ------
    ValueError
        If the problem has no points.
    """
    points, noise = _points(problem)
    boundary, planes = Boundary.of(points[None], noise[None]), np.asarray(plane, dtype=float)[None]
    given = bounds(problem.setup, planes, boundary) if covariance is None else np.asarray(covariance)[None]
    return reach(problem.setup, planes, given, boundary, typical_sigma(noise[None]))


def reach(setup: eq.Setup, planes: Array, covariance: Array, boundary: Boundary, sigma: Array) -> Reach:
    """Whether the bound can be reached, for M planes at once.

    Parameters
    ----------
    setup : Setup
    planes : (M, 3)
        In the equations' sense.
    covariance : (M, 3, 3)
        Of the planes, from the points' noise.
    boundary : Boundary
        M rows of points with their noise.
    sigma : (M,)
        Typical standard deviation of the points, mm.
    """
    known = within_bounds(planes, setup) & np.isfinite(covariance).all(axis=(-1, -2))
    harmless = np.where(known[:, None], planes, [setup.f * setup.r, 0.0, 0.0])
    spread = np.where(known[:, None, None], covariance, 1e-12 * np.eye(3))
    bent = curvatures(setup, harmless, spread, boundary)
    axis = minor_axes(setup, harmless)
    return Reach(
        *(np.where(known, value, np.nan) for value in (sigma / axis, bent, slope_sigmas(spread))),
    )


def minor_axes(setup: eq.Setup, planes: Array) -> Array:
    """Minor semi-axes (M,) of the image ellipses of planes (M, 3), mm."""
    conics = eq.image_conic_in_slopes(np, eq.SlopeVariables(None, *planes.T), setup)
    b = np.stack(np.broadcast_arrays(*conics), axis=-1)
    B = b[..., 1:] / b[..., :1]
    real = is_ellipse(B)
    axes = np.min(geometric_from_conic(np.where(real[:, None], B, [0.0, 1.0, 0.0, 0.0, -1.0])).semi_axes, axis=-1)
    return np.where(real, axes, np.nan)


def curvatures(setup: eq.Setup, planes: Array, covariance: Array, boundary: Boundary) -> Array:
    """Tangential curvatures K (M,) as `Reach` has them."""
    cloud, images = _cloud(boundary), Images.of(setup)
    found = at_planes(planes, boundary, setup)[1]
    feet = cloud.monomials()
    feet[3] -= found.dx * boundary.unit[:, None]
    feet[4] -= found.dy * boundary.unit[:, None]
    complete(feet)
    at, by_plane = images.coordinates(planes, cloud.origin)
    seen = tangents(cloud, conics_at(at), feet)
    return curvatures_seen(setup, images, planes, covariance, cloud.origin, seen, by_plane, Quadratic.of(seen, at))


def curvatures_seen(
    setup: eq.Setup,
    images: Images,
    planes: Array,
    covariance: Array,
    origin: Array,
    seen: Tangents,
    by_plane: Array,
    quadratic: Quadratic,
) -> Array:
    """`curvatures`, from the points at the planes' ellipses.

    A point ``y`` of the ellipse ``F = 0`` has from the ellipse of ``u + d`` the signed distance ``s + s^2 (V g)' A V g
    / h^3`` to second order, ``s = F_d(y) / |grad F_d(y)|_V``, ``g = grad F``, ``h = |g|_V``, A the quadratic part of
    F. Its even part in d is half of what is wanted.
    """
    size = np.stack([planes[:, 0], np.ones(len(planes)), np.ones(len(planes))], axis=-1)
    values, vectors = np.linalg.eigh(covariance / (size[:, :, None] * size[:, None, :]))
    steps = np.swapaxes(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :], 1, 2)
    steps = np.concatenate([steps, -steps], axis=1)
    moved = planes[:, None, :] + steps
    moved[..., 0] = planes[:, :1] * np.exp(steps[..., 0])
    visible = within_bounds(moved, setup)
    first, second = images.differences(planes, moved, origin)
    # F_d, the components of its gradient, and F_dd, of three directions.
    coefficients = np.concatenate([value_and_gradient(first.reshape(-1, 6)).reshape(-1, 9, 6), second], axis=1)
    conics, sums = conics_at(quadratic.at), np.empty((len(planes), 6, 3))
    size = max(1, BLOCK // seen.left.shape[1])
    for begin in range(0, len(planes), size):
        some = slice(begin, begin + size)
        sums[some] = _second_sums(seen, conics[some], coefficients[some], some)
    along = np.swapaxes(by_plane, 1, 2) @ (SPAN.T @ sums)
    own = np.swapaxes(by_plane, 1, 2) @ quadratic.information @ by_plane
    bent = np.sqrt(np.einsum("mik,mik->mk", along, np.linalg.solve(own, along)))
    return np.max(np.where(visible[:, :3] & visible[:, 3:], bent, np.inf), axis=-1)


def _second_sums(seen: Tangents, conics: Array, coefficients: Array, some: slice) -> Array:
    """Sums (M, 6, 3) of second derivatives of the distances along three directions with the monomials, for some rows.

    `coefficients` (M, 12, 6): of F_d and of the components of its gradient, for each direction, then of F_dd.
    """
    monomials, weight = seen.monomials[:, some], seen.weight[some]
    ax, ay = seen.carried[0][some], seen.carried[1][some]
    rows = combinations(coefficients, monomials)
    across = (conics[:, :1] * ax + conics[:, 1:2] * ay) * ax + conics[:, 2:3] * ay * ay
    across *= weight
    for k in range(3):
        value, gx, gy, bent = rows[3 * k], rows[3 * k + 1], rows[3 * k + 2], rows[9 + k]
        # (F_dd - 2 F_d (V g)' grad F_d / h^2 + 2 F_d^2 (V g)' A (V g) / h^4) / h^2
        gx *= ax
        gy *= ay
        gx += gy
        np.multiply(value, across, out=gy)
        gx -= gy
        gx *= value
        gx *= weight
        gx *= 2
        bent -= gx
        bent *= weight
    return products(monomials, rows[9:])


def _cloud(boundary: Boundary) -> Cloud:
    unit = boundary.unit[:, None]
    used = np.broadcast_to(boundary.weight > 0, boundary.x.shape)
    if boundary.precision[0].ndim == 0:
        sigma = unit / np.where(boundary.weight > 0, boundary.weight, 1.0)
        xx, xy, yy = np.broadcast_to(sigma * sigma, boundary.x.shape), None, None
    else:
        xx, xy, yy = (part * unit * unit for part in boundary.covariance)
    return Cloud(boundary.x * unit, boundary.y * unit, boundary.origin, xx, xy, yy, used)


def _tangents(setup: eq.Setup, planes: Array, boundary: Boundary) -> Array:
    """Derivatives (M, 3, N) of the points' distances by the planes."""
    conics, found, monomials = at_planes(planes, boundary, setup)
    return (conics.by_plane @ monomials) * found.rate[:, None, :]


def _points(problem: Problem) -> tuple[Array, Array]:
    if problem.points is None or problem.noise is None:
        raise ValueError("the bound needs the boundary points, not the ellipse alone")
    return problem.points, problem.noise
