"""Maximum likelihood for many sets of points at once: Reprojection's answers, honest covariances, rows on their own."""

import math

import numpy as np
import pytest
import scipy.stats

from cases import WORKED, WORKED_SETUP, Array, boundary, circle, slopes
from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.estimation import PointsSolution, solve_points, solve_problem
from planeopt.estimation.judged import improbability
from planeopt.formulations import Problem, Reprojection
from planeopt.solution import Status
from planeopt.solvers import Ipopt

SIGMA = 0.3 * 0.005
TRUTH = slopes(WORKED)
LEVEL = 0.001


def noisy(rows: int, n: int = 100, seed: int = 0, sigma: float = SIGMA) -> Array:
    exact = boundary(WORKED, WORKED_SETUP, circle(n))
    return exact + sigma * np.random.default_rng(seed).standard_normal((rows, n, 2))


def random_planes(k: eq.Setup, rng: np.random.Generator, rows: int) -> list[eq.PaperVariables]:
    planes = []
    while len(planes) < rows:
        alpha, z_L = math.radians(rng.uniform(0, 75)), rng.uniform(60, 1000)
        v = eq.PaperVariables(k.r / math.cos(alpha), z_L, alpha, rng.uniform(-np.pi, np.pi))
        if z_L > 1.2 * k.r * math.tan(alpha) and eq.lit_side(np, v, k) > 0.01 * z_L:
            planes.append(v)
    return planes


def ragged(k: eq.Setup, rng: np.random.Generator, rows: int) -> tuple[Array, Array, np.ndarray]:
    """Points, sigmas and counts of random planes, arcs and noises up to a thirtieth of the spot."""
    counts = rng.integers(6, 90, rows)
    points, sigmas = np.full((rows, 90, 2), np.nan), np.full((rows, 90), np.nan)
    for row, (v, n) in enumerate(zip(random_planes(k, rng, rows), counts.tolist(), strict=True)):
        exact = boundary(v, k, circle(n, rng.choice([1.0, 0.7, 0.4]), rng.uniform(-np.pi, np.pi)))
        size = float(k.f * k.r / v.z_L * math.cos(v.alpha) * 10 ** rng.uniform(-4, -1.5))
        sigmas[row, :n] = size * rng.uniform(0.5, 2, n)
        points[row, :n] = exact + sigmas[row, :n, None] * rng.standard_normal((n, 2))
    return points, sigmas, counts


@pytest.mark.parametrize(
    "setup",
    [
        WORKED_SETUP,
        eq.Setup(12.0, 3.0, -2.0, 6.0),
        eq.Setup(1.0, 6.0, 8.0, 10.0),
        eq.Setup(16.0, 0.0, 0.0, 4.0),
        eq.Setup(8.0, -40.0, 5.0, 2.0),
    ],
    ids=["worked example", "camera in the beam", "camera on the beam", "camera on the axis", "thin beam"],
)
def test_it_is_reprojection(setup: eq.Setup) -> None:
    points, sigmas, counts = ragged(setup, np.random.default_rng(5), 14)
    found = solve_points(points, sigmas, setup, counts=counts)
    for row, n in enumerate(counts.tolist()):
        problem = Problem.from_points(points[row, :n], setup, sigmas[row, :n])
        one = solve_problem(problem, formulation=Reprojection(), solver=Ipopt(tol=1e-10))
        assert found.status[row] is one.status
        assert one.pose is not None, one.message
        assert one.covariance is not None
        error = found.planes[row] - [one.pose.z_L, *one.pose.slopes]
        assert error @ np.linalg.solve(one.covariance, error) < 1e-3**2
        # Reprojection's covariance has the curvature of the residuals in it: of the order of noise over size.
        np.testing.assert_allclose(found.covariance[row], one.covariance, rtol=0.3, atol=0.1 * one.covariance.max())
        # First-order forms of the same statistics; the next order is the noise over the size, up to a thirtieth, times
        # their root.
        assert found.chi2[row] == pytest.approx(one.chi2, rel=0.3, abs=0.1)
        assert found.cost[row] == pytest.approx(one.chi2_points, rel=0.1)


def test_covariances_are_as_good_as_sigmas() -> None:
    points = noisy(3)
    skew = SIGMA**2 * np.array([[1.3, 0.4], [0.4, 0.7]])
    found = solve_points(points, np.broadcast_to(skew, (3, 100, 2, 2)), WORKED_SETUP)
    problem = Problem.from_points(points[0], WORKED_SETUP, np.broadcast_to(skew, (100, 2, 2)))
    one = solve_problem(problem, formulation=Reprojection(), solver=Ipopt(tol=1e-10))
    assert one.pose is not None
    assert one.covariance is not None
    error = found.planes[0] - [one.pose.z_L, *one.pose.slopes]
    assert error @ np.linalg.solve(one.covariance, error) < 1e-3**2
    isotropic = solve_points(points, SIGMA, WORKED_SETUP)
    as_covariance = solve_points(points, np.broadcast_to(SIGMA**2 * np.eye(2), (3, 100, 2, 2)), WORKED_SETUP)
    np.testing.assert_allclose(isotropic.planes, as_covariance.planes, rtol=1e-7)


