"""Plateau and background as smooth functions of the place: low-order polynomials, and waves round the spot."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def surface(places: Array, degree: int) -> Array:
    """Return the harmonic polynomials (M, 2 degree + 1) at places (M, 2): 1; x, y; x^2 - y^2, 2xy.

    Round a circle these are the waves 0 to `degree`, each with a slope across it that goes with it.

    Parameters
    ----------
    places : (M, 2) array
    degree : int
        0, 1 or 2.
    """
    x, y = places.T
    return np.stack([np.ones_like(x), x, y, x * x - y * y, 2 * x * y][: 2 * degree + 1], axis=1)


def surface_slope(places: Array, normals: Array, degree: int) -> Array:
    """Return the derivatives (M, 2 degree + 1) of `surface` along unit vectors (M, 2)."""
    (x, y), (m, n) = places.T, normals.T
    return np.stack([np.zeros_like(x), m, n, 2 * (x * m - y * n), 2 * (y * m + x * n)][: 2 * degree + 1], axis=1)


def waves(theta: Array, low: int, high: int) -> Array:
    """Return cosine and sine (M, 2 (high - low + 1)) of the multiples `low` to `high` of angles (M,); 1 for 0."""
    columns = [np.ones_like(theta)] if low == 0 <= high else []
    for k in range(max(low, 1), high + 1):
        columns += [np.cos(k * theta), np.sin(k * theta)]
    return np.stack(columns, axis=1) if columns else np.empty((len(theta), 0))
