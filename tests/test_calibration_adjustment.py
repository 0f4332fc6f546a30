"""The joint adjustment: against OpenCV, against itself written otherwise, and against outliers."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from opencv_camera import opencv_camera
from planeopt.board import Observations, View
from planeopt.calibration import Calibration, Options, calibrate
from planeopt.calibration.adjustment import Adjustment, adjust, refit
from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.expected import expected_information
from planeopt.calibration.ladder import camera_prior, climb, compare_terms, parallelism
from planeopt.calibration.model import Model
from planeopt.calibration.noise import MOST_CORNERS, REJECT, Noise
from planeopt.errors import InputError
from planeopt.rig import Rig
from planeopt.simulation.board_random import Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession, simulated_session
from planeopt.spot import Spot

FIVE = 5.0
"""Standard deviations: 6e-7 for each number that is compared."""


@pytest.fixture(scope="module")
def session() -> SimulatedSession:
    return random_session(2, shooting=Shooting(12))


@pytest.fixture(scope="module")
def fitted(session: SimulatedSession) -> Adjustment:
    return adjust(session.observations, Model(distortion="k3"))


@pytest.fixture(scope="module")
def calibrated(session: SimulatedSession) -> Calibration:
    return calibrate(session.observations)


def truth(session: SimulatedSession, name: str) -> float:
    if name in ("warp_x", "warp_y"):
        return session.warp[name == "warp_y"]
    return session.divergence if name == "divergence" else session.rig.parameter(name)


def test_every_parameter_is_found(session: SimulatedSession, fitted: Adjustment):
    assert fitted.converged
    for name in fitted.names:
        assert abs(fitted.value(name) - truth(session, name)) < FIVE * fitted.sigma(name), name
    error = fitted.values - [truth(session, name) for name in fitted.names]
    assert chi2.sf(error @ np.linalg.solve(fitted.covariance, error), len(error)) > 1e-4


def test_poses_are_found_with_their_covariance(session: SimulatedSession, fitted: Adjustment):
    for row, covariance in enumerate(fitted.pose_covariances):
        turn, _ = cv2.Rodrigues(fitted.rotations[row] @ session.poses.rotations[row].T)
        error = np.concatenate([turn[:, 0], fitted.translations[row] - session.poses.translations[row]])
        assert chi2.sf(error @ np.linalg.solve(covariance, error), 6) > 1e-5


def test_the_noise_is_found(session: SimulatedSession, fitted: Adjustment):
    # The stated sigmas are true, so the factor is 1 but for its own error 1/sqrt(2 dof).
    assert fitted.noise.corners == pytest.approx(1, abs=FIVE / np.sqrt(2 * fitted.dof_corners))
    assert fitted.corner_sigma == pytest.approx(session.corner_sigma, rel=FIVE / np.sqrt(2 * fitted.dof_corners))
    unknown = 6 * len(session.observations.views) + len(fitted.names)
    seen = 2 * sum(map(len, session.observations.views)) + 5 * np.count_nonzero(fitted.spot_used)
    assert fitted.dof_corners + fitted.dof_spots == pytest.approx(seen - unknown, abs=0.5)


def test_stated_sigmas_matter_by_their_ratios_only(session: SimulatedSession, fitted: Adjustment):
    views = tuple(replace(view, sigma=7 * view.sigma) for view in session.observations.views)
    other = adjust(replace(session.observations, views=views), Model(distortion="k3"))
    np.testing.assert_allclose(other.values, fitted.values, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(other.covariance, fitted.covariance, rtol=1e-4)
    assert other.noise.corners == pytest.approx(fitted.noise.corners / 7, rel=1e-4)


def test_camera_alone_is_opencv_s():
    """The same model and corners, equal weights: the two minima are one, to a hundredth of a standard deviation."""
    session = random_session(4, shooting=Shooting(10), warp=(0.0, 0.0), spot="none")
    ours = adjust(session.observations, Model("separate", "k3", warp=False, beam="none"), reject=False)
    theirs, deviations = opencv_camera(session.observations)
    sigmas = [ours.sigma(name) for name in ours.names]
    np.testing.assert_array_less(np.abs(ours.values - theirs) / sigmas, 0.01)
    # OpenCV's own deviations are by the same formula.
    np.testing.assert_allclose(deviations, sigmas, rtol=0.01)


def _spoilt(session: SimulatedSession, share: float, seed: int = 0) -> tuple[Observations, list[np.ndarray]]:
    """Move a share of the corners by 20 standard deviations and more."""
    rng = np.random.default_rng(seed)
    views, wrong = [], []
    for view in session.observations.views:
        bad = rng.uniform(size=len(view)) < share
        jump = rng.uniform(20, 60, (len(view), 1)) * view.sigma[:, None] * rng.choice([-1, 1], (len(view), 2))
        views.append(replace(view, corners=np.where(bad[:, None], view.corners + jump, view.corners)))
        wrong.append(bad)
    return replace(session.observations, views=tuple(views)), wrong


def test_wrong_corners_are_left_out_and_nothing_else(session: SimulatedSession, fitted: Adjustment):
    observations, wrong = _spoilt(session, 0.02)
    found = adjust(observations, Model(distortion="k3"))
    assert found.before is not None
    left_out = np.concatenate([~used for used in found.corner_used])
    np.testing.assert_array_equal(left_out[np.concatenate(wrong)], True)
    # Of right ones, one in 16,000.
    assert np.count_nonzero(left_out & ~np.concatenate(wrong)) <= 1
    assert np.all(np.abs(found.values - fitted.values) < np.sqrt(np.diag(fitted.covariance)))
    assert found.before.chi2_corners > 3 * found.chi2_corners
    assert all(used.all() for used in found.before.corner_used)


def test_no_more_than_a_share_is_left_out(session: SimulatedSession):
    observations, _ = _spoilt(session, 0.15)
    found = adjust(observations, Model(distortion="k3"))
    count = sum(map(len, observations.views))
    left_out = sum(int(np.count_nonzero(~used)) for used in found.corner_used)
    assert int(MOST_CORNERS * count) - 3 <= left_out <= int(MOST_CORNERS * count)


def test_a_wrong_spot_is_left_out(session: SimulatedSession, fitted: Adjustment):
    views = list(session.observations.views)
    row = next(row for row, view in enumerate(views) if view.spot is not None)
    spot = views[row].spot
    assert spot is not None
    assert spot.sigma is not None
    moved = Spot(points=spot.points + np.array([10 * spot.sigma[0], 0.0]), sigma=spot.sigma)
    views[row] = replace(views[row], spot=moved)
    found = adjust(replace(session.observations, views=tuple(views)), Model(distortion="k3"))
    assert np.flatnonzero(~found.spot_used & fitted.spot_used).tolist() == [row]
    assert found.spot_chi2[row] > chi2.isf(2e-5, 5) > REJECT**2
    assert abs(found.value("e_x") - fitted.value("e_x")) < fitted.sigma("e_x")


def test_a_boundary_off_by_more_than_its_noise_widens_the_beam(session: SimulatedSession):
    """Ellipses that miss by twice their sigma: the stated one is too small, and what comes of it is scaled."""
    rng = np.random.default_rng(5)
    views = []
    for view in session.observations.views:
        spot = view.spot
        if spot is not None and spot.sigma is not None:
            shift = 2 * spot.sigma[0] / np.sqrt(len(spot)) * rng.standard_normal(2)
            spot = Spot(points=spot.points + shift, sigma=spot.sigma)
        views.append(replace(view, spot=spot))
    found = adjust(replace(session.observations, views=tuple(views)), Model(distortion="k3"))
    assert found.noise.spots > 1.2
    assert found.chi2_spots / found.noise.spots**2 == pytest.approx(found.dof_spots, rel=0.01)


def test_held_camera_gives_poses_only(session: SimulatedSession, fitted: Adjustment):
    held = adjust(session.observations, Model(camera=False, warp=False, beam="none"), held=fitted.rig)
    assert held.names == ()
    assert held.rig.camera == fitted.rig.camera
    assert held.rig.covariance is None
    error = np.linalg.norm(held.translations - session.poses.translations, axis=1)
    assert np.all(error < 1e-2 * session.poses.translations[:, 2])
    # The beam is not fitted, so all five numbers of each spot test it.
    assert np.nansum(held.spot_chi2) > 0


def test_prior_is_one_more_session():
    """Half the views with the other half as prior: what all of them together give."""
    model = Model(distortion="k3", warp=False)
    plain = random_session(9, shooting=Shooting(24), warp=(0.0, 0.0), corner_sigma=0.02, spot_sigma=0.02)
    views, noise = plain.observations.views, Noise()
    halves = [replace(plain.observations, views=views[:12]), replace(plain.observations, views=views[12:])]
    first = adjust(halves[0], model, noise=noise, reject=False)
    both = adjust(halves[1], model, prior=first.rig, noise=noise, reject=False)
    whole = adjust(plain.observations, model, noise=noise, reject=False)
    # The prior is the first half linearised where that half put it: the curvature within its own sigmas is left.
    np.testing.assert_array_less(np.abs(both.values - whole.values), 0.1 * np.sqrt(np.diag(whole.covariance)))
    np.testing.assert_allclose(np.diag(both.covariance), np.diag(whole.covariance), rtol=0.05)


def test_refit_keeps_weights_and_tests_nested_models(fitted: Adjustment):
    smaller = refit(fitted, replace(fitted.model, warp=False))
    assert smaller.noise == fitted.noise
    assert smaller.value("warp_x") == 0
    assert smaller.cost > fitted.cost
    same = refit(fitted, fitted.model)
    np.testing.assert_allclose(same.values, fitted.values, rtol=1e-9)


def test_what_is_there_is_seen_and_what_is_not_is_not():
    base = random_session(11, shooting=Shooting(14), warp=(0.3, 0.0))
    observations = simulated_session(
        base.rig, base.board, base.poses, corner_sigma=0.05, spot_sigma=0.05, warp=base.warp, divergence=1e-3, seed=1
    )
    found = adjust(observations, Model(distortion="k3"))
    tests = compare_terms(found)
    assert tests["warp"].p_value < 1e-6
    assert tests["divergence"].p_value < 1e-6
    value, sigma = tests["divergence"].larger["divergence"]
    assert abs(value - 1e-3) < FIVE * sigma
    assert tests["aspect"].p_value > 1e-4
    angle, sigma = parallelism(found)
    x, y, _ = base.rig.require_beam().direction
    assert abs(angle - np.arcsin(np.hypot(x, y))) < FIVE * sigma
    assert tests["parallel"].used


def test_a_parallel_beam_is_not_called_tilted():
    base = random_session(12, shooting=Shooting(10))
    beam = replace(base.rig.require_beam(), direction=(0.0, 0.0, 1.0))
    rig = replace(base.rig, beam=beam)
    observations = simulated_session(rig, base.board, base.poses, corner_sigma=0.05, spot_sigma=0.05, seed=3)
    found = adjust(observations, Model(distortion="k3"))
    assert compare_terms(found)["parallel"].p_value > 1e-4
    parallel = adjust(observations, Model(distortion="k3", beam="parallel"))
    assert parallel.rig.beam is not None
    assert parallel.rig.beam.direction == (0.0, 0.0, 1.0)
    assert abs(parallel.value("e_x") - rig.parameter("e_x")) < FIVE * parallel.sigma("e_x")


def test_the_ladder_reports_each_rung_and_leaves_nothing_out(session: SimulatedSession):
    found, tests = climb(session.observations, Model(), None)
    assert [test.name for test in tests] == ["k1", "k2", "tangential", "k3"]
    assert found.model.distortion == "k3"
    assert all(test.used for test in tests)
    asked, tests = climb(session.observations, Model(), "k1")
    assert asked.model.distortion == "k1"
    assert [test.used for test in tests] == [True, False, False, False]
    assert asked.prior is None


def test_the_prior_of_all_cameras_does_not_count_in_a_good_session(session: SimulatedSession, fitted: Adjustment):
    found, _ = climb(session.observations, Model(), None)
    prior = camera_prior(found.camera)
    for name in ("f", "cx", "cy", "k1"):
        row = prior.names.index(name)
        assert found.sigma(name) < 0.02 * prior.information[row, row] ** -0.5
        assert abs(found.value(name) - fitted.value(name)) < 0.02 * fitted.sigma(name)


def test_expected_information_is_what_the_views_gave(fitted: Adjustment):
    expected = expected_information(fitted, fitted.rotations, fitted.translations)
    sigmas = np.sqrt(np.diag(np.linalg.inv(expected.sum(axis=0))))
    # Counted at a margin from the border, and spots by the median number of points a pixel of boundary.
    np.testing.assert_allclose(sigmas, np.sqrt(np.diag(fitted.covariance)), rtol=0.3)


def test_same_observations_same_bytes(session: SimulatedSession, fitted: Adjustment):
    again = adjust(session.observations, Model(distortion="k3"))
    assert again.values.tobytes() == fitted.values.tobytes()
    assert again.covariance.tobytes() == fitted.covariance.tobytes()


def test_what_cannot_be_adjusted_is_refused(session: SimulatedSession):
    observations = session.observations
    with pytest.raises(InputError, match="no view"):
        adjust(replace(observations, views=()))
    few = replace(observations.views[0], ids=[0, 1], corners=observations.views[0].corners[:2], sigma=[0.1, 0.1])
    with pytest.raises(InputError, match="2 corners"):
        adjust(replace(observations, views=(few,)))
    with pytest.raises(AdjustmentError, match="cannot determine"):
        adjust(replace(observations, views=(_thinned(observations.views[0], 7),)), Model(beam="none"))
    spotless = tuple(replace(view, spot=None) for view in observations.views)
    with pytest.raises(AdjustmentError, match="No view has a spot"):
        adjust(replace(observations, views=spotless))
    with pytest.raises(InputError, match="no \\[covariance\\]"):
        adjust(observations, prior=session.rig)
    with pytest.raises(InputError, match="distortion must be one of"):
        Model(distortion="k4")  # pyright: ignore[reportArgumentType] - what a user may write


def _thinned(view: View, count: int) -> View:
    chosen = np.linspace(0, len(view) - 1, count).round().astype(int)
    return View(view.name, view.ids[chosen], view.corners[chosen], view.sigma[chosen])


def test_the_rig_has_the_joint_covariance_of_what_was_free(fitted: Adjustment):
    rig: Rig = fitted.rig
    assert rig.covariance is not None
    assert rig.covariance.parameters == tuple(name for name in fitted.names if not name.startswith("warp"))
    assert rig.spot is not None
    assert rig.spot.kind == "disc"
    for name, sigma in zip(rig.covariance.parameters, rig.covariance.sigmas, strict=True):
        assert sigma == pytest.approx(fitted.sigma(name))
        assert rig.parameter(name) == pytest.approx(fitted.value(name))


def test_the_principal_point_turns_the_beam_and_leaves_its_offset(fitted: Adjustment):
    """An error of the principal point turns the camera's frame about its centre, and with it the beam's direction."""
    rig = fitted.rig
    assert rig.covariance is not None
    names = rig.covariance.parameters
    row, column = names.index("cx"), names.index("direction_x")
    assert rig.covariance.correlation[row, column] < -0.9


def test_copies_of_a_view_are_left_out(session: SimulatedSession, calibrated: Calibration):
    views = session.observations.views
    copies = (*views, replace(views[0], name="copy.png"), replace(views[3], name="another.png"))
    found = calibrate(replace(session.observations, views=copies))
    assert len(found.observations.views) == len(views)
    assert found.rig == calibrated.rig


def test_views_that_determine_no_pose_are_left_out(session: SimulatedSession):
    view = session.observations.views[0]
    columns = session.board.squares[0] - 1
    ids = np.arange(columns)
    places = np.stack([100.0 + 40 * ids, 200.0 + ids], axis=1).astype(np.float64)
    row = View("row.png", ids, places, np.full(columns, 0.1))
    few = _thinned(replace(view, name="few.png", spot=None), 5)
    found = calibrate(replace(session.observations, views=(*session.observations.views, row, few)))
    assert {view.name for view in found.observations.views} == {view.name for view in session.observations.views}


def test_expectations_are_checked_at_once():
    for expect, message in (
        ({"radius_mm": (np.nan, 0.1)}, "radius_mm must be a number"),
        ({"radius_mm": (6.0, 0.0)}, "positive tolerance"),
        ({"colour": (6.0, 0.1)}, "'colour' is not one of"),
    ):
        with pytest.raises(InputError, match=message):
            Options(expect=expect)


def test_an_f_test_rejects_as_often_as_it_says():
    """A flat board's bow, tested over and over: two terms, so half of the p-values are above a half."""
    base = random_session(21, shooting=Shooting(8), warp=(0.0, 0.0), corner_sigma=0.1, spot_sigma=0.1)
    first = adjust(base.observations, Model(distortion="k1"))
    p_values = []
    for seed in range(24):
        found = adjust(base.again(seed).observations, Model(distortion="k1"), start=first.state)
        p_values.append(compare_terms(found, only=("warp",))["warp"].p_value)
    # Of 24 halves, 4 to 20 with a chance of 0.9999; a p-value of half as many terms has a mean of 0.3 or less.
    assert 4 <= np.count_nonzero(np.array(p_values) > 0.5) <= 20
    assert 0.5 - 4 * np.sqrt(1 / 12 / 24) < np.mean(p_values) < 0.5 + 4 * np.sqrt(1 / 12 / 24)


