"""OpenCV's ChArUco detector, of all its versions from 4.10 on: what of a board is in an image, roughly.

The only place that talks to `cv2.aruco`. Its corners are starts: those of OpenCV before 4.14 are half a pixel off.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.board.pattern import printed_markers

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

DICTIONARIES = {
    "DICT_4X4_50": 50,
    "DICT_5X5_50": 50,
    "DICT_6X6_50": 50,
    "DICT_7X7_50": 50,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_36h11": 587,
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_APRILTAG_36h10": 2320,
}
"""OpenCV's predefined dictionaries and how many markers each has; of nested ones the smallest, which the others begin
with."""

_ERRORS_ONLY = 2  # of OpenCV's log levels


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers in an image.

    Parameters
    ----------
    ids : (M,) array of int
    corners : (M, 4, 2) array
        px: top left, top right, bottom right, bottom left as printed.
    others : int
        How many more squares could not be read.
    """

    ids: Ids
    corners: Array
    others: int = 0

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Found:
    """What OpenCV found of a board.

    Parameters
    ----------
    markers : Markers
    ids : (N,) array of int
        Of the corners.
    corners : (N, 2) array
        px.
    """

    markers: Markers
    ids: Ids
    corners: Array


def find_board(image: NDArray[np.uint8], board: Board) -> Found:
    """Look for a board's markers and corners in a grey image of 8 bits."""
    detector = cv2.aruco.CharucoDetector(_charuco_board(board))
    corners, ids, marker_corners, marker_ids = detector.detectBoard(image)
    return Found(_markers(marker_corners, marker_ids), _ids(ids), _points(corners))


def find_markers(image: NDArray[np.uint8], dictionary: str) -> Markers:
    """Look for a dictionary's markers in a grey image of 8 bits, whatever they are printed on."""
    corners, ids, rejected = cv2.aruco.ArucoDetector(_dictionary(dictionary)).detectMarkers(image)
    return replace(_markers(corners, ids), others=len(rejected))


def marker_corners(board: Board) -> dict[int, Array]:
    """Return the corners (4, 2), mm, of each printed marker by its id, in the order of `Markers`."""
    return {
        number: np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        for number, (x0, y0, x1, y1) in printed_markers(board).items()
    }


def _charuco_board(board: Board) -> Any:
    # Squares that are not quite square make no difference to where OpenCV looks.
    side = float(np.sqrt(board.square_mm[0] * board.square_mm[1]))
    marker = min(board.marker_mm, 0.999 * side)
    ids = np.arange(board.first_id, board.first_id + board.marker_count, dtype=np.int32)
    # It remarks upon narrow margins on standard error. OpenCV 4.10 keeps the level of its log elsewhere.
    log: Any = getattr(cv2.utils, "logging", cv2)
    level = log.getLogLevel()
    log.setLogLevel(_ERRORS_ONLY)
    try:
        made = cv2.aruco.CharucoBoard(board.squares, side, marker, _dictionary(board.dictionary), ids)
    finally:
        log.setLogLevel(level)
    made.setLegacyPattern(board.legacy)
    return made


def _dictionary(name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _points(values: Any) -> Array:
    # (N, 1, 2) before OpenCV 5, (N, 2) since; None where nothing was found.
    return np.empty((0, 2)) if values is None else np.asarray(values, dtype=np.float64).reshape(-1, 2)


def _ids(values: Any) -> Ids:
    return np.empty(0, dtype=np.int64) if values is None else np.asarray(values, dtype=np.int64).reshape(-1)


def _markers(corners: Any, ids: Any) -> Markers:
    numbers = _ids(ids)
    places = np.array([_points(four) for four in corners]).reshape(-1, 4, 2) if len(numbers) else np.empty((0, 4, 2))
    order = np.argsort(numbers, kind="stable")
    return Markers(numbers[order], places[order])
