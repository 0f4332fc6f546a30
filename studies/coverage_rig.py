"""A calibration that knows the beam's offset to 0.04 mm: what its covariance is for."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from planeopt.estimation import solve_batch
from planeopt.executors import ordered_map
from planeopt.posterior import Posterior, Prior
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from studies.coverage_checks import Checks, check
from studies.coverage_draws import draw_spot, draw_truth
from studies.coverage_points import sample
from studies.draws import Range

COUNTED, IGNORED = "counted", "ignored"
OFFSET_SIGMA_MM = 0.04
NOISE_PX = Range(0.1, 0.3)
POINTS = 80
PRIOR = Prior(depth_radii=(20.0, 40.0))


@dataclass(frozen=True, kw_only=True)
class WrongRigRow(Checks):
    """One point set, with the calibration's covariance counted or ignored.

    Attributes
    ----------
    rig : str
    draw : int
    q_low95, q_high95 : float
        Ends of the posterior's 95 % interval of q, less the true q; NaN where there is none.
    """

    rig: str
    draw: int
    q_low95: float
    q_high95: float


def nominal_rig() -> Rig:
    """Return a rig whose calibration left nothing uncertain but e_x and e_y, by 0.04 mm each."""
    camera = Camera((1600, 1200), 2500.0, 2500.0, 800.0, 600.0, (0.0, 0.0, 0.0, 0.0, 0.0))
    covariance = RigCovariance(("e_x", "e_y"), OFFSET_SIGMA_MM**2 * np.eye(2))
    return Rig(camera, Beam(8.0, (24.0, 18.0), (0.0, 0.0, 1.0)), covariance=covariance)


@dataclass(frozen=True)
class Job:
    """Sets from one number up to another; those below a third are sampled as well as solved."""

    first: int
    end: int
    sampled: int


_PER_JOB = 10


def run_wrong_rig(sets: int, sampled: int, executor: Executor | None) -> list[WrongRigRow]:
    """Simulate so many sets, each before a rig of its own, and measure each with and without the covariance."""
    jobs = [Job(first, min(first + _PER_JOB, sets), sampled) for first in range(0, sets, _PER_JOB)]
    return [row for rows in ordered_map(measure, jobs, executor) for row in rows]


def measure(job: Job) -> Sequence[WrongRigRow]:
    """Return two rows for each set of a job."""
    nominal = nominal_rig()
    numbers = range(job.first, job.end)
    truths, spots = [], []
    for draw in numbers:
        rng = np.random.default_rng([74, draw])
        truths.append(draw_truth(nominal, PRIOR, rng))
        spots.append(draw_spot(truths[-1], arc=1.0, points=POINTS, sigma_px=NOISE_PX.draw_log(rng), rng=rng))
    rows = []
    for name, rig in ((COUNTED, nominal), (IGNORED, replace(nominal, covariance=None))):
        solved = solve_batch(spots, rig)
        for i, (draw, truth, spot) in enumerate(zip(numbers, truths, spots, strict=True)):
            true = truth.quantities
            exact = name == IGNORED
            posterior = sample(spot, nominal, PRIOR, draw, condition_on_rig=exact) if draw < job.sampled else None
            low, high = _interval(posterior)
            rows.append(
                WrongRigRow(
                    **vars(check(solved.row(i), posterior, true, draw)),
                    rig=name,
                    draw=draw,
                    q_low95=low - true["q"],
                    q_high95=high - true["q"],
                )
            )
    return rows


def _interval(posterior: Posterior | None) -> tuple[float, float]:
    interval = None if posterior is None else posterior.summary("q")
    return (np.nan, np.nan) if interval is None else (interval.low95, interval.high95)
