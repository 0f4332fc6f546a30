"""What a state says of each observation: residuals in pixels and their analytic derivatives, all views at once.

A corner b of the board, with the bow w, is at ``b + w.bow(b) z`` on the board and at ``X = R b + t`` in the camera. A
point of a spot's boundary goes the other way: its pixel's ray meets the (bowed) board at X, and there

    g(X) = |(I - d d')(X - e)| - r - delta d.(X - e)

is how far outside the beam it lies, in mm: e = (e_x, e_y, 0) where the axis crosses z = 0, d its direction, r the
radius at z_L = 0 and delta the growth of the radius per mm. Divided by the length of its gradient in the image it is
the distance from the predicted boundary in px (Sampson; exact for a beam seen face on, since g is a length).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.calibration.model import BEAM, CAMERA, FULL, WARP
from planeopt.calibration.state import State, cross_matrices
from planeopt.errors import InputError
from planeopt.rig import Camera, distort

Array = NDArray[np.float64]

_INTERSECTION_STEPS = 3  # of Newton on a parabola much flatter than the rays are steep: to rounding


@dataclass(frozen=True, eq=False)
class Linear:
    """Residuals and their derivatives, one row a number observed.

    Parameters
    ----------
    residual : (V, N) array
        Observed minus predicted, px.
    shared : (V, N, 17) array
        d residual / d `FULL`.
    pose : (V, N, 6) array
        d residual / d (turn, shift) of `State.moved`.
    """

    residual: Array
    shared: Array
    pose: Array


@dataclass(frozen=True, eq=False)
class Boundaries:
    """Where points of the spots' boundaries lie on the beam, and the residuals.

    Parameters
    ----------
    linear : Linear
        Positive outside of the predicted boundary.
    points : (V, M, 3) array
        On the board, camera frame, mm.
    around : (V, M) array
        Angle round the beam's axis.
    scale : (V, M) array
        Length of g's gradient in the image, mm per px.
    """

    linear: Linear
    points: Array
    around: Array
    scale: Array


def corner_points(board: Board, warp: Array) -> Array:
    """Return the corners (K, 3) of a bowed board, board frame, mm."""
    return np.column_stack([board.corners, board.bow(board.corners) @ warp])


def predict_corners(board: Board, state: State) -> Array:
    """Return the pixels (V, K, 2) of the board's corners.

    Raises
    ------
    InputError
        If a corner is behind the camera, or the state is no camera.
    """
    placed = _in_camera(corner_points(board, state.warp), state)
    return state.camera.project(placed[..., :2] / _in_front(placed[..., 2:]))


def linear_corners(board: Board, corners: Array, state: State) -> Linear:
    """Return the residuals of the corners, u and v of each in turn.

    Parameters
    ----------
    board : Board
    corners : (V, K, 2) array
        Observed, px.
    state : State

    Raises
    ------
    InputError
        If a corner is behind the camera, or the state is no camera.
    """
    camera = state.camera
    fixed = corner_points(board, state.warp)
    turned = fixed @ np.swapaxes(state.rotations, -1, -2)
    placed = turned + state.translations[:, None]
    depth = _in_front(placed[..., 2:])
    normalised = placed[..., :2] / depth
    observed = corners - camera.project(normalised)
    by_point = _by_normalised(camera, normalised) @ _by_place(normalised, depth)
    views, count = corners.shape[:2]
    shared = np.zeros((views, count, 2, len(FULL)))
    shared[..., CAMERA] = _by_camera(camera, normalised)
    shared[..., WARP] = (by_point @ state.rotations[:, None, :, 2:]) * board.bow(board.corners)[:, None, :]
    pose = np.concatenate([-by_point @ cross_matrices(turned), by_point], axis=-1)
    return Linear(
        observed.reshape(views, 2 * count),
        -shared.reshape(views, 2 * count, len(FULL)),
        -pose.reshape(views, 2 * count, 6),
    )


def linear_boundaries(board: Board, boundary: Array, seen: NDArray[np.bool_], state: State) -> Boundaries:
    """Return the residuals of points of the spots' boundaries; of padding they are zero.

    Parameters
    ----------
    board : Board
    boundary : (V, M, 2) array
        Observed, px.
    seen : (V, M) array of bool
    state : State

    Raises
    ------
    InputError
        If a ray does not meet the board in front of the camera, or the state is no rig.
    """
    camera = state.camera
    normalised, inverse = camera.normalise(boundary)
    rays = np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)
    lengths, normals, on_board = _meet(board, rays, seen, state)
    points = rays * lengths[..., None]
    steep = np.where(seen, np.sum(normals * rays, axis=-1), 1.0)

    radial, along, distance = _beside_beam(points, state)
    direction, divergence = state.direction, state.value("divergence")
    gradient = np.where(seen[..., None], radial - divergence * direction, 0.0)
    # X = s (m, 1) on the surface: as the ray turns by dm, X moves by s (dm, 0) less what leaves the surface.
    slope = np.sum(gradient * rays, axis=-1) / steep
    by_ray = lengths[..., None] * (gradient - slope[..., None] * normals)[..., :2]
    by_pixel = (by_ray[..., None, :] @ inverse)[..., 0, :]
    scale = np.where(seen, np.linalg.norm(by_pixel, axis=-1), 1.0)

    offset = points - state.translations[:, None]
    views, count = seen.shape
    shared = np.zeros((views, count, len(FULL)))
    shared[..., CAMERA] = -(by_pixel[..., None, :] @ _by_camera(camera, normalised))[..., 0, :]
    shared[..., WARP] = slope[..., None] * board.bow(on_board[..., :2])
    shared[..., BEAM] = _by_beam(gradient, radial, points, along, state)
    turn = -slope[..., None] * np.cross(normals, offset)
    shift = slope[..., None] * normals
    outside = distance - state.value("radius") - divergence * along
    used = (seen / scale)[..., None]
    linear = Linear(np.where(seen, outside, 0.0) / scale, shared * used, np.concatenate([turn, shift], axis=-1) * used)
    return Boundaries(linear, points, _angles(radial, direction), scale)


def beam_on_board(board_from: State, angles: Array) -> Array:
    """Return where generators of the beam meet the boards of all views, taken as flat.

    Parameters
    ----------
    board_from : State
    angles : (M,) array
        Round the beam's axis.

    Returns
    -------
    ndarray, shape (V, M, 3)
        Camera frame, mm. Behind the camera where the beam, drawn forward, does not meet the board.
    """
    direction = board_from.direction
    first, second = _across(direction)
    e_x, e_y, radius = board_from.values[BEAM][:3].tolist()
    starts = np.array([e_x, e_y, 0.0]) + radius * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
    normals = board_from.rotations[:, None, :, 2]
    away = np.sum(normals * (board_from.translations[:, None] - starts), axis=-1)
    return starts + (away / (normals @ direction))[..., None] * direction


def _in_camera(points: Array, state: State) -> Array:
    return points @ np.swapaxes(state.rotations, -1, -2) + state.translations[:, None]


def _in_front(depth: Array) -> Array:
    if not np.all(depth > 0):
        raise InputError("a corner of the board is behind the camera")
    return depth


def _by_normalised(camera: Camera, normalised: Array) -> Array:
    """Return d pixel / d normalised coordinates (..., 2, 2)."""
    xx, xy, yy = camera.distortion_jacobian(normalised)
    rows = [np.stack([camera.fx * xx, camera.fx * xy], axis=-1), np.stack([camera.fy * xy, camera.fy * yy], axis=-1)]
    return np.stack(rows, axis=-2)


def _by_place(normalised: Array, depth: Array) -> Array:
    """Return d (X/Z, Y/Z) / d (X, Y, Z), shape (..., 2, 3)."""
    flat = np.broadcast_to(np.eye(2), (*normalised.shape[:-1], 2, 2))
    return np.concatenate([flat, -normalised[..., None]], axis=-1) / depth[..., None]


def _by_camera(camera: Camera, normalised: Array) -> Array:
    """Return d pixel / d (fx, fy, cx, cy, k1, k2, p1, p2, k3), shape (..., 2, 9), of fixed normalised coordinates."""
    x, y = normalised[..., 0], normalised[..., 1]
    r2 = x * x + y * y
    xd, yd = distort(x, y, *camera.distortion)
    zero, one = np.zeros_like(x), np.ones_like(x)
    fx, fy = camera.fx, camera.fy
    u = [xd, zero, one, zero, fx * x * r2, fx * x * r2**2, 2 * fx * x * y, fx * (r2 + 2 * x * x), fx * x * r2**3]
    v = [zero, yd, zero, one, fy * y * r2, fy * y * r2**2, fy * (r2 + 2 * y * y), 2 * fy * x * y, fy * y * r2**3]
    return np.stack([np.stack(u, axis=-1), np.stack(v, axis=-1)], axis=-2)


def _meet(board: Board, rays: Array, seen: NDArray[np.bool_], state: State) -> tuple[Array, Array, Array]:
    """Return where rays (V, M, 3) meet the boards: multiples, the surface's normals there, and points on the board."""
    inward, origin = state.rotations, state.translations
    flat = inward[:, None, :, 2]
    steep = np.where(seen, np.sum(flat * rays, axis=-1), 1.0)
    lengths = np.sum(flat * origin[:, None], axis=-1) / steep
    half = np.array(board.size_mm) / 2
    normals, on_board = np.broadcast_to(flat, rays.shape), (rays * lengths[..., None] - origin[:, None]) @ inward
    if np.any(state.warp != 0):
        for _ in range(_INTERSECTION_STEPS):
            slopes = -2 * (on_board[..., :2] - half) / half**2 * state.warp
            normals = flat - slopes @ np.swapaxes(inward[..., :2], -1, -2)
            above = on_board[..., 2] - board.bow(on_board[..., :2]) @ state.warp
            lengths = lengths - np.where(seen, above, 0.0) / np.where(seen, np.sum(normals * rays, axis=-1), 1.0)
            on_board = (rays * lengths[..., None] - origin[:, None]) @ inward
    if not np.all(lengths[seen] > 0):
        raise InputError("a spot's boundary does not lie on the board in front of the camera")
    return np.where(seen, lengths, 1.0), np.where(seen[..., None], normals, [0.0, 0.0, 1.0]), on_board


