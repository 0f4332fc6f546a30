"""Residuals of corners and boundaries: derivatives, and a second route to what they predict."""

from dataclasses import replace

import casadi as ca
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from planeopt.calibration.model import BEAM, FULL, WARP
from planeopt.calibration.packed import Packed
from planeopt.calibration.projection import beam_on_board, linear_boundaries, linear_corners, predict_corners
from planeopt.calibration.state import State, cross_matrices, rotation_matrices
from planeopt.errors import InputError
from planeopt.rig import distort
from planeopt.simulation.board_random import random_session

Array = NDArray[np.float64]

# Of central differences: large enough for rounding, small enough for the third derivative.
STEPS = np.array([*[1e-2] * 4, *[1e-5] * 5, *[1e-4] * 2, *[1e-4] * 3, *[1e-6] * 2, 1e-7])


def true_state(session) -> State:
    rig = session.rig
    beam = rig.require_beam()
    camera = rig.camera
    values = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion, *session.warp]
    values += [*beam.offset, beam.radius, *beam.direction[:2], session.divergence]
    return State(np.array(values), session.poses.rotations, session.poses.translations, camera.image_size)


@pytest.fixture(scope="module")
def case() -> tuple[Packed, State]:
    session = random_session(3, warp=(0.4, -0.3), corner_sigma=0.3, spot_sigma=0.3)
    moved = np.array([3, -5, 2, 1, 0.01, 0.02, 1e-4, -2e-4, 0.03, 0.1, 0.1, 0.1, 0.1, 0.02, 1e-3, 1e-3, 1e-4])
    state = true_state(session)
    return Packed.of(session.observations), replace(state, values=state.values + moved)


def _corner_residuals(packed: Packed, state: State) -> Array:
    return linear_corners(packed.board, packed.corners, state).residual


def _outside(packed: Packed, state: State) -> Array:
    """The distance from the beam in mm: what the derivatives are those of, over a scale that is held."""
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
    return found.linear.residual * found.scale


@pytest.mark.parametrize("column", range(len(FULL)), ids=FULL)
def test_derivatives_by_what_is_shared(case: tuple[Packed, State], column: int):
    packed, state = case
    step = np.where(np.arange(len(FULL)) == column, STEPS[column], 0.0)
    still = np.zeros((len(packed), 3))
    ahead, behind = state.moved(step, still, still), state.moved(-step, still, still)
    corners = linear_corners(packed.board, packed.corners, state).shared[..., column]
    numeric = (_corner_residuals(packed, ahead) - _corner_residuals(packed, behind)) / (2 * STEPS[column])
    # Truncation is of second order in the step: 1e-5 or less of the derivative here; rounding of 1e3 px is 1e-13.
    np.testing.assert_allclose(corners, numeric, atol=1e-6 * np.abs(corners).max() + 1e-12 / STEPS[column])
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
    numeric = (_outside(packed, ahead) - _outside(packed, behind)) / (2 * STEPS[column])
    by_shared = found.linear.shared[..., column] * found.scale
    np.testing.assert_allclose(by_shared, numeric, atol=1e-6 * np.abs(by_shared).max() + 1e-12 / STEPS[column])


@pytest.mark.parametrize("column", range(6))
def test_derivatives_by_poses(case: tuple[Packed, State], column: int):
    packed, state = case
    size = 1e-6 if column < 3 else 1e-3
    step = np.zeros((len(packed), 6))
    step[:, column] = size
    none = np.zeros(len(FULL))
    ahead, behind = state.moved(none, step[:, :3], step[:, 3:]), state.moved(none, -step[:, :3], -step[:, 3:])
    corners = linear_corners(packed.board, packed.corners, state).pose[..., column]
    numeric = (_corner_residuals(packed, ahead) - _corner_residuals(packed, behind)) / (2 * size)
    np.testing.assert_allclose(corners, numeric, atol=1e-6 * np.abs(corners).max() + 1e-12 / size)
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
    numeric = (_outside(packed, ahead) - _outside(packed, behind)) / (2 * size)
    by_pose = found.linear.pose[..., column] * found.scale
    np.testing.assert_allclose(by_pose, numeric, atol=1e-6 * np.abs(by_pose).max() + 1e-12 / size)


