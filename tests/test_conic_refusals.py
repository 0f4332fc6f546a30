"""Points that are no ellipse are refused, in one line that says what they are."""

from typing import cast

import numpy as np
import pytest

from planeopt import conic
from planeopt.conic import Verdict
from planeopt.errors import InputError

METHODS: tuple[conic.Method, ...] = ("maximum_likelihood", "taubin", "direct", "least_squares")


def present(values: np.ndarray | None) -> np.ndarray:
    assert values is not None
    return values


T = np.linspace(-1.2, 1.2, 30)
CIRCLE = np.stack([np.cos(2.5 * T), np.sin(2.5 * T)], axis=-1)


def turned(x, y):
    return np.stack([0.8 * x - 0.6 * y + 3, 0.6 * x + 0.8 * y - 5], axis=-1)


LINE = turned(T, 0 * T)
HYPERBOLA = turned(np.cosh(T), 0.7 * np.sinh(T))
BOTH_BRANCHES = np.concatenate([HYPERBOLA[::2], turned(-np.cosh(T), 0.7 * np.sinh(T))[::2]])
PARABOLA = turned(T, T**2)
CROSS = np.concatenate([turned(T, 0.5 * T)[::2], turned(T, -T)[::2]])
PARALLELS = np.concatenate([turned(T, 0 * T)[::2], turned(T, 0 * T + 1)[::2]])
BUT_ONE = np.concatenate([LINE[:-1], [[3.0, 9.0]]])
FEW = np.repeat(CIRCLE[:4], 8, axis=0)


def with_value(array, index, value):
    array = np.array(array, dtype=float)
    array[index] = value
    return array


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("points", "message", "verdict"),
    [
        (FEW, "only 4 of the 32 points are distinct", Verdict.TOO_FEW),
        (np.ones((9, 2)), "only 1 of the 9 points are distinct", Verdict.LINE),
        (LINE, "the 30 points lie on a straight line", Verdict.LINE),
        (LINE * 1e-3 + 700, "straight line", Verdict.LINE),
        (BUT_ONE, "the 30 points lie on a pair of straight lines", Verdict.LINE_PAIR),
        (with_value(CIRCLE, (3, 0), np.nan), "1 of 30 points have a coordinate that is not finite, first in row 3", 1),
        (with_value(CIRCLE, (slice(7, 9), 1), np.inf), "2 of 30 points .* first in row 7", Verdict.NOT_FINITE),
    ],
)
def test_refused_by_every_method(method, points, message, verdict):
    with pytest.raises(InputError, match=message) as refusal:
        conic.fit_conic(points, method=method)
    assert "\n" not in str(refusal.value)
    assert conic.fit_conic(points, method=method, check=False).verdict == verdict


@pytest.mark.parametrize("method", [m for m in METHODS if m != "direct"])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (HYPERBOLA, "the 30 points lie on a hyperbola, not on an ellipse"),
        (BOTH_BRANCHES, "hyperbola"),
        (PARABOLA, "parabola"),
        (CROSS, "a pair of straight lines"),
        (PARALLELS, "a pair of straight lines"),
    ],
)
@pytest.mark.parametrize("sigma", [None, 1e-4])
def test_the_other_conics_are_named(method, points, message, sigma):
    with pytest.raises(InputError, match=message):
        conic.fit_conic(points, sigma, method=method)


@pytest.mark.parametrize("method", METHODS)
def test_a_line_with_noise_is_a_line(method):
    noise = 0.01 * np.random.default_rng(30).standard_normal((20, 30, 2))
    assert (conic.fit_conic(LINE + noise, 0.01, method, check=False).verdict == Verdict.LINE).all()
    # Three standard deviations above chi-squared's mean: 99 in 100 pass; the rest must not become an ellipse unless
    # the noise is unknown, where a thin one may fit by chance.
    assert np.mean(conic.fit_conic(LINE + noise, None, method, check=False).verdict == Verdict.LINE) > 0.9


