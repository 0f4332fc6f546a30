"""Why an image shows too few of a board's corners, in words."""

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.calibration.corners import Corners


def why_no_corners(values: NDArray[np.float32], board: Board, corners: Corners) -> str:
    """Return the reason for which an image shows too few corners of a board."""
    if not len(corners.found.markers):
        return "no marker of the board was found in it"
    if corners.map is None:
        return "its markers are not laid out as those of the board"
    return f"only {len(corners)} of the board's corners could be measured"
