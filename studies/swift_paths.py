"""Paths of searches: over the objective's valley in the worked example, and how their error falls with the work."""

import itertools
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.executors import ordered_map
from planeopt.formulations import Penalty, Problem
from planeopt.nlp import Nlp
from planeopt.solvers import Ipopt, Solver, Sqp, Swift
from planeopt.solvers.base import Found
from studies.study import Mode
from studies.swift_problems import Case, apart, problem_of, start_of, truth_of
from studies.swift_runs import BUDGET, DEFAULT, READINGS, SCHEDULES, STARTS, minimiser

Array = NDArray[np.float64]

NOISE_PX = 0.3
CASES: dict[Mode, tuple[int, ...]] = {"full": (0, 1, 2, 4, 6), "quick": (0,)}
TOLERANCES: dict[Mode, tuple[float, ...]] = {
    "full": tuple(10.0**-i for i in range(1, 13)),
    "quick": (1e-3, 1e-10),
}

GRID: dict[Mode, tuple[int, int, int]] = {"full": (61, 46, 180), "quick": (13, 10, 24)}
DEPTHS_MM = (25.0, 320.0)
TILTS_DEG = (0.0, 85.0)
_MOST_ROWS = 150
"""Of a path: every so many iterations, and the last of each stage."""


@dataclass(frozen=True)
class WorkRow:
    """How far a search is from the minimiser, and from the truth, after so much work.

    Attributes
    ----------
    problem, start, method : str
    tolerance : float
        Of the simplex, whose searches end there; of IPOPT and SQP nothing: their rows are the iterates of one search.
    iteration : int
    calls : int
        Values, gradients and Hessians asked for, one each; of an iterate of IPOPT and SQP its share of the whole.
    to_minimiser, to_truth : float
        Relative in depth, or rad.
    """

    problem: str
    start: str
    method: str
    tolerance: float
    iteration: int
    calls: int
    to_minimiser: float
    to_truth: float


@dataclass(frozen=True)
class PathRow:
    """An iterate in the worked example, noise of 0.3 px, from the paper's start; of SWIFT the simplex's best vertex."""

    method: str
    weight: float
    iteration: int
    R_mm: float
    z_L_mm: float
    alpha_deg: float
    beta_deg: float


@dataclass(frozen=True)
class ValleyRow:
    """The least sum of the ten squared residuals over beta, at a depth and a tilt, the spot on the beam.

    Nothing where no such plane can be seen.
    """

    z_L_mm: float
    alpha_deg: float
    least_sum: float


# --- Error against work -----------------------------------------------------------------------------------------------


def accuracies(mode: Mode, executor: Executor | None) -> list[WorkRow]:
    """Search (29) with J = 0 by simplexes of falling tolerance, and by IPOPT and SQP."""
    work = [(index, where, TOLERANCES[mode]) for index in CASES[mode] for where in STARTS]
    return list(itertools.chain.from_iterable(ordered_map(_accuracy, work, executor)))


