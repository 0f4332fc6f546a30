"""The covariance is what the noise does to the fit, and maximum likelihood reaches the bound."""

import numpy as np
import pytest
from scipy.stats import chi2

from planeopt import conic

METHODS: tuple[conic.Method, ...] = ("maximum_likelihood", "taubin", "direct", "least_squares")


def present(values: np.ndarray | None) -> np.ndarray:
    assert values is not None
    return values


TRUTH = conic.conic_from_geometric([500, 300], [100, 60], 0.3)
SIGMA = 0.05
DRAWS = 1500
LEVEL = 1e-4
"""Probability that one of these statistical tests fails by chance, were the seed not fixed."""


def boundary(fraction, n=200):
    t = 0.5 + 2 * np.pi * fraction * (np.arange(n) / n if fraction == 1 else np.linspace(0, 1, n))
    u, v = 100 * np.cos(t), 60 * np.sin(t)
    cos, sin = np.cos(0.3), np.sin(0.3)
    return np.stack([500 + cos * u - sin * v, 300 + sin * u + cos * v], axis=-1)


def mahalanobis(errors, whitener):
    return np.sum((whitener @ errors[..., None])[..., 0] ** 2, axis=-1)


@pytest.fixture(scope="module", params=[1.0, 0.4], ids=["full", "40 %"])
def draws(request):
    base = boundary(request.param)
    noise = SIGMA * np.random.default_rng(20).standard_normal((DRAWS, 200, 2))
    return base, base + noise


@pytest.mark.parametrize("method", METHODS)
def test_scatter_is_what_the_covariance_says(draws, method):
    _, points = draws
    fits = conic.fit_conic(points, SIGMA, method)
    errors = fits.B - TRUTH
    if method in ("direct", "least_squares"):
        # Their bias is of second order in the noise, outside a covariance.
        errors = errors - np.mean(errors, axis=0)
    total = np.sum(mahalanobis(errors, fits.whitener))
    # A sum of 5 x DRAWS unit squares to first order; 1 % for the second order at this noise (sigma / axis = 1e-3).
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], 5 * DRAWS)
    assert 0.99 * low < total < 1.01 * high


def test_maximum_likelihood_reaches_the_bound(draws):
    base, points = draws
    fits = conic.fit_conic(points, SIGMA)
    # The KCR bound is the inverse Fisher information at the true points.
    bound = conic.fit_conic(base, SIGMA)
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], 5 * DRAWS)
    assert 0.99 * low < np.sum(mahalanobis(fits.B - TRUTH, bound.whitener)) < 1.01 * high
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], 195 * DRAWS)
    assert low < np.sum(present(fits.chi2)) < high


def test_no_fit_beats_the_bound_and_algebraic_fits_share_one_covariance(draws):
    base, _ = draws
    bound = conic.fit_conic(base, SIGMA)
    algebraic = [conic.fit_conic(base, SIGMA, m) for m in ("taubin", "direct", "least_squares")]
    for fit in algebraic:
        eigenvalues = np.linalg.eigvalsh(bound.whitener @ present(fit.covariance) @ bound.whitener.T)
        assert eigenvalues[0] > 1 - 1e-6
        assert eigenvalues[-1] > 1.01
        np.testing.assert_allclose(present(fit.covariance), present(algebraic[0].covariance), rtol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_covariance_is_the_derivative_of_the_fit_by_the_points(method):
    rng = np.random.default_rng(21)
    n = 12
    points = boundary(0.7, n)
    root = rng.standard_normal((n, 2, 2)) * 0.4 + np.eye(2)
    V = 0.01 * root @ np.swapaxes(root, -1, -2)
    step = 1e-3
    shifts = step * np.eye(2 * n).reshape(2 * n, n, 2)
    high, low = (conic.fit_conic(points + sign * shifts, V, method).B for sign in (1, -1))
    J = ((high - low) / (2 * step)).T.reshape(5, n, 2)
    numeric = np.einsum("ani,nij,bnj->ab", J, V, J)
    fit = conic.fit_conic(points, V, method)
    # Central differences: the relative error is (step / semi-axis)^2 times the fit's amplification, below 1e-5 here.
    np.testing.assert_allclose(fit.whitener @ numeric @ fit.whitener.T, np.eye(5), atol=1e-5)


def test_covariance_of_unequal_and_directed_noise():
    rng = np.random.default_rng(22)
    base = boundary(0.6, 80)
    root = rng.standard_normal((80, 2, 2)) * 0.4 + np.eye(2)
    root[::4] *= 5
    root *= SIGMA
    V = root @ np.swapaxes(root, -1, -2)
    points = base + (root @ rng.standard_normal((DRAWS, 80, 2, 1)))[..., 0]
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], 5 * DRAWS)
    for method in ("maximum_likelihood", "taubin"):
        fits = conic.fit_conic(points, V, method)
        assert 0.985 * low < np.sum(mahalanobis(fits.B - TRUTH, fits.whitener)) < 1.015 * high


def test_estimated_scale_gives_students_scatter():
    points = boundary(1.0, 20) + SIGMA * np.random.default_rng(23).standard_normal((DRAWS, 20, 2))
    fits = conic.fit_conic(points)
    # Hotelling: mahalanobis / 5 is F(5, 15), of mean 15 / 13 and variance 2 * 15^2 * 18 / (5 * 13^2 * 11).
    mean, spread = 15 / 13, np.sqrt(2 * 15**2 * 18 / (5 * 13**2 * 11) / DRAWS)
    assert abs(np.mean(mahalanobis(fits.B - TRUTH, fits.whitener)) / 5 - mean) < 4 * spread + 0.01
