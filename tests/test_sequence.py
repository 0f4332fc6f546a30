"""Trends along a sequence: their laws, what the rig does to them, where the positions come from."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from cases import Array
from example_rig import pose_at
from frames import frames, outline, uncertain_rig
from planeopt.cli.times import read_times
from planeopt.errors import InputError
from planeopt.estimation.sequence import Positions, Sequenced, trends
from planeopt.plane import SpotPose
from planeopt.rig import Rig
from planeopt.solution import Solution

FAMILY = 0.001


@pytest.fixture(scope="module")
def rig() -> Rig:
    return uncertain_rig()


@pytest.fixture(scope="module")
def base(rig: Rig) -> Solution:
    """One frame of noise 0.1 px."""
    return frames(rig, outline(rig, rig.plane_from_pose(pose_at())), 1, np.random.default_rng(5))[0]


def at(base: Solution, rig: Rig, plane: Array) -> Solution:
    """A solution with another plane ``(z_L, p, q)`` and the same covariances."""
    z_L, p, q = plane.tolist()
    pose = SpotPose.from_slopes(z_L, p, q, base.radius)
    return replace(base, pose=pose, plane=rig.plane_from_pose(pose))


def drawn(base: Solution, rig: Rig, place: Array, rate: Array, rng: np.random.Generator, noise: float = 1) -> Sequenced:
    """Planes that move at a rate, with errors drawn from the spots' covariance."""
    assert base.pose is not None
    assert base.uncertainty is not None
    root = noise * np.linalg.cholesky(base.uncertainty.spot)
    start = np.array([base.pose.z_L, *base.pose.slopes])
    planes = start + place[:, None] * rate + rng.normal(size=(len(place), 3)) @ root.T
    return trends([at(base, rig, plane) for plane in planes], rig, Positions(tuple(place.tolist())))


def test_slopes_of_a_still_plane_have_their_law(base: Solution, rig: Rig) -> None:
    """Squared slopes over their variance against chi-squared, and p-values against uniform, family-wise 0.001.

    The turn of the normal has two degrees of freedom and only a p-value. A quantity is said to change at most as often
    as `LEVEL` a sequence: more than 4 of 500 have a probability of 2e-4.
    """
    rng = np.random.default_rng(1)
    place = np.array([1.0, 2.0, 4.0, 5.0, 9.0, 10.0])
    results = [drawn(base, rig, place, np.zeros(3), rng) for _ in range(500)]
    for number in range(4):
        found = [result.trends[number] for result in results]
        assert scipy.stats.kstest([trend.p_value for trend in found], "uniform").pvalue > FAMILY / 7
        if number < 3:
            low, high = scipy.stats.chi2.ppf([FAMILY / 14, 1 - FAMILY / 14], len(found))
            assert low < sum((trend.slope / trend.slope_sigma) ** 2 for trend in found) < high
    assert sum(any(trend.changes for trend in result.trends) for result in results) <= 4


def test_a_moving_plane_is_found_with_its_rate(base: Solution, rig: Rig) -> None:
    """Each slope within 4.5 of its own standard deviations: four bounds, 3e-5."""
    place = np.arange(12.0)
    rate = np.array([0.02, 0.0, 0.004])
    result = drawn(base, rig, place, rate, np.random.default_rng(2))
    assert result.images == tuple(range(12))
    assert [trend.name for trend in result.trends] == ["z_L", "p", "q", "turn of the normal"]
    for trend, truth in zip(result.trends, rate, strict=False):
        assert abs(trend.slope - truth) < 4.5 * trend.slope_sigma
        np.testing.assert_allclose(np.diff(trend.fitted), trend.slope, rtol=1e-9)
        assert trend.changes == (truth != 0)
        assert trend.scatter_p_value > 1e-4
    turn = result.trends[3]
    planes = [at(base, rig, np.array([240.0, *(base_slopes(base) + place[i] * rate[1:])])).plane for i in (0, -1)]
    assert planes[0] is not None
    assert planes[1] is not None
    assert turn.slope == pytest.approx(planes[0].angle_to(planes[1]) / 11, abs=4.5 * turn.slope_sigma)
    assert "z_L changes: +0.0" in result.message
    assert "deg per image" in result.message
    assert "p changes" not in result.message


def base_slopes(base: Solution) -> Array:
    assert base.pose is not None
    return np.array(base.pose.slopes)


