"""Simulated point sets: planes of the prior, random rigs, full and short arcs, much and little noise."""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from planeopt.conic import geometric_from_conic, is_ellipse
from planeopt.errors import InputError
from planeopt.estimation import solve_batch
from planeopt.executors import ordered_map
from planeopt.formulations import Problem
from planeopt.posterior import Posterior, Prior, sample_posterior
from planeopt.rig import Rig
from planeopt.spot import Spot
from studies.coverage_checks import Checks, check
from studies.coverage_draws import Truth, draw_rig, draw_spot, draw_truth
from studies.draws import Range

ARCS = (1.0, 0.4)
POINTS = (40, 80)
NOISE_PX = Range(0.1, 1.0)

SMALLEST_PX = 8.0
"""Shorter semi-axis of the measured ellipse; below it there is hardly a boundary to be found in an image."""

LARGEST_CURVATURE = 0.05
"""Of the measured ellipse, times the points' sigma: beyond it the noise is no longer small against the spot, and
distances from the boundary lose their meaning. 20 sigma for the radius of a circle."""

STEPS = 200
"""Of the ensemble. The walkers begin at draws by importance, nearly right already; 40 of them give some hundreds of
effective draws in so many steps (`effective_draws`), of which 199 are ranked. In 150 steps two sets of a thousand fall
short of these."""


@dataclass(frozen=True, kw_only=True)
class SetRow(Checks):
    """One point set.

    Attributes
    ----------
    rig, draw : int
        Which rig, which set of it.
    covariance : str
        "given": the rig that there is was drawn from the calibration's covariance; "none": it is the given one.
    arc : float
        Share of the turn that the points cover.
    points : int
    sigma_px : float
    passed_over : int
        Sets before this one that were too small or not solvable by what was measured of them: by the data alone, so
        that the posterior's claims hold for what is left as well.
    effective_draws : float
        Of the posterior's chain; NaN where none was run.
    prior_dominated : int
        Whether the posterior says that it is.
    """

    rig: int
    draw: int
    covariance: str
    arc: float
    points: int
    sigma_px: float
    passed_over: int
    effective_draws: float
    prior_dominated: int


@dataclass(frozen=True)
class Job:
    """So many sets of one rig, the first few of which are sampled as well as solved."""

    rig: int
    sets: int
    sampled: int


def run_points(rigs: int, sets: int, sampled: int, executor: Executor | None) -> list[SetRow]:
    """Simulate and solve so many sets of each of so many rigs, and sample the first few of each."""
    jobs = [Job(rig, sets, sampled) for rig in range(rigs)]
    return [row for rows in ordered_map(sets_of, jobs, executor) for row in rows]


@dataclass(frozen=True)
class Drawn:
    """A set that can be measured."""

    truth: Truth
    spot: Spot
    arc: float
    sigma_px: float
    passed_over: int


def sets_of(job: Job) -> list[SetRow]:
    """Return the sets of a job; every second rig has a covariance."""
    rng = np.random.default_rng([73, job.rig])
    rig, prior = draw_rig(rng, covariance=job.rig % 2 == 1), Prior()
    drawn = [draw_set(rig, prior, draw, rng) for draw in range(job.sets)]
    solved = solve_batch([each.spot for each in drawn], rig)
    rows = []
    for draw, each in enumerate(drawn):
        seed = job.rig * job.sets + draw
        truth = each.truth.quantities
        posterior = sample(each.spot, rig, prior, seed) if draw < job.sampled else None
        rows.append(
            SetRow(
                **vars(check(solved.row(draw), posterior, truth, seed)),
                rig=job.rig,
                draw=draw,
                covariance="none" if rig.covariance is None else "given",
                arc=each.arc,
                points=len(each.spot),
                sigma_px=each.sigma_px,
                passed_over=each.passed_over,
                effective_draws=float("nan") if posterior is None else posterior.diagnostics.ess,
                prior_dominated=int(posterior is not None and posterior.prior_dominated),
            )
        )
    return rows


def sample(spot: Spot, rig: Rig, prior: Prior, seed: int, *, condition_on_rig: bool = False) -> Posterior:
    """Return a posterior with as many draws as are needed here."""
    return sample_posterior(spot, rig, prior=prior, seed=seed, budget=STEPS, condition_on_rig=condition_on_rig)


def draw_set(rig: Rig, prior: Prior, draw: int, rng: np.random.Generator) -> Drawn:
    """Draw planes until the points of one can be measured, as far as the points themselves tell."""
    arc, passed_over = ARCS[draw % len(ARCS)], 0
    while True:
        truth, sigma_px = draw_truth(rig, prior, rng), NOISE_PX.draw_log(rng)
        points = int(rng.integers(*POINTS, endpoint=True))
        spot = draw_spot(truth, arc=arc, points=points, sigma_px=sigma_px, rng=rng)
        if measurable(spot, rig):
            return Drawn(truth, spot, arc, sigma_px, passed_over)
        passed_over += 1


def measurable(spot: Spot, rig: Rig) -> bool:
    """Whether the points determine an ellipse, large enough and of a curvature that is small against their noise."""
    try:
        problem = Problem.from_spot(spot, rig)
    except InputError:
        return False
    if problem.noise is None or not is_ellipse(problem.B):
        return False
    major, minor = geometric_from_conic(problem.B).semi_axes.tolist()
    sigma = np.sqrt(np.mean(np.trace(problem.noise, axis1=1, axis2=2)) / 2)
    pixel = problem.setup.f / rig.camera.fx
    return bool(minor >= SMALLEST_PX * pixel and sigma * major / minor**2 <= LARGEST_CURVATURE)
