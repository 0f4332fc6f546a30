"""Which board suits a rig and a sheet of paper; and what a board is once its print has been measured."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from planeopt.board.page import MARGIN_MM, needed_mm
from planeopt.board.paper import SERIES, Paper, paper_of
from planeopt.board.spec import Board
from planeopt.errors import InputError
from planeopt.rig.checks import positive

Window = tuple[float, float, float, float]

SQUARES = (13, 9)
"""Columns and rows unless others are asked for: odd, so that old and new versions of OpenCV draw the same board."""

REACH = 1.4
"""Size of a board over what the camera sees at the working distance: the spot is not in the middle of the image, and
the board has to reach the far corners of the image while the spot is in its window."""

_MARKER = 0.75  # of a square: the cells of a marker of 4 x 4 bits are then eighths of a square
_WINDOW = (5, 3)  # squares, along the board's longer and shorter side
_SPOTS = 2.5  # height of a window over the spot's diameter: tilted by 60 deg the spot is twice as long as wide
_FRAME = 2  # squares on each side of the window, for corners all round it
_DICTIONARIES = (("DICT_4X4_50", 50), ("DICT_4X4_100", 100), ("DICT_4X4_250", 250), ("DICT_4X4_1000", 1000))
_STEPS = ((10.0, 1.0), (5.0, 0.5), (1.0, 0.1))  # squares from this size on are multiples of that, mm
_SMALLEST = 1.0  # mm
_UNITS = (0.5, 2.0)  # measured over drawn: beyond, the numbers are no mm
# Printers err by a percent or two; a size further off, or of another shape, is more likely measured elsewhere.
_OFF = 0.1
_STRETCH = 0.02
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Wishes:
    """What is asked of a board; what is left out is chosen.

    Parameters
    ----------
    squares : tuple of int
        Columns and rows.
    square_mm : tuple of float, optional
        Width and height of a square.
    marker_mm : float, optional
    dictionary : str, optional
    legacy : bool
    first_id : int
    window_mm : tuple of float or "chosen", optional
        (x, y, width, height); None is a board without window.
    view_mm : tuple of float, optional
        Width and height of what the camera sees at the working distance.
    spot_mm : float, optional
        Diameter of the beam.
    """

    squares: tuple[int, int] = SQUARES
    square_mm: tuple[float, float] | None = None
    marker_mm: float | None = None
    dictionary: str | None = None
    legacy: bool = False
    first_id: int = 0
    window_mm: Window | Literal["chosen"] | None = "chosen"
    view_mm: tuple[float, float] | None = None
    spot_mm: float | None = None

    def board(self, square_mm: tuple[float, float]) -> Board:
        """Return the board with squares of a size.

        Raises
        ------
        InputError
            If it is impossible, or has no room for the spot.
        """
        last = self.first_id + self.squares[0] * self.squares[1] // 2 - 1
        enough = next((name for name, size in _DICTIONARIES if last < size), _DICTIONARIES[-1][0])
        plain = Board(
            squares=self.squares,
            square_mm=square_mm,
            marker_mm=round(_MARKER * min(square_mm), 4) if self.marker_mm is None else self.marker_mm,
            dictionary=enough if self.dictionary is None else self.dictionary,
            legacy=self.legacy,
            first_id=self.first_id,
        )
        return replace(plain, window_mm=_window(plain, self.spot_mm) if self.window_mm == "chosen" else self.window_mm)


def design(
    wishes: Wishes, paper: Paper | None = None, *, name: str = "board.pdf", margin_mm: float = MARGIN_MM
) -> tuple[Board, Paper]:
    """Return a board that suits what is asked, and the paper for it.

    Squares of no given size are as large as the paper allows, but not larger than makes the board 1.4 times what the
    camera sees. Without a paper it is the smallest of A5 to A0 on which the board has that size, or A4 if it is not
    known what the camera sees.

    Parameters
    ----------
    wishes : Wishes
    paper : Paper, optional
    name : str
        Of the file, which is written on the sheet.
    margin_mm : float

    Raises
    ------
    InputError
        If the board is impossible, or does not fit the paper whatever the size of its squares.
    """
    wanted = wishes.square_mm or _wanted(wishes)
    if paper is None:
        paper = paper_of("A4") if wanted is None else paper_for(wishes.board(wanted), name=name, margin_mm=margin_mm)
    if wishes.square_mm is not None:
        return wishes.board(wishes.square_mm), paper
    width, height = paper.size_mm
    columns, rows = wishes.squares
    # Without anything round the board, in the better of both positions.
    largest = max(min(width / columns, height / rows), min(height / columns, width / rows))
    largest = largest if wanted is None else min(largest, wanted[0])
    bare = replace(wishes, marker_mm=None, window_mm=None)
    for side in _sides_below(largest):
        # First whether the squares fit, so that a marker or a spot without room is refused at a size that could be.
        if paper.holding(needed_mm(bare.board((side, side)), name, margin_mm)):
            board = wishes.board((side, side))
            if paper.holding(needed_mm(board, name, margin_mm)):
                return board, paper
    raise InputError(f"{columns} x {rows} squares with rulers, words and margins do not fit {paper} at any size")


def paper_for(board: Board, *, name: str = "board.pdf", margin_mm: float = MARGIN_MM) -> Paper:
    """Return the smallest of A5 to A0 that holds a board; A0 if none does."""
    needed = needed_mm(board, name, margin_mm)
    papers = [paper_of(key) for key in SERIES]
    return next((sheet for sheet in papers if sheet.holding(needed)), papers[-1])


def as_measured(
    board: Board, *, square_mm: tuple[float, float] | None = None, size_mm: tuple[float, float] | None = None
) -> Board:
    """Return a board as its print was measured: window and markers scaled with the squares.

    Parameters
    ----------
    board : Board
        As drawn.
    square_mm : tuple of float, optional
        Width and height of a square.
    size_mm : tuple of float, optional
        Or of all squares together, which is the better measurement.

    Raises
    ------
    InputError
        If neither or both are given, or are so far from the drawing that they cannot be mm; a size also where it is
        more than 10 % off, or off by more than 2 % differently in width and height, as when both are exchanged or are
        not those of all squares. A print that was scaled indeed is described by its measured squares.
    """
    if (square_mm is None) == (size_mm is None):
        raise InputError("give either the measured squares or the measured size of all squares together")
    drawn = board.square_mm if square_mm is not None else board.size_mm
    measured = square_mm or size_mm or drawn
    scale = [positive("a measured length", m, "mm") / d for m, d in zip(measured, drawn, strict=True)]
    for way, ratio, m, d in zip(("width", "height"), scale, measured, drawn, strict=True):
        if not _UNITS[0] < ratio < _UNITS[1]:
            raise InputError(f"the measured {way} is {m:g} mm, but {d:g} mm was drawn: give mm, width first")
    x, y = scale
    if size_mm is not None and (max(abs(x - 1), abs(y - 1)) > _OFF or abs(x / y - 1) > _STRETCH):
        raise InputError(
            f"the measured size, {measured[0]:g} x {measured[1]:g} mm, is {100 * (x - 1):+.1f} % and "
            f"{100 * (y - 1):+.1f} % off the board's {drawn[0]:g} x {drawn[1]:g} mm: are width and height exchanged, "
            f"or was it not from outer edge to outer edge of all {board.squares[0]} x {board.squares[1]} squares? If "
            "the print is so indeed, give its squares (--measured-square-mm)"
        )
    window = board.window_mm
    return replace(
        board,
        square_mm=(round(board.square_mm[0] * x, 6), round(board.square_mm[1] * y, 6)),
        marker_mm=round(board.marker_mm * math.sqrt(x * y), 6),
        window_mm=None
        if window is None
        else (round(window[0] * x, 6), round(window[1] * y, 6), round(window[2] * x, 6), round(window[3] * y, 6)),
    )


def _wanted(wishes: Wishes) -> tuple[float, float] | None:
    """Return the squares with which the board is as large as the rig asks for."""
    if wishes.view_mm is None:
        return None
    view = (
        positive("the view's width", wishes.view_mm[0], "mm"),
        positive("the view's height", wishes.view_mm[1], "mm"),
    )
    side = max(REACH * size / count for size, count in zip(view, wishes.squares, strict=True))
    side = next(_sides_below(side), None)
    if side is None:
        raise InputError(
            f"a view of {view[0]:g} x {view[1]:g} mm needs squares below {_SMALLEST:g} mm: take fewer squares"
        )
    return side, side


def _sides_below(largest: float) -> Iterator[float]:
    """Go through the sizes of squares that are round numbers, from the largest down, mm."""
    side = largest
    while True:
        step = next((step for least, step in _STEPS if side >= least * (1 - _ROUNDING)), None)
        if step is None:
            return
        side = round(math.floor(side / step + _ROUNDING) * step, 6)
        yield side
        side -= _STEPS[-1][1] / 2


def _window(board: Board, spot_mm: float | None) -> Window:
    """Return a window of whole squares in the middle of a board."""
    lying = board.squares[0] >= board.squares[1]
    least, wanted = (1, 1), _WINDOW if lying else _WINDOW[::-1]
    if spot_mm is not None:
        height = _SPOTS * positive("the spot's diameter", spot_mm, "mm")
        least = tuple(math.ceil(height / side - _ROUNDING) for side in board.square_mm)
        # Longer than it need be, so that the board can be moved under the spot.
        longer = (least[0] + 2 * lying, least[1] + 2 * (not lying))
        wanted = (max(wanted[0], longer[0]), max(wanted[1], longer[1]))
    counts = [_central(total, *sizes) for total, *sizes in zip(board.squares, least, wanted, strict=True)]
    if None in counts:
        room = f"{_FRAME} squares on each side of it on a board of {board.squares[0]} x {board.squares[1]} squares"
        if spot_mm is None:
            raise InputError(f"a window does not leave {room}: take more squares, or a board without window")
        raise InputError(
            f"a window for a spot of {spot_mm:g} mm, {_SPOTS:g} times as high, does not leave {room} of "
            f"{board.square_mm[0]:g} mm: take larger paper or larger squares"
        )
    numbers = [
        ((total - count) // 2 * side, count * side)
        for total, count, side in zip(board.squares, (n or 0 for n in counts), board.square_mm, strict=True)
    ]
    (x, width), (y, height) = numbers
    return round(x, 6), round(y, 6), round(width, 6), round(height, 6)


def _central(total: int, least: int, wanted: int) -> int | None:
    """Return the number of squares of a window that lies in the middle: as many as wanted, or nearly."""
    possible = [n for n in range(least, total - 2 * _FRAME + 1) if (total - n) % 2 == 0]
    return next((n for n in possible if n >= wanted), possible[-1] if possible else None)
