"""Simulated sessions: corners and spots where the truth puts them, noise as stated, poses as a person would take."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.stats

from planeopt.board import Board
from planeopt.errors import InputError
from planeopt.simulation import (
    BoardPoses,
    BoardView,
    Setting,
    Shooting,
    SimulatedSession,
    board_views,
    mirrored_session,
    mixed_session,
    random_session,
    simulated_session,
    spotless_session,
    tilted,
    wrong_scale_session,
)

FAMILY = 0.001
ANGLES = np.linspace(0, 2 * np.pi, 37)


@pytest.fixture(scope="module")
def session() -> SimulatedSession:
    return random_session(4, warp=(0.3, -0.2))


def truth_of(session: SimulatedSession, index: int) -> BoardView:
    return session.views()[index]


def test_corners_are_where_opencv_projects_them(session: SimulatedSession):
    camera = session.rig.camera
    for view in session.views():
        px, seen = view.corners
        bow = session.board.bow(session.board.corners) @ session.warp
        space = np.column_stack([session.board.corners, bow])
        rvec, _ = cv2.Rodrigues(view.rotation)
        expected, _ = cv2.projectPoints(space, rvec, view.translation, camera.matrix, np.array(camera.distortion))
        assert np.max(np.abs(px - expected.reshape(-1, 2))[seen]) < 1e-8
        assert not np.any(seen & ~session.board.printed)


@pytest.mark.parametrize("divergence", [0.0, 2e-3])
def test_the_outline_lies_on_the_beam_and_on_the_bowed_board(session: SimulatedSession, divergence: float):
    beam = session.rig.require_beam()
    axis = np.array(beam.direction)
    for view in session.views():
        view = replace(view, divergence=divergence)
        on_board = view.spot_on_board(ANGLES)
        assert np.max(np.abs(on_board[:, 2] - session.board.bow(on_board[:, :2]) @ session.warp)) < 1e-9
        space = on_board @ view.rotation.T + view.translation - [*beam.offset, 0.0]
        along = space @ axis
        across = np.linalg.norm(space - along[:, None] * axis, axis=1)
        assert across == pytest.approx(beam.radius + divergence * along, abs=1e-9)
        px, normals = view.outline(ANGLES)
        seen, _ = view.pixels(np.array([*beam.offset, 0.0]) + space)
        assert np.max(np.abs(px - seen)) < 1e-9
        # The circle that is wider by one in ten thousand lies outside, along the normal.
        further = view.outline(ANGLES, 1.0001)[0] - px
        assert np.all(np.sum(further * normals, axis=1) > 0)


def test_normals_are_across_the_boundary(session: SimulatedSession):
    view = truth_of(session, 0)
    step = 1e-6
    _, normals = view.outline(ANGLES)
    tangent = (view.outline(ANGLES + step)[0] - view.outline(ANGLES - step)[0]) / (2 * step)
    along = np.sum(tangent * normals, axis=1) / np.linalg.norm(tangent, axis=1)
    # Central differences of a curve of some 100 px: 1e-12 px of rounding over 2e-6.
    assert np.max(np.abs(along)) < 1e-6


def test_noise_is_what_is_stated(session: SimulatedSession):
    corners, across = [], []
    for seed in range(6):
        drawn = session.again(seed)
        for view, truth in zip(drawn.observations.views, session.views(), strict=True):
            corners.append(((view.corners - truth.corners[0][view.ids]) / view.sigma[:, None]).ravel())
            if view.spot is None:
                continue
            assert view.spot.sigma is not None
            table, normals = truth.outline(np.linspace(0, 2 * np.pi, 8_000))
            points = view.spot.points[::20]
            nearest = np.argmin(np.linalg.norm(table[None] - points[:, None], axis=2), axis=1)
            across.append(np.sum((points - table[nearest]) * normals[nearest], axis=1) / view.spot.sigma[::20])
    for standard in (np.concatenate(corners), np.concatenate(across)):
        low, high = scipy.stats.chi2.ppf([FAMILY / 4, 1 - FAMILY / 4], len(standard))
        assert low < np.sum(standard**2) < high


def test_a_view_does_not_depend_on_the_others(session: SimulatedSession):
    few = simulated_session(session.rig, session.board, session.poses.some(slice(3)), seed=9)
    many = simulated_session(session.rig, session.board, session.poses, seed=9)
    for a, b in zip(few.views, many.views, strict=False):
        assert np.array_equal(a.corners, b.corners)
    again = simulated_session(session.rig, session.board, session.poses, seed=10)
    assert not np.array_equal(many.views[0].corners, again.views[0].corners)


def test_random_sessions_are_sensible():
    offsets, tilts = [], []
    for seed in range(40):
        session = random_session(seed)
        observations = session.observations
        assert 8 <= len(observations.views) <= 30
        assert min(len(view) for view in observations.views) >= 20
        with_spot = [view.spot is not None for view in observations.views]
        assert np.mean(with_spot) >= 0.75
        beam = session.rig.require_beam()
        hit = [v.spot_on_board(ANGLES) @ v.rotation.T + v.translation for v in session.views()]
        depths = np.array([points[:, 2].mean() for points, spot in zip(hit, with_spot, strict=True) if spot])
        assert depths.max() / depths.min() > 1.5
        normals = session.poses.rotations[:, :, 2]
        tilts.append(np.degrees(np.arccos(normals[:, 2])).max())
        offsets.append(beam.offset)
        assert np.degrees(np.arccos(beam.direction[2])) <= 1.0
        for view, spot in zip(session.views(), with_spot, strict=True):
            if spot:
                assert view.spot_state() == "seen"
    assert min(tilts) > 38
    assert max(tilts) <= 45
    signs = {(x > 0, y > 0) for x, y in offsets}
    assert len(signs) == 4
    assert (
        random_session(3).observations.views[0].corners.tobytes()
        == random_session(3).observations.views[0].corners.tobytes()
    )


def test_a_spot_off_the_window_is_not_there(session: SimulatedSession):
    poses = BoardPoses(session.poses.rotations[:1], session.poses.translations[:1].copy())
    aside = poses.translations + session.poses.rotations[0][:, 0] * session.board.size_mm[0] / 2
    moved = simulated_session(session.rig, session.board, BoardPoses(poses.rotations, aside))
    assert moved.views[0].spot is None
    plain = replace(session.board, window_mm=None)
    (view,) = board_views(session.rig, plain, poses)
    assert view.spot_state() == "seen"
    assert len(simulated_session(session.rig, plain, poses, spot="none").views[0].corners)
    turned = BoardPoses(poses.rotations @ tilted(np.pi, 0.0, 0.0), poses.translations)
    assert len(simulated_session(session.rig, plain, turned).views[0]) == 0


def test_faults():
    assert sum(view.spot is not None for view in spotless_session(1).observations.views) == 3
    plain, mixed = random_session(1, shooting=Shooting(15), warp=(0, 0)), mixed_session(1)
    for index, (a, b) in enumerate(zip(plain.observations.views, mixed.observations.views, strict=True)):
        same = len(a) == len(b) and np.array_equal(a.corners, b.corners)
        assert same == (index % 2 == 0)
    wrong = wrong_scale_session(1)
    assert wrong.observations.board.corners == pytest.approx(wrong.board.corners * 1.02)
    assert isinstance(wrong.again(2).observations.board, Board)
    mirrored = mirrored_session(1)
    back = mirrored.observations.views[0].corners * [-1, 1] + [mirrored.rig.camera.image_size[0] - 1, 0]
    assert back == pytest.approx(plain.observations.views[0].corners)


def test_a_setting_without_poses_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("planeopt.simulation.board_random._TRIES", 20)
    session = random_session(0)
    small = replace(session.board, square_mm=(1.0, 1.0), marker_mm=0.7, window_mm=(3.0, 2.0, 3.0, 3.0))
    with pytest.raises(InputError, match="no pose at"):
        random_session(0, setting=Setting(session.rig, small, depth=300.0))
