"""The sampled posterior against what is known by other ways: the normal limit, integration on a grid, edge cases."""

import math

import numpy as np
import pytest
import scipy.special
import scipy.stats

from cases import Array
from example_rig import example_rig, pose_at, spot_of
from planeopt import Prior, sample_posterior
from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.estimation.distances import distances
from planeopt.formulations import Problem, Reprojection
from planeopt.posterior import Likelihood, Scale, Stop, sample_problem
from planeopt.posterior.chain import Progress
from planeopt.posterior.target import Target
from planeopt.solution import Flag
from posterior_cases import LEVEL, PIXEL, SETUP, same_law, seen


def assert_share(share: float, expected: float, n: float, tests: int) -> None:
    """A share of n independent draws that should hold ``expected`` of them, two-sided at the family-wise level."""
    limit = float(scipy.stats.norm.isf(LEVEL / 2 / tests)) * math.sqrt(expected * (1 - expected) / n)
    assert abs(share - expected) < limit, (share, expected, limit)


def test_normal_limit_is_the_maximum_likelihood_plane_and_its_covariance() -> None:
    """With little noise the posterior is normal, with the moments of `Reprojection`, an exact and separate solver.

    Means within their standard errors; variances along the principal axes within theirs, sqrt(2/n).
    """
    problem = seen(n=200)
    posterior = sample_problem(problem, seed=1, draws=4000)
    n = posterior.diagnostics.ess
    solution = solve_problem(problem, formulation=Reprojection())
    assert solution.pose is not None
    assert solution.covariance is not None
    plane = np.array([solution.pose.z_L, *solution.pose.slopes])
    standard = np.linalg.solve(np.linalg.cholesky(solution.covariance), (posterior.samples - plane).T)
    limit = float(scipy.stats.norm.isf(LEVEL / 2 / 6))
    assert np.max(np.abs(np.mean(standard, axis=1))) < limit / math.sqrt(n)
    assert np.max(np.abs(np.var(standard, axis=1) - 1)) < limit * math.sqrt(2 / n)
    assert posterior.agrees
    assert posterior.diagnostics.stopped is Stop.CONVERGED
    assert posterior.diagnostics.converged
    assert n > 4000
    assert not posterior.prior_dominated
    assert posterior.laplace is not None
    np.testing.assert_allclose(posterior.laplace.plane, plane, atol=0.05 * math.sqrt(solution.covariance[0, 0]))
    np.testing.assert_allclose(posterior.laplace.covariance, solution.covariance, rtol=0.05)
    assert not posterior.laplace.rig.any()


def on_grid(problem: Problem, low: Array, high: Array, cells: int, prior: Prior) -> tuple[Array, Array]:
    """Planes (cells^3, 3) and their posterior weights from orthogonal distances: nothing of the sampler's but the form
    of the prior, which is written out.
    """
    axes = [low[i] + (high[i] - low[i]) * (np.arange(cells) + 0.5) / cells for i in range(3)]
    theta = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    planes = np.column_stack([np.exp(theta[:, 0]), theta[:, 1:]])
    assert problem.points is not None
    assert problem.noise is not None
    rho2 = np.concatenate(
        [
            np.sum(distances(block, problem.points, problem.noise, problem.setup) ** 2, axis=1)
            for block in np.array_split(planes, cells)
        ]
    )
    slope2 = np.sum(planes[:, 1:] ** 2, axis=1)
    depth = planes[:, 0] / problem.setup.r
    inside = (slope2 < math.tan(prior.max_tilt) ** 2) & (depth > prior.depth_radii[0]) & (depth < prior.depth_radii[1])
    with np.errstate(invalid="ignore"):
        log_density = np.where(inside, -0.5 * rho2 - 1.5 * np.log1p(slope2), -np.inf)
    return planes, np.exp(log_density - np.max(log_density))