def squared(found: PointsSolution) -> Array:
    error = found.planes - TRUTH
    return np.sum(error * np.linalg.solve(found.covariance, error[..., None])[..., 0], axis=-1)


@pytest.mark.parametrize("known", [True, False], ids=["sigma given", "sigma estimated"])
def test_errors_have_the_stated_covariance_and_tests_their_law(known: bool) -> None:
    draws, n = 3000, 60
    found = solve_points(noisy(draws, n, seed=3), SIGMA if known else None, WORKED_SETUP)
    assert found.ok.all()
    p_values = improbability(found.chi2, found.scale_dof)
    if known:
        low, high = scipy.stats.chi2.ppf([LEVEL / 8, 1 - LEVEL / 8], 3 * draws)
        assert low < np.sum(squared(found)) < high
        low, high = scipy.stats.chi2.ppf([LEVEL / 8, 1 - LEVEL / 8], (n - 3) * draws)
        assert low < np.sum(found.cost) < high
    else:
        # chi-squared with 3 over one with n - 5 degrees of freedom; the scale's square is unbiased.
        assert scipy.stats.kstest(squared(found) / 3, scipy.stats.f(3, n - 5).cdf).pvalue > LEVEL / 4
        relative = np.sqrt(2 / ((n - 5) * draws))
        assert abs(np.mean(found.scale**2) / SIGMA**2 - 1) < scipy.stats.norm.isf(LEVEL / 8) * relative
    assert scipy.stats.kstest(p_values, "uniform").pvalue > LEVEL / 4


def test_rows_do_not_touch_each_other() -> None:
    points = noisy(8, 30)
    sigmas = np.full((8, 30), SIGMA)
    counts = np.full(8, 30)
    alone = solve_points(points, SIGMA, WORKED_SETUP)
    points[1, 7] = np.nan
    sigmas[2, 4] = -1.0
    counts[3] = 4
    points[4] = np.arange(30)[:, None] * [1.0, 2.0]
    points[5] = points[5, 0]
    points[6, :, 0] += 100.0
    found = solve_points(points, sigmas, WORKED_SETUP, counts=counts)
    for row in (1, 2, 3, 4, 5):
        assert found.status[row] is Status.UNUSABLE
        assert np.isnan(found.planes[row]).all()
    assert found.status[6] is not Status.CONVERGED
    for row in (0, 7):
        assert found.status[row] is Status.CONVERGED
        np.testing.assert_allclose(found.planes[row], alone.planes[row], rtol=1e-9)
        np.testing.assert_allclose(found.covariance[row], alone.covariance[row], rtol=1e-6)


def test_the_order_of_the_rows_does_not_matter() -> None:
    points, sigmas, counts = ragged(WORKED_SETUP, np.random.default_rng(8), 40)
    order = np.random.default_rng(9).permutation(40)
    one = solve_points(points, sigmas, WORKED_SETUP, counts=counts)
    other = solve_points(points[order], sigmas[order], WORKED_SETUP, counts=counts[order])
    np.testing.assert_allclose(other.planes, one.planes[order], rtol=1e-6)
    assert other.status == tuple(one.status[row] for row in order)
    np.testing.assert_array_equal(other.counts, counts[order])


def test_nothing_in_nothing_out() -> None:
    found = solve_points(np.empty((0, 10, 2)), 1.0, WORKED_SETUP)
    assert len(found) == 0
    assert found.planes.shape == (0, 3)


def test_exact_points_give_the_exact_plane() -> None:
    """What is left is rounding of the points, 50 mm from the origin on an ellipse of some mm, and its conditioning."""
    for noise in (None, 1e-12):
        found = solve_points(noisy(2, sigma=0.0), noise, WORKED_SETUP)
        assert found.ok.all()
        assert found.floored.all()
        np.testing.assert_allclose(found.planes[0], TRUTH, rtol=1e-9)


@pytest.mark.parametrize("size", [1e200, 1e150, 1e-200])
@pytest.mark.parametrize("as_variance", [False, True])
def test_noise_beyond_numbers_costs_its_row(size: float, as_variance: bool) -> None:
    points, noise = noisy(2, 30), np.full((2, 30), SIGMA)
    given = noise[..., None, None] ** 2 * np.eye(2) if as_variance else noise
    right = solve_points(points, given, WORKED_SETUP).planes[0]
    given[1] = size * np.eye(2) if as_variance else size
    found = solve_points(points, given, WORKED_SETUP)
    np.testing.assert_allclose(found.planes[0], right, rtol=1e-9)
    if not (as_variance and size == 1e150):
        assert found.status[1] is Status.UNUSABLE


