"""Observations as arrays, a row a view: padded, so that all views are computed at once; padding weighs nothing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board, Observations, View
from planeopt.spot import Spot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Packed:
    """All views of a calibration.

    Parameters
    ----------
    board : Board
    image_size : tuple of int
        px.
    corners : (V, K, 2) array
        Raw px, a place for each corner of the board.
    corner_sigma : (V, K) array
        px, each coordinate, up to a common factor.
    corner_seen : (V, K) array of bool
    boundary : (V, M, 2) array
        Points of the spots' boundaries, raw px.
    boundary_sigma : (V, M) array
        px, across the boundary.
    boundary_seen : (V, M) array of bool
    """

    board: Board
    image_size: tuple[int, int]
    corners: Array
    corner_sigma: Array
    corner_seen: Mask
    boundary: Array
    boundary_sigma: Array
    boundary_seen: Mask

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.corners)

    @property
    def with_spot(self) -> Mask:
        """Which views (V,) have a spot."""
        return np.asarray(self.boundary_seen.any(axis=1), dtype=np.bool_)

    def some(self, rows: NDArray[np.intp]) -> "Packed":
        """Return some of the views."""
        return Packed(
            self.board,
            self.image_size,
            self.corners[rows],
            self.corner_sigma[rows],
            self.corner_seen[rows],
            self.boundary[rows],
            self.boundary_sigma[rows],
            self.boundary_seen[rows],
        )

    @classmethod
    def of(cls, observations: Observations) -> "Packed":
        """Return the observations as arrays; boundaries whose `sigma` is not known get one pixel."""
        views, board = observations.views, observations.board
        count = len(board.corners)
        spots = [view.spot for view in views]
        longest = max((len(spot) for spot in spots if spot is not None), default=0)
        middle = (np.array(observations.image_size) - 1) / 2
        corners = np.broadcast_to(middle, (len(views), count, 2)).copy()
        corner_sigma = np.ones((len(views), count))
        corner_seen = np.zeros((len(views), count), dtype=np.bool_)
        boundary = np.broadcast_to(middle, (len(views), longest, 2)).copy()
        boundary_sigma = np.ones((len(views), longest))
        boundary_seen = np.zeros((len(views), longest), dtype=np.bool_)
        for row, view in enumerate(views):
            _put_corners(view, corners[row], corner_sigma[row], corner_seen[row])
            if view.spot is not None:
                _put_spot(view.spot, boundary[row], boundary_sigma[row], boundary_seen[row])
        return cls(
            board, observations.image_size, corners, corner_sigma, corner_seen, boundary, boundary_sigma, boundary_seen
        )


def _put_corners(view: View, corners: Array, sigma: Array, seen: Mask) -> None:
    corners[view.ids] = view.corners
    sigma[view.ids] = view.sigma
    seen[view.ids] = True


def _put_spot(spot: Spot, boundary: Array, sigma: Array, seen: Mask) -> None:
    boundary[: len(spot)] = spot.points
    if spot.sigma is not None:
        sigma[: len(spot)] = spot.sigma
    seen[: len(spot)] = True
