"""What views that are not there yet would tell: what they show, and the information that they would add."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.board import Board
from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.packed import Packed
from planeopt.calibration.per_view import joined, weights_of
from planeopt.calibration.projection import beam_on_board, corner_points, linear_boundaries, linear_corners
from planeopt.calibration.start import LEAST_CORNERS
from planeopt.calibration.state import State

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHUNK = 256
"""Views worked on at once."""

_ANGLES = 48
_MARGIN = 0.02
"""Of the image's smaller side: what corners and spot keep from its border."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What views show.

    Attributes
    ----------
    corners : (C, K, 2) array
        px.
    corner_seen : (C, K) array of bool
    boundary : (C, M, 2) array
        Of the spots, px; the image's middle where there is none.
    spot_seen : (C,) array of bool
        Whether the whole spot lies in the window and in the image.
    """

    corners: Array
    corner_seen: Mask
    boundary: Array
    spot_seen: Mask


@dataclass(frozen=True, eq=False)
class Observer:
    """A rig and a board as an adjustment left them, with the noise that it found.

    Attributes
    ----------
    board : Board
    state : State
        Its poses are those of the session.
    selection : (17, g) array
        Of the free parameters.
    corner_weight : float
        One over the variance of a corner's coordinate, 1/px^2.
    boundary_weight : float
        One over the variance of a boundary's position, for each px of its length, 1/px^3; 0 without a beam.
    """

    board: Board
    state: State
    selection: Array
    corner_weight: float
    boundary_weight: float

    @classmethod
    def of(cls, adjustment: Adjustment) -> "Observer":
        """Return the observer of an adjustment."""
        packed = Packed.of(adjustment.observations)
        weights = weights_of(adjustment, packed)
        used = weights.corners > 0
        lit = weights.boundary.any(axis=1)
        boundary_weight = 0.0
        if adjustment.model.beam != "none" and np.any(lit):
            per_length = [
                float(weights.boundary[row].sum()) / _perimeter(packed.boundary[row][packed.boundary_seen[row]])
                for row in np.flatnonzero(lit)
            ]
            boundary_weight = float(np.median(per_length))
        return cls(
            packed.board,
            adjustment.state,
            adjustment.model.selection,
            float(np.median(weights.corners[used])),
            boundary_weight,
        )

    @property
    def with_beam(self) -> bool:
        """Whether a spot is looked for."""
        return self.boundary_weight > 0

    def seen(self, state: State) -> Seen:
        """Return what views show whose boards lie before the camera."""
        fixed = corner_points(self.board, state.warp)
        placed = fixed @ np.swapaxes(state.rotations, -1, -2) + state.translations[:, None]
        corners, visible = self._pixels(placed)
        count = len(placed)
        middle = (np.array(state.image_size) - 1) / 2
        boundary = np.broadcast_to(middle, (count, _ANGLES, 2)).copy()
        spot_seen = np.zeros(count, dtype=np.bool_)
        if self.with_beam:
            points = beam_on_board(state, np.linspace(0, math.tau, _ANGLES, endpoint=False))
            on_board = (points - state.translations[:, None]) @ state.rotations
            x, y, width, height = self.board.window_mm or (0.0, 0.0, *self.board.size_mm)
            past = on_board[..., :2] - [x, y]
            found, inside = self._pixels(points)
            inside &= np.all((past >= 0) & (past <= [width, height]), axis=-1)
            spot_seen = inside.all(axis=1)
            boundary[spot_seen] = found[spot_seen]
        return Seen(corners, visible & self.board.printed, boundary, spot_seen)

    def information(self, state: State, seen: Seen) -> Array:
        """Return what views would add to the information (C, g, g) about the free parameters."""
        linear = linear_corners(self.board, seen.corners, state)
        weight = np.asarray(np.repeat(seen.corner_seen * self.corner_weight, 2, axis=1), dtype=np.float64)
        parts = [(linear, weight)]
        if np.any(seen.spot_seen):
            lit = np.broadcast_to(seen.spot_seen[:, None], seen.boundary.shape[:2])
            # On a bowed board the boundary is a little elsewhere; its derivatives are not.
            found = linear_boundaries(self.board, seen.boundary, lit, state).linear
            steps = np.roll(seen.boundary, -1, axis=1) - np.roll(seen.boundary, 1, axis=1)
            length = np.asarray(np.linalg.norm(steps, axis=-1) / 2, dtype=np.float64)
            parts.append((found, self.boundary_weight * length * lit))
        return joined(parts, self.selection).information

    def _pixels(self, placed: Array) -> tuple[Array, Mask]:
        """Return the pixels of points (..., 3) in the camera frame, and which of them lie well within the image."""
        before = placed[..., 2] > 0
        normalised = placed[..., :2] / np.where(before, placed[..., 2], 1.0)[..., None]
        camera = self.state.camera
        before &= np.hypot(normalised[..., 0], normalised[..., 1]) < camera.invertible_radius
        px = camera.project(np.where(before[..., None], normalised, 0.0))
        size = np.array(self.state.image_size)
        margin = _MARGIN * size.min()
        return px, before & np.all((px >= margin) & (px <= size - 1 - margin), axis=-1)


def expected_information(adjustment: Adjustment, rotations: ArrayLike, translations: ArrayLike) -> Array:
    """Return what views that are not there yet would add to `Adjustment.information`, each alone.

    Their corners are those well within the image, with the typical noise of those that were seen; their spots, where
    all of the boundary is in the window and in the image, have the typical noise per length of boundary.

    Parameters
    ----------
    adjustment : Adjustment
    rotations : array_like, shape (C, 3, 3)
        Board to camera.
    translations : array_like, shape (C, 3)
        mm.

    Returns
    -------
    ndarray, shape (C, g, g)
        Zero for views from which the board is not seen.
    """
    observer = Observer.of(adjustment)
    state = replace(
        adjustment.state,
        rotations=np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3),
        translations=np.asarray(translations, dtype=np.float64).reshape(-1, 3),
    )
    names = observer.selection.shape[1]
    found = np.zeros((len(state.rotations), names, names))
    for begin in range(0, len(found), CHUNK):
        chunk = np.arange(len(found))[begin : begin + CHUNK]
        rows = chunk[before_camera(observer.board, state.some(chunk))]
        part = state.some(rows)
        seen = observer.seen(part)
        enough = np.count_nonzero(seen.corner_seen, axis=1) >= LEAST_CORNERS
        if np.any(enough):
            found[rows[enough]] = observer.information(part.some(enough), some_seen(seen, enough))
    return found


def before_camera(board: Board, state: State) -> Mask:
    """Whether boards (C,) lie before the camera as a whole."""
    edges = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]) * [*board.size_mm, 0.0]
    placed = edges @ np.swapaxes(state.rotations, -1, -2) + state.translations[:, None]
    return np.all(placed[..., 2] > 0, axis=1)


def some_seen(seen: Seen, rows: Mask) -> Seen:
    """Return what some of the views show."""
    return Seen(seen.corners[rows], seen.corner_seen[rows], seen.boundary[rows], seen.spot_seen[rows])


def _perimeter(points: Array) -> float:
    """Return the length of the closed line through points (N, 2) in the order of their angle about their middle, px."""
    away = points - points.mean(axis=0)
    ordered = points[np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")]
    return float(np.linalg.norm(np.roll(ordered, -1, axis=0) - ordered, axis=1).sum())
