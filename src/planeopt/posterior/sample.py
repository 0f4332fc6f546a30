"""From a spot and a rig to draws from the posterior of the plane."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.estimation import solve_problem
from planeopt.formulations.problem import Problem
from planeopt.posterior import chain
from planeopt.posterior.first_order import laplace_of
from planeopt.posterior.gaussian import compare
from planeopt.posterior.likelihood import Likelihood
from planeopt.posterior.prior import PlanePrior, Prior
from planeopt.posterior.prior_effect import prior_effect
from planeopt.posterior.proposal import Mixture, Peak, climb, resample
from planeopt.posterior.quantities import beams, quantities
from planeopt.posterior.result import Mode, Posterior
from planeopt.posterior.target import Target
from planeopt.rig import Rig
from planeopt.spot import Spot

Array = NDArray[np.float64]

_CANDIDATES = 2000

_LOOK_ROUND = 4000

# Effective draws among the candidates that make a mixture good enough, draws whose moments make it better, and when to
# leave it at that.
_ENOUGH, _MOMENTS, _MOST_PEAKS = 100, 60, 6

# A likelihood that falls by this from its top is beyond the 1e-6 quantile of chi-squared with 3 degrees of freedom.
_BEYOND = 15.3

# The width at which a search begins that knows nothing better: of log z_L, slopes and log scale.
_GUESS = 0.05


def sample_posterior(
    spot: Spot,
    rig: Rig,
    *,
    seed: int = 0,
    prior: PlanePrior | None = None,
    robust: float | None = None,
    condition_on_rig: bool = False,
    both_sides: bool = False,
    draws: int = 2000,
    budget: int = 20_000,
    progress: Callable[[chain.Progress], None] | None = None,
) -> Posterior:
    """Draw planes from the posterior, given a spot.

    Parameters
    ----------
    spot : Spot
        Boundary points in raw pixels, from `find_spot` or `read_points`.
    rig : Rig
        With a beam. Its covariance, where it has one, is part of the posterior.
    seed : int
        The same seed gives the same draws.
    prior : PlanePrior, optional
        `Prior()` unless given.
    robust : float, optional
        Degrees of freedom of Student's t for the points' noise, 4 for example; normal unless given.
    condition_on_rig : bool
        Take the rig as it stands, whatever its covariance.
    both_sides : bool
        The plane is translucent: the spot may be seen from either side, and both planes of its image are sampled.
    draws : int
        Effective independent draws wanted.
    budget : int
        Steps of the ensemble allowed.
    progress : callable, optional
        Called with a `Progress` now and then; an interrupt (Ctrl-C) ends sampling and returns what there is.

    Returns
    -------
    Posterior

    Raises
    ------
    InputError
        If spot, rig or an option cannot be used, five points come without a sigma, or the prior leaves out every plane
        that the spot allows.
    """
    problem = Problem.from_spot(spot, rig)
    found = sample_problem(
        problem,
        seed=seed,
        prior=prior,
        robust=robust,
        condition_on_rig=condition_on_rig,
        both_sides=both_sides,
        draws=draws,
        budget=budget,
        progress=progress,
    )
    return replace(found, flags=(*spot.flags, *found.flags))


def sample_problem(
    problem: Problem,
    *,
    seed: int = 0,
    prior: PlanePrior | None = None,
    robust: float | None = None,
    condition_on_rig: bool = False,
    both_sides: bool = False,
    draws: int = 2000,
    budget: int = 20_000,
    progress: Callable[[chain.Progress], None] | None = None,
) -> Posterior:
    """As `sample_posterior`, from a `Problem`: points on the laser-parallel image plane, in mm."""
    for name, value in (("seed", seed + 1), ("draws", draws), ("budget", budget)):
        if value < 1:
            raise InputError(f"{name} must be a whole number, {'0' if name == 'seed' else '1'} or more")
    prior = Prior() if prior is None else prior
    likelihood = Likelihood.of(problem, robust=robust, condition_on_rig=condition_on_rig)
    target = Target(likelihood, prior, both_sides)
    state = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))

    peaks = _peaks(target, problem, state)
    mixture = Mixture(target, peaks, prior if isinstance(prior, Prior) else Prior())
    mixture, candidates, log_likelihood, log_prior = _fitted(target, mixture, state)
    log_weights = -mixture.log_density(candidates)
    start = _walkers(target, candidates, log_likelihood + log_prior + log_weights, peaks[0], state)
    run = chain.run(target, mixture, start, state, draws=draws, budget=budget, progress=progress)

    planes, log_scale = target.planes(run.draws), target.log_scale(run.draws)
    rig_samples = likelihood.draw_rig(np.random.default_rng([seed, 1]), planes, log_scale)
    names = () if likelihood.rig is None else likelihood.rig.parameters
    values = quantities(planes, beams(problem, names, rig_samples))
    if log_scale is not None:
        values["noise_scale"] = np.exp(log_scale)
    samples = np.stack([values["z_L"], values["p"], values["q"]], axis=1)
    modes = _modes(target, planes, samples, run.diagnostics.ess)
    # Of two modes the heavier is compared: which of them it is, is the prior's to say.
    mine, near = target.lit(planes) == modes[0].lit_side, target.lit(target.planes(candidates)) == modes[0].lit_side
    laplace = laplace_of(
        target, problem, next((peak for peak in peaks if _lit(target, peak) == modes[0].lit_side), None)
    )
    return Posterior(
        samples=samples,
        rig_samples=rig_samples,
        rig_parameters=names,
        quantities=values,
        laplace=laplace,
        agreement_with_laplace=compare(laplace, samples[mine], run.diagnostics.ess * modes[0].weight),
        diagnostics=run.diagnostics,
        prior=prior,
        prior_sentence=prior.sentence(problem.setup.r),
        prior_effect=prior_effect(
            target, run.draws[mine], (log_likelihood + log_weights)[near], ~np.isfinite(log_prior[near])
        ),
        scale=likelihood.scale,
        robust=likelihood.robust,
        modes=modes,
        flags=problem.flags,
    )


def _peaks(target: Target, problem: Problem, state: np.random.RandomState) -> tuple[Peak, ...]:
    """Tops of the likelihood: from the solved plane, from the best of many draws, and mirrored.

    The first is the one that the posterior favours, where the prior allows any of them.
    """
    starts: list[tuple[Array, Array]] = []
    guess = _GUESS * np.eye(target.dimension)
    solution = solve_problem(problem)
    if solution.pose is not None:
        plane = np.array([solution.pose.z_L + problem.axial_shift, *solution.pose.slopes])
        root = guess.copy()
        if solution.uncertainty is not None and np.isfinite(solution.uncertainty.spot).all():
            scale = np.array([1 / plane[0], 1.0, 1.0])
            root[:3, :3] = scale[:, None] * np.linalg.cholesky(solution.uncertainty.spot)
        starts.append((_theta(target, plane), root))
    wide = Prior(depth_radii=(1.0, 1e4)).draw_unseen(state, _LOOK_ROUND, problem.setup)
    thetas = np.column_stack([np.log(wide[:, 0]), wide[:, 1:], np.zeros((len(wide), target.dimension - 3))])
    # For a look round the nominal rig will do.
    values = replace(target, likelihood=replace(target.likelihood, rig=None)).log_likelihood(thetas)
    starts.append((thetas[int(np.argmax(values))], guess))
    found = [
        climb(target.log_likelihood, start, root)
        for start, root in starts
        if np.isfinite(target.log_likelihood(start[None])[0])
    ]
    if not found:
        raise InputError("no plane before the camera has a spot anywhere near these points")
    if target.has_mirror:
        best = max(found, key=lambda peak: peak.height)
        image = target.mirrored(best.centre[None])[0][0]
        found.append(climb(target.log_likelihood, image, best.root))
    found.sort(key=lambda peak: -peak.height)
    kept: list[Peak] = []
    for peak in found:
        apart = all(np.linalg.norm(np.linalg.solve(other.root, peak.centre - other.centre)) > 1 for other in kept)
        if apart and peak.height > found[0].height - _BEYOND:
            kept.append(peak)
    log_prior = _checked(target.log_prior(np.stack([peak.centre for peak in kept])))
    order = np.argsort(-(log_prior + [peak.height for peak in kept]), kind="stable")
    return tuple(kept[i] for i in order)


def _fitted(target: Target, mixture: Mixture, state: np.random.RandomState) -> tuple[Mixture, Array, Array, Array]:
    """A mixture that covers the posterior, draws from it, and their log likelihoods and log priors.

    The peaks are the likelihood's. Where few of their draws count, as where a bound of the prior cuts the peak off, the
    draws that do count say where the posterior is: a law with their moments is added, once and again.
    """
    first = True
    while True:
        candidates = mixture.draw(state, _CANDIDATES)
        log_likelihood, log_prior = target.log_likelihood(candidates), _checked(target.log_prior(candidates))
        if first:
            _refuse_excluded(target, mixture.peaks, log_likelihood, log_prior)
        log_weights = log_likelihood + log_prior - mixture.log_density(candidates)
        weights = np.exp(log_weights - np.max(log_weights))
        if np.sum(weights) ** 2 > _ENOUGH * np.sum(weights**2) or len(mixture.peaks) > _MOST_PEAKS:
            return mixture, candidates, log_likelihood, log_prior
        found = candidates[resample(state, log_weights, _MOMENTS)]
        spread = np.cov(found, rowvar=False) + 1e-4 * mixture.peaks[0].covariance
        root = np.asarray(np.linalg.cholesky(spread), dtype=float)
        added = Peak(np.mean(found, axis=0), root, mixture.peaks[0].height, False)
        mixture, first = replace(mixture, peaks=(*mixture.peaks, added)), False


def _lit(target: Target, peak: Peak) -> bool:
    return bool(target.lit(target.planes(peak.centre[None]))[0])


def _theta(target: Target, plane: Array) -> Array:
    return np.array([math.log(max(plane[0], 1e-300)), *plane[1:], *([0.0] * (target.dimension - 3))])


def _checked(log_prior: Array) -> Array:
    if np.isnan(log_prior).any() or np.max(log_prior) == np.inf:
        raise InputError("the prior's log density must be a number, or minus infinity, for every plane")
    return log_prior


def _refuse_excluded(target: Target, peaks: tuple[Peak, ...], log_likelihood: Array, log_prior: Array) -> None:
    """Say it where no draw that the prior allows is anywhere near what the spot says."""
    allowed = np.isfinite(log_prior)
    peak = max(peaks, key=lambda peak: peak.height)
    if allowed.any() and np.max(log_likelihood[allowed]) > peak.height - _BEYOND:
        return
    z_L, p, q = target.planes(peak.centre[None])[0].tolist()
    tilt = math.degrees(math.atan(math.hypot(p, q)))
    raise InputError(
        f"the prior leaves out every plane that the spot allows (the likeliest has z_L = {z_L:.5g} mm, "
        f"{z_L / target.likelihood.setup.r:.4g} radii of the beam, and a tilt of {tilt:.4g} deg): widen its bounds"
    )


def _walkers(target: Target, candidates: Array, log_weights: Array, peak: Peak, state: np.random.RandomState) -> Array:
    """Walkers where the posterior is: draws from the mixture, drawn again by their weights."""
    usable = int(np.sum(np.isfinite(log_weights)))
    chosen = candidates[resample(state, log_weights, min(chain.WALKERS, usable))]
    while len(chosen) < chain.WALKERS:
        near = chosen[state.randint(len(chosen), size=chain.WALKERS)]
        moved = near + 0.1 * state.standard_normal(near.shape) @ peak.root.T
        chosen = np.concatenate([chosen, moved[np.isfinite(target(moved))]])[: chain.WALKERS]
    return chosen


def _modes(target: Target, planes: Array, samples: Array, ess: float) -> tuple[Mode, ...]:
    lit = target.lit(planes)
    found = []
    for side in (True, False):
        mine = lit == side
        weight = float(np.mean(mine))
        if mine.any():
            error = math.sqrt(weight * (1 - weight) / ess)
            found.append(Mode(weight, error, np.median(samples[mine], axis=0), side))
    return tuple(sorted(found, key=lambda mode: -mode.weight))
