"""What a board looks like: its printed pattern as reflectance, and the light that falls on it."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from scipy.special import ndtr

from planeopt.board import Board
from planeopt.board.pattern import black_rectangles
from planeopt.simulation.tables import NotNegative, Pair, Table, Triple

Array = NDArray[np.float64]

_FAR = 1e30
# Of a square: edges nearer than this are one edge, apart by rounding.
_SAME = 1e-6


class BoardSurface(Table, frozen=True):
    """What the board and what is behind it look like without the laser.

    Parameters
    ----------
    white : float
        Brightness of blank paper in the image's middle, share of full scale.
    black : float
        Of the print, share of the paper's; it is the share of the laser's light as well.
    around : float
        Of what is behind the board, share of the paper's.
    margin_mm : float
        Of blank paper round the squares.
    gradient : (float, float)
        Relative change of the light on the board over the image's width and height.
    rgb : (float, float, float)
        Of a colour camera: what the red, green and blue channels see of this light.
    """

    key: ClassVar[str] = "surface"

    white: Annotated[float, Meta(gt=0, le=1000)] = 0.4
    black: Annotated[float, Meta(ge=0, le=1)] = 0.08
    around: NotNegative = 0.3
    margin_mm: NotNegative = 8.0
    gradient: Pair = (0.0, 0.0)
    rgb: Triple = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Pattern:
    """Reflectance, constant in each cell of a grid whose lines run through all edges of the print.

    Attributes
    ----------
    x, y : (M,), (N,) ndarray
        Places of the lines, rising, mm, board frame.
    reflectance : (N + 1, M + 1) ndarray
        Of the cells before, between and behind the lines; white paper is 1.
    """

    x: Array
    y: Array
    reflectance: Array

    @classmethod
    def of(cls, board: Board, surface: BoardSurface) -> "Pattern":
        """Return the pattern of a board on paper."""
        rectangles = black_rectangles(board)
        across, down = board.size_mm
        margin, least = surface.margin_mm, _SAME * min(board.square_mm)
        x = _lines([*rectangles[:, 0], *rectangles[:, 2], -margin, across + margin], least)
        y = _lines([*rectangles[:, 1], *rectangles[:, 3], -margin, down + margin], least)
        reflectance = np.full((len(y) + 1, len(x) + 1), surface.around)
        reflectance[1:-1, 1:-1] = 1.0
        columns = np.searchsorted(x, rectangles[:, [0, 2]] + least)
        rows = np.searchsorted(y, rectangles[:, [1, 3]] + least)
        for (left, right), (top, bottom) in zip(columns.tolist(), rows.tolist(), strict=True):
            reflectance[top:bottom, left:right] = surface.black
        return cls(x, y, reflectance)

    def smoothed(self, x: Array, y: Array, blur_x: Array, blur_y: Array) -> Array:
        """Return the reflectance (...) at places (...), mm, smoothed by Gaussians along x and y, mm.

        Edges next to a place's own cell count: right where cells are wider than two standard deviations or so.
        """
        column, left, right = _shares(self.x, x, blur_x)
        row, above, below = _shares(self.y, y, blur_y)
        width = self.reflectance.shape[1]
        padded = np.pad(self.reflectance, 1, mode="edge").ravel()
        at = (row + 1) * (width + 2) + column + 1

        def line(start: NDArray[np.intp]) -> Array:
            middle = padded[start]
            return middle + left * (padded[start - 1] - middle) + right * (padded[start + 1] - middle)

        middle = line(at)
        return middle + above * (line(at - width - 2) - middle) + below * (line(at + width + 2) - middle)


def _lines(places: list[float], least: float) -> Array:
    """Return places in order, those that differ by rounding once."""
    ordered = np.sort(np.array(places))
    return ordered[np.diff(ordered, prepend=-np.inf) > least]


def _shares(lines: Array, at: Array, blur: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Return in which cell places lie, and how much of a Gaussian there lies before and behind that cell."""
    cell = np.searchsorted(lines, at)
    ends = np.concatenate([[-_FAR], lines, [_FAR]])
    inverse = 1 / blur
    return cell, ndtr((ends[cell] - at) * inverse), ndtr((at - ends[cell + 1]) * inverse)
