"""The image ellipse (16), `x^2 + B1 x y + B2 y^2 + B3 x + B4 y + B5 = 0`, and its other representations.

Every function works on arrays with any leading dimensions. `B` holds `(B1, ..., B5)` in its last axis; the unit of
`B3`, `B4` is that of the points (mm here) and of `B5` its square; `B1`, `B2` are pure numbers. Scaling the equation so
that the coefficient of `x^2` is one is possible for every ellipse.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Ellipses by centre, semi-axes and angle.

    Attributes
    ----------
    centre : (..., 2) array
        Centre, in the unit of the points.
    semi_axes : (..., 2) array
        Major and minor semi-axis, in the unit of the points.
    angle : (...) array
        Direction of the major axis from x towards y, rad, in (-pi/2, pi/2]. A circle has no direction; its angle
        is zero or rounding noise.
    """

    centre: FloatArray
    semi_axes: FloatArray
    angle: FloatArray


def as_coefficients(B: ArrayLike) -> FloatArray:
    """Return `B` as an array, or say what shape was given instead.

    Raises
    ------
    InputError
        The last axis does not hold five numbers.
    """
    array = np.asarray(B, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 5:
        raise InputError(f"B must hold the five coefficients B1..B5 in its last axis; its shape is {array.shape}")
    return array


def conic_matrix(B: ArrayLike) -> FloatArray:
    """Return the symmetric matrix C, shape (..., 3, 3), with `[x, y, 1] C [x, y, 1]' = 0` on the conic."""
    B = as_coefficients(B)
    B1, B2, B3, B4, B5 = np.moveaxis(B, -1, 0)
    C = np.empty((*B.shape[:-1], 3, 3))
    C[..., 0, 0] = 1.0
    C[..., 0, 1] = C[..., 1, 0] = B1 / 2
    C[..., 1, 1] = B2
    C[..., 0, 2] = C[..., 2, 0] = B3 / 2
    C[..., 1, 2] = C[..., 2, 1] = B4 / 2
    C[..., 2, 2] = B5
    return C


def conic_from_matrix(C: ArrayLike) -> FloatArray:
    """Return B, shape (..., 5), of symmetric matrices (..., 3, 3) of any scale and sign.

    Raises
    ------
    InputError
        The coefficient of `x^2` is zero: the conic is no ellipse and has no B.
    """
    C = np.asarray(C, dtype=float)
    if C.ndim < 2 or C.shape[-2:] != (3, 3):
        raise InputError(f"a conic's matrix must have shape (..., 3, 3); it is {C.shape}")
    b0 = C[..., 0, 0]
    if np.any(b0 == 0):
        raise InputError("the coefficient of x^2 is zero, so the conic is not an ellipse and cannot be written as B")
    coefficients = (C[..., 0, 1] * 2, C[..., 1, 1], C[..., 0, 2] * 2, C[..., 1, 2] * 2, C[..., 2, 2])
    return np.stack(coefficients, axis=-1) / b0[..., None]


def adjugate(C: ArrayLike) -> FloatArray:
    """Return the adjugate of symmetric 3x3 matrices, shape (..., 3, 3): `adj(C) C = det(C) I`."""
    C = np.asarray(C, dtype=float)
    a, b, c = C[..., 0, 0], C[..., 0, 1], C[..., 0, 2]
    d, e, f = C[..., 1, 1], C[..., 1, 2], C[..., 2, 2]
    rows = (d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b)
    A = np.empty_like(C)
    A[..., 0, 0], A[..., 1, 1], A[..., 2, 2] = rows[0], rows[3], rows[5]
    A[..., 0, 1] = A[..., 1, 0] = rows[1]
    A[..., 0, 2] = A[..., 2, 0] = rows[2]
    A[..., 1, 2] = A[..., 2, 1] = rows[4]
    return A


def dual_conic(B: ArrayLike) -> FloatArray:
    """Return the dual conic C* = adj(C), shape (..., 3, 3): `l' C* l = 0` for every tangent line l."""
    return adjugate(conic_matrix(B))


def conic_from_dual(dual: ArrayLike) -> FloatArray:
    """Return B, shape (..., 5), of dual conics (..., 3, 3) of any scale and sign (see `conic_from_matrix`)."""
    return conic_from_matrix(adjugate(dual))


def _centre_and_height(B: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centre, minus the value of the equation there, and the determinant of the quadratic part."""
    B1, B2, B3, B4, B5 = np.moveaxis(B, -1, 0)
    det = B2 - B1 * B1 / 4
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (B1 * B4 / 4 - B2 * B3 / 2) / det
        y = (B1 * B3 / 4 - B4 / 2) / det
        height = -(B5 + (B3 * x + B4 * y) / 2)
    return np.stack([x, y], axis=-1), height, det


def is_ellipse(B: ArrayLike) -> BoolArray:
    """Tell, shape (...), where B is a real ellipse: not a hyperbola, parabola, point, imaginary ellipse or NaN."""
    _, height, det = _centre_and_height(as_coefficients(B))
    return np.asarray((det > 0) & (height > 0) & np.isfinite(height))


def geometric_from_conic(B: ArrayLike) -> Ellipse:
    """Return centre, semi-axes and angle of real ellipses.

    Raises
    ------
    InputError
        One of the conics is not a real ellipse; the first is named by its index.
    """
    B = as_coefficients(B)
    real = is_ellipse(B)
    if not np.all(real):
        index = int(np.flatnonzero(~real)[0])
        raise InputError(f"conic {index} of {real.size} is not a real ellipse, so it has no semi-axes")
    centre, height, det = _centre_and_height(B)
    B1, B2 = B[..., 0], B[..., 1]
    # The smaller eigenvalue as determinant over the larger one: their difference would cancel for a long ellipse.
    larger = (1 + B2) / 2 + np.hypot((1 - B2) / 2, B1 / 2)
    semi_axes = np.stack([np.sqrt(height * larger / det), np.sqrt(height / larger)], axis=-1)
    angle = np.arctan2(-B1, B2 - 1) / 2
    return Ellipse(centre, semi_axes, np.where(angle <= -np.pi / 2, np.pi / 2, angle))


def conic_from_geometric(centre: ArrayLike, semi_axes: ArrayLike, angle: ArrayLike = 0.0) -> FloatArray:
    """Return B, shape (..., 5), of ellipses by centre (..., 2), semi-axes (..., 2) and angle (...), rad.

    The semi-axes may come in either order: `angle` is the direction of the first.

    Raises
    ------
    InputError
        A semi-axis is not positive and finite.
    """
    centre, semi_axes, angle = (np.asarray(value, dtype=float) for value in (centre, semi_axes, angle))
    if not np.all(np.isfinite(semi_axes) & (semi_axes > 0)):
        raise InputError("the semi-axes of an ellipse must be positive and finite")
    cos, sin = np.cos(angle), np.sin(angle)
    # Divide by the first semi-axis, not by both: no overflow and the ratio is what B1, B2 depend on.
    ratio = semi_axes[..., 1] / semi_axes[..., 0]
    b0 = (ratio * cos) ** 2 + sin**2
    B1 = 2 * cos * sin * (ratio - 1) * (ratio + 1) / b0
    B2 = ((ratio * sin) ** 2 + cos**2) / b0
    x, y = centre[..., 0], centre[..., 1]
    B5 = x * x + B1 * x * y + B2 * y * y - semi_axes[..., 1] ** 2 / b0
    return np.stack(np.broadcast_arrays(B1, B2, -2 * x - B1 * y, -B1 * x - 2 * B2 * y, B5), axis=-1)
