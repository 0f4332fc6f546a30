"""Predictions of what had no say: their errors are as large as they should be, and too large where views disagree."""

from functools import cache

import numpy as np
import pytest

from calibrated import FLAT, good
from planeopt.calibration.adjustment import adjust
from planeopt.calibration.held_out import HeldOut, held_out
from planeopt.calibration.model import Model
from planeopt.simulation import board_faults
from planeopt.simulation.board_random import Shooting, random_session


@cache
def found(seed: int = 2, views: int = 12) -> HeldOut:
    made = held_out(good(seed, views), seed=1)
    assert made is not None
    return made


@pytest.mark.parametrize("seed", [2, 4, 6])
def test_errors_are_as_large_as_expected(seed: int):
    made = found(seed)
    assert made.ok, made.sentence
    # The standard deviation of the ratio is computed beside it; the noise itself was estimated from the same corners.
    assert abs(made.halves.ratio - 1) < 3.9 * made.halves.uncertainty
    assert made.error_px == made.halves.error_px
    ratios = np.array([fold.error_px / fold.expected_px for fold in made.folds])
    spots = np.array([[fold.spots.ratio, fold.spots.uncertainty] for fold in made.folds])
    assert abs(ratios.mean() - 1) < 0.15
    # The spots' noise is never taken to be less than stated, so errors may be a little less than expected.
    assert np.all(spots[:, 0] - 1 < 3.9 * spots[:, 1])


def test_expected_errors_are_right_in_the_mean():
    """Over sessions with other noise: the stated spread of the ratio is its spread, and one its mean."""
    session = random_session(4, shooting=Shooting(8), warp=FLAT, corner_sigma=0.1)
    ratios, spread = [], 0.0
    for seed in range(5):
        made = held_out(adjust(session.again(seed).observations, Model()), folds=0)
        assert made is not None
        ratios.append(made.halves.ratio)
        spread = made.halves.uncertainty
    # 3.9 sigma of a mean and of a standard deviation of 5.
    assert abs(np.mean(ratios) - 1) < 3.9 * spread / np.sqrt(5)
    assert np.std(ratios, ddof=1) < spread * (1 + 3.9 / np.sqrt(8))


def test_every_view_is_in_one_fold():
    made = found()
    names = sorted(name for fold in made.folds for name in fold.views)
    assert names == sorted(view.name for view in good().observations.views)
    assert max(fold.largest_shift for fold in made.folds) > 0


def test_the_same_seed_gives_the_same_answer_and_another_one_does_not():
    again = held_out(good(), seed=1)
    assert again is not None
    assert again.halves == found().halves
    other = held_out(good(), seed=2)
    assert other is not None
    assert other.halves != found().halves


def test_views_of_another_camera_do_not_pass():
    made = held_out(adjust(board_faults.mixed_session(2, 1.02).observations, Model()))
    assert made is not None
    assert not made.ok
    assert "more than" in made.sentence


def test_few_views_are_not_left_out():
    made = held_out(good(2, 5))
    assert made is not None
    assert made.folds == ()
    assert "too few views" in made.sentence


def test_a_camera_alone_is_tested_too():
    session = random_session(2, shooting=Shooting(8), warp=FLAT, spot="none")
    made = held_out(adjust(session.observations, Model(beam="none")))
    assert made is not None
    assert made.ok
    assert all(fold.spots.count == 0 for fold in made.folds)