def test_corners_are_opencv_s(case: tuple[Packed, State]):
    packed, state = case
    flat = replace(state, values=np.where(np.isin(np.arange(len(FULL)), range(*WARP.indices(99))), 0.0, state.values))
    board = np.column_stack([packed.board.corners, np.zeros(len(packed.board.corners))])
    for row, predicted in enumerate(predict_corners(packed.board, flat)):
        turn, _ = cv2.Rodrigues(flat.rotations[row])
        px, _ = cv2.projectPoints(
            board, turn, flat.translations[row], flat.camera.matrix, np.array(flat.camera.distortion)
        )
        np.testing.assert_allclose(predicted, px[:, 0], atol=1e-9)


def test_boundary_distance_by_casadi(case: tuple[Packed, State]):
    """The distance of a boundary point from the beam, written a second time: forward, from the board to the pixel.

    A point of the bowed board that images at the pixel is found by CasADi's Newton; there the distance from the axis is
    a one-liner.
    """
    packed, state = case
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    pixel, pose = ca.SX.sym("pixel", 2), ca.SX.sym("pose", 3, 4)
    half = np.array(packed.board.size_mm) / 2
    depth = sum(w * (1 - ((s - h) / h) ** 2) for w, s, h in zip(state.warp, (x, y), half, strict=True))
    X = pose[:, :3] @ ca.vertcat(x, y, depth) + pose[:, 3]
    camera = state.camera
    u, v = distort(X[0] / X[2], X[1] / X[2], *camera.distortion)
    miss = ca.vertcat(camera.fx * u + camera.cx, camera.fy * v + camera.cy) - pixel
    problem = {"x": ca.vertcat(x, y), "p": ca.vertcat(pixel, ca.vec(pose)), "g": miss}
    solve = ca.rootfinder("solve", "newton", problem, {"abstol": 1e-11})
    place = ca.Function("place", [ca.vertcat(x, y), pose], [X])
    e_x, e_y, radius, _, _, divergence = state.values[BEAM]
    for row in np.flatnonzero(packed.with_spot)[:3]:
        matrix = np.column_stack([state.rotations[row], state.translations[row]])
        for point in range(0, int(packed.boundary_seen[row].sum()), 17):
            on_board = (found.points[row, point] - state.translations[row]) @ state.rotations[row]
            at = solve(x0=on_board[:2] + 0.1, p=np.concatenate([packed.boundary[row, point], matrix.T.ravel()]))["x"]
            away = np.array(place(at, matrix)).ravel() - [e_x, e_y, 0]
            along = away @ state.direction
            distance = np.sqrt(away @ away - along**2) - radius - divergence * along
            measured = found.linear.residual[row, point] * found.scale[row, point]
            assert measured == pytest.approx(distance, abs=1e-9)


def test_exact_boundaries_have_no_residual():
    session = random_session(5, warp=(0.3, 0.2), corner_sigma=0.0, spot_sigma=0.0)
    packed, state = Packed.of(session.observations), true_state(session)
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
    assert np.abs(found.linear.residual).max() < 1e-8
    assert np.abs(_corner_residuals(packed, state).reshape(len(packed), -1, 2)[packed.corner_seen]).max() < 1e-8


def test_beam_on_board_lies_on_both():
    session = random_session(6, warp=(0.0, 0.0))
    state = true_state(session)
    points = beam_on_board(state, np.linspace(0, 2 * np.pi, 7))
    on_board = (points - state.translations[:, None]) @ state.rotations
    assert np.abs(on_board[..., 2]).max() < 1e-9
    beam = state.beam
    away = points - np.array([*beam.offset, 0.0])
    across = away - (away @ state.direction)[..., None] * state.direction
    np.testing.assert_allclose(np.linalg.norm(across, axis=-1), beam.radius, rtol=1e-12)


def test_what_is_behind_the_camera_is_refused():
    session = random_session(3)
    state = true_state(session)
    packed = Packed.of(session.observations)
    behind = replace(state, translations=-state.translations)
    with pytest.raises(InputError, match="behind"):
        predict_corners(packed.board, behind)
    with pytest.raises(InputError, match="in front"):
        linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, behind)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-4, 1.0, 3.1])
def test_rotations_are_opencv_s(size: float):
    vector = size * np.array([0.48, -0.6, 0.64])
    expected, _ = cv2.Rodrigues(vector)
    np.testing.assert_allclose(rotation_matrices(vector), expected, atol=1e-15)
    np.testing.assert_allclose(cross_matrices(vector) @ [1.0, 2.0, 3.0], np.cross(vector, [1.0, 2.0, 3.0]), atol=1e-15)
