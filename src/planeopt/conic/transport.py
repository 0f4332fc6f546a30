"""Carry a conic, and the covariance of its coefficients, through an affine map of the plane."""

import numpy as np
from numpy.typing import ArrayLike

from planeopt.conic.ellipse import FloatArray, as_coefficients
from planeopt.errors import InputError


def _coefficient_map(A: FloatArray, t: FloatArray) -> FloatArray:
    """Return T, shape (..., 6, 6), with `b' ~ T b` for the six coefficients when points move by `x' = A x + t`."""
    G = np.linalg.inv(A)
    h = -(G @ t[..., None])[..., 0]
    x = (G[..., 0, 0], G[..., 0, 1], h[..., 0])  # the old x as a linear form in (x', y', 1)
    y = (G[..., 1, 0], G[..., 1, 1], h[..., 1])
    zero, one = np.zeros_like(h[..., 0]), np.ones_like(h[..., 0])

    def product(p: tuple[FloatArray, ...], q: tuple[FloatArray, ...]) -> FloatArray:
        return np.stack(
            [
                p[0] * q[0],
                p[0] * q[1] + p[1] * q[0],
                p[1] * q[1],
                p[0] * q[2] + p[2] * q[0],
                p[1] * q[2] + p[2] * q[1],
                p[2] * q[2],
            ],
            axis=-1,
        )

    unit = (zero, zero, one)
    columns = [product(x, x), product(x, y), product(y, y), product(x, unit), product(y, unit), product(unit, unit)]
    return np.stack(columns, axis=-1)


def _checked_map(A: ArrayLike, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
    A, t = np.asarray(A, dtype=float), np.asarray(t, dtype=float)
    if A.ndim < 2 or A.shape[-2:] != (2, 2) or t.ndim < 1 or t.shape[-1] != 2:
        raise InputError(f"an affine map needs A (..., 2, 2) and t (..., 2); the shapes are {A.shape} and {t.shape}")
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(t)) and np.all(np.linalg.det(A) != 0)):
        raise InputError("an affine map of a conic must be finite and invertible")
    return A, t


def transform_conic(B: ArrayLike, A: ArrayLike, t: ArrayLike) -> FloatArray:
    """Return B, shape (..., 5), of the conic whose points are `x' = A x + t`.

    Parameters
    ----------
    B : (..., 5) array
        Conics.
    A, t : (..., 2, 2) and (..., 2) arrays
        The map; leading dimensions broadcast against those of `B`.

    Raises
    ------
    InputError
        The shapes are wrong or the map is not invertible.
    """
    B = as_coefficients(B)
    T = _coefficient_map(*_checked_map(A, t))
    b = T[..., 0] + (T[..., 1:] @ B[..., None])[..., 0]
    return b[..., 1:] / b[..., :1]


def transform_jacobian(B: ArrayLike, A: ArrayLike, t: ArrayLike) -> FloatArray:
    """Return the derivative, shape (..., 5, 5), of `transform_conic(B, A, t)` by `B`."""
    B = as_coefficients(B)
    T = _coefficient_map(*_checked_map(A, t))
    b = T[..., 0] + (T[..., 1:] @ B[..., None])[..., 0]
    new = b[..., 1:] / b[..., :1]
    return (T[..., 1:, 1:] - new[..., :, None] * T[..., :1, 1:]) / b[..., :1, None]


def transform_covariance(covariance: ArrayLike, B: ArrayLike, A: ArrayLike, t: ArrayLike) -> FloatArray:
    """Return the covariance, shape (..., 5, 5), of `transform_conic(B, A, t)`, to first order.

    To keep small eigenvalues exact carry a factor instead: `transform_jacobian(B, A, t) @ S`.
    """
    J = transform_jacobian(B, A, t)
    return J @ np.asarray(covariance, dtype=float) @ np.swapaxes(J, -1, -2)


def conic_from_local(local: FloatArray, origin: FloatArray, unit: FloatArray) -> FloatArray:
    """Return B, shape (..., 5), from its value in coordinates `u = (x - origin) / unit`.

    `unit` is a power of two in the fits, so that only the shift rounds.
    """
    B1, B2 = local[..., 0], local[..., 1]
    b3, b4 = unit * local[..., 2], unit * local[..., 3]
    x, y = origin[..., 0], origin[..., 1]
    B5 = unit * unit * local[..., 4] + (x * (x + B1 * y) + B2 * y * y) - (b3 * x + b4 * y)
    return np.stack([B1, B2, b3 - 2 * x - B1 * y, b4 - B1 * x - 2 * B2 * y, B5], axis=-1)


def local_jacobian(origin: FloatArray, unit: FloatArray) -> FloatArray:
    """Return the derivative, shape (..., 5, 5), of `conic_from_local`; it does not depend on the conic."""
    x, y = origin[..., 0], origin[..., 1]
    J = np.zeros((*unit.shape, 5, 5))
    J[..., 0, 0] = J[..., 1, 1] = 1.0
    J[..., 2, 2] = J[..., 3, 3] = unit
    J[..., 4, 4] = unit * unit
    J[..., 2, 0], J[..., 3, 0], J[..., 3, 1] = -y, -x, -2 * y
    J[..., 4, 0], J[..., 4, 1] = x * y, y * y
    J[..., 4, 2], J[..., 4, 3] = -unit * x, -unit * y
    return J
