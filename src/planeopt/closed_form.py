"""Both planes of an image ellipse at once, in closed form and vectorised.

It starts and cross-checks all other formulations. The plane maps the beam's cross-section to the image by
``H = [[f, 0, 0], [0, f, 0], [p, q, w]]`` with ``w = z_L - p e_x - q e_y``, the plane's intercept on the optical axis.
The image conic is ``C ~ H^-T C_0 H^-1``, its dual ``C* ~ H C_0* H'``, where ``C_0 = [[I, -e], [-e', k]]``,
``C_0* = [[e e' - r^2 I, e], [e', 1]]`` and ``k = |e|^2 - r^2``. Two routes lead back:

- *primal* (`from_primal`) divides by ``k``: well conditioned while the camera is clearly outside the beam;
- *dual* (`from_dual`) divides by ``r^2``: right also inside the beam and on its surface, where ``k = 0``.

Neither is the accurate answer under noise: the weak directions of the conic are those that matter for the plane.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.equations import Setup

Array = NDArray[np.float64]
Analytic = NDArray[np.inexact]
"""Real, or complex for a derivative by a complex step."""


@dataclass(frozen=True)
class TwoPlanes:
    """The two planes that fit an image ellipse, in the laser-parallel frame; leading dimensions as the conics'.

    Attributes
    ----------
    visible : (..., 3)
        ``(z_L, p, q)`` of the plane whose lit side faces the camera (``c > 0``); mm, 1, 1. NaN where ``ok`` is false.
    other : (..., 3)
        ``(z_L, p, q)`` of the plane with intercept ``-c``; NaN where it does not exist (camera on the beam's surface).
    intercept : (...)
        ``c`` of the visible plane, mm.
    ok : (...) of bool
        Whether a plane with its whole spot in front of the camera was found.
    """

    visible: Array
    other: Array
    intercept: Array
    ok: NDArray[np.bool_]


def solve_both(B: ArrayLike, setup: Setup) -> TwoPlanes:
    """Both planes for each image ellipse.

    Parameters
    ----------
    B : (..., 5)
        Coefficients ``B_1 ... B_5`` of (16), mm on the image plane.
    setup : Setup
        ``f, e_x, e_y, r`` in mm, each a number.

    Returns
    -------
    TwoPlanes
    """
    coefficients = np.asarray(B, dtype=float)
    e, r = np.array([setup.e_x, setup.e_y]), setup.r
    # What is no image of this beam ends in the root of a negative number, or in a division by it: NaN, no warning.
    with np.errstate(all="ignore"):
        visible = np.stack(visible_plane(coefficients, setup), axis=-1)
        z_L, n = visible[..., 0], visible[..., 1:]
        intercept = z_L - n @ e
        ok = np.isfinite(visible).all(axis=-1) & (intercept > 0) & (z_L > r * np.linalg.norm(n, axis=-1))
    visible = np.where(ok[..., None], visible, np.nan)
    intercept = np.where(ok, intercept, np.nan)
    return TwoPlanes(visible, other_plane(visible, setup), intercept, ok)


def other_plane(visible: Array, setup: Setup) -> Array:
    """Second exact solution of the ten equations: ``z_L' = z_L + 2 c r^2/k``, ``n' = n + 2 c e/k``, ``c' = -c``.

    Parameters
    ----------
    visible : (..., 3)
        ``(z_L, p, q)`` of one plane.
    setup : Setup
        ``f, e_x, e_y, r`` in mm.

    Returns
    -------
    (..., 3)
        The other plane; NaN where ``k = |e|^2 - r^2`` vanishes to rounding, since it is then at infinity.
    """
    e, r = np.array([setup.e_x, setup.e_y]), setup.r
    k = e @ e - r**2
    if abs(k) <= 4 * np.finfo(float).eps * r**2:
        return np.full_like(visible, np.nan)
    c = visible[..., 0] - visible[..., 1:] @ e
    return visible + (2 * c / k)[..., None] * np.array([r**2, *e])


def visible_plane(B: Analytic, setup: Setup) -> tuple[Analytic, Analytic, Analytic]:
    """``z_L, p, q`` of the root ``c > 0`` by the route that divides by the larger number; analytic in ``B``.

    Complex ``B`` is allowed, so that `slope_jacobian` can differentiate by a complex step.
    """
    k = setup.e_x**2 + setup.e_y**2 - setup.r**2
    return from_primal(B, setup) if abs(k) > setup.r**2 else from_dual(B, setup)


def from_primal(B: Analytic, setup: Setup) -> tuple[Analytic, Analytic, Analytic]:
    """Visible plane from the point conic; needs ``k = |e|^2 - r^2`` away from zero.

    ``f^2 (A - c c'/g) = nu (I - e e'/k)`` gives ``nu`` (3 numbers, 1 unknown: least squares), ``w^2 = nu k/g`` with the
    visible root ``w > 0``, and ``n = -(f c/nu + e/w) w^2/k``.
    """
    f, e_x, e_y, r = setup
    k = e_x**2 + e_y**2 - r**2
    b1, b2, c1, c2, g = B[..., 0] / 2, B[..., 1], B[..., 2] / 2, B[..., 3] / 2, B[..., 4]
    model = (1 - e_x**2 / k, -e_x * e_y / k, 1 - e_y**2 / k)
    measured = (1 - c1 * c1 / g, b1 - c1 * c2 / g, b2 - c2 * c2 / g)
    nu = f**2 * _scale(measured, model)
    w = np.sqrt(nu * k / g)
    p = -(f * c1 / nu + e_x / w) * w**2 / k
    q = -(f * c2 / nu + e_y / w) * w**2 / k
    return w + p * e_x + q * e_y, p, q


def from_dual(B: Analytic, setup: Setup) -> tuple[Analytic, Analytic, Analytic]:
    """Visible plane from the line conic; right also at ``|e| = r`` and ``e = 0``.

    ``C* = mu [[f^2 (e e' - r^2 I), f (e z_L - r^2 n)], [., z_L^2 - r^2 |n|^2]]``: its upper left block gives ``mu``,
    then ``A z_L^2 + 2 h z_L - C = 0`` with ``A = 1 - |e|^2/r^2``, ``h = e.d/r^2``,
    ``C = |d|^2/r^2 + C*_22/mu``, ``d = C*_12/(mu f)``.
    """
    f, e_x, e_y, r = setup
    b1, b2, c1, c2, g = B[..., 0] / 2, B[..., 1], B[..., 2] / 2, B[..., 3] / 2, B[..., 4]
    model = (e_x**2 - r**2, e_x * e_y, e_y**2 - r**2)
    measured = (b2 * g - c2 * c2, c1 * c2 - b1 * g, g - c1 * c1)
    mu = _scale(measured, model) / f**2
    d1, d2 = (b1 * c2 - b2 * c1) / (mu * f), (b1 * c1 - c2) / (mu * f)
    outside = 1 - (e_x**2 + e_y**2) / r**2
    h = (e_x * d1 + e_y * d2) / r**2
    big_c = (d1 * d1 + d2 * d2) / r**2 + (b2 - b1 * b1) / mu
    root = np.sqrt(h * h + outside * big_c)
    from_sum = big_c / (h + root)
    z_L = from_sum if outside == 0 else np.where(np.real(h) > 0, from_sum, (root - h) / outside)
    return z_L, (e_x * z_L - d1) / r**2, (e_y * z_L - d2) / r**2


def _scale(measured: tuple[Analytic, Analytic, Analytic], model: tuple[float, float, float]) -> Analytic:
    """Least-squares factor between two symmetric 2x2 matrices given as (11, 12, 22)."""
    weights = (model[0], 2 * model[1], model[2])
    norm = model[0] * weights[0] + model[1] * weights[1] + model[2] * weights[2]
    return (measured[0] * weights[0] + measured[1] * weights[1] + measured[2] * weights[2]) / norm


def slope_jacobian(B: ArrayLike, setup: Setup) -> Array:
    """Derivative (..., 3, 5) of the visible ``(z_L, p, q)`` by ``B``: a complex step, exact to rounding."""
    coefficients = np.asarray(B, dtype=float)
    step = 1e-30 * (np.abs(coefficients) + 1)
    stepped = coefficients[..., None, :] + 1j * step[..., None, :] * np.eye(5)
    with np.errstate(all="ignore"):
        planes = np.stack(visible_plane(stepped, setup), axis=-1)
    return np.swapaxes(planes.imag / step[..., :, None], -1, -2)
