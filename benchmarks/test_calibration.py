"""A calibration, piece by piece, on one core: the board's corners, and the adjustment beside OpenCV's of the camera."""

from functools import cache

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from planeopt.board import Observations
from planeopt.calibration import Model, adjust, detect_image, load_session
from planeopt.calibration.ladder import adjust_all, climb, compare_terms
from planeopt.example import example_folder
from planeopt.simulation import Shooting, long_session, random_session
from planeopt.spot import read_image

DETECTION = "One view of a board, 0.7 MP, one core"
ADJUSTMENT = "Camera of 14 views, one core"
WHOLE = "Camera and beam, one core"


@cache
def observations(views: int) -> Observations:
    session = random_session(1, shooting=Shooting(views)) if views < 100 else long_session(1, views)
    return session.observations


def opencv_camera(seen: Observations) -> float:
    board = np.column_stack([seen.board.corners, np.zeros(len(seen.board.corners))]).astype(np.float32)
    rms, *_ = cv2.calibrateCamera(
        [board[view.ids] for view in seen.views],
        [view.corners.astype(np.float32) for view in seen.views],
        seen.image_size,
        np.eye(3),
        np.zeros(5),
    )
    return float(rms)


@pytest.mark.parametrize("spot", ["none", "disc"])
def test_one_view(benchmark: BenchmarkFixture, spot: str) -> None:
    session = load_session(example_folder() / "session")
    image = read_image(session.images[0])
    benchmark.group = DETECTION
    benchmark.extra_info["what"] = "corners" if spot == "none" else "corners and spot"
    kind = "disc" if spot == "disc" else "none"
    view, _ = benchmark.pedantic(detect_image, args=(image, session.board, kind), rounds=5, warmup_rounds=1)
    assert view is not None


def test_one_view_by_opencv(benchmark: BenchmarkFixture) -> None:
    session = load_session(example_folder() / "session")
    image, board = read_image(session.images[0]), session.board
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    drawn = cv2.aruco.CharucoBoard(board.squares, board.square_mm[0], board.marker_mm, dictionary)
    detector = cv2.aruco.CharucoDetector(drawn)
    benchmark.group, benchmark.extra_info["what"] = DETECTION, "cv2.aruco.CharucoDetector, corners six times noisier"
    corners, *_ = benchmark.pedantic(detector.detectBoard, args=(image,), rounds=5, warmup_rounds=1)
    assert corners is not None


def test_camera(benchmark: BenchmarkFixture) -> None:
    seen, model = observations(14), Model("separate", "k3", warp=False, beam="none")
    benchmark.group, benchmark.extra_info["what"] = ADJUSTMENT, "adjust, with covariance and outliers by rule"
    assert benchmark.pedantic(adjust, args=(seen, model), rounds=5, warmup_rounds=1).converged


def test_camera_by_opencv(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = ADJUSTMENT, "cv2.calibrateCamera"
    assert benchmark.pedantic(opencv_camera, args=(observations(14),), rounds=5, warmup_rounds=1) > 0


def test_camera_and_beam(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = WHOLE, "14 views"
    assert benchmark.pedantic(adjust_all, args=(observations(14), Model()), rounds=5, warmup_rounds=1).converged


def test_with_the_ladder_and_all_tests(benchmark: BenchmarkFixture) -> None:
    def everything() -> int:
        adjustment, ladder = climb(observations(14), Model(), None)
        return len(ladder) + len(compare_terms(adjustment))

    benchmark.group, benchmark.extra_info["what"] = WHOLE, "14 views, with the ladder and all tests"
    assert benchmark.pedantic(everything, rounds=5, warmup_rounds=1) == 8


def test_a_thousand_views(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = WHOLE, "1,000 views"
    assert benchmark.pedantic(adjust_all, args=(observations(1000), Model()), rounds=1).converged
