"""The prior: what is drawn is what is written, and what is written is a density."""

import math

import numpy as np
import pytest
import scipy.stats

from planeopt import InputError
from planeopt import equations as eq
from planeopt.posterior import Prior
from planeopt.posterior.prior import visible
from posterior_cases import LEVEL, SETUP, same_law

ON_AXIS = eq.Setup(12.0, 0.0, 0.0, 6.0)
"""With the camera in the beam every plane of the default prior is seen: nothing is cut off."""


def test_draws_are_uniform_on_the_hemisphere_and_in_log_depth() -> None:
    """Chi-squared over patches of equal area, and over log depth, each against its own 5e-4 tail on both sides."""
    n, prior = 40_000, Prior()
    planes = prior.draw(np.random.default_rng(1), n, ON_AXIS)
    cosine = 1 / np.sqrt(1 + np.sum(planes[:, 1:] ** 2, axis=1))
    azimuth = np.arctan2(planes[:, 2], planes[:, 1])
    least, most = (math.log(bound * ON_AXIS.r) for bound in prior.depth_radii)
    share = np.stack(
        [
            (1 - cosine) / (1 - math.cos(prior.max_tilt)),
            (azimuth + np.pi) / (2 * np.pi),
            (np.log(planes[:, 0]) - least) / (most - least),
        ]
    )
    bins = np.clip((share * np.array([[8], [10], [6]])).astype(int), 0, [[7], [9], [5]])
    counts = np.zeros((8, 10, 6))
    np.add.at(counts, tuple(bins), 1)
    expected = n / counts.size
    statistic = float(np.sum((counts - expected) ** 2) / expected)
    low, high = scipy.stats.chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], counts.size - 1)
    assert low < statistic < high


def test_density_is_that_of_the_draws() -> None:
    """It integrates to one, and its mean over a region is the share of the draws there."""
    prior = Prior(max_tilt=math.radians(70))
    tangent = math.tan(prior.max_tilt)
    side = np.linspace(-tangent, tangent, 801)
    p, q = np.meshgrid(side, side, indexing="ij")
    planes = np.stack([np.full_like(p, 50 * ON_AXIS.r), p, q], axis=-1)
    density = np.exp(prior.log_density(planes, ON_AXIS))
    depth = math.log(prior.depth_radii[1] / prior.depth_radii[0])
    # The edge of the disc crosses the cells: an error of their size.
    assert np.sum(density) * (side[1] - side[0]) ** 2 * depth == pytest.approx(1, abs=2e-3)
    draws = prior.draw(np.random.default_rng(2), 20_000, ON_AXIS)
    expected = np.sum(density[np.hypot(p, q) < 0.5]) * (side[1] - side[0]) ** 2 * depth
    found = np.mean(np.hypot(draws[:, 1], draws[:, 2]) < 0.5)
    assert abs(found - expected) < 4 * math.sqrt(expected * (1 - expected) / len(draws)) + 2e-3


@pytest.mark.parametrize("both_sides", [False, True])
def test_what_is_drawn_can_be_seen(both_sides: bool) -> None:
    planes = Prior().draw(np.random.default_rng(3), 5000, SETUP, both_sides=both_sides)
    assert planes.shape == (5000, 3)
    assert visible(planes, SETUP, both_sides=both_sides).all()
    lit = eq.lit_side_in_slopes(np, eq.SlopeVariables(None, *planes.T), SETUP) > 0
    assert lit.all() != both_sides


def test_restriction_to_what_is_seen_does_not_bend_the_rest() -> None:
    """Drawn with the restriction, and drawn without and then left out: the same law of the depth and of the tilt."""
    prior, setup = Prior(depth_radii=(20.0, 60.0)), eq.Setup(12.0, 60.0, 0.0, 6.0)
    restricted = prior.draw(np.random.default_rng(4), 4000, setup)
    free = prior.draw_unseen(np.random.default_rng(5), 12_000, setup)
    free = free[visible(free, setup)]
    for column in range(3):
        assert same_law(restricted[:, column], free[:, column]) > LEVEL / 3


def test_it_says_what_it_assumes() -> None:
    sentence = Prior(depth_radii=(10, 500), max_tilt=math.radians(80)).sentence(6.0)
    assert "60 to 3000 mm" in sentence
    assert "80 deg" in sentence


@pytest.mark.parametrize(
    "wrong",
    [{"depth_radii": (0.0, 10.0)}, {"depth_radii": (30.0, 20.0)}, {"max_tilt": math.pi / 2}, {"max_tilt": 0.0}],
)
def test_bounds_that_are_none_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match="prior"):
        Prior(**wrong)  # pyright: ignore[reportArgumentType] - the point of the test


def test_a_prior_of_planes_that_nobody_sees_is_refused() -> None:
    """So near that nearly every spot reaches behind the camera."""
    with pytest.raises(InputError, match="hardly any plane"):
        Prior(depth_radii=(1e-9, 2e-9)).draw(np.random.default_rng(6), 10, SETUP)
