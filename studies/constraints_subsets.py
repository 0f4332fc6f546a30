"""All 31 choices of (11)-(15) as hard rows: what IPOPT says, what they fix, and where searches with them end."""

import itertools
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.estimation import starts
from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, Problem, Start
from planeopt.nlp import Nlp
from planeopt.plane import SpotPose
from planeopt.ranks import independent_rows
from planeopt.solvers import Ipopt
from studies.constraints_forms import HardLaserRows, Rows
from studies.constraints_ranks import NOISE_MM, exact_problem
from studies.study import Mode

Array = NDArray[np.float64]

STARTS: dict[Mode, int] = {"full": 20, "quick": 2}
CHOICES: dict[Mode, tuple[Rows, ...]] = {
    "full": (*(rows for n in range(1, 6) for rows in itertools.combinations(range(5), n)), (5,)),
    "quick": ((1,), (0, 1), (0, 1, 2, 3, 4), (5,)),
}
_SEED = 15
_SAME = 1e-6
"""Relative, or rad: planes this close are the same."""
SINGULAR = 1e-10
"""Smallest over largest singular value of a KKT matrix of order 1."""
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class SubsetRow:
    """A choice of laser rows as hard constraints, in the worked example with noise of 0.3 px.

    Attributes
    ----------
    rows : str
    count : int
    also_hold_at_beta_deg : str
        Azimuths where all of them hold for any ``R``; there they say nothing of the spot's size.
    equalities_with_slack, unknowns_with_slack : int
        With the image block as five more equality rows and five slack unknowns.
    ipopt_with_slack, ipopt_with_objective : str
        What IPOPT says from the closed form; with the image block as objective there are four unknowns and no other
        equality.
    right_with_slack, right_with_objective : str
        "yes" where it stops at the plane of `Constrained`, a minimum as computed again.
    independent : int
        Of the chosen rows' gradients at the plane of `Constrained`.
    kkt_smallest_over_largest : float
        Singular values of the KKT matrix there, unknowns and rows scaled to order 1; image block as
        objective.
    searches, on_the_plane, off_the_beam, elsewhere, no_minimum : int
        From random starts, image block as objective: at the plane of `Constrained`; at a minimum whose spot is off the
        beam; at another minimum; nowhere. None is searched where there are more rows than unknowns.
    """

    rows: str
    count: int
    also_hold_at_beta_deg: str
    equalities_with_slack: int
    unknowns_with_slack: int
    ipopt_with_slack: str
    ipopt_with_objective: str
    right_with_slack: str
    right_with_objective: str
    independent: int
    kkt_smallest_over_largest: float
    searches: int
    on_the_plane: int
    off_the_beam: int
    elsewhere: int
    no_minimum: int


@dataclass(frozen=True)
class _Job:
    rows: Rows
    searches: int


def subset_rows(mode: Mode, executor: Executor | None) -> list[SubsetRow]:
    """Try every choice."""
    return list(ordered_map(_subset, [_Job(rows, STARTS[mode]) for rows in CHOICES[mode]], executor))


def _subset(job: _Job) -> SubsetRow:
    problem = _problem()
    start = starts.from_closed_form(problem)
    slack, plain = HardLaserRows(job.rows, "slack"), HardLaserRows(job.rows, "objective")
    with_slack, nlp = slack.build(problem, start), plain.build(problem, start)
    raw_slack, raw = ask_ipopt(with_slack), ask_ipopt(nlp)
    there = _best_unknowns()
    accepted = len(job.rows) <= 4
    ends = [_end(plain, problem, begin) for begin in _random_starts(job.searches)] if accepted else []
    return SubsetRow(
        plain.name,
        len(job.rows),
        " ".join(f"{beta:.4g}" for beta in np.degrees(also_hold_at(job.rows, problem.setup))),
        int(np.sum(with_slack.model.equalities)),
        len(with_slack.start),
        raw_slack.said,
        raw.said,
        "yes" if raw_slack.at_plane else "no",
        "yes" if raw.at_plane else "no",
        _independent(nlp, there),
        _kkt_ratio(nlp, there),
        len(ends),
        *(ends.count(end) for end in ("plane", "off the beam", "elsewhere", "no minimum")),
    )


@cache
def _problem() -> Problem:
    exact = exact_problem(paper.SETUP, np.array([paper.TRUTH.z_L, *eq.slopes(np, paper.TRUTH)]))
    if exact.points is None:
        raise ValueError("the worked example has no points")
    noise = NOISE_MM * np.random.default_rng(_SEED).standard_normal(exact.points.shape)
    return Problem.from_points(exact.points + noise, paper.SETUP, NOISE_MM)


# --- What the rows say ------------------------------------------------------------------------------------------------


