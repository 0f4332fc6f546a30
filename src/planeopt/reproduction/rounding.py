"""How far the rounding of Table 1 to four decimals may move the answer: carried through each method to first order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.closed_form import slope_jacobian
from planeopt.formulations.identifiability import ten_jacobian

Array = NDArray[np.float64]

_STEP = 1e-30
"""Of the complex-step derivatives, which need no compromise: they are exact to rounding."""


@dataclass(frozen=True)
class Allowance:
    """What rounding the coordinates may do to ``(R, z_L, alpha, beta)``; (4,) each, mm and rad.

    Attributes
    ----------
    worst : (4,)
        With every coordinate rounded by the most, in the direction that does most harm.
    sigma : (4,)
        Standard deviation, for rounding errors that are independent and uniform.
    """

    worst: Array
    sigma: Array


def allowance(by_points: Array, rounding: float) -> Allowance:
    """Bound and standard deviation from the derivative by the points' coordinates.

    Parameters
    ----------
    by_points : (4, 2N)
        Derivative of ``(R, z_L, alpha, beta)`` by ``x_1, y_1, x_2, ...``.
    rounding : float
        Largest error of a coordinate, mm.
    """
    # A uniform error on [-h, h] has the standard deviation h/sqrt(3).
    sigma = np.linalg.norm(by_points, axis=1) * rounding / np.sqrt(3)
    return Allowance(np.sum(np.abs(by_points), axis=1) * rounding, sigma)


def ellipse_by_points(B: Array, points: Array) -> Array:
    """Derivative (5, 2N) of the maximum-likelihood fit of (16) by the points' coordinates, at points on the ellipse.

    The fit solves ``sum A_i rho_i = 0`` with ``rho_i`` the distance of point i from the ellipse and ``A_i`` its
    derivative by ``B``; a point moves its distance by the part of its step along the normal.
    """
    by_ellipse, normals = _distances(B, points)
    return -np.linalg.pinv(by_ellipse) @ _spread(normals)


def constrained_by_ellipse(plane: Array, setup: eq.Setup, B: Array, points: Array) -> Array:
    """Derivative (3, 5) of `Constrained`'s ``(z_L, p, q)`` by ``B``: least squares weighted by Sigma_B^-1."""
    whitener = _distances(B, points)[0]
    return np.asarray(np.linalg.pinv(whitener @ _ellipse_by_plane(plane, setup)) @ whitener, dtype=float)


def closed_form_by_ellipse(setup: eq.Setup, B: Array) -> Array:
    """Derivative (3, 5) of the closed form's ``(z_L, p, q)`` by ``B``."""
    return slope_jacobian(B, setup)


def penalty_by_ellipse(v: eq.PaperVariables, setup: eq.Setup, B: Array) -> Array:
    """Derivative (4, 5) of the minimiser of (29) with ``J = 0``: unweighted least squares of all ten equations."""
    rows = np.asarray(ten_jacobian()(np.array(v), np.concatenate([setup, B])))
    # Only (17)-(21) hold B, each with the factor -1.
    return np.asarray(np.linalg.pinv(rows)[:, len(eq.LASER_BLOCK) :], dtype=float)


def paper_by_slopes(plane: Array, r: float) -> Array:
    """Derivative (4, 3) of ``(R, z_L, alpha, beta)`` by ``(z_L, p, q)`` on the beam, where the tilt is not zero."""
    _, p, q = plane
    tangent2 = p * p + q * q
    tangent, secant2 = np.sqrt(tangent2), 1 + tangent2
    return np.array(
        [
            [0.0, r * p / np.sqrt(secant2), r * q / np.sqrt(secant2)],
            [1.0, 0.0, 0.0],
            [0.0, p / (tangent * secant2), q / (tangent * secant2)],
            [0.0, -q / tangent2, p / tangent2],
        ]
    )


def _distances(B: Array, points: Array) -> tuple[Array, Array]:
    """Derivative (N, 5) of the points' distances from the ellipse by ``B``, and the unit normals (N, 2) there."""
    x, y = points.T
    gradient = np.stack([2 * x + B[0] * y + B[2], B[0] * x + 2 * B[1] * y + B[3]], axis=1)
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    return np.stack([x * y, y * y, x, y, np.ones_like(x)], axis=1) / length, gradient / length


def _spread(normals: Array) -> Array:
    """Derivative (N, 2N) of the distances by the coordinates: each point moves only its own."""
    n = len(normals)
    spread = np.zeros((n, n, 2))
    spread[np.arange(n), np.arange(n)] = normals
    return spread.reshape(n, 2 * n)


def _ellipse_by_plane(plane: Array, setup: eq.Setup) -> Array:
    """Derivative (5, 3) of (6)'s ``b_i/b_0`` by ``(z_L, p, q)``, by complex steps."""
    stepped = plane[:, None] + 1j * _STEP * np.eye(3)
    b = eq.image_conic_in_slopes(np, eq.SlopeVariables(None, *stepped), setup)
    return np.imag(np.stack([b_i / b[0] for b_i in b[1:]])) / _STEP
