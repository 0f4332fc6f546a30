"""A ChArUco board: its specification and where its corners are."""

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.rig.checks import finite, positive

FloatArray = NDArray[np.float64]

_PREDEFINED = re.compile(
    r"DICT_(?:([4-7])X\1_(50|100|250|1000)|ARUCO_ORIGINAL|ARUCO_MIP_36h12|APRILTAG_(?:16h5|25h9|36h10|36h11))"
)
_NAMED_SIZES = {
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
_LEAST = 3
# Of a square: what a window's edge may lie off the corner that it was meant to touch.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Board:
    """A chessboard with a marker in each white square, and a blank white window for the spot if it has one.

    The board frame has its origin at the outer corner of the top left square (the margin not counted), x right, y down,
    z into the board, mm. Inner corner `id` is in column `id % (columns - 1)` and row `id // (columns - 1)`, from 0.

    Parameters
    ----------
    squares : tuple of int
        Columns and rows, at least 3 each.
    square_mm : tuple of float
        Width and height of a square, mm, as measured on the print.
    marker_mm : float
        Side of a marker, mm.
    dictionary : str
        Name of one of OpenCV's predefined dictionaries, such as `DICT_4X4_100`.
    legacy : bool
        Whether a board with even rows has the marker that OpenCV before 4.6 put in the top left square.
    first_id : int
        Id of the first marker.
    window_mm : tuple of float, optional
        (x, y, width, height) of the window, board frame, mm.

    Raises
    ------
    InputError
        If a value is impossible, the markers do not fit their squares, or the window lies off the board.
    """

    squares: tuple[int, int]
    square_mm: tuple[float, float]
    marker_mm: float
    dictionary: str
    legacy: bool = False
    first_id: int = 0
    window_mm: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        squares = tuple(self.squares)
        if len(squares) != 2 or not all(float(n).is_integer() and n >= _LEAST for n in squares):
            raise InputError(
                f"squares must be two whole numbers [columns, rows], {_LEAST} or more each, not {list(squares)}"
            )
        object.__setattr__(self, "squares", (int(squares[0]), int(squares[1])))
        sides = tuple(self.square_mm)
        if len(sides) != 2:
            raise InputError(f"square_mm must be one number or two, [x, y], not {len(sides)}")
        sides = tuple(positive("square_mm", side, "mm") for side in sides)
        object.__setattr__(self, "square_mm", sides)
        marker = positive("marker_mm", self.marker_mm, "mm")
        if marker >= min(sides):
            raise InputError(
                f"marker_mm is {marker:g}, but a marker must be smaller than its square, {min(sides):g} mm"
            )
        object.__setattr__(self, "marker_mm", marker)
        if not _PREDEFINED.fullmatch(self.dictionary):
            raise InputError(
                f"dictionary {self.dictionary!r} is not known: give one of OpenCV's, DICT_4X4_100 for example"
            )
        if self.first_id < 0 or self.first_id != int(self.first_id):
            raise InputError(f"first_id must be a whole number from 0, not {self.first_id}")
        if self.last_id >= self.dictionary_size:
            raise InputError(
                f"the board needs the markers {self.first_id} to {self.last_id}, but {self.dictionary} ends at "
                f"{self.dictionary_size - 1}: take a larger dictionary or fewer squares"
            )
        if self.window_mm is not None:
            object.__setattr__(self, "window_mm", self._checked_window())

    def _checked_window(self) -> tuple[float, float, float, float]:
        window = tuple(self.window_mm or ())
        if len(window) != 4:
            raise InputError(f"window_mm must be four numbers [x, y, width, height], not {len(window)}")
        x, y, width, height = (finite("window_mm", value) for value in window)
        if width <= 0 or height <= 0:
            raise InputError(f"window_mm: width and height must be positive, not {width:g} and {height:g}")
        across, down = self.size_mm
        if x < 0 or y < 0 or x + width > across * (1 + _ROUNDING) or y + height > down * (1 + _ROUNDING):
            raise InputError(
                f"window_mm {list(window)} does not lie on the board, which is {across:g} x {down:g} mm without margin"
            )
        return x, y, width, height

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of all squares together, mm."""
        return self.squares[0] * self.square_mm[0], self.squares[1] * self.square_mm[1]

    @property
    def marker_count(self) -> int:
        """Number of white squares, each with a marker; those under the window are counted too."""
        columns, rows = self.squares
        return rows * columns // 2

    @property
    def last_id(self) -> int:
        """Id of the last marker."""
        return int(self.first_id) + self.marker_count - 1

    @property
    def dictionary_size(self) -> int:
        """Number of markers in the dictionary."""
        found = _PREDEFINED.fullmatch(self.dictionary)
        if found is None:
            raise InputError(f"dictionary {self.dictionary!r} is not known")
        return int(found[2]) if found[2] else _NAMED_SIZES[self.dictionary]

    @cached_property
    def corners(self) -> FloatArray:
        """Inner corners (K, 2), mm, board frame, one a row in the order of their ids."""
        columns, rows = self.squares
        y, x = np.mgrid[1:rows, 1:columns]
        found = np.stack([x.ravel() * self.square_mm[0], y.ravel() * self.square_mm[1]], axis=1)
        found.setflags(write=False)
        return found

    @cached_property
    def printed(self) -> NDArray[np.bool_]:
        """Which corners (K,) are there: not under the window, nor on its edge, where a square is missing."""
        seen = np.ones(len(self.corners), dtype=np.bool_)
        if self.window_mm is not None:
            x, y, width, height = self.window_mm
            slack = _ROUNDING * min(self.square_mm)
            past = self.corners - np.array([x, y])
            seen[np.all((past >= -slack) & (past <= np.array([width, height]) + slack), axis=1)] = False
        seen.setflags(write=False)
        return seen

    def stretched(self, x: float, y: float) -> "Board":
        """Return a board whose lengths are longer by these factors along x and along y; the markers by the smaller."""
        window = self.window_mm
        if window is not None:
            window = (window[0] * x, window[1] * y, window[2] * x, window[3] * y)
        sides = self.square_mm[0] * x, self.square_mm[1] * y
        return replace(self, square_mm=sides, marker_mm=self.marker_mm * min(x, y), window_mm=window)

    def bow(self, points: ArrayLike) -> FloatArray:
        """Return the two shapes by which a bowed board departs from a plane, at points of it.

        A parabola along x and one along y: 1 at the board's middle, 0 at its edges, as in mrcal's model. The board
        is at z = w_x bow_x + w_y bow_y, with (w_x, w_y) the depth of the middle behind the edges, mm.

        Parameters
        ----------
        points : array_like, shape (..., 2)
            mm, board frame.

        Returns
        -------
        ndarray, shape (..., 2)
        """
        half = np.array(self.size_mm) / 2
        return 1 - ((np.asarray(points, dtype=np.float64) - half) / half) ** 2