def test_a_round_spot_is_no_line():
    assert conic.fit_conic(CIRCLE * [1.0, 0.1], 0.01).ok


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (0.0, "sigma must be positive and finite; it is 0"),
        (-1.0, "it is -1"),
        (np.nan, "it is nan"),
        (with_value(np.ones(30), 4, 0.0), r"1 of 30 sigmas are not positive and finite, first in row 4 \(0\)"),
        (with_value(np.ones(30), 29, np.inf), r"row 29 \(inf\)"),
        (np.ones(29), r"match the points; its shape is \(29,\)"),
        (np.tile(np.ones((2, 2)), (30, 1, 1)), "30 of 30 point covariances are not positive definite, first in row 0"),
        (with_value(np.tile(np.eye(2), (30, 1, 1)), (6, 1, 1), -1.0), "1 of 30 .* row 6"),
        (with_value(np.tile(np.eye(2), (30, 1, 1)), (6, 0, 1), 0.5), "symmetric"),
    ],
)
def test_noise_that_is_none(method, noise, message):
    with pytest.raises(InputError, match=message):
        conic.fit_conic(CIRCLE, noise, method)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (CIRCLE[:4], "4 points given; an ellipse needs at least 5"),
        (np.ones((3, 5)), r"shape \(\.\.\., N, 2\); it is \(3, 5\)"),
        (np.ones(7), r"it is \(7,\)"),
    ],
)
def test_shapes(points, message):
    with pytest.raises(InputError, match=message):
        conic.fit_conic(points)


def test_unknown_method():
    with pytest.raises(InputError, match="unknown conic fit 'ransac'"):
        conic.fit_conic(CIRCLE, method=cast(conic.Method, "ransac"))


@pytest.mark.parametrize("method", METHODS)
def test_a_bad_draw_costs_itself_only(method):
    good = CIRCLE + 0.01 * np.random.default_rng(31).standard_normal((7, 30, 2))
    points = good.copy()
    points[1] = LINE
    points[3, 5, 0] = np.nan
    points[4] = np.repeat(CIRCLE[:3], 10, axis=0)
    sigma = np.full((7, 30), 0.01)
    sigma[6, 2] = 0
    fits = conic.fit_conic(points, sigma, method, check=False)
    np.testing.assert_array_equal(fits.ok, [True, False, True, False, False, True, False])
    np.testing.assert_array_equal(
        fits.verdict[~fits.ok], [Verdict.LINE, Verdict.NOT_FINITE, Verdict.TOO_FEW, Verdict.BAD_NOISE]
    )
    alone = conic.fit_conic(good, 0.01, method)
    np.testing.assert_allclose(fits.B[fits.ok], alone.B[fits.ok], rtol=1e-9)
    np.testing.assert_allclose(present(fits.chi2)[fits.ok], present(alone.chi2)[fits.ok], rtol=1e-9)
    for values in (fits.B, present(fits.sqrt_covariance), present(fits.chi2), present(fits.scale)):
        assert np.isnan(values[~fits.ok]).all()
        assert np.isfinite(values[fits.ok]).all()
    with pytest.raises(InputError, match="set 1 of 7: the 30 points lie on a straight line"):
        conic.fit_conic(points, sigma, method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("n", [5, 6, 9, 40])
def test_whatever_the_points_are_there_is_a_verdict(method, n):
    rng = np.random.default_rng(32)
    points = rng.standard_normal((300, n, 2)) * np.exp(3 * rng.standard_normal((300, 1, 2)))
    points[100:200] = np.round(points[100:200])
    points[200:] += 1e6
    angles = 2 * np.pi * np.arange(n) / n
    points[:50] = 5 * np.stack([np.cos(angles), np.sin(angles)], axis=-1) + 0.1 * rng.standard_normal((50, n, 2))
    for noise in (None, 0.1):
        fits = conic.fit_conic(points, noise, method, check=False)
        assert np.isfinite(fits.B[fits.ok]).all()
        assert conic.is_ellipse(fits.B_local[fits.ok]).all()
        assert np.isnan(fits.B[~fits.ok]).all()
        assert fits.ok[:50].mean() > 0.9
        assert not fits.ok.all()


def test_a_line_bent_by_a_lens_costs_itself_only():
    """Maximum likelihood runs off from there until there are no derivatives left."""
    t = np.linspace(-1.5, 1.5, 8)
    bent = np.stack([t, 0.33 * t + 1e-3 * t**2 + 1e-4 * t**3], axis=-1)
    angles = 2 * np.pi * np.arange(8) / 8
    good = np.stack([np.cos(angles), np.sin(angles)], axis=-1) + 0.01 * np.random.default_rng(33).standard_normal(
        (8, 2)
    )
    with pytest.raises(InputError, match="the 8 points lie on a hyperbola, not on an ellipse"):
        conic.fit_conic(bent)
    fits = conic.fit_conic(np.stack([bent, good]), check=False)
    assert fits.verdict.tolist() == [Verdict.HYPERBOLA, Verdict.OK]
    np.testing.assert_allclose(fits.B[1], conic.fit_conic(good).B, rtol=1e-9)