def test_weak_data_agree_with_integration_on_a_grid() -> None:
    """A small far spot, slopes hardly known, the posterior bent and cut by the prior: nine quantiles of each quantity.

    For each quantile of the grid the share of the draws below it is binomial. At 2 % of the spot's radius the noise
    is small enough for the sampler's distances, which are the orthogonal ones to third order.
    """
    problem = seen(z_L=2000.0, alpha=0.3, n=30, sigma_px=0.11, seed=5)
    prior = Prior(max_tilt=math.radians(75))
    posterior = sample_problem(problem, seed=2, prior=prior, draws=3000)
    spread = np.ptp(posterior.samples, axis=0)
    low, high = posterior.samples.min(axis=0) - 0.3 * spread, posterior.samples.max(axis=0) + 0.3 * spread
    limit = math.tan(prior.max_tilt)
    low[1:], high[1:] = np.maximum(low[1:], -limit), np.minimum(high[1:], limit)
    low[0], high[0] = math.log(low[0]), math.log(high[0])
    planes, weights = on_grid(problem, low, high, 32, prior)
    assert np.sum(weights) ** 2 / np.sum(weights**2) > 500
    tilt = np.arctan(np.hypot(planes[:, 1], planes[:, 2]))
    tests = 4 * 9
    for values, draws in (
        (planes[:, 0], posterior.samples[:, 0]),
        (planes[:, 1], posterior.samples[:, 1]),
        (planes[:, 2], posterior.samples[:, 2]),
        (tilt, posterior.quantities["alpha"]),
    ):
        # A cell's mass is spread over its width: as a step function the grid's own law would be too rough.
        found = np.interp(np.quantile(draws, np.arange(1, 10) / 10), *cumulated(values, weights))
        for expected, share in zip(np.arange(1, 10) / 10, found, strict=True):
            assert_share(float(share), float(expected), posterior.diagnostics.ess, tests)
    assert not posterior.agrees
    assert "Trust the samples" in posterior.agreement
    assert posterior.prior_dominated
    assert "Prior-dominated" in posterior.prior_effect.sentence


def cumulated(values: Array, weights: Array) -> tuple[Array, Array]:
    """Distribution function: in bins as wide as a grid's cell, so that each value's mass lies about it."""
    edges = np.linspace(values.min() - 1e-9, values.max() + 1e-9, 33)
    mass, _ = np.histogram(values, edges, weights=weights)
    return edges, np.concatenate([[0], np.cumsum(mass)]) / np.sum(mass)


def test_unknown_scale_is_integrated_to_student_t() -> None:
    """Six points: 1 degree of freedom for the scale, and 2 more from what no plane explains. Against a grid."""
    problem = seen(n=8, known=False, seed=4)
    posterior = sample_problem(problem, seed=3, draws=3000)
    assert posterior.scale is Scale.INTEGRATED
    assert Flag.SCALE_ESTIMATED in posterior.flags
    assert problem.points is not None
    assert problem.noise is not None
    # The grid in standard deviations of a normal law 20 wide each way would miss tails of t with 5 degrees of freedom
    # by 1e-6; the quantiles looked at are far inside.
    assert posterior.laplace is not None
    root = np.linalg.cholesky(posterior.laplace.covariance)
    line = 20 * (np.arange(60) + 0.5) / 30 - 20
    y = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    planes = posterior.laplace.plane + y @ root.T
    rho = distances(planes, problem.points, problem.noise, problem.setup)
    weights = np.sum(rho**2, axis=1) ** (-problem.n_points / 2)
    standard = np.linalg.solve(root, (posterior.samples - posterior.laplace.plane).T)
    levels = np.array([0.05, 0.16, 0.5, 0.84, 0.95])
    for column in range(3):
        mass, edges = np.histogram(y[:, column], np.linspace(-20, 20, 61), weights=weights)
        law = np.concatenate([[0], np.cumsum(mass)]) / np.sum(mass)
        found = np.interp(np.quantile(standard[column], levels), edges, law)
        for expected, share in zip(levels, found, strict=True):
            # Bins of two thirds of a sigma: linear within them to about 1 %.
            limit = scipy.stats.norm.isf(LEVEL / 2 / 15) * math.sqrt(
                expected * (1 - expected) / posterior.diagnostics.ess
            )
            assert abs(share - expected) < limit + 0.01


def test_sampled_scale_and_integrated_scale_agree() -> None:
    """Student-t noise of many degrees of freedom is normal; its scale is sampled, normal noise's is integrated."""
    problem = seen(n=12, known=False, seed=6)
    one, other = (sample_problem(problem, seed=4, robust=dof, draws=3000) for dof in (None, 1e7))
    assert (one.scale, other.scale) == (Scale.INTEGRATED, Scale.SAMPLED)
    for column in range(3):
        assert same_law(one.samples[:, column], other.samples[:, column]) > LEVEL / 4
    # Sigma over its estimate from n - 5 residuals: with the 1/sigma prior n - 3 degrees of freedom remain.
    scale = other.summary("noise_scale")
    assert scale is not None
    assert scale.low95 < 1 < scale.high95


def test_robust_noise_leaves_outliers_aside() -> None:
    problem = seen(n=60)
    assert problem.points is not None
    points = problem.points.copy()
    points[::10] += 10 * PIXEL
    spoilt = Problem.from_points(points, SETUP, 0.05 * PIXEL)
    truth = np.array([240.0, -math.tan(0.5) * math.sin(0.8), math.tan(0.5) * math.cos(0.8)])
    robust, normal = (sample_problem(spoilt, seed=5, robust=dof, draws=1000) for dof in (3.0, None))
    for posterior, holds in ((robust, True), (normal, False)):
        far = np.abs(np.mean(posterior.samples, axis=0) - truth) / np.std(posterior.samples, axis=0)
        assert (far < 4).all() == holds, far


