import json
import math
from pathlib import Path

import numpy as np
import pytest

from example_rig import SIGMA_PX, TARGETS, example_rig, points_file, pose_at, seen, spot_of
from planeopt.accuracy import Score, Truth, error_of, read_truth, truth_beside
from planeopt.comparison import Comparison, Root, compare, compare_file, nearest_root
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.formulations import ClosedForm, Constrained, LeastSquares
from planeopt.methods import METHODS, Method
from planeopt.plane import Plane, SpotPose
from planeopt.solution import Status
from planeopt.solvers import Ipopt
from planeopt.spot import Spot

TRUE_POSE = pose_at()


def truth() -> Truth:
    return Truth(TRUE_POSE, example_rig().plane_from_pose(TRUE_POSE))


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(spot_of(TRUE_POSE), example_rig(), truth=truth())


def test_every_method_has_its_row_in_order(comparison: Comparison):
    assert [(row.formulation, row.solver) for row in comparison.rows] == [
        (method.formulation.name, "none" if method.solver is None else method.solver.name) for method in METHODS
    ]


def test_all_searches_find_the_visible_plane_from_the_closed_form(comparison: Comparison):
    for row in comparison.rows[:-1]:
        assert row.root is Root.VISIBLE, row.formulation
        assert row.solution.effort.evaluations > 0 or row.formulation == "ClosedForm"


def test_maximum_likelihood_methods_agree_far_within_the_noise(comparison: Comparison):
    depths = [
        row.solution.pose.z_L
        for row in comparison.rows
        if row.formulation in ("Constrained", "Constrained(paper)", "Reprojection") and row.solution.pose is not None
    ]
    sigma = comparison.rows[0].solution.sigma
    assert sigma is not None
    # They are equal to first order in the noise; what is left is its square, and the solvers' tolerance.
    assert len(depths) == 6
    assert np.ptp(depths) < 0.01 * sigma.z_L


def test_failures_stay_with_their_reason(comparison: Comparison):
    refused = comparison.rows[-1]
    assert refused.solution.status is Status.OVERDETERMINED
    assert "10 equations, 4 unknowns, laser block rank 1" in refused.to_dict()["message"]
    assert refused.root is None
    assert refused.error is None
    assert refused.from_closed_form is None


def test_errors_against_the_truth_are_within_five_sigmas(comparison: Comparison):
    for row in comparison.rows:
        sigma = row.solution.sigma
        if sigma is not None:
            assert row.error is not None
            assert abs(row.error.depth) < 5 * sigma.z_L, row.formulation
            assert row.error.normal < 5 * sigma.normal, row.formulation


def test_closed_form_is_no_distance_from_itself(comparison: Comparison):
    row = next(row for row in comparison.rows if row.formulation == "ClosedForm")
    assert row.from_closed_form is not None
    assert (row.from_closed_form.depth, row.from_closed_form.normal) == (0.0, 0.0)


def test_rows_are_json_with_the_residual_of_each_equation(comparison: Comparison):
    rows = json.loads(json.dumps(comparison.to_dicts(), allow_nan=False))
    assert len({tuple(row) for row in rows}) == 1
    equations = [f"({number})" for number in (11, 12, 13, 14, 15, 17, 18, 19, 20, 21)]
    assert [name.split()[0] for name in rows[0]["residuals"]] == equations
    # The laser block is hard in Constrained: it holds to rounding of its own terms, R^2 and r^2 among them.
    assert all(abs(value) < 1e-6 for name, value in rows[0]["residuals"].items() if name[:4] <= "(15)")


def test_same_start_is_used_for_all_and_wild_ones_are_told_apart():
    methods = (Method(Constrained(), Ipopt()), Method(LeastSquares(), Ipopt()))
    near = compare(spot_of(TRUE_POSE), example_rig(), methods=methods)
    far = compare(spot_of(TRUE_POSE), example_rig(), methods=methods, start=(10.0, 250.0, 0.35, 0.35))
    for warm, cold in zip(near.rows, far.rows, strict=True):
        assert cold.solution.effort.iterations > warm.solution.effort.iterations
    assert far.rows[0].root is Root.VISIBLE


