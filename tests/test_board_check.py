"""New views of a board against a rig with its covariance: false alarms, what is found, what is not tested."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from planeopt.board import Observations
from planeopt.calibration.adjustment import adjust
from planeopt.calibration.board_check import check_board
from planeopt.calibration.board_verdict import TEST_LEVEL, UNTESTED, BoardCheck, BoardPart, BoardState
from planeopt.calibration.rig_evidence import Extra, RigEvidence, found_from, noncentrality
from planeopt.errors import InputError
from planeopt.rig import Rig, RigCovariance
from planeopt.simulation.board_random import Setting, Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession, simulated_session

FAMILY = 0.001
BOW = 0.1


@pytest.fixture(scope="module")
def session() -> SimulatedSession:
    return random_session(2)


@pytest.fixture(scope="module")
def calibrated(session: SimulatedSession) -> Rig:
    """The true rig, with the covariance that a calibration from the session gives it."""
    return replace(session.rig, covariance=adjust(session.observations).rig.covariance)


@pytest.fixture(scope="module")
def later(session: SimulatedSession) -> dict[int, SimulatedSession]:
    """Other views of the same board, as many as asked for."""
    depth = float(np.median(session.poses.translations[:, 2]))
    setting = Setting(session.rig, session.board, depth=depth)
    ratios = {1: 1.0, 2: 1.6, 3: 1.6, 6: 1.8}
    return {
        count: random_session(50 + count, setting=setting, shooting=Shooting(count, depth_ratio=ratio))
        for count, ratio in ratios.items()
    }


def drawn(rig: Rig, rng: np.random.Generator) -> Rig:
    """What a calibration might have left in the file: the true rig and an error drawn from its covariance."""
    assert rig.covariance is not None
    names = rig.covariance.parameters
    values = [rig.parameter(name) for name in names]
    values = values + np.linalg.cholesky(rig.covariance.matrix) @ rng.normal(size=len(names))
    return rig.with_parameters(dict(zip(names, values.tolist(), strict=True)))


def seen(true: Rig, later: SimulatedSession, seed: int, bow: tuple[float, float] = (0.05, -0.05)) -> Observations:
    return simulated_session(
        true, later.board, later.poses, corner_sigma=0.1, spot_sigma=0.1, warp=bow, spot_points=80, seed=seed
    )


def moved(rig: Rig, **changes: float) -> Rig:
    return rig.with_parameters({name: rig.parameter(name) + change for name, change in changes.items()})


@pytest.mark.parametrize("views", [1, 3])
def test_a_rig_as_calibrated_is_called_degraded_no_more_often_than_stated(
    calibrated: Rig, later: dict[int, SimulatedSession], views: int
) -> None:
    """20 rigs as a calibration leaves them, boards bowed as allowed for: every part's law, from points to verdict.

    Sums of the parts' chi-squared, at a family-wise 0.001 over eight of them, two-sided. Over a noise that is itself
    estimated from some 40 numbers or more the upper bound is that of F, which the p-values are of: they are uniform.
    """
    rng = np.random.default_rng(views)
    results: list[BoardCheck] = []
    for number in range(20):
        bow = tuple((BOW * rng.normal(size=2)).tolist())
        observations = seen(calibrated, later[views], 100 * views + number, bow)
        results.append(check_board(observations, drawn(calibrated, rng), bow_mm=BOW))
    assert all(result.tests for result in results)
    parts = {test.part for test in results[0].tests}
    assert parts == ({BoardPart.SHIFT, BoardPart.REST} if views == 1 else set(BoardPart))
    for part in parts:
        p_values = [test.p_value for result in results for test in result.tests if test.part is part]
        assert scipy.stats.kstest(p_values, "uniform").pvalue > FAMILY / 8, part
        assert min(p_values) > FAMILY / len(p_values) / 8, part
    assert sum(not result.ok for result in results) <= 1
    for name in ("p_value", "spot_p_value"):
        each = [getattr(view, name) for result in results for view in result.views[:1]]
        assert scipy.stats.kstest(each, "uniform").pvalue > FAMILY / 8, name


MOVES = (
    ("the focal length", {"f": 12.0}, 2),
    ("the lens's distortion", {"k1": 0.03}, 2),
    ("the beam's offset", {"e_x": 0.08, "e_y": -0.06}, 3),
    ("the beam's radius", {"radius": 0.06}, 2),
    ("the beam's direction", {"direction_x": 6e-4, "direction_y": -4e-4}, 6),
    ("the principal point", {"cx": 3.0, "cy": 2.0}, 6),
)


@pytest.mark.parametrize(("group", "changes", "views"), MOVES, ids=[group for group, _, _ in MOVES])
def test_what_moved_is_named_and_measured(
    calibrated: Rig, later: dict[int, SimulatedSession], group: str, changes: dict[str, float], views: int
) -> None:
    """One group of parameters, by amounts worth noticing: found, named, and right within 4.5 standard deviations."""
    true = moved(calibrated, **changes)
    file = drawn(calibrated, np.random.default_rng(7))
    result = check_board(seen(true, later[views], 8), file)
    assert result.state is BoardState.DEGRADED
    assert result.verdict.startswith("DEGRADED: ")
    assert {test.part for test in result.tests if not test.ok} <= {BoardPart.SHIFT, BoardPart.POOLED}
    assert group in (result.causes[0].group, *result.instead)
    assert result.causes[0].group in result.verdict
    alone = next(moved for moved in result.groups if moved.group == group)
    for name, _, value, sigma in alone.changes:
        assert abs(value - changes.get(name, 0.0)) < 4.5 * sigma, name


def test_the_change_that_is_said_to_be_found_is_found(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    """With a probability of 0.9 stated, fewer than 7 of 12 have one of 2e-4."""
    quiet = check_board(seen(calibrated, later[3], 9), calibrated)
    radius = next(change for change in quiet.changes if change.name == "radius")
    assert 0 < radius.found_from < 0.1
    true = moved(calibrated, radius=radius.found_from)
    rng = np.random.default_rng(10)
    found = [not check_board(seen(true, later[3], 20 + number), drawn(calibrated, rng)).ok for number in range(12)]
    assert sum(found) >= 7


def test_what_the_calibration_held_fixed_is_tested(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    """A second focal length, where the calibration had one: no change of what was free explains it, and it is named."""
    true = replace(calibrated, covariance=None).with_parameters({"fy": calibrated.camera.fy * 1.005})
    result = check_board(seen(true, later[6], 17), calibrated)
    assert not next(test for test in result.tests if test.part is BoardPart.REST).ok
    assert "Held fixed were fy" in result.verdict
    covariance = calibrated.covariance
    assert covariance is not None
    row = covariance.parameters.index("f")
    names = ("fx", "fy", *(name for name in covariance.parameters if name != "f"))
    rows = [row, row, *(at for at in range(len(covariance.parameters)) if at != row)]
    matrix = covariance.matrix[np.ix_(rows, rows)] + np.diag([0.1, 0.1, *np.zeros(len(rows) - 2)])
    separate = replace(calibrated, covariance=RigCovariance(names, matrix))
    assert check_board(seen(calibrated, later[3], 18), separate).ok


def test_a_spot_that_is_none_is_left_out_and_said(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    observations = seen(calibrated, later[6], 19)
    spot = observations.views[2].spot
    assert spot is not None
    wrong = replace(spot, points=spot.points + np.array([30.0, 0.0]))
    views = [*observations.views]
    views[2] = replace(views[2], spot=wrong)
    result = check_board(replace(observations, views=tuple(views)), calibrated)
    assert result.ok
    assert f"the spot of {views[2].name}" in result.verdict
    assert result.views[2].spot_chi2 is None


def test_views_without_a_spot_test_the_camera_and_say_so(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    observations = seen(calibrated, later[3], 11)
    bare = replace(observations, views=tuple(replace(view, spot=None) for view in observations.views), spot="none")
    result = check_board(bare, calibrated)
    assert result.ok
    assert "Not tested, since no view has a spot: the beam." in result.untested
    assert {change.name for change in result.changes} & {"e_x", "radius"} == set()
    assert all(view.spot_chi2 is None for view in result.views)
    camera = replace(calibrated, beam=None, covariance=None)
    assert check_board(bare, camera).ok


def test_one_view_says_what_it_cannot_test(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    """A frontal view without a spot: a focal length is a distance there. (The beam, being there, would tell it.)"""
    one = later[1]
    frontal = replace(one.poses, rotations=np.eye(3)[None])
    observations = simulated_session(calibrated, one.board, frontal, corner_sigma=0.1, spot="none", seed=12)
    result = check_board(observations, calibrated)
    assert result.ok
    assert "the focal length" in result.untested
    assert UNTESTED in result.untested


def test_the_update_is_sharper_and_nearer(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    rng = np.random.default_rng(13)
    distances, count = [], 0
    for number in range(10):
        result = check_board(seen(calibrated, later[6], 40 + number), drawn(calibrated, rng))
        assert result.updated is not None
        assert result.updated.covariance is not None
        names, matrix = result.updated.covariance.parameters, result.updated.covariance.matrix
        off = np.array([result.updated.parameter(name) - calibrated.parameter(name) for name in names])
        distances.append(off @ np.linalg.solve(matrix, off))
        count += len(names)
        assert all(change.sigma_after <= change.sigma_before for change in result.changes)
    low, high = scipy.stats.chi2.ppf([FAMILY / 2, 1 - FAMILY / 2], count)
    # The corners' noise that the covariance rests on is known to 5 %.
    assert low * 0.9 < sum(distances) < high * 1.1


def test_a_rig_without_a_covariance_claims_to_be_exact(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    exact = replace(calibrated, covariance=None)
    observations = seen(calibrated, later[3], 14)
    assert check_board(observations, exact).ok
    result = check_board(seen(moved(calibrated, f=6.0), later[3], 14), exact)
    assert not result.ok
    assert result.updated is None
    assert "no covariance" in result.verdict


def test_what_cannot_be_tested_is_untested(calibrated: Rig, later: dict[int, SimulatedSession]) -> None:
    observations = seen(calibrated, later[3], 15)
    nothing = check_board(replace(observations, views=()), calibrated)
    assert nothing.state is BoardState.UNTESTED
    assert nothing.tests == ()
    mirrored = tuple(
        replace(view, corners=view.corners * [-1, 1] + [observations.image_size[0] - 1, 0], spot=None)
        for view in observations.views
    )
    assert not check_board(replace(observations, views=mirrored), calibrated).ok
    with pytest.raises(InputError, match="px, but the rig's camera has"):
        check_board(replace(observations, image_size=(640, 480)), calibrated)
    for bow in (0.0, np.nan):
        with pytest.raises(InputError, match="bowed"):
            check_board(observations, calibrated, bow_mm=bow)


def test_evidence_is_the_textbook_s() -> None:
    """Against the formulas with inverses, where all of them exist."""
    rng = np.random.default_rng(16)
    square = rng.normal(size=(6, 4))
    information, sigma = square.T @ square, np.diag(rng.uniform(0.5, 2, 4))
    pull = rng.normal(size=4)
    evidence = RigEvidence(information, pull, sigma, np.full(4, 1e6))
    best = np.linalg.solve(information, pull)
    spread = np.linalg.inv(information) + sigma
    assert evidence.test() == (pytest.approx(best @ np.linalg.solve(spread, best)), 4)
    after = np.linalg.inv(information + np.linalg.inv(sigma))
    np.testing.assert_allclose(evidence.updated, after, atol=1e-12)
    np.testing.assert_allclose(evidence.update, after @ pull, atol=1e-12)
    np.testing.assert_allclose(evidence.expected, sigma - after, atol=1e-12)
    np.testing.assert_allclose(evidence.metric, np.linalg.inv(spread), atol=1e-12)
    everything = evidence.explained_by([0, 1, 2, 3])
    assert everything.chi2 == pytest.approx(evidence.test()[0])
    np.testing.assert_allclose(everything.change, best, atol=1e-9)
    level = found_from(evidence, TEST_LEVEL, 0.9)
    assert level[0] == pytest.approx(np.sqrt(noncentrality(4, TEST_LEVEL, 0.9) / evidence.metric[0, 0]))
    limit = scipy.stats.chi2.isf(TEST_LEVEL, 4)
    assert scipy.stats.ncx2.sf(limit, 4, noncentrality(4, TEST_LEVEL, 0.9)) == pytest.approx(0.9, abs=1e-6)
    both = rng.normal(size=(8, 5))
    full = both.T @ both
    more = RigEvidence(full[:4, :4], pull, sigma, np.full(4, 1e6))
    chi2, dof = more.beyond(Extra(full[4:, 4:], full[4:, :4], np.array([0.7])))
    posterior = np.linalg.inv(full[:4, :4] + np.linalg.inv(sigma))
    left = 0.7 - full[4, :4] @ posterior @ pull
    assert dof == 1
    assert chi2 == pytest.approx(left**2 / (full[4, 4] - full[4, :4] @ posterior @ full[:4, 4]))