def test_scatter_beyond_sigma_is_said_and_makes_the_slope_less_certain(base: Solution, rig: Rig) -> None:
    """With five times the scatter, slopes of many nominal sigmas are common and are not taken for a change.

    At a level of 0.001 a sequence, more than 4 of 200 have a probability of 3e-6.
    """
    rng = np.random.default_rng(3)
    false = [drawn(base, rig, np.arange(8.0), np.zeros(3), rng, noise=5) for _ in range(200)]
    first = [result.trends[0] for result in false]
    assert np.mean([trend.scatter_p_value < 1e-3 for trend in first]) > 0.9
    assert sum(trend.changes for trend in first) <= 4
    assert np.mean([abs(trend.slope) > 3.3 * trend.slope_sigma for trend in first]) > 0.3
    assert any("scatter about the line" in trend.message for trend in first)


def test_the_rigs_part_does_not_move_a_still_plane(base: Solution, rig: Rig) -> None:
    result = drawn(base, rig, np.arange(10.0), np.zeros(3), np.random.default_rng(4))
    assert base.sigma is not None
    for trend in result.trends:
        assert trend.slope_sigma_rig < 1e-9 * max(base.sigma.z_L, 1)


def test_the_rigs_part_of_a_slope_is_the_change_of_its_effect(rig: Rig) -> None:
    """Two distances, one slope: the rig's part is that of the difference of its effects over the way."""
    where = [pose_at(z_L) for z_L in (200.0, 250.0, 300.0)]
    rng = np.random.default_rng(6)
    solutions = [frames(rig, outline(rig, rig.plane_from_pose(pose)), 1, rng, noise=0.01)[0] for pose in where]
    result = trends(solutions, rig, Positions((0.0, 1.0, 2.0)))
    assert rig.covariance is not None
    parts = [solution.uncertainty for solution in solutions if solution.uncertainty is not None]
    assert parts[0].plane_by_rig is not None
    assert parts[2].plane_by_rig is not None
    difference = (parts[2].plane_by_rig - parts[0].plane_by_rig)[0] / 2
    expected = math.sqrt(difference @ rig.covariance.matrix @ difference)
    # The middle image's weight in the slope is not exactly zero: its spot is smaller than the first's and has a share.
    assert result.trends[0].slope_sigma_rig == pytest.approx(expected, rel=0.15)


def test_too_few_images_have_no_trend(base: Solution, rig: Rig) -> None:
    refused = replace(base, pose=None, plane=None, uncertainty=None)
    result = trends([base, refused, base], rig, Positions((1.0, 2.0, 3.0)))
    assert result.trends == ()
    assert result.images == (0, 2)
    assert "no trend can be told" in result.message
    assert trends([base] * 4, rig, Positions((1.0,) * 4)).trends == ()
    assert trends([], rig, Positions(())).trends == ()
    with pytest.raises(InputError, match="a position for each"):
        trends([base], rig, Positions((1.0, 2.0)))


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a/f_0003.png", "a/f_0007.png", "a/f_0010.png"], (3, 7, 10)),
        (["v2_1.png", "v2_2.png"], (1, 2)),
        (["f2.png", "f1.png"], (1, 2)),
        (["f1.png", "g.png", "h3.png"], (1, 2, 3)),
        (["f1.png", "f1.tif"], (1, 2)),
        ([], ()),
    ],
)
def test_positions_are_the_numbers_in_names_that_order_them(names: list[str], expected: tuple[float, ...]) -> None:
    assert Positions.of_names(names).values == expected


def test_times_are_read_since_the_first(tmp_path: Path) -> None:
    file = tmp_path / "times.csv"
    file.write_text("image,time_s\na.png,100.5\nother.png,7\nsub/b.png,99\n\n", encoding="utf-8")
    found = read_times(file, ["x/a.png", "sub/b.png"])
    assert found.values == (1.5, 0.0)
    assert (found.label, found.unit) == ("time, s", "s")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a.png,1\n", "must begin with the header image,time_s"),
        ("", "must begin with the header"),
        ("image,time_s\na.png,noon\n", "line 2: must be an image and a finite number of seconds"),
        ("image,time_s\na.png,nan\n", "line 2: must be"),
        ("image,time_s\na.png\n", "line 2: must be"),
        ("image,time_s\na.png,1\na.png,2\n", "line 3: a.png stands there twice"),
        ("image,time_s\nb.png,1\n", "has no row for a.png"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_by_its_line(tmp_path: Path, content: str, words: str) -> None:
    file = tmp_path / "times.csv"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_times(file, ["a.png"])
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(file))


def test_positions_are_finite() -> None:
    with pytest.raises(InputError, match="finite"):
        Positions((1.0, math.inf))