def test_the_second_plane_is_called_the_second_plane():
    spot, rig = spot_of(TRUE_POSE), example_rig()
    direct = solve(spot, rig, formulation=ClosedForm())
    assert direct.pose is not None
    assert direct.plane is not None
    other = direct.other_plane
    assert other is not None
    assert nearest_root(other.pose, other.plane, direct) is Root.OTHER
    assert nearest_root(direct.pose, direct.plane, direct) is Root.VISIBLE
    nowhere = SpotPose.canonical(direct.pose.R, 2 * direct.pose.z_L, direct.pose.alpha, direct.pose.beta)
    assert nearest_root(nowhere, rig.plane_from_pose(nowhere), direct) is Root.ELSEWHERE


def test_file_without_a_pose_has_a_record_and_no_comparison(tmp_path: Path):
    missing = compare_file(str(tmp_path / "none.png"), example_rig())
    assert missing.record.status == "error"
    assert missing.comparison is None


def test_truth_is_found_beside_the_file_and_a_bad_one_is_an_error(tmp_path: Path):
    path = points_file(tmp_path)
    assert truth_beside(path) is None
    beside = path.with_suffix(".json")
    beside.write_text(TARGETS[0].with_suffix(".json").read_text())
    found = truth_beside(path)
    assert found is not None
    assert found.pose.alpha == pytest.approx(math.radians(2.0), abs=1e-12)
    beside.write_text('{"z_L_mm": 1}')
    result = compare_file(str(path), example_rig())
    assert result.record.status == "error"
    assert "alpha_deg" in result.record.message


@pytest.mark.parametrize("text", ["", "[]", '{"z_L_mm": "far"}'])
def test_what_is_no_truth_is_refused(tmp_path: Path, text: str):
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(InputError, match="not the true pose"):
        read_truth(path)


def test_untilted_truth_has_no_beta(tmp_path: Path):
    record = json.loads(TARGETS[0].with_suffix(".json").read_text()) | {"alpha_deg": 0.0, "beta_deg": None}
    path = tmp_path / "t.json"
    path.write_text(json.dumps(record))
    assert read_truth(path).pose.beta is None


def test_score_splits_the_normals_error_along_and_across_the_tilt():
    rig = example_rig()
    measured = SpotPose.canonical(
        TRUE_POSE.R, TRUE_POSE.z_L + 0.1, TRUE_POSE.alpha + 3e-4, (TRUE_POSE.beta or 0) - 4e-4
    )
    score = Score("a", measured, rig.plane_from_pose(measured), None, truth())
    along, across = score.along[0], score.across[0]
    assert along == pytest.approx(3e-4, rel=1e-9)
    # Pythagoras on the sphere, to the second order of 5e-4.
    assert math.hypot(along, across) == pytest.approx(score.error.normal, rel=1e-3)
    assert score.error.depth == pytest.approx(0.1, rel=1e-9)
    assert score.depth_sigmas is None


def test_error_of_a_refused_solution_is_none():
    refused = solve(spot_of(TRUE_POSE), example_rig(), formulation=METHODS[-1].formulation)
    assert error_of(refused, truth()) is None
    assert Score.of("a", refused, truth()) is None


def test_coverage_of_the_reported_depth_sigma():
    # 60 independent draws: the mean of the squared standardised error has the deviation sqrt(2/60); four of them.
    rig, pose = example_rig(), TRUE_POSE
    standardised = []
    for seed in range(60):
        spot = Spot(points=seen(pose, seed=seed), sigma=np.full(60, SIGMA_PX))
        score = Score.of("a", solve(spot, rig), Truth(pose, Plane(np.array([0, 0, 1.0]), np.zeros(3))))
        assert score is not None
        standardised.append(score.depth_sigmas)
    assert np.mean(np.square(standardised)) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 60))
