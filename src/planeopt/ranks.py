"""Which rows of a matrix say something of their own."""

from typing import cast

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]


def independent_rows(matrix: Array, tolerance: float) -> NDArray[np.integer]:
    """Indices, in order, of a largest set of rows that do not depend on each other.

    Parameters
    ----------
    matrix : (m, n)
    tolerance : float
        A row, at unit length, whose part orthogonal to those taken before is smaller than this depends on them.

    Returns
    -------
    (rank,) of int
        By pivoted QR, which takes the row with the largest new part next. Rows of zeros are never taken.
    """
    length = np.linalg.norm(matrix, axis=1)
    nonzero = np.flatnonzero(length > 0)
    if not len(nonzero):
        return nonzero
    unit = matrix[nonzero] / length[nonzero, None]
    triangle, order = cast("tuple[Array, NDArray[np.intp]]", scipy.linalg.qr(unit.T, mode="r", pivoting=True))
    size = np.abs(np.diag(triangle))
    return np.sort(nonzero[order[: len(size)][size > tolerance]])
