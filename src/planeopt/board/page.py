"""The sheet that a board is printed on: where the board, two rulers and its specification in words stand.

All is in mm from the sheet's top left corner, x right, y down.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from reportlab.pdfbase.pdfmetrics import stringWidth

from planeopt.board.paper import Paper
from planeopt.board.pattern import black_rectangles
from planeopt.board.spec import Board
from planeopt.errors import InputError

FloatArray = NDArray[np.float64]

FONT, BOLD = "Helvetica", "Helvetica-Bold"
MARGIN_MM = 8.0
"""What printers leave white, and some to hold the sheet by."""

_PT = 25.4 / 72  # mm
_GAP = 5.0  # between the board and a ruler: white, so that the outer markers are found
_TICKS = {10: 4.0, 5: 3.0, 1: 2.0}  # length in mm of each tenth, fifth, single one
_LINE = 0.15  # mm
_LABEL_PT, _WORDS_PT = 6.0, 6.5
_LEADING = 2.9  # mm
_LABEL = 4.5  # mm, room for a ruler's numbers
_STRIP = _TICKS[10] + _LABEL
_RULERS = (500, 200, 100, 50, 20, 10)  # mm
_RULER_SHARE = 0.9  # of the board's shorter side
_BESIDE = 95.0  # mm: words stand beside the ruler where they have as much
_NARROWEST = 60.0


@dataclass(frozen=True)
class Words:
    """A line of text.

    Parameters
    ----------
    text : str
    x, y : float
        Where its base line begins, mm; the middle of it if centred.
    size_pt : float
    bold, centred : bool
    """

    text: str
    x: float
    y: float
    size_pt: float
    bold: bool = False
    centred: bool = False

    @property
    def width(self) -> float:
        """In mm, as printed."""
        return _width(self.text, self.size_pt, bold=self.bold)


@dataclass(frozen=True, eq=False)
class Page:
    """A sheet with all that is on it.

    Parameters
    ----------
    board : Board
    paper : Paper
    size_mm : tuple of float
        Width and height as the sheet lies.
    origin_mm : tuple of float
        The outer corner of the board's top left square.
    pattern : ndarray, shape (N, 4)
        What is black of the board, in the board's frame.
    rulers : ndarray, shape (M, 4)
        The lines of the rulers, in the sheet's.
    words : tuple of Words
    """

    board: Board
    paper: Paper
    size_mm: tuple[float, float]
    origin_mm: tuple[float, float]
    pattern: FloatArray
    rulers: FloatArray
    words: tuple[Words, ...]


def lay_out(board: Board, paper: Paper, name: str, *, margin_mm: float = MARGIN_MM) -> Page:
    """Return a sheet with a board in its middle.

    Parameters
    ----------
    board : Board
        As it is to be printed.
    paper : Paper
    name : str
        Of the file, which is written on the sheet.
    margin_mm : float
        Least width of the white border.

    Raises
    ------
    InputError
        If it does not fit: one line with what is needed, and the largest squares that do.
    """
    block, needed = _Block.of(board, name), needed_mm(board, name, margin_mm)
    size = paper.holding(needed)
    if size is None:
        raise InputError(
            f"a board of {board.squares[0]} x {board.squares[1]} squares of {sides_in_words(board)} needs a sheet of "
            f"{math.ceil(needed[0])} x {math.ceil(needed[1])} mm with rulers, words and margins, which does not fit "
            f"{paper}: take larger paper, or smaller or fewer squares"
        )
    left, top = (size[0] - block.width) / 2, (size[1] - block.height) / 2
    shift = np.array([left, top, left, top])
    words = tuple(
        Words(line.text, line.x + left, line.y + top, line.size_pt, line.bold, line.centred) for line in block.words
    )
    return Page(board, paper, size, (left, top), black_rectangles(board), block.rulers + shift, words)


def needed_mm(board: Board, name: str, margin_mm: float = MARGIN_MM) -> tuple[float, float]:
    """Return width and height of the smallest sheet that holds a board, its rulers, its words and the margins."""
    block = _Block.of(board, name)
    return block.width + 2 * margin_mm, block.height + 2 * margin_mm


def specification(board: Board, name: str) -> list[str]:
    """Return what is written on the sheet, a paragraph each: the last one says how to print and to measure."""
    columns, rows = board.squares
    across, down = board.size_mm
    lines = [
        f"ChArUco board, {columns} x {rows} squares (columns x rows) of {sides_in_words(board)}; "
        f"markers {board.marker_mm:g} mm, {board.dictionary}, ids {board.first_id} to {board.last_id}; "
        f"legacy: {'yes' if board.legacy else 'no'}",
    ]
    if board.window_mm is None:
        lines.append("No window for the spot: take each view a second time with the laser off.")
    else:
        x, y, width, height = board.window_mm
        lines.append(
            f"Window for the spot: {width:g} x {height:g} mm, {x:g} mm right of and {y:g} mm below the outer corner of "
            "the top left square."
        )
    ruler = _ruler_length(board)
    lines.append(
        f"Print at 100 % (actual size), not fitted to the page: both rulers must measure {ruler} mm. Then measure all "
        f"squares together ({across:g} x {down:g} mm as drawn) and write what you find into board.toml: "
        "planeopt board --from board.toml --measured-size-mm WIDTH HEIGHT"
    )
    return [*lines, f"File: {name}"]


@dataclass(frozen=True, eq=False)
class _Block:
    """Board, rulers and words, from the board's corner."""

    width: float
    height: float
    rulers: FloatArray
    words: tuple[Words, ...]

    @staticmethod
    def of(board: Board, name: str) -> "_Block":
        across, down = board.size_mm
        length = _ruler_length(board)
        width = max(across + _GAP + _STRIP, _NARROWEST)
        left = length + 8.0
        beside = width - left >= _BESIDE
        x, y = (left, down + _GAP + _LEADING * 0.75) if beside else (0.0, down + _GAP + _STRIP + _LEADING)
        lines = [
            (line, i == 0)
            for i, text in enumerate(specification(board, name))
            for line in _broken(text, width - x, bold=i == 0)
        ]
        words = [Words(line, x, y + i * _LEADING, _WORDS_PT, bold) for i, (line, bold) in enumerate(lines)]
        height = max(down + _GAP + _STRIP, words[-1].y + 0.3 * _LEADING)
        horizontal, below = _ruler(length, down + _GAP)
        vertical, beyond = _ruler(length, across + _GAP, upright=True)
        return _Block(width, height, np.concatenate([horizontal, vertical]), (*below, *beyond, *words))


