"""Path-traced sessions with their truth: the calibration, and the poses of the targets with the calibrated rig.

The same of the bundled session is asked of the demo, which calibrates on it: test_cli_demo.py.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from opencv_camera import opencv_camera
from planeopt.accuracy import Score, read_truth
from planeopt.batch import measure
from planeopt.calibration import Calibration, Options, calibrate
from planeopt.rig import load_rig

SIGMAS = 3.5
"""Standard deviations within which every parameter and pose lies: of 60 numbers, by chance beyond it 3 in 100."""


def shared(name: str) -> Path:
    data = os.environ.get("PLANEOPT_DATA")
    if data is None:
        pytest.skip("PLANEOPT_DATA, the folder of further path-traced images, is not set")
    return Path(data) / name


@pytest.fixture(scope="module", params=["rig-a"])
def data(request: pytest.FixtureRequest) -> tuple[Path, Calibration]:
    folder = shared(request.param)
    return folder, calibrate(folder / "session")


def test_every_parameter_is_true_to_its_sigma(data: tuple[Path, Calibration]):
    folder, found = data
    truth, rig = load_rig(folder / "truth_rig.toml"), found.rig
    assert found.verdict == "ok"
    assert rig.covariance is not None
    for name, sigma in zip(rig.covariance.parameters, rig.covariance.sigmas, strict=True):
        assert abs(rig.parameter(name) - truth.parameter(name)) < SIGMAS * sigma, name
    assert rig.parameter("f") == pytest.approx(truth.parameter("f"), rel=1e-3)
    assert rig.parameter("radius") == pytest.approx(truth.parameter("radius"), abs=0.01)


def test_targets_are_measured_with_the_calibrated_rig(data: tuple[Path, Calibration]):
    folder, found = data
    scores = []
    for path in sorted((folder / "targets").glob("*.png")):
        measured = measure(path, found.rig)
        assert measured.solution is not None, measured.record.message
        score = Score.of(path.stem, measured.solution, read_truth(path.with_suffix(".json")))
        assert score is not None
        scores.append(score)
    normals = [np.degrees(score.error.normal) for score in scores]
    depths = [abs(score.error.depth) / score.truth.pose.z_L for score in scores]
    assert np.median(normals) < 0.08
    assert np.median(depths) < 1e-4
    for score in scores:
        assert score.depth_sigmas is not None
        assert score.normal_sigmas is not None
        assert abs(score.depth_sigmas) < SIGMAS, score.name
        assert score.normal_sigmas < SIGMAS, score.name


def test_the_offset_goes_with_the_direction_and_poses_hardly_suffer(data: tuple[Path, Calibration]):
    _, found = data
    for cost in found.cost:
        # What the parameters' own sigmas would seem to cost, were camera and beam independent, is far more.
        assert cost.sigma_z_L < 0.5 * cost.independent_z_L
        assert cost.sigma_normal < 0.5 * cost.independent_normal


def test_real_photographs_are_too_few():
    found = calibrate(shared("real-charuco"), Options(focal="separate", distortion="k3", warp=False))
    assert found.verdict == "refused"
    assert "too few views" in found.message
    assert found.adjustment is not None


def test_real_photographs_give_opencv_s_camera():
    """The same model and corners, equal weights, none left out: the two programs' minima are one."""
    options = Options(focal="separate", distortion="k3", warp=False, corner_weights="equal", reject=False)
    ours = calibrate(shared("real-charuco"), options).adjustment
    assert ours is not None
    theirs, _ = opencv_camera(ours.observations)
    sigmas = [ours.sigma(name) for name in ours.names]
    # OpenCV takes corners in single precision, which is 3e-5 px here, a three thousandth of their noise.
    np.testing.assert_array_less(np.abs(ours.values - theirs) / sigmas, 0.01)
