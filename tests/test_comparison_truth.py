"""What comparisons are held against: simulated points, truths in files, and the scores of answers."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cases import WORKED_SETUP
from example_rig import TARGETS, example_rig, points_file, spot_of
from planeopt import equations as eq
from planeopt.accuracy import Score, error_of, read_truth, truth_beside
from planeopt.comparison import compare_file, compare_files
from planeopt.comparison.simulated import boundary, simulated_spot, worked_example
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.methods import METHODS
from planeopt.plane import SpotPose
from test_comparison import SQP, TRUE_POSE, truth

# --- Simulated points -------------------------------------------------------------------------------------------------


def test_simulated_points_lie_on_the_image_of_the_spot():
    rig, pose = worked_example()
    points, _ = rig.to_laser_plane(boundary(rig, pose, 12))
    b = np.array(eq.image_conic(np, eq.PaperVariables(pose.R, pose.z_L, pose.alpha, pose.beta), WORKED_SETUP))
    x, y = points.T
    terms = b[:, None] * np.stack([x * x, x * y, y * y, x, y, np.ones(12)])
    assert np.max(np.abs(terms.sum(axis=0)) / np.abs(terms).max(axis=0)) < 1e-9


def test_simulated_noise_is_as_it_says_and_repeats():
    rig, pose = worked_example()
    spot, again, other = (simulated_spot(rig, pose, n=2000, noise_px=0.3, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(spot.points, again.points)
    assert np.any(spot.points != other.points)
    # 4,000 numbers: their standard deviation is known to 1.1 %; four of that.
    assert np.std(spot.points - boundary(rig, pose, 2000)) == pytest.approx(0.3, rel=0.045)
    for n, noise_px in ((4, 0.3), (20, 0.0), (20, math.nan)):
        with pytest.raises(InputError):
            simulated_spot(rig, pose, n=n, noise_px=noise_px, seed=1)
    behind = SpotPose.canonical(pose.R, 5.0, pose.alpha, pose.beta)
    with pytest.raises(InputError, match="does not see"):
        boundary(rig, behind, 12)


# --- Files and the truth ----------------------------------------------------------------------------------------------


def test_file_without_a_pose_has_a_record_and_no_comparison(tmp_path: Path):
    good, missing = str(points_file(tmp_path)), str(tmp_path / "none.png")
    absent, found = compare_files([missing, good], example_rig(), methods=SQP)
    assert absent.record.status == "error"
    assert absent.comparison is None
    assert found.comparison is not None
    assert [case.name for case in found.comparison.cases] == [good]


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
