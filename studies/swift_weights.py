"""What the weight of (29) does: to the minimiser, the beam's equations and the error, and to where a simplex ends."""

import itertools
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, Penalty
from planeopt.solvers import Ipopt, Swift
from studies.study import Mode
from studies.swift_problems import Case, apart, problem_of, start_of, truth_of
from studies.swift_runs import READINGS, afresh, follow, laser_violation, minimiser

Array = NDArray[np.float64]

WEIGHTS: dict[Mode, tuple[float, ...]] = {
    "full": tuple(10.0**i for i in range(-12, 5)),
    "quick": (1e-12, 1e-8, 1e-4, 1.0, 1e4),
}
CASES: dict[Mode, tuple[int, ...]] = {"full": (0, 1, 2, 4), "quick": (0,)}
DRAWS: dict[Mode, int] = {"full": 40, "quick": 2}
NOISE_PX = 0.3
_CHUNK = 10

TOLERANCE_WEIGHTS = tuple(10.0**i for i in range(-4, 11, 2))
VALUE_TOL = 1e-6
ALMOST_ANY = 0.5
"""A simplex's size that leaves the decision to its values."""
_ASIDE = 1.05
"""Times the closed form's unknowns: a start that is not itself the answer, and near enough to end there."""


@dataclass(frozen=True)
class WeightRow:
    """Minimisers of (29) at a weight, over draws of noise.

    Attributes
    ----------
    problem, reading : str
    weight : float
    draws : int
    most_from_weight_1 : float
        Farthest that a draw's plane is from that at weight 1: relative in depth, or rad.
    laser_violation : float
        Median of ``|R cos(alpha) - r| / r``.
    rms_error : float
        RMS distance from the true plane: relative in depth, or rad.
    over_constrained : float
        Over that of `Constrained`, which weighs the image block by its covariance and keeps the beam's equation.
    """

    problem: str
    reading: str
    weight: float
    draws: int
    most_from_weight_1: float
    laser_violation: float
    rms_error: float
    over_constrained: float


@dataclass(frozen=True)
class ToleranceRow:
    """A search with J = 0 that ends where its simplex's values differ by less than `VALUE_TOL`.

    Attributes
    ----------
    problem : str
    weight : float
        The only one of its schedule.
    evaluations : int
    to_minimiser, to_truth : float
        Relative in depth, or rad.
    """

    problem: str
    weight: float
    evaluations: int
    to_minimiser: float
    to_truth: float


@dataclass(frozen=True)
class _Draw:
    """One draw's planes: distances from that at weight 1 and from the truth, and violations, by reading and weight."""

    moved: Array
    violation: Array
    error: Array
    constrained: float


def weigh(mode: Mode, executor: Executor | None) -> list[WeightRow]:
    """Follow the minimisers over the weights."""
    weights, draws = WEIGHTS[mode], DRAWS[mode]
    starts = range(0, draws, _CHUNK)
    work = [(index, range(i, min(i + _CHUNK, draws)), weights) for index in CASES[mode] for i in starts]
    found = ordered_map(_draws, work, executor)
    rows = []
    for index in CASES[mode]:
        own = list(itertools.chain.from_iterable(itertools.islice(found, len(starts))))
        best = float(np.sqrt(np.mean([draw.constrained**2 for draw in own])))
        for (i, reading), (j, weight) in itertools.product(enumerate(READINGS), enumerate(weights)):
            rms = float(np.sqrt(np.mean([draw.error[i, j] ** 2 for draw in own])))
            moved = max(float(draw.moved[i, j]) for draw in own)
            violation = float(np.median([draw.violation[i, j] for draw in own]))
            name = Case(index, NOISE_PX).name
            rows.append(WeightRow(name, reading, weight, len(own), moved, violation, rms, rms / best))
    return rows


def _draws(work: tuple[int, range, tuple[float, ...]]) -> list[_Draw]:
    index, draws, weights = work
    return [_draw(index, draw, weights) for draw in draws]


def _draw(index: int, draw: int, weights: tuple[float, ...]) -> _Draw:
    problem, truth = problem_of(Case(index, NOISE_PX), draw), truth_of(index).plane
    start = start_of(problem, "closed form")
    moved, violation, error = (np.empty((len(READINGS), len(weights))) for _ in range(3))
    for i, reading in enumerate(READINGS):
        nlp = Penalty(reading).build(problem, start)
        # With J = 0 each weight's search begins anew, so that an answer that does not move has not just been kept.
        ends = afresh(nlp, [1.0, *weights]) if reading == "printed" else follow(nlp, [1.0, *weights])
        at_1 = ends[1.0].nlp.plane(ends[1.0].x)
        for j, weight in enumerate(weights):
            plane = ends[weight].nlp.plane(ends[weight].x)
            moved[i, j], error[i, j] = apart(plane, at_1), apart(plane, truth)
            violation[i, j] = laser_violation(ends[weight])
    constrained = Ipopt().solve(Constrained().build(problem, start))
    return _Draw(moved, violation, error, apart(constrained.nlp.plane(constrained.x), truth))


def tolerances(mode: Mode, executor: Executor | None) -> list[ToleranceRow]:
    """Search by weights of which each is the only one, until the values agree."""
    return list(itertools.chain.from_iterable(ordered_map(_tolerances, CASES[mode], executor)))


def _tolerances(index: int) -> list[ToleranceRow]:
    case, reading = Case(index, NOISE_PX), READINGS[0]
    problem, truth = problem_of(case), truth_of(index).plane
    nlp = Penalty(reading).build(problem, start_of(problem, "closed form"))
    nlp = replace(nlp, start=_ASIDE * nlp.start)
    best = minimiser(case, reading, 1.0)
    rows = []
    for weight in TOLERANCE_WEIGHTS:
        found = Swift((weight,), ALMOST_ANY, value_tol=VALUE_TOL).solve(nlp)
        plane, evaluations = found.nlp.plane(found.x), found.effort.evaluations
        off = apart(plane, best.nlp.plane(best.x))
        rows.append(ToleranceRow(case.name, weight, evaluations, off, apart(plane, truth)))
    return rows