def also_hold_at(rows: Rows, setup: eq.Setup) -> Array:
    """Azimuths in (-pi, pi] where the factors of all the rows vanish, so that they hold for any ``R``.

    Each factor times ``d_0`` is ``A sin(2 beta) + B cos(2 beta) + C`` and so has at most two zeros in half a turn.
    """
    if not set(rows) <= set(range(5)):
        return np.empty(0)
    v = eq.PaperVariables(2.0 * setup.r, 100.0, 0.7, 0.0)

    def size(beta: float, i: int) -> float:
        at = v._replace(beta=beta)
        return float(eq.laser_factors(np, at, setup)[i] * eq.laser_conic(np, at, setup)[0])

    grid = np.linspace(-np.pi / 2, np.pi / 2, 361) + 1e-3
    values = [size(beta, rows[0]) for beta in grid]
    most = max(abs(value) for value in values)
    roots = [
        _root(lambda beta: size(beta, rows[0]), low, high)
        for low, high, a, b in zip(grid, grid[1:], values, values[1:], strict=False)
        if a * b < 0
    ]
    scale = [max(most, max(abs(size(beta, i)) for beta in grid)) for i in rows]
    common = [beta for beta in roots if all(abs(size(beta, i)) < 1e-9 * s for i, s in zip(rows, scale, strict=True))]
    both = np.array([turned for beta in common for turned in (beta, beta + np.pi)])
    return np.sort(np.pi - np.remainder(np.pi - both, 2 * np.pi))


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    found: Any = scipy.optimize.brentq(function, low, high, xtol=1e-15)
    return float(found)


def _active(nlp: Nlp, x: Array) -> Array:
    """Gradients of the equalities by the scaled unknowns."""
    jacobian = np.asarray(nlp.model.first_order(x, nlp.parameters)[3]) * nlp.x_scale
    return jacobian[nlp.model.equalities]


def _independent(nlp: Nlp, x: Array) -> int:
    rows = _active(nlp, x)
    length = np.linalg.norm(rows, axis=1)
    return len(independent_rows(rows[length > _DEPENDENT * length.max()], _DEPENDENT))


def _kkt_ratio(nlp: Nlp, x: Array) -> float:
    """Smallest over largest singular value of the KKT matrix with all equality rows, scaled by its largest entries."""
    rows = _active(nlp, x)
    multipliers = np.zeros(len(nlp.model.rows))
    gradient = np.asarray(nlp.model.first_order(x, nlp.parameters)[1]).ravel() * nlp.x_scale
    multipliers[nlp.model.equalities] = np.linalg.lstsq(rows.T, -gradient, rcond=None)[0]
    hessian = np.asarray(nlp.model.hessian(x, nlp.parameters, multipliers)) * np.outer(nlp.x_scale, nlp.x_scale)
    unit = 1 / np.sqrt(np.abs(np.diag(hessian)))
    rows = rows * unit
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    zero = np.zeros((len(rows), len(rows)))
    matrix = np.block([[hessian * np.outer(unit, unit), rows.T], [rows, zero]])
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(values[-1] / values[0])


# --- What IPOPT says --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Asked:
    """What IPOPT says of a programme, and where it stops."""

    said: str
    x: Array
    at_plane: bool


def ask_ipopt(nlp: Nlp) -> Asked:
    """Call IPOPT; where equalities outnumber unknowns, which the library refuses, call it all the same."""
    if int(np.sum(nlp.model.equalities)) <= len(nlp.start):
        found = Ipopt().solve(nlp)
        return Asked(found.report, found.x, found.kkt.ok and _at_plane(nlp, found.x))
    model = nlp.model
    programme = {"x": model.x, "p": model.p, "f": model.objective, "g": model.constraints}
    quiet = {"print_time": False, "show_eval_warnings": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    solver = ca.nlpsol("solver", "ipopt", programme, quiet)
    lower, upper = nlp.row_bounds
    solver(x0=nlp.start, p=nlp.parameters, lbx=nlp.lower, ubx=nlp.upper, lbg=lower, ubg=upper)
    return Asked(str(solver.stats()["return_status"]), nlp.start, at_plane=False)


def _at_plane(nlp: Nlp, x: Array) -> bool:
    best, plane = _best(), nlp.plane(x)
    return bool(np.all(np.abs(plane - best) <= _SAME * np.array([best[0], *(2 * [1 + best[1:] @ best[1:]])])))


# --- Where searches end -----------------------------------------------------------------------------------------------


def _random_starts(n: int) -> list[Start]:
    """The same for every choice: half to four times the true depth, tilts to 75 degrees, R on the beam."""
    rng = np.random.default_rng([_SEED, 1])
    made = []
    for _ in range(n):
        z_L, alpha, beta = 75 * 2 ** rng.uniform(-1, 2), np.radians(rng.uniform(5, 75)), rng.uniform(-np.pi, np.pi)
        R = paper.SETUP.r / np.cos(alpha)
        p, q = (float(value) for value in eq.slopes(np, eq.PaperVariables(R, z_L, alpha, beta)))
        made.append(Start(float(R), (float(z_L), p, q), float(beta), cold=True))
    return made


def _end(form: HardLaserRows, problem: Problem, start: Start) -> str:
    found = Ipopt().solve(form.build(problem, start))
    if not found.kkt.ok:
        return "no minimum"
    R, _, alpha, _ = found.x
    if abs(R * np.cos(alpha) - problem.setup.r) > _SAME * problem.setup.r:
        return "off the beam"
    return "plane" if _at_plane(found.nlp, found.x) else "elsewhere"


def _best_unknowns() -> Array:
    """``(R, z_L, alpha, beta)`` of `_best`, on the beam to rounding."""
    z_L, p, q = (float(value) for value in _best())
    pose = SpotPose.from_slopes(z_L, p, q, paper.SETUP.r)
    return np.array([pose.R, pose.z_L, pose.alpha, pose.beta])


@cache
def _best() -> Array:
    problem = _problem()
    found = Ipopt().solve(Constrained().build(problem, starts.from_closed_form(problem)))
    return found.nlp.plane(found.x)
