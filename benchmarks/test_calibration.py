"""A calibration of a thousand views of points, and of as few as a session has."""

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from planeopt.calibration.adjustment import adjust
from planeopt.calibration.model import Model
from planeopt.simulation import long_session


@pytest.mark.parametrize("views", [15, 125, 1000])
def test_adjustment(benchmark: BenchmarkFixture, views: int) -> None:
    observations = long_session(3, views).observations
    benchmark.group = "joint adjustment of camera, poses, bow and beam"
    benchmark.extra_info["what"] = f"{views} views, {sum(map(len, observations.views))} corners"
    found = benchmark.pedantic(adjust, (observations, Model(distortion="k3")), rounds=1)
    assert len(found.rotations) == views