def test_the_sigma_of_the_beam_s_angle_is_its_direction_s(fitted: Adjustment):
    angle, sigma = parallelism(fitted)
    names = ("direction_x", "direction_y")
    rng = np.random.default_rng(0)
    rows = [fitted.names.index(name) for name in names]
    block = fitted.covariance[np.ix_(rows, rows)]
    draws = rng.multivariate_normal([fitted.value(name) for name in names], block, 4000)
    angles = np.arcsin(np.hypot(*draws.T))
    assert angle == pytest.approx(np.arcsin(np.hypot(fitted.value(names[0]), fitted.value(names[1]))))
    # 1/sqrt(2 N) is 1.1 %.
    assert sigma == pytest.approx(angles.std(), rel=0.06)


def test_square_pixels_have_one_focal_length_and_others_two(session: SimulatedSession, calibrated: Calibration):
    assert calibrated.rig.camera.fx == calibrated.rig.camera.fy
    camera = session.rig.camera
    rig = replace(session.rig, camera=replace(camera, fy=1.003 * camera.fx))
    oblong = replace(session, rig=rig).again(1)
    found = calibrate(oblong.observations).rig.camera
    assert found.fy / found.fx == pytest.approx(1.003, abs=5e-4)


def test_costs_are_told_at_the_session_s_distances(session: SimulatedSession, calibrated: Calibration):
    distances = sorted({cost.z_L for cost in calibrated.cost})
    beam = session.rig.require_beam()
    normals, places = session.poses.rotations[:, :, 2], session.poses.translations
    along = np.sum(normals * (places - [*beam.offset, 0.0]), axis=1) / (normals @ np.array(beam.direction))
    lit = [view.spot is not None for view in session.observations.views]
    assert distances == pytest.approx(np.quantile(along[lit], [0, 0.5, 1]), rel=1e-2)
