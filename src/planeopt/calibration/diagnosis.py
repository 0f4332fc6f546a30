"""Why an image shows too few of a board's corners, in words that say what to do.

Slow, and only for images that are refused: other dictionaries, the mirrored image and other layouts are tried.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.board.pattern import printed_markers
from planeopt.calibration.board_image import fit_board_image
from planeopt.calibration.charuco import DICTIONARIES, Markers, find_markers
from planeopt.calibration.corners import MIN_SIDE, Corners, eight_bits

_BLANK = 0.02  # of full scale: less contrast is none
_SOME = 4  # markers: fewer say nothing of a layout, and may be chance
_CLEARLY = 2  # times as many
_KNOWN, _FIT = 0.8, 0.95  # of the markers can be of a layout, and lie where it puts them: shifted ones mostly do too
_LOOKED_UP = 300_000  # squares times markers: half a second
_MOST_COLUMNS = 40


def why_no_corners(values: NDArray[np.float32], board: Board, corners: Corners) -> str:
    """Return the reason for which an image shows too few corners of a board: a sentence without a full stop.

    Parameters
    ----------
    values : (H, W) array
        Grey values, share of full scale.
    board : Board
    corners : Corners
        What was found.
    """
    if corners.map is not None:
        found = f"only {len(corners)} of the board's corners" if len(corners) else "none of the board's corners"
        return f"{found} could be measured: the others are cut off, hidden, lit by the spot or too blurred"
    if min(values.shape) < MIN_SIDE:
        return f"the image is too small to hold a board: {values.shape[1]} x {values.shape[0]} px"
    low, high = np.quantile(values[::4, ::4], [0.01, 0.99])
    if high - low < _BLANK:
        return f"the image is blank: nearly all of it is {100 * float(low + high) / 2:.0f} % of full scale"
    images = list(eight_bits(values))
    seen = _most(find_markers(image, board.dictionary) for image in images)
    mirrored = _most(find_markers(_flipped(image), board.dictionary) for image in images)
    if len(mirrored) >= _SOME and len(mirrored) > _CLEARLY * len(seen):
        return f"the image is mirrored: {len(mirrored)} markers can be read when it is flipped; save it as seen"
    if len(seen) < _SOME:
        squares = len(seen) + seen.others
        other, count = _best_dictionary(images[0], board.dictionary, squares) if squares >= _SOME else ("", 0)
        if count >= _SOME and count > _CLEARLY * len(seen):
            larger = ", or a larger one of its kind," if "X" in other else ""
            return f"its markers are not of {board.dictionary}: {count} of {other}{larger} can be read"
        if len(seen):
            return (
                f"only {len(seen)} of the board's markers can be read: it is cut off, hidden, too blurred or too small"
            )
        return "none of the board's markers can be read: it is not there, or too blurred, too small or too oblique"
    return _wrong_layout(seen, board, (values.shape[1], values.shape[0]))


def _flipped(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(image[:, ::-1])


def _most(tries: Iterable[Markers]) -> Markers:
    return max(tries, key=len)


def _best_dictionary(image: NDArray[np.uint8], but: str, squares: int) -> tuple[str, int]:
    """Return the dictionary of which most markers can be read in an image with so many squares, and how many."""
    family = but.rpartition("_")[0]
    found = {
        name: len(np.unique(find_markers(image, name).ids))
        for name, size in DICTIONARIES.items()
        # In noise there are squares without end, and looking all of them up takes long.
        if size * squares < _LOOKED_UP and not ("X" in family and name.startswith(f"{family}_"))
    }
    best = max(found, key=lambda name: found[name], default=but)
    return best, found.get(best, 0)


@dataclass(frozen=True)
class _Layout:
    """Which white square each marker is in: so many columns, the first square white or black, the first marker's id."""

    columns: int
    first_white: bool
    first_id: int

    def middles(self, ids: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the middles (N, 2) of the squares of markers (N,), in squares."""
        number = ids - self.first_id
        rows = 2 * int(number.max()) // self.columns + 3
        row, column = np.mgrid[:rows, : self.columns]
        white = ((row + column) % 2 == 0) == self.first_white
        return np.stack([column[white], row[white]], axis=1)[number] + 0.5

    def fits(self, seen: Markers, board: Board, size: tuple[int, int]) -> bool:
        """Return whether most markers lie so, by their middles: their size may be another."""
        which = seen.ids >= self.first_id
        if which.sum() < max(_SOME, _KNOWN * len(seen)):
            return False
        points = self.middles(seen.ids[which]) * np.array(board.square_mm)
        pixels = seen.corners[which].mean(axis=1)
        mapped = fit_board_image(points, pixels, size, board.square_mm)
        return mapped is not None and float(np.mean(mapped.fits(points, pixels))) > _FIT


def _under_window(board: Board) -> set[int]:
    return set(range(board.first_id, board.last_id + 1)) - set(printed_markers(board))


def _wrong_layout(seen: Markers, board: Board, size: tuple[int, int]) -> str:
    """Return what is wrong with the board's description, as the markers (4 or more) lie."""
    columns, rows = board.squares
    swapped = board.legacy and rows % 2 == 0
    said = _Layout(columns, swapped, board.first_id)
    strangers = seen.ids[(seen.ids < board.first_id) | (seen.ids > board.last_id)]
    read = f"its {len(seen)} markers do not lie as in board.toml, but as with"
    if said.fits(seen, board, size):
        hidden = [number for number in seen.ids.tolist() if number in _under_window(board)]
        if hidden:
            return f"the marker {hidden[0]} is seen where board.toml has the window: check window_mm"
        if len(strangers):
            return f"the marker {strangers[0]} is not of a board of {columns} x {rows} squares: it has more rows"
        return f"its {len(seen)} markers lie as they should, but no corner between them can be made out"
    exchanged = [_Layout(rows, white, board.first_id) for white in (swapped, not swapped)]
    if any(layout.fits(seen, board, size) for layout in exchanged):
        return f"{read} columns and rows exchanged: squares = [{rows}, {columns}]"
    if replace(said, first_white=not swapped).fits(seen, board, size):
        if rows % 2:
            return f"{read} an even number of rows and legacy = true"
        return f"{read} legacy = {str(not board.legacy).lower()}"
    for other in range(3, _MOST_COLUMNS):
        if any(_Layout(other, white, board.first_id).fits(seen, board, size) for white in (swapped, not swapped)):
            return f"{read} {other} columns of squares, not {columns}"
    # Two rows further the pattern is the same again.
    lowest = int(seen.ids.min())
    for first in range(lowest, max(lowest - columns, -1), -1):
        if first != board.first_id and replace(said, first_id=first).fits(seen, board, size):
            return f"{read} first_id = {first} (or {columns} less or more, and so on), not {board.first_id}"
    if len(strangers) > (1 - _KNOWN) * len(seen):
        return (
            f"it has the marker {strangers[0]}, but the board has {board.first_id} to {board.last_id}: check squares "
            "and first_id"
        )
    return f"its {len(seen)} markers lie neither as in board.toml nor as with other squares: it is another board"
