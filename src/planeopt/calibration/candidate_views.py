"""Views that could be shot: where the board may be held so that it and its spot are seen, and what each would tell."""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.board import Board
from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.packed import Packed
from planeopt.calibration.per_view import joined, weights_of
from planeopt.calibration.projection import beam_on_board, corner_points, linear_boundaries, linear_corners
from planeopt.calibration.start import LEAST_CORNERS
from planeopt.calibration.state import State, rotation_matrices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TILTS = np.radians([0.0, 20.0, 30.0, 40.0, 50.0])
_DIRECTIONS = np.radians(np.arange(0, 360, 45))
_TURNS = np.radians([0.0, 90.0])
_PLACES = np.array(list(product((0.0, -1.0, 1.0), repeat=2)))
_DEPTHS = 7
_NEARER, _FARTHER = 0.65, 1.6
"""Of the middle distance: how far candidates reach beyond those of the session."""
_AIM = 0.3
"""Of the image's size: how far from its middle a board without a spot is held."""
_ANGLES = 48
_CHUNK = 256

_MARGIN = 0.02
"""Of the image's smaller side: what corners and spot keep from its border."""
_STEEPEST = math.radians(60)
"""Between the board's normal and the line of sight: beyond it markers are hardly read."""
_LEAST_SQUARE = 20.0
"""px, foreshortened: a marker of 6 x 6 cells is then read from cells of 2.5 px."""
_CORNERS_SEEN = 0.6
"""Of the board's corners: what a candidate shows."""


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
        parts = [(linear, np.repeat(seen.corner_seen * self.corner_weight, 2, axis=1))]
        if np.any(seen.spot_seen):
            lit = np.broadcast_to(seen.spot_seen[:, None], seen.boundary.shape[:2])
            # On a bowed board the boundary is a little elsewhere; its derivatives are not.
            found = linear_boundaries(self.board, seen.boundary, lit, state).linear
            steps = np.roll(seen.boundary, -1, axis=1) - np.roll(seen.boundary, 1, axis=1)
            parts.append((found, self.boundary_weight * np.linalg.norm(steps, axis=-1) / 2 * lit))
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
    state = _some(state, np.ones(len(state.rotations), dtype=np.bool_))
    names = observer.selection.shape[1]
    found = np.zeros((len(state.rotations), names, names))
    for begin in range(0, len(found), _CHUNK):
        chunk = np.arange(len(found))[begin : begin + _CHUNK]
        rows = chunk[_before_camera(observer.board, _some(state, chunk))]
        part = _some(state, rows)
        seen = observer.seen(part)
        enough = np.count_nonzero(seen.corner_seen, axis=1) >= LEAST_CORNERS
        if np.any(enough):
            found[rows[enough]] = observer.information(_some(part, enough), _some_seen(seen, enough))
    return found


def candidates(observer: Observer) -> tuple[State, Array]:
    """Return poses in which the board could be held, and what each would add to the information, (C, g, g).

    Distances, tilts, directions of the tilt, turns in the plane and places are gone through; what is kept shows most of
    the board, not too steeply nor too small to be read, and the spot well within its window.
    """
    proposed = _proposed(observer)
    kept, added = [], []
    for begin in range(0, len(proposed.rotations), _CHUNK):
        part = _some(proposed, np.arange(len(proposed.rotations))[begin : begin + _CHUNK])
        part = _some(part, _readable(observer, part))
        seen = observer.seen(part)
        share = np.count_nonzero(seen.corner_seen, axis=1) / np.count_nonzero(observer.board.printed)
        good = share >= _CORNERS_SEEN
        if observer.with_beam:
            good &= seen.spot_seen
        if np.any(good):
            part = _some(part, good)
            kept.append(part)
            added.append(observer.information(part, _some_seen(seen, good)))
    names = observer.selection.shape[1]
    return (
        replace(
            proposed,
            rotations=np.concatenate([part.rotations for part in kept]) if kept else np.empty((0, 3, 3)),
            translations=np.concatenate([part.translations for part in kept]) if kept else np.empty((0, 3)),
        ),
        np.concatenate(added) if added else np.empty((0, names, names)),
    )


