"""The next view: what it is predicted to add is what it adds, none of the others is better, and its words are right."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibrated import FLAT, good, good_session
from planeopt.board import Observations
from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.candidate_views import candidates, depths
from planeopt.calibration.expected import Observer, expected_information
from planeopt.calibration.model import Model
from planeopt.calibration.next_view import in_words, next_view
from planeopt.calibration.pose_cost import pose_cost, working_planes
from planeopt.calibration.state import rotation_matrices
from planeopt.simulation.board_random import Shooting, random_session
from planeopt.simulation.board_sessions import simulated_session
from planeopt.simulation.board_views import BoardPoses


def with_view(seed: int, adjustment: Adjustment, R: np.ndarray, t: np.ndarray) -> Adjustment:
    """Return the adjustment with one more view of the same rig, shot in this pose."""
    session = good_session(*CASE)
    more = simulated_session(
        session.rig, session.board, BoardPoses(R[None], t[None]), corner_sigma=session.corner_sigma,
        spot_sigma=session.spot_sigma, seed=seed,
    )  # fmt: skip
    view = replace(more.views[0], name="next.png")
    together = Observations(
        session.board, session.rig.camera.image_size, (*adjustment.observations.views, view), "disc",
        session.rig.camera.pixel_pitch_mm,
    )  # fmt: skip
    return adjust(together, adjustment.model, noise=adjustment.noise)


CASE = (4, 10)


def test_information_expected_of_the_sessions_own_views_is_what_they_gave():
    adjustment = good(*CASE)
    added = expected_information(adjustment, adjustment.rotations, adjustment.translations).sum(axis=0)
    ratio = np.sqrt(np.diagonal(added) / np.diagonal(adjustment.information))
    # Corners near the image's border, which were seen, are not counted on: it may be a little less.
    assert np.all(ratio < 1.1)
    assert np.all(ratio > 0.75)


def test_the_gain_is_what_the_view_brings_when_it_is_shot():
    adjustment = good(*CASE)
    along = depths(Observer.of(adjustment))
    planes = working_planes(np.quantile(along, [0.0, 0.5, 1.0]))
    found = next_view(adjustment, planes)
    assert found is not None
    after = with_view(8, adjustment, found.R, found.t)

    def square(one: Adjustment) -> np.ndarray:
        costs = pose_cost(one.rig, planes)
        return np.array([[cost.sigma_z_L**2, cost.sigma_normal**2] for cost in costs])

    gain = 1 - math.sqrt(float(np.mean(square(after) / square(adjustment))))
    # To first order in the noise of one view, and less what is not counted on near the border.
    assert gain == pytest.approx(found.gain, abs=0.03)
    assert found.gain > 0.05


def test_no_candidate_is_better_than_the_one_taken():
    adjustment = good(*CASE)
    observer = Observer.of(adjustment)
    state, added = candidates(observer)
    planes = working_planes(np.quantile(depths(observer), [0.0, 1.0]))
    found = next_view(adjustment, planes)
    assert found is not None
    now = np.array([[c.sigma_z_L**2, c.sigma_normal**2] for c in pose_cost(adjustment.rig, planes)])
    names = [adjustment.names.index(name) for name in adjustment.model.freedom]
    for row in np.random.default_rng(2).choice(len(added), 20, replace=False):
        covariance = np.linalg.inv(adjustment.information + added[row])[np.ix_(names, names)]
        assert adjustment.rig.covariance is not None
        rig = replace(adjustment.rig, covariance=replace(adjustment.rig.covariance, matrix=covariance))
        after = np.array([[c.sigma_z_L**2, c.sigma_normal**2] for c in pose_cost(rig, planes)])
        assert 1 - math.sqrt(float(np.mean(after / now))) <= found.gain + 1e-9
    assert len(state.rotations) == len(added) > 100


def test_candidates_show_the_board_and_the_spot_in_its_window():
    adjustment = good(*CASE)
    session = good_session(*CASE)
    state, _ = candidates(Observer.of(adjustment))
    some = np.random.default_rng(1).choice(len(state.rotations), 60, replace=False)
    poses = BoardPoses(state.rotations[some], state.translations[some])
    seen = simulated_session(session.rig, session.board, poses, corner_sigma=0.0, spot_sigma=0.0)
    # The true rig is the adjusted one to a few hundredths of a pixel.
    assert all(view.spot is not None for view in seen.views)
    assert min(len(view) for view in seen.views) >= 0.6 * np.count_nonzero(session.board.printed)


def test_a_session_at_one_depth_is_told_another_and_a_flat_one_a_tilt():
    near = random_session(4, shooting=Shooting(12, depth_ratio=1.02), warp=FLAT)
    adjustment = adjust(near.observations, Model())
    middle = float(np.median(depths(Observer.of(adjustment))))
    wide = working_planes([0.8 * middle, middle, 1.25 * middle])
    found = next_view(adjustment, wide)
    assert found is not None
    here = replace(adjustment.state, rotations=found.R[None], translations=found.t[None])
    distance = depths(replace(Observer.of(adjustment), state=here))[0]
    assert abs(math.log(distance / middle)) > math.log(1.2)

    flat = random_session(4, shooting=Shooting(12, tilt_deg=(0.0, 12.0)), warp=FLAT)
    found = next_view(adjust(flat.observations, Model()))
    assert found is not None
    assert math.degrees(math.acos(found.R[2, 2])) >= 30


def test_a_camera_alone_is_told_a_view_too():
    session = good_session(*CASE)
    views = tuple(replace(view, spot=None) for view in session.observations.views)
    adjustment = adjust(replace(session.observations, views=views, spot="none"), Model(beam="none"))
    found = next_view(adjustment)
    assert found is not None
    assert 0 < found.gain < 0.5
    assert found.sentence.startswith("Next, shoot a view with the board at about ")


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        # A turn about an axis by the right-hand rule, y down: about +y, the right side comes nearer.
        ((0.0, 40.0, 0.0), "its left side tilted away by 40 degrees"),
        ((0.0, -30.0, 0.0), "its right side tilted away by 30 degrees"),
        ((40.0, 0.0, 0.0), "its lower edge tilted away by 40 degrees"),
        ((-40.0, 0.0, 0.0), "its upper edge tilted away by 40 degrees"),
        ((-21.2, 21.2, 0.0), "its upper left corner tilted away by 30 degrees"),
        ((0.0, 0.0, 0.0), "facing the camera"),
        ((0.0, 0.0, 90.0), "turned in its plane by a quarter"),
    ],
)
def test_words_say_where_the_board_is(axis: tuple[float, float, float], words: str):
    observer = Observer.of(good(*CASE))
    board = observer.board
    R = rotation_matrices(np.radians(np.array(axis)))
    t = np.array([0.0, 0.0, 1.2 * good(*CASE).translations[:, 2].mean()]) - R[:, :2] @ (np.array(board.size_mm) / 2)
    sentence = in_words(observer, R, t)
    assert words in sentence
    # What is said to be farther is.
    corners = board.corners @ R[:, :2].T + t
    if "left side" in words or "right side" in words:
        slope = np.polyfit(corners[:, 0], corners[:, 2], 1)[0]
        assert (slope < 0) == ("left" in words)
    if "edge" in words:
        slope = np.polyfit(corners[:, 1], corners[:, 2], 1)[0]
        assert (slope < 0) == ("upper" in words)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (0.0, 0.0, "in the middle of the image"),
        (0.25, 0.0, "in the right part of the image"),
        (-0.25, -0.25, "in the upper left of the image"),
        (0.0, 0.25, "in the lower part of the image"),
    ],
)
def test_words_say_in_which_part_of_the_image(x: float, y: float, words: str):
    observer = Observer.of(good(*CASE))
    camera = good(*CASE).camera
    width, height = camera.image_size
    px = np.array([(0.5 + x) * width, (0.5 + y) * height])
    ray = np.append(np.asarray(camera.normalise(px[None])[0])[0], 1.0)
    far = 4 * max(observer.board.size_mm) * camera.fx / width
    t = far * ray - np.array([*observer.board.size_mm, 0.0]) / 2
    assert words in in_words(observer, np.eye(3), t)
