"""What was seen of a board: its corners and the laser's spot on it, view by view."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.board.spec import Board
from planeopt.errors import InputError
from planeopt.spot import Spot

FloatArray = NDArray[np.float64]

SpotOnBoard = Literal["disc", "ring", "none"]
"""What the laser draws on the board; "none" means that only the camera is calibrated."""


@dataclass(frozen=True, eq=False)
class View:
    """One image's corners, and the boundary of its spot if that was measured.

    Parameters
    ----------
    name : str
        Of the image.
    ids : array_like, shape (N,)
        Ids of the corners, each once.
    corners : array_like, shape (N, 2)
        Raw (distorted) pixels; pixel centres are at integers.
    sigma : array_like, shape (N,)
        Standard deviation of each coordinate, px, up to a common factor, which the adjustment finds.
    spot : Spot, optional

    Raises
    ------
    InputError
        If the arrays do not go together, an id stands twice, or a value is not finite (sigma: not positive).
    """

    name: str
    ids: NDArray[np.int64]
    corners: FloatArray
    sigma: FloatArray
    spot: Spot | None = None

    def __post_init__(self) -> None:
        ids = np.array(self.ids, dtype=np.int64).reshape(-1)
        corners = _numbers(self.corners, f"{self.name}: corners")
        sigma = _numbers(self.sigma, f"{self.name}: sigma_px")
        if corners.shape != (len(ids), 2) or sigma.shape != (len(ids),):
            raise InputError(
                f"{self.name}: {len(ids)} ids need corners of shape ({len(ids)}, 2) and as many sigmas, "
                f"not {corners.shape} and {sigma.shape}"
            )
        if len(np.unique(ids)) != len(ids):
            twice = int(next(k for k in ids if np.count_nonzero(ids == k) > 1))
            raise InputError(f"{self.name}: the corner {twice} stands there more than once")
        if np.any(sigma <= 0):
            raise InputError(f"{self.name}: sigma_px must be positive, not {sigma.min():g}")
        ids.setflags(write=False)
        for name, value in (("ids", ids), ("corners", corners), ("sigma", sigma)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Return the number of corners."""
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Observations:
    """Everything that a calibration starts from.

    Parameters
    ----------
    board : Board
    image_size : tuple of int
        Width and height, px.
    views : tuple of View
    spot : {"disc", "ring", "none"}
    pixel_pitch_mm : float, optional

    Raises
    ------
    InputError
        If a view has a corner that the board does not have.
    """

    board: Board
    image_size: tuple[int, int]
    views: tuple[View, ...]
    spot: SpotOnBoard = "disc"
    pixel_pitch_mm: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(self.views))
        count = len(self.board.corners)
        for view in self.views:
            wrong = view.ids[(view.ids < 0) | (view.ids >= count)]
            if wrong.size:
                raise InputError(f"{view.name}: the board has the corners 0 to {count - 1}, not {int(wrong[0])}")

    @property
    def corner_sigma(self) -> float:
        """Root mean square of the sigmas of all corners, px, as given; 1 without corners."""
        sigmas = np.concatenate([np.empty(0), *(view.sigma for view in self.views)])
        return float(np.sqrt(np.mean(sigmas**2))) if sigmas.size else 1.0


def _numbers(values: ArrayLike, what: str) -> FloatArray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be numbers: {error}") from None
    if not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be finite (no NaN, no infinity)")
    array.setflags(write=False)
    return array