def _beside_beam(points: Array, state: State) -> tuple[Array, Array, Array]:
    """Return the unit vectors away from the beam's axis, and the distances along and from it."""
    e_x, e_y = state.values[BEAM][:2].tolist()
    away = points - np.array([e_x, e_y, 0.0])
    along = away @ state.direction
    across = away - along[..., None] * state.direction
    distance = np.linalg.norm(across, axis=-1)
    return across / np.where(distance > 0, distance, 1.0)[..., None], along, distance


def _by_beam(gradient: Array, radial: Array, points: Array, along: Array, state: State) -> Array:
    """Return d g / d (e_x, e_y, radius, direction_x, direction_y, divergence), shape (..., 6)."""
    direction, divergence = state.direction, state.value("divergence")
    e_x, e_y = state.values[BEAM][:2].tolist()
    away = points - np.array([e_x, e_y, 0.0])
    by_direction = -along[..., None] * radial - divergence * away
    # direction_z = sqrt(1 - x^2 - y^2).
    by_tilt = by_direction[..., :2] - by_direction[..., 2:] * (direction[:2] / direction[2])
    return np.concatenate([-gradient[..., :2], -np.ones_like(along)[..., None], by_tilt, -along[..., None]], axis=-1)


def _across(direction: Array) -> tuple[Array, Array]:
    """Return two unit vectors across the beam."""
    first = np.cross(direction, [0.0, 1.0, 0.0])
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)


def _angles(radial: Array, direction: Array) -> Array:
    first, second = _across(direction)
    return np.arctan2(radial @ second, radial @ first)
