"""Run emcee until it has sampled enough, or is told to stop."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np
from emcee.moves import DEMove
from numpy.typing import NDArray

from planeopt.posterior.diagnostics import R_HAT_LIMIT, Diagnostics, Stop, autocorrelation_time, split_r_hat
from planeopt.posterior.moves import IndependenceMove, InvolutionMove, SnookerMove
from planeopt.posterior.proposal import Mixture
from planeopt.posterior.target import Target

Array = NDArray[np.float64]

WALKERS = 40
BURN_IN = 5
"""Autocorrelation times left out at the beginning; the walkers begin at draws that are already nearly right."""

TIMES = 50
"""Autocorrelation times that a chain must be long for their estimate to be believed."""

STEADY = 0.02
CHECK_EVERY = 100


@dataclass(frozen=True)
class Progress:
    """How far sampling is: effective draws of those wanted, steps of those allowed."""

    effective: float
    wanted: int
    steps: int
    budget: int


@dataclass(frozen=True, eq=False)
class Chain:
    """Draws (S, d) in the target's coordinates, nearly independent, and how they came about."""

    draws: Array
    diagnostics: Diagnostics


def run(
    target: Target,
    mixture: Mixture,
    start: Array,
    state: np.random.RandomState,
    *,
    draws: int,
    budget: int,
    progress: Callable[[Progress], None] | None = None,
) -> Chain:
    """Sample from where the walkers stand.

    Parameters
    ----------
    target : Target
    mixture : Mixture
        Covers the target; its first peak gives the units.
    start : (W, d)
        Where the target is finite.
    state : numpy.random.RandomState
        All the randomness there is.
    draws : int
        Effective draws wanted.
    budget : int
        Steps of the ensemble allowed.
    progress : callable, optional
        Told now and then.
    """
    centre, root = mixture.peaks[0].centre, mixture.peaks[0].root
    inverse = np.linalg.inv(root)

    def to_theta(y: Array) -> Array:
        return centre + y @ root.T

    def to_units(theta: Array) -> Array:
        return (theta - centre) @ inverse.T

    def jump(y: Array) -> tuple[Array, Array]:
        image, log_jacobian = target.mirrored(to_theta(y))
        return to_units(image), log_jacobian

    moves: list[tuple[emcee.moves.Move, float]] = [
        (DEMove(), 0.6),
        (SnookerMove(), 0.15),
        (
            IndependenceMove(
                lambda random, n: to_units(mixture.draw(random, n)), lambda y: mixture.log_density(to_theta(y))
            ),
            0.25,
        ),
    ]
    if target.has_mirror:
        moves.append((InvolutionMove(jump), 0.25))

    def log_density(y: Array) -> Array:
        return target(to_theta(y))

    sampler = emcee.EnsembleSampler(len(start), target.dimension, log_density, vectorize=True, moves=moves)
    # emcee wraps the function so as to print all parameters when it raises, at a Ctrl-C too: a library does not print.
    vars(sampler)["log_prob_fn"] = log_density
    at: emcee.State | None = emcee.State(to_units(start), random_state=state.get_state())
    stopped, tau, steps = Stop.BUDGET, np.inf, 0
    try:
        while steps < budget:
            ahead = min(CHECK_EVERY, budget - steps)
            sampler.run_mcmc(at, ahead, skip_initial_state_check=True)
            at, steps, before = None, steps + ahead, tau
            path = np.asarray(sampler.get_chain())
            tau = autocorrelation_time(path)
            effective = _effective(_kept(path, tau)[0])
            if progress is not None:
                progress(Progress(effective, draws, steps, budget))
            long_enough = steps > TIMES * tau and abs(tau - before) < STEADY * tau and effective >= draws
            if long_enough and split_r_hat(path[int(BURN_IN * tau) :]) < R_HAT_LIMIT:
                stopped = Stop.CONVERGED
                break
    except KeyboardInterrupt:
        stopped = Stop.INTERRUPTED
    return _summed_up(sampler, start, to_theta, stopped)


def _kept(path: Array, tau: float) -> tuple[Array, int, int]:
    """The steps that are kept, (K, W, d): after the burn-in, the last of each autocorrelation time; both in steps."""
    burn_in = min(math.ceil(BURN_IN * tau), len(path) // 2)
    thin = min(math.ceil(tau), len(path) - burn_in)
    return path[burn_in:][::-1][::thin][::-1], burn_in, thin


def _effective(kept: Array) -> float:
    """How many independent draws those kept are worth."""
    return kept.shape[0] * kept.shape[1] / autocorrelation_time(kept)


def _summed_up(
    sampler: emcee.EnsembleSampler, start: Array, to_theta: Callable[[Array], Array], stopped: Stop
) -> Chain:
    steps = sampler.iteration
    if steps == 0:
        # The walkers' first places are draws by themselves.
        return Chain(start, Diagnostics(stopped, 0, 0, 1, len(start), 1.0, float(len(start)), np.inf, 0.0))
    path = np.asarray(sampler.get_chain())
    tau = autocorrelation_time(path)
    kept, burn_in, thin = _kept(path, tau)
    draws = to_theta(kept.reshape(-1, start.shape[1]))
    acceptance = float(np.mean(sampler.acceptance_fraction))
    diagnostics = Diagnostics(
        stopped, steps, burn_in, thin, len(start), tau, _effective(kept), split_r_hat(path[burn_in:]), acceptance
    )
    return Chain(draws, diagnostics)
