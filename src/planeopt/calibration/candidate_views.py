"""Views that could be shot: where the board may be held so that it and its spot are seen, and what each would tell."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.expected import CHUNK, Observer, before_camera, some_seen
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
_STEEPEST = math.radians(60)
"""Between the board's normal and the line of sight: beyond it markers are hardly read."""
_LEAST_SQUARE = 20.0
"""px, foreshortened: a marker of 6 x 6 cells is then read from cells of 2.5 px."""
_CORNERS_SEEN = 0.6
"""Of the board's corners: what a candidate shows."""


def candidates(observer: Observer) -> tuple[State, Array]:
    """Return poses in which the board could be held, and what each would add to the information, (C, g, g).

    Distances, tilts, directions of the tilt, turns in the plane and places are gone through; what is kept shows most of
    the board, not too steeply nor too small to be read, and the spot well within its window.
    """
    proposed = _proposed(observer)
    kept, added = [], []
    for begin in range(0, len(proposed.rotations), CHUNK):
        part = proposed.some(np.arange(len(proposed.rotations))[begin : begin + CHUNK])
        part = part.some(_readable(observer, part))
        seen = observer.seen(part)
        share = np.count_nonzero(seen.corner_seen, axis=1) / np.count_nonzero(observer.board.printed)
        good = share >= _CORNERS_SEEN
        if observer.with_beam:
            good &= seen.spot_seen
        if np.any(good):
            part = part.some(good)
            kept.append(part)
            added.append(observer.information(part, some_seen(seen, good)))
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
    return before_camera(board, state) & (cosine > math.cos(_STEEPEST)) & (size >= _LEAST_SQUARE)