def test_five_points_need_a_sigma() -> None:
    points = noisy(1, 5)
    with_sigma, without = solve_points(points, SIGMA, WORKED_SETUP), solve_points(points, None, WORKED_SETUP)
    assert with_sigma.status == (Status.CONVERGED,)
    assert without.status == (Status.NO_NOISE_SCALE,)
    np.testing.assert_allclose(with_sigma.planes, without.planes, rtol=1e-6)
    assert np.isnan(without.covariance).all()


def test_some_rows_may_know_their_sigma() -> None:
    points = noisy(2)
    found = solve_points(points, np.full((2, 100), SIGMA), WORKED_SETUP, scale_known=[True, False])
    assert found.scale[0] == 1
    # The estimated factor has a relative error of 1/sqrt(2 dof).
    assert abs(found.scale[1] - 1) < 4 / math.sqrt(2 * 95)
    np.testing.assert_array_equal(found.scale_dof, [-1, 95])


def test_a_wrong_rig_is_seen() -> None:
    wrong = eq.Setup(25.0, 31.0, 38.0, 10.0)
    assert solve_points(noisy(1), SIGMA, wrong).status == (Status.INCONSISTENT,)


def test_a_start_is_a_start_only() -> None:
    points = noisy(4)
    cold = solve_points(points, SIGMA, WORKED_SETUP)
    starts = np.array([[60.0, 0.0, 0.0], [200.0, -1.0, 0.5], [-3.0, 0.0, 0.0], [np.nan] * 3])
    np.testing.assert_allclose(solve_points(points, SIGMA, WORKED_SETUP, start=starts).planes, cold.planes, rtol=1e-7)


def test_a_short_noisy_arc_does_not_end_in_a_local_minimum() -> None:
    """On a third of the arc with noise of a fiftieth of the radius every other conic is no ellipse: a start from the
    direct fit led to the far side of what can be seen, at eight times the cost."""
    k, n = eq.Setup(25.0, 13.7, -14.5, 10.0), 200
    v = eq.PaperVariables(10.0, 1000.0, 0.0, 0.0)
    exact = boundary(v, k, circle(n, 0.3, 1.0))
    points = exact + 0.005 * np.random.default_rng(2).standard_normal((400, n, 2))
    found = solve_points(points, 0.005, k)
    from_truth = solve_points(points, 0.005, k, start=np.tile(slopes(v), (400, 1)))
    np.testing.assert_allclose(found.cost, from_truth.cost, rtol=1e-6)
    # The largest of 400 values of chi-squared with 197 degrees of freedom, at LEVEL.
    assert found.cost.max() < scipy.stats.chi2.isf(LEVEL / 400, n - 3)


def test_students_t_takes_gross_errors() -> None:
    points = noisy(200, seed=4)
    points[:, ::12] += 0.05
    plain, robust = (solve_points(points, SIGMA, WORKED_SETUP, robust=nu) for nu in (None, 4.0))
    free = solve_points(points, None, WORKED_SETUP, robust=4.0)
    expected = scipy.stats.chi2.ppf(0.999, 3)
    assert np.median(squared(plain)) > 10 * expected
    assert np.mean(squared(robust) < expected) > 0.95
    assert np.mean(squared(free) < expected) > 0.95


@pytest.mark.parametrize("known", [True, False], ids=["scale given", "scale estimated"])
def test_students_t_is_honest_for_its_own_noise(known: bool) -> None:
    draws, n, nu = 1500, 100, 4.0
    exact = boundary(WORKED, WORKED_SETUP, circle(n))
    tangent = np.roll(exact, -1, axis=0) - np.roll(exact, 1, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
    noise = SIGMA * np.random.default_rng(6).standard_t(nu, (draws, n, 1))
    found = solve_points(exact + noise * normal, SIGMA if known else None, WORKED_SETUP, robust=nu)
    # Of first order in 1/n beside the sampling error of the mean: 3 % for a hundred points.
    mean = np.mean(squared(found)) / 3
    assert abs(mean - 1) < 0.05 + scipy.stats.norm.isf(LEVEL / 4) * math.sqrt(2 / (3 * draws))


@pytest.mark.parametrize(
    ("points", "noise", "options", "words"),
    [
        (np.zeros((5, 2)), 1.0, {}, "points must have shape"),
        (np.zeros((2, 6, 2)), np.ones(3), {}, "noise must be one sigma"),
        (np.zeros((2, 6, 2)), 1.0, {"robust": 0.0}, "robust must be"),
        (np.zeros((2, 6, 2)), 1.0, {"robust": np.inf}, "robust must be"),
        (np.zeros((2, 6, 2)), 1.0, {"counts": [7, 6]}, "counts must be"),
        (np.zeros((2, 6, 2)), 1.0, {"start": np.zeros(3)}, "start must have shape"),
    ],
)
def test_shapes_are_checked(points: Array, noise: Array | float, options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        solve_points(points, noise, WORKED_SETUP, **options)  # pyright: ignore[reportArgumentType] - wrong on purpose
