"""SWIFT by schedule, reading, start and problem, beside IPOPT and SQP on the same penalised programme."""

import itertools
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.executors import ordered_map
from planeopt.formulations import Penalty
from planeopt.formulations.ten import Reading
from planeopt.nlp import Nlp
from planeopt.solvers import Ipopt, Solver, Sqp, Swift
from planeopt.solvers.base import Found
from studies.study import Mode
from studies.swift_problems import Case, apart, problem_of, start_of, truth_of

Array = NDArray[np.float64]

READINGS: tuple[Reading, ...] = ("printed", "image objective")
STARTS = ("closed form", "paper's")
NOISES_PX = (0.0, 0.3)
RANDOM_CASES: dict[Mode, int] = {"full": 9, "quick": 0}

SCHEDULES: dict[str, tuple[float, ...]] = {
    "1": (1.0,),
    "1e5": (1e5,),
    "1, 1e5": (1.0, 1e5),
    "1 to 1e5 by 10": tuple(10.0**i for i in range(6)),
    "1 to 1e5 by 3.2": tuple(10.0 ** (i / 2) for i in range(11)),
    "1e-3 to 1e5 by 10": tuple(10.0**i for i in range(-3, 6)),
    "1e3 to 1e5 by 10": tuple(10.0**i for i in range(3, 6)),
}
"""Constant, fast, geometric, slow, from a light start, from a heavy one; the fourth is the default of `Swift`."""

DEFAULT = "1 to 1e5 by 10"
AT_ONCE = "1e5"
"""The weight of the programme that IPOPT and SQP search: the last of the others."""
BUDGET = 24_000
"""Evaluations for all stages of a schedule together."""

AT_MINIMISER = 1e-6
"""Planes this close, relative in depth or rad, are the same: a search's own tolerance is a thousand times smaller."""


@dataclass(frozen=True)
class RunRow:
    """A search.

    Attributes
    ----------
    problem : str
    noise_px : float
    reading : str
        Of (29): "printed", J = 0 and all ten penalised; "image objective", the image block as J and the laser block
        penalised.
    start : str
    method, schedule : str
        The schedule's last weight is that of the programme; IPOPT and SQP search that programme at once.
    stages : int
    end : str
        "minimiser"; "local" for another point that fulfils the conditions of a minimum; "none" for no minimum.
    iterations, evaluations, first_derivatives, second_derivatives : int
    to_minimiser, to_truth : float
        How far the plane found is from the programme's minimiser, and from the true plane: the larger of the depths'
        difference over the depth and the angle in rad.
    minimiser_to_truth : float
    laser_violation : float
        ``|R cos(alpha) - r| / r``.
    """

    problem: str
    noise_px: float
    reading: str
    start: str
    method: str
    schedule: str
    stages: int
    end: str
    iterations: int
    evaluations: int
    first_derivatives: int
    second_derivatives: int
    to_minimiser: float
    to_truth: float
    minimiser_to_truth: float
    laser_violation: float


def cases_of(mode: Mode) -> list[Case]:
    """The worked example and random ones, each exact and with noise."""
    noises = NOISES_PX if mode == "full" else NOISES_PX[1:]
    return [Case(i, noise) for i in range(RANDOM_CASES[mode] + 1) for noise in noises]


def run_all(mode: Mode, executor: Executor | None) -> list[RunRow]:
    """Search every case by every schedule, from both starts, in both readings."""
    schedules = tuple(SCHEDULES) if mode == "full" else ("1", "1e5", DEFAULT)
    work = [Job(case, reading, schedules) for case in cases_of(mode) for reading in READINGS]
    return list(itertools.chain.from_iterable(ordered_map(run_case, work, executor)))


@dataclass(frozen=True)
class Job:
    """A case to search in one reading, by schedules."""

    case: Case
    reading: Reading
    schedules: tuple[str, ...]


def run_case(job: Job) -> list[RunRow]:
    """All searches of a case in one reading."""
    case, reading, schedules = job.case, job.reading, job.schedules
    problem = problem_of(case)
    rows = []
    for where in STARTS:
        nlp = Penalty(reading).build(problem, start_of(problem, where))
        for name in schedules:
            weights = SCHEDULES[name]
            swift = Swift(weights, max_evaluations=BUDGET // len(weights))
            rows.append(_row(case, reading, where, name, swift.solve(nlp), len(weights)))
        for solver in (Ipopt(), Sqp()):
            (weight,) = SCHEDULES[AT_ONCE]
            rows.append(_row(case, reading, where, AT_ONCE, solver.solve(nlp.penalised(weight)), 1, solver))
    return rows


def _row(
    case: Case, reading: Reading, where: str, schedule: str, found: Found, stages: int, solver: Solver | None = None
) -> RunRow:
    truth = truth_of(case.index)
    best = minimiser(case, reading, float(found.nlp.parameters[-1]))
    least, plane = best.nlp.plane(best.x), found.nlp.plane(found.x)
    off, effort = apart(plane, least), found.effort
    end = "minimiser" if off <= AT_MINIMISER else "local" if found.kkt.ok else "none"
    return RunRow(
        case.name,
        case.noise_px,
        reading,
        where,
        "Swift" if solver is None else solver.name,
        schedule,
        stages,
        end,
        effort.iterations,
        effort.evaluations,
        effort.first_derivatives,
        effort.second_derivatives,
        off,
        apart(plane, truth.plane),
        apart(least, truth.plane),
        laser_violation(found),
    )


def laser_violation(found: Found) -> float:
    """``|R cos(alpha) - r| / r`` of a search in the paper's variables."""
    r = float(found.nlp.parameters[3])
    return abs(float(found.x[0] * np.cos(found.x[2])) - r) / r


def minimiser(case: Case, reading: Reading, weight: float, draw: int = 0) -> Found:
    """The minimiser of (29) at a weight, by Newton steps from the closed form's."""
    problem = problem_of(case, draw)
    nlp = Penalty(reading).build(problem, start_of(problem, "closed form"))
    return follow(nlp, [weight])[weight]


def follow(nlp: Nlp, weights: list[float]) -> dict[float, Found]:
    """Minimisers of (29) at weights, each found by SQP from that at the weight before, the first from weight 1.

    Raises
    ------
    RuntimeError
        If one of them does not fulfil the conditions of a minimum, as computed again.
    """
    ends: dict[float, Found] = {}
    for part in ([w for w in sorted(weights) if w >= 1], [w for w in sorted(weights, reverse=True) if w < 1]):
        start = _newton(nlp.penalised(1.0)).x if part else nlp.start
        for weight in part:
            ends[weight] = _newton(replace(nlp.penalised(weight), start=start))
            start = ends[weight].x
    return ends


def afresh(nlp: Nlp, weights: list[float]) -> dict[float, Found]:
    """Minimisers of (29) at weights, each found by SQP from the programme's start; raises as `follow` does."""
    return {weight: _newton(nlp.penalised(weight)) for weight in weights}


def _newton(nlp: Nlp) -> Found:
    for solver in (Sqp(), Ipopt()):
        found = solver.solve(nlp)
        if found.kkt.ok:
            return found
    raise RuntimeError(f"no minimum of {nlp.model.name} was found from {nlp.start}: {found.report}")
