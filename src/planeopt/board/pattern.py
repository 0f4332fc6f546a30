"""What of a ChArUco board is black: the squares, the cells of the markers, and nothing under the window.

Rectangles are rows (x0, y0, x1, y1) with x0 < x1 and y0 < y1, mm, in the board's frame: origin at the outer corner of
the top left square, x right, y down. They do not overlap.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planeopt.board.markers import marker_cells
from planeopt.board.spec import Board

FloatArray = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]


def black_rectangles(board: Board) -> FloatArray:
    """Return all that is black on a board, as rectangles (N, 4) that do not overlap.

    The squares and markers lie as in OpenCV's `CharucoBoard` (without the legacy pattern the top left square is black).
    The window is white throughout: squares are cut at its edge, and a marker that it touches is left out.
    """
    squares = [part for square in _black_squares(board) for part in _outside(square, board.window_mm)]
    # A window may leave nothing: that is (0, 4) too.
    return np.array([*squares, *_marker_rectangles(board)], dtype=np.float64).reshape(-1, 4)


def printed_markers(board: Board) -> dict[int, Rectangle]:
    """Return the place of each marker that is printed, by its id."""
    columns, rows = board.squares
    across, down = board.square_mm
    side = board.marker_mm
    white = [(i, j) for j in range(rows) for i in range(columns) if not _is_black(board, i, j)]
    places = {}
    for number, (i, j) in enumerate(white, start=board.first_id):
        x, y = (i + 0.5) * across - side / 2, (j + 0.5) * down - side / 2
        place = (x, y, x + side, y + side)
        if board.window_mm is None or not _overlap(place, board.window_mm):
            places[number] = place
    return places


def _is_black(board: Board, column: int, row: int) -> bool:
    # OpenCV's legacy pattern differs only where the number of rows is even.
    swapped = board.legacy and board.squares[1] % 2 == 0
    return ((column + row) % 2 == 0) != swapped


def _black_squares(board: Board) -> Iterator[Rectangle]:
    (columns, rows), (across, down) = board.squares, board.square_mm
    for j in range(rows):
        for i in range(columns):
            if _is_black(board, i, j):
                yield i * across, j * down, (i + 1) * across, (j + 1) * down


def _overlap(rectangle: Rectangle, window: Rectangle) -> bool:
    x0, y0, x1, y1 = rectangle
    x, y, width, height = window
    return x0 < x + width and x1 > x and y0 < y + height and y1 > y


def _outside(rectangle: Rectangle, window: Rectangle | None) -> list[Rectangle]:
    """Return what of a rectangle is not under the window: at most four rectangles."""
    if window is None or not _overlap(rectangle, window):
        return [rectangle]
    x0, y0, x1, y1 = rectangle
    left, top = max(x0, window[0]), max(y0, window[1])
    right, bottom = min(x1, window[0] + window[2]), min(y1, window[1] + window[3])
    parts = [(x0, y0, x1, top), (x0, bottom, x1, y1), (x0, top, left, bottom), (right, top, x1, bottom)]
    least = _SLIVER * min(x1 - x0, y1 - y0)
    return [part for part in parts if part[2] - part[0] > least and part[3] - part[1] > least]


_SLIVER = 1e-6  # of a square: what rounding leaves where the window's edge is the square's


def _marker_rectangles(board: Board) -> Iterator[Rectangle]:
    places = printed_markers(board)
    for cells, (x, y, _, _) in zip(marker_cells(board.dictionary, list(places)), places.values(), strict=True):
        side = board.marker_mm / len(cells)
        for j, row in enumerate(cells):
            edges = np.flatnonzero(np.diff(row, prepend=False, append=False))
            for begin, end in edges.reshape(-1, 2):
                yield x + int(begin) * side, y + j * side, x + int(end) * side, y + (j + 1) * side
