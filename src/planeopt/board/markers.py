"""The markers of OpenCV's dictionaries as cells, black or white; the only place of this room that talks to OpenCV."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


def marker_cells(dictionary: str, ids: Sequence[int]) -> BoolArray:
    """Return which cells of markers are black.

    Parameters
    ----------
    dictionary : str
        Name of a predefined dictionary, as `Board` checks it.
    ids : sequence of int

    Returns
    -------
    ndarray, shape (len(ids), n, n)
        Rows from the top, columns from the left, with the black frame, which is one cell wide.
    """
    return _all_cells(dictionary)[np.asarray(ids, dtype=np.int64)]


@lru_cache(maxsize=4)
def _all_cells(dictionary: str) -> BoolArray:
    import cv2

    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    side = int(markers.markerSize) + 2
    drawn = [
        np.asarray(cv2.aruco.generateImageMarker(markers, i, side, borderBits=1)) for i in range(len(markers.bytesList))
    ]
    found = np.stack(drawn).reshape(len(drawn), side, side) == 0
    found.setflags(write=False)
    return found
