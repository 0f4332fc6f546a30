"""Many small linear systems, element by element over all of them: `numpy.linalg` takes several times as long.

Nothing is checked: of what is singular or not finite the solutions are no numbers, or no use.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def lower_solved(triangles: Array, right: Array) -> Array:
    """Solutions (M, k, n) of lower triangular systems (M, k, k)."""
    return _substituted(triangles, right, range(triangles.shape[1]))


def upper_solved(triangles: Array, right: Array) -> Array:
    """Solutions (M, k, n) of upper triangular systems (M, k, k)."""
    return _substituted(triangles, right, range(triangles.shape[1])[::-1])


def _substituted(triangles: Array, right: Array, order: range) -> Array:
    # The systems last, so that they lie side by side.
    parts, made = (np.array(np.moveaxis(given, 0, 2), order="C") for given in (triangles, right))
    for place, i in enumerate(order):
        for j in order[:place]:
            made[i] -= parts[i, j] * made[j]
        made[i] /= parts[i, i]
    return np.moveaxis(made, 2, 0)


def positive_solved(matrices: Array, right: Array) -> Array:
    """Solutions (M, 3) of symmetric positive definite systems (M, 3, 3), by elimination, which needs no pivots."""
    a, b, c, d, e, f = (matrices[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    second, third = b / a, c / a
    d, e, f = d - second * b, e - second * c, f - third * c
    last = e / d
    f = f - last * e
    made = np.empty_like(right)
    x, y, z = made.T
    y_left = right[:, 1] - second * right[:, 0]
    np.divide(right[:, 2] - third * right[:, 0] - last * y_left, f, out=z)
    np.subtract(y_left / d, last * z, out=y)
    np.subtract(right[:, 0] / a, second * y + third * z, out=x)
    return made