def _accuracy(work: tuple[int, str, tuple[float, ...]]) -> list[WorkRow]:
    index, where, tolerances = work
    case, reading = Case(index, NOISE_PX), READINGS[0]
    problem = problem_of(case)
    nlp = Penalty(reading).build(problem, start_of(problem, where))
    best = minimiser(case, reading, 1.0)
    least, truth = best.nlp.plane(best.x), truth_of(index).plane

    def row(method: str, tolerance: float, iteration: int, calls: int, plane: Array) -> WorkRow:
        return WorkRow(case.name, where, method, tolerance, iteration, calls, apart(plane, least), apart(plane, truth))

    rows = []
    for name in ("1", DEFAULT):
        for tolerance in tolerances:
            weights = SCHEDULES[name]
            found = Swift(weights, tolerance, BUDGET // len(weights)).solve(nlp)
            effort = found.effort
            rows.append(
                row(f"Swift, {name}", tolerance, effort.iterations, effort.evaluations, found.nlp.plane(found.x))
            )
    for solver in (Ipopt(record=True), Sqp(record=True)):
        found = solver.solve(nlp.penalised(1.0))
        rows += [row(solver.name, np.nan, i, calls, plane) for i, calls, plane in _iterates(found)]
    return rows


def _iterates(found: Found) -> Iterator[tuple[int, int, Array]]:
    """Number, calls until then and plane of each iterate, and of the answer."""
    path, effort = found.trace.x, found.effort
    if path is None:
        raise ValueError("the search kept no iterates")
    total = effort.evaluations + effort.derivative_evaluations
    last = max(effort.iterations, len(path))
    for i, x in enumerate(path):
        yield i, round(total * (i + 1) / (last + 1)), found.nlp.plane(x)
    yield last, total, found.nlp.plane(found.x)


# --- Over the valley --------------------------------------------------------------------------------------------------


def paths() -> list[PathRow]:
    """Iterates from the paper's start: SWIFT in both readings, and IPOPT with J = 0."""
    problem = problem_of(Case(0, NOISE_PX))
    start = start_of(problem, "paper's")
    rows: list[PathRow] = []
    for reading in READINGS:
        nlp = Penalty(reading).build(problem, start)
        rows += _path(f"Swift, {reading}", Swift(SCHEDULES[DEFAULT], record=True), nlp, SCHEDULES[DEFAULT])
    return rows + _path("Ipopt, printed", Ipopt(record=True), Penalty().build(problem, start).penalised(1.0), (1.0,))


def _path(name: str, solver: Solver, nlp: Nlp, weights: tuple[float, ...]) -> list[PathRow]:
    trace = solver.solve(nlp).trace
    if trace.x is None:
        raise ValueError("the search kept no iterates")
    every = max(1, len(trace.x) // _MOST_ROWS)
    ends = set(np.flatnonzero(np.diff(trace.stage, append=trace.stage[-1] + 1)).tolist())
    kept = [i for i in range(len(trace.x)) if i % every == 0 or i in ends]
    at = [(0, 0, nlp.start), *((i + 1, int(trace.stage[i]), trace.x[i]) for i in kept)]
    return [
        PathRow(name, weights[stage], i, float(x[0]), float(x[1]), *(float(v) for v in np.degrees(_folded(x[2:]))))
        for i, stage, x in at
    ]


def _folded(angles: Array) -> tuple[float, float]:
    """``(alpha, beta)`` with ``alpha >= 0`` and ``-180 < beta <= 180`` deg, rad."""
    alpha, beta = float(np.remainder(angles[0] + np.pi / 2, np.pi) - np.pi / 2), float(angles[1])
    beta = beta + np.pi if alpha < 0 else beta
    return abs(alpha), float(np.pi - np.remainder(np.pi - beta, 2 * np.pi))


def valley(mode: Mode) -> list[ValleyRow]:
    """The sum of the ten squared residuals over depth and tilt, R on the beam and beta at its best."""
    problem = problem_of(Case(0, NOISE_PX))
    n_depths, n_tilts, n_turns = GRID[mode]
    z_L = np.geomspace(*DEPTHS_MM, n_depths)[:, None, None]
    alpha = np.radians(np.linspace(*TILTS_DEG, n_tilts))[None, :, None]
    step = 2 * np.pi / n_turns
    beta: Array = np.asarray(step * np.arange(n_turns) - np.pi, dtype=float)[None, None, :]
    for _ in range(_FINER):
        total = _sum_of_squares(problem, z_L, alpha, beta)
        # Round the best of them again, by steps of a tenth.
        centre = np.take_along_axis(np.broadcast_to(beta, total.shape), np.argmin(total, axis=2)[:, :, None], axis=2)
        step /= 10
        beta = np.asarray(centre + step * np.arange(-10, 11), dtype=float)
    best = _sum_of_squares(problem, z_L, alpha, beta).min(axis=2)
    best = np.where(np.isfinite(best), best, np.nan)
    tilts = np.degrees(alpha.ravel())
    return [
        ValleyRow(float(z), float(tilt), float(value))
        for z, values in zip(z_L.ravel(), best, strict=True)
        for tilt, value in zip(tilts, values, strict=True)
    ]


_FINER = 2


def _sum_of_squares(problem: Problem, z_L: Array, alpha: Array, beta: Array) -> Array:
    """Of the ten residuals, the spot on the beam; infinite where the plane cannot be seen."""
    v = eq.PaperVariables(problem.setup.r / np.cos(alpha), z_L, alpha, beta)
    rows = eq.ten_residuals(np, v, problem.setup, problem.B.tolist())
    total = sum((np.square(row) for row in rows), np.zeros(np.broadcast_shapes(z_L.shape, alpha.shape, beta.shape)))
    return np.where((eq.in_front(np, v, problem.setup) > 0) & (eq.lit_side(np, v, problem.setup) > 0), total, np.inf)