def _ruler_length(board: Board) -> int:
    shorter = min(board.size_mm)
    return next((length for length in _RULERS if length <= _RULER_SHARE * shorter), _RULERS[-1])


def _ruler(length: int, begin: float, *, upright: bool = False) -> tuple[FloatArray, list[Words]]:
    """Return a ruler's lines and numbers: it runs along x (or y, upright) from 0, its ticks point away from `begin`."""
    at = np.arange(length + 1.0)
    long = np.where(at % 10 == 0, _TICKS[10], np.where(at % 5 == 0, _TICKS[5], _TICKS[1]))
    full = np.full_like(at, begin)
    half = _LINE / 2
    lines = np.stack([at - half, full, at + half, full + long], axis=1)
    lines = np.concatenate([[[-half, begin - half, length + half, begin + half]], lines])
    step = 10 if length <= 200 else 50
    numbers = range(0, length + 1, step)
    height = 0.72 * _LABEL_PT * _PT  # of a digit
    if upright:
        labels = [
            Words(str(n), begin + _TICKS[10] + 0.8 + _width(str(n), _LABEL_PT) / 2, n + height / 2, _LABEL_PT)
            for n in numbers
        ]
        lines = lines[:, [1, 0, 3, 2]]
    else:
        labels = [Words(str(n), n, begin + _TICKS[10] + 0.8 + height, _LABEL_PT) for n in numbers]
    return lines, [Words(w.text, w.x, w.y, w.size_pt, centred=True) for w in labels]


def sides_in_words(board: Board) -> str:
    """Return the size of a square: one number, or width x height where they differ."""
    x, y = board.square_mm
    return f"{x:g} mm" if x == y else f"{x:g} x {y:g} mm"


def _width(text: str, size_pt: float, *, bold: bool = False) -> float:
    return float(stringWidth(text, BOLD if bold else FONT, size_pt)) * _PT


def _broken(text: str, width: float, *, bold: bool) -> list[str]:
    """Break a paragraph into lines, a word that is too long for one standing alone."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and _width(longer, _WORDS_PT, bold=bold) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