def depths(observer: Observer) -> Array:
    """Return the distances (V,) of the session's boards: along the beam where there is one, else z of their middles."""
    state = observer.state
    if not observer.with_beam:
        middles = state.rotations[:, :, :2] @ (np.array(observer.board.size_mm) / 2) + state.translations
        return middles[:, 2]
    normals = state.rotations[..., 2]
    e_x, e_y = state.value("e_x"), state.value("e_y")
    away = np.sum(normals * (state.translations - np.array([e_x, e_y, 0.0])), axis=-1)
    return away / (normals @ state.direction)


def _proposed(observer: Observer) -> State:
    """Return all poses that are looked at, good or not."""
    state, board = observer.state, observer.board
    known = depths(observer)
    known = known[known > 0] if np.any(known > 0) else np.abs(known)
    middle = float(np.median(known))
    reach = np.geomspace(min(known.min(), _NEARER * middle), max(known.max(), _FARTHER * middle), _DEPTHS)
    leans = [(0.0, 0.0), *((tilt, direction) for tilt in _TILTS[1:] for direction in _DIRECTIONS)]
    grid = np.array(
        [
            (depth, *lean, turn, *place)
            for depth, lean, turn, place in product(reach.tolist(), leans, _TURNS.tolist(), _PLACES.tolist())
        ]
    )
    depth, tilt, direction, turn, place = grid[:, 0], grid[:, 1], grid[:, 2], grid[:, 3], grid[:, 4:]
    axes = tilt[:, None] * np.stack([np.cos(direction), np.sin(direction), np.zeros_like(tilt)], axis=-1)
    spins = turn[:, None] * np.array([0.0, 0.0, 1.0])
    rotations = rotation_matrices(axes) @ rotation_matrices(spins)
    if observer.with_beam:
        x, y, width, height = board.window_mm or (0.0, 0.0, *board.size_mm)
        # The spot is longest across the tilt's axis; what is left of the window's sides is free.
        longest = state.value("radius") / np.cos(np.minimum(tilt, _STEEPEST))
        free = np.maximum(np.array([width, height]) / 2 - 1.1 * longest[:, None], 0.0)
        at = np.array([x + width / 2, y + height / 2]) + place * free
        hit = np.array([state.value("e_x"), state.value("e_y"), 0.0]) + depth[:, None] * state.direction
    else:
        at = np.broadcast_to(np.array(board.size_mm) / 2, place.shape)
        px = (np.array(state.image_size) - 1) / 2 + place * _AIM * np.array(state.image_size)
        rays = np.asarray(state.camera.normalise(px)[0])
        hit = depth[:, None] * np.concatenate([rays, np.ones_like(rays[:, :1])], axis=-1)
    shifts = hit - (rotations[..., :2] @ at[..., None])[..., 0]
    return replace(state, rotations=rotations, translations=shifts)


def _readable(observer: Observer, state: State) -> Mask:
    """Whether boards lie before the camera, face it not too steeply and are large enough in the image."""
    board, camera = observer.board, observer.state.camera
    middles = state.rotations[:, :, :2] @ (np.array(board.size_mm) / 2) + state.translations
    sight = middles / np.linalg.norm(middles, axis=-1, keepdims=True)
    cosine = np.sum(state.rotations[..., 2] * sight, axis=-1)
    size = camera.fx * min(board.square_mm) * cosine / np.maximum(middles[:, 2], np.finfo(np.float64).tiny)
    return _before_camera(board, state) & (cosine > math.cos(_STEEPEST)) & (size >= _LEAST_SQUARE)


def _before_camera(board: Board, state: State) -> Mask:
    edges = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]) * [*board.size_mm, 0.0]
    placed = edges @ np.swapaxes(state.rotations, -1, -2) + state.translations[:, None]
    return np.all(placed[..., 2] > 0, axis=1)


def _some(state: State, rows: Array | Mask | NDArray[np.intp]) -> State:
    return replace(state, rotations=state.rotations[rows], translations=state.translations[rows])


def _some_seen(seen: Seen, rows: Mask) -> Seen:
    return Seen(seen.corners[rows], seen.corner_seen[rows], seen.boundary[rows], seen.spot_seen[rows])


def _perimeter(points: Array) -> float:
    """Return the length of the closed line through points (N, 2) in the order of their angle about their middle, px."""
    away = points - points.mean(axis=0)
    ordered = points[np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")]
    return float(np.linalg.norm(np.roll(ordered, -1, axis=0) - ordered, axis=1).sum())
