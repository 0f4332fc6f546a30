"""A calibration of a thousand views: what it takes grows as the views do."""

import tracemalloc

import numpy as np
import pytest

from planeopt.calibration.adjustment import adjust
from planeopt.calibration.model import Model
from planeopt.simulation import long_session

COUNTS = (10, 20, 40)


@pytest.fixture(scope="module")
def peaks() -> list[tuple[int, int, int]]:
    """Steps of the descent, corners and the most memory held at once, by the number of views."""
    # What is made once, whatever the session, is made before.
    adjust(long_session(3, COUNTS[0]).observations, Model(distortion="k3"))
    found = []
    for views in COUNTS:
        observations = long_session(3, views).observations
        tracemalloc.start()
        adjustment = adjust(observations, Model(distortion="k3"))
        found.append((adjustment.iterations, sum(map(len, observations.views)), tracemalloc.get_traced_memory()[1]))
        tracemalloc.stop()
    return found


def test_memory_is_linear(peaks: list[tuple[int, int, int]]):
    """Twice the views, twice the memory: a dense matrix of all poses would take four times as much."""
    first, second, third = (peak for _, _, peak in peaks)
    assert (third - second) / (second - first) == pytest.approx(2.0, rel=0.15)
    # Per view: 13 shared and 6 own columns of some 70 rows of corners and 160 of boundary, a few times over.
    assert third / COUNTS[-1] < 0.5e6


def test_more_views_take_no_more_steps(peaks: list[tuple[int, int, int]]):
    """Each step's work is a sum over views; so the work grows as the views do."""
    steps = [count for count, _, _ in peaks]
    assert max(steps) <= 2 * min(steps) + 2
    assert np.ptp([corners / views for (_, corners, _), views in zip(peaks, COUNTS, strict=True)]) < 5
