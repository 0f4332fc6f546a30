"""Plateau and background as smooth functions of the place: low-order polynomials, and waves round the spot."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def surface(places: NDArray[Any], degree: int) -> NDArray[Any]:
    """Return the harmonic polynomials (2 degree + 1, M) at places (2, M): 1; x, y; x^2 - y^2, 2xy.

    Round a circle these are the waves 0 to `degree`, each with a slope across it that goes with it.

    Parameters
    ----------
    places : (2, M) array
    degree : int
        0, 1 or 2.
    """
    x, y = places
    return np.stack([np.ones_like(x), x, y, x * x - y * y, 2 * x * y][: 2 * degree + 1])


def surface_slope(places: NDArray[Any], normals: NDArray[Any], degree: int) -> NDArray[Any]:
    """Return the derivatives (2 degree + 1, M) of `surface` along unit vectors (2, M)."""
    (x, y), (m, n) = places, normals
    return np.stack([np.zeros_like(x), m, n, 2 * (x * m - y * n), 2 * (y * m + x * n)][: 2 * degree + 1])


def waves(theta: Array, highest: int) -> Array:
    """Return 1, and cosine and sine of the multiples 1 to `highest` of angles (M,), as rows (2 highest + 1, M)."""
    return waves_of(np.stack([np.cos(theta), np.sin(theta)]), highest)


def waves_of(turn: NDArray[Any], highest: int) -> NDArray[Any]:
    """Return `waves` for angles of these cosines and sines (2, M), in the precision of these."""
    rows = np.empty((2 * highest + 1, turn.shape[1]), dtype=turn.dtype)
    rows[0] = 1.0
    if highest:
        rows[1:3] = turn
    c, s = turn
    for k in range(3, 2 * highest, 2):
        c, s = c * turn[0] - s * turn[1], s * turn[0] + c * turn[1]
        rows[k], rows[k + 1] = c, s
    return rows