@pytest.mark.parametrize("z_L", [300.0, 500.0])
def test_two_modes_have_the_weights_of_an_integral(z_L: float) -> None:
    """A translucent screen far from the beam: both planes are likely, equally by the image.

    Their weights follow from the prior alone; a sum over a fine grid about each of them is the reference.
    """
    setup = eq.Setup(12.0, 400.0, 300.0, 6.0)
    problem = seen(z_L=z_L, alpha=0.2, sigma_px=0.5, setup=setup)
    posterior = sample_problem(problem, seed=6, both_sides=True, draws=3000)
    assert len(posterior.modes) == 2
    target = Target(Likelihood.of(problem), Prior(), both_sides=True)
    masses = {}
    for mode in posterior.modes:
        mine = target.lit(posterior.samples) == mode.lit_side
        theta = np.column_stack([np.log(posterior.samples[mine, 0]), posterior.samples[mine, 1:]])
        root = np.linalg.cholesky(np.cov(theta, rowvar=False))
        line = np.linspace(-6, 6, 41)
        y = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
        log_density = target(np.mean(theta, axis=0) + y @ root.T)
        masses[mode.lit_side] = scipy.special.logsumexp(log_density) + np.linalg.slogdet(root)[1]
    expected = float(scipy.special.expit(masses[True] - masses[False]))
    weight = next(mode.weight for mode in posterior.modes if mode.lit_side)
    assert 0.05 < expected < 0.95
    assert sum(mode.weight for mode in posterior.modes) == pytest.approx(1)
    # Which mode a walker is in has an autocorrelation time of its own; the stated error is for the slowest coordinate.
    assert abs(weight - expected) < 4 * posterior.modes[0].error
    assert not all(mode.lit_side for mode in posterior.modes)


def test_one_side_only_unless_asked() -> None:
    setup = eq.Setup(12.0, 400.0, 300.0, 6.0)
    posterior = sample_problem(seen(z_L=300.0, alpha=0.2, sigma_px=0.5, setup=setup), draws=300)
    assert [mode.lit_side for mode in posterior.modes] == [True]
    # Inside the beam there is no second plane before the camera.
    inside = seen(setup=eq.Setup(12.0, 2.0, 1.0, 6.0))
    assert len(sample_problem(inside, both_sides=True, draws=300).modes) == 1


def global_state() -> str:
    return repr(np.random.get_state(legacy=False))  # noqa: NPY002 - that it is left alone is what is tested


def test_same_seed_same_draws_and_nobody_elses_randomness() -> None:
    spot, rig = spot_of(pose_at()), example_rig()
    before = global_state()
    first, again, other = (sample_posterior(spot, rig, seed=seed, draws=300) for seed in (7, 7, 8))
    assert global_state() == before
    assert first.samples.tobytes() == again.samples.tobytes()
    assert not np.array_equal(first.samples[:10], other.samples[:10])


def test_budget_is_kept_and_said() -> None:
    seen_progress: list[Progress] = []
    posterior = sample_problem(seen(), budget=130, progress=seen_progress.append)
    assert posterior.diagnostics.stopped is Stop.BUDGET
    assert posterior.diagnostics.steps == 130
    assert "budget" in posterior.diagnostics.sentence
    assert not posterior.diagnostics.converged
    assert [told.steps for told in seen_progress] == [100, 130]
    assert len(posterior) > 100


class Interrupting(Prior):
    """A prior in whose n-th evaluation the user presses Ctrl-C."""

    calls: list[int]

    def after(self, calls: int) -> "Interrupting":
        object.__setattr__(self, "calls", [calls])
        return self

    def log_density(self, planes: Array, setup: eq.Setup) -> Array:
        self.calls[0] -= 1
        if self.calls[0] == 0:
            raise KeyboardInterrupt
        return super().log_density(planes, setup)


@pytest.mark.parametrize(("calls", "some"), [(300, True), (5, False)])
def test_interrupted_it_returns_what_it_has(calls: int, some: bool) -> None:
    posterior = sample_problem(seen(), prior=Interrupting().after(calls), draws=100_000)
    assert posterior.diagnostics.stopped is Stop.INTERRUPTED
    assert "interrupted" in posterior.diagnostics.sentence
    assert (posterior.diagnostics.steps > 0) == some
    assert np.isfinite(posterior.samples).all()
    centre = posterior.summary("z_L")
    assert centre is not None
    assert centre.low95 < centre.median < centre.high95
    assert abs(centre.median - 240) < 0.1
