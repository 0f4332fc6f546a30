"""The log posterior of half an ensemble, in one call and in one call a walker, and whole posteriors."""

import numpy as np
import pytest
from emcee import EnsembleSampler, State
from emcee.moves import DEMove
from pytest_benchmark.fixture import BenchmarkFixture

from planeopt.posterior import Likelihood, Posterior, Prior, sample_problem
from planeopt.posterior.chain import WALKERS
from planeopt.posterior.moves import SnookerMove
from planeopt.posterior.target import Target
from worked_example import problem

GROUP = f"Log posterior, 200 points, {WALKERS // 2} walkers"
PRIOR = Prior(depth_radii=(5.0, 1000.0))
"""The worked example's depth is 7.5 radii."""


@pytest.fixture(scope="module")
def target() -> Target:
    return Target(Likelihood.of(problem()), PRIOR)


@pytest.fixture(scope="module")
def half() -> np.ndarray:
    """Half an ensemble about the worked example's plane."""
    rng = np.random.default_rng(1)
    centre, spread = np.array([np.log(75.0), -0.866, 1.5]), np.array([1e-5, 1e-4, 1e-4])
    return centre + spread * rng.standard_normal((WALKERS // 2, 3))


def test_in_one_call(benchmark: BenchmarkFixture, target: Target, half: np.ndarray) -> None:
    values = benchmark(target, half)
    benchmark.group, benchmark.extra_info["what"] = GROUP, "in one call"
    assert np.isfinite(values).all()


def test_a_call_a_walker(benchmark: BenchmarkFixture, target: Target, half: np.ndarray) -> None:
    def loop() -> list[float]:
        return [float(target(row[None])[0]) for row in half]

    values = benchmark(loop)
    benchmark.group, benchmark.extra_info["what"] = GROUP, "in a call a walker"
    np.testing.assert_allclose(values, target(half), rtol=1e-9)


def test_what_emcee_itself_takes(benchmark: BenchmarkFixture) -> None:
    """Half of one step with a density that costs nothing."""
    sampler = EnsembleSampler(
        WALKERS, 3, lambda x: np.zeros(len(x)), vectorize=True, moves=[(DEMove(), 0.8), (SnookerMove(), 0.2)]
    )
    random = np.random.RandomState(1)
    state = State(random.randn(WALKERS, 3), random_state=random.get_state())
    state = sampler.run_mcmc(state, 10)
    benchmark(lambda: sampler.run_mcmc(state, 1, store=False))
    benchmark.group, benchmark.extra_info["what"] = GROUP, "emcee's own part of a whole step"


@pytest.mark.parametrize("robust", [None, 4.0])
def test_two_thousand_effective_draws(benchmark: BenchmarkFixture, robust: float | None) -> None:
    of = problem()
    posterior: Posterior = benchmark(sample_problem, of, prior=PRIOR, robust=robust)
    benchmark.group = "2000 effective draws, 200 points"
    benchmark.extra_info["what"] = "normal noise" if robust is None else f"Student-t noise, {robust:g} degrees"
    assert posterior.diagnostics.ess >= 2000
