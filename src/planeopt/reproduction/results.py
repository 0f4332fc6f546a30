"""Everything that the reproduction shows, as numbers: computed once, then printed, drawn and written."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.conic import fit_conic
from planeopt.estimation import solve_problem
from planeopt.formulations import AsPrinted, ClosedForm, Constrained, Formulation, Penalty, Problem
from planeopt.plane import SpotPose
from planeopt.reproduction import rounding
from planeopt.reproduction.rounding import Allowance
from planeopt.reproduction.searches import Search, relative_misfit, searches, second_pose, stated_plane
from planeopt.solution import Solution
from planeopt.solvers import Ipopt, Solver, Swift

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """One method's answer from Table 1.

    Attributes
    ----------
    solution : Solution
    found : (4,)
        ``(R, z_L, alpha, beta)``, mm and rad.
    allowance : Allowance
        What the rounding of Table 1 may do to this method.
    """

    solution: Solution
    found: Array
    allowance: Allowance

    @property
    def name(self) -> str:
        solver = self.solution.solver
        return self.solution.formulation if solver == "none" else f"{self.solution.formulation} + {solver}"

    @property
    def error(self) -> Array:
        """Found minus true, (4,), mm and rad."""
        return self.found - np.array(paper.TRUTH)

    @property
    def within_rounding(self) -> bool:
        """Whether rounding alone can explain the error."""
        return bool(np.all(np.abs(self.error) <= self.allowance.worst))


@dataclass(frozen=True)
class SecondPlane:
    """The other exact solution of the ten equations.

    Attributes
    ----------
    pose : SpotPose
        At the stated solution, without rounding.
    from_table_1 : SpotPose
        As a solve from Table 1 reports it.
    misfit : float
        `relative_misfit` at ``pose``: zero to rounding.
    reason : str
        Why it is excluded.
    """

    pose: SpotPose
    from_table_1: SpotPose
    misfit: float
    reason: str


@dataclass(frozen=True)
class FittedB4:
    """B_4 of the least-squares fit (16) to Table 1, with its standard deviation, mm: too wide to decide Table 2."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Reproduction:
    """All results.

    Attributes
    ----------
    problem : Problem
        Table 1's points with their rounding as noise, and the ellipse fitted to them.
    answers : tuple of Answer
    second_plane : SecondPlane
    refusal : Solution
        Of `AsPrinted`.
    searches : tuple of Search
        See `planeopt.reproduction.searches.searches`.
    fitted_B4 : FittedB4
    """

    problem: Problem
    answers: tuple[Answer, ...]
    second_plane: SecondPlane
    refusal: Solution
    searches: tuple[Search, ...]
    fitted_B4: FittedB4


def compute() -> Reproduction:
    """Solve the worked example from Table 1 and the paper's start by each method, without ever starting again."""
    problem = table_1_problem()
    methods: tuple[tuple[Formulation, Solver], ...] = (
        (Constrained(), Ipopt(record=True)),
        (Constrained("paper"), Ipopt()),
        (Penalty(), Swift(record=True)),
        (ClosedForm(), Ipopt()),
    )
    solutions = [_solve(problem, formulation, solver) for formulation, solver in methods]
    allowances = _allowances()
    answers = tuple(
        Answer(solution, _unknowns(solution), allowances[type(formulation)])
        for solution, (formulation, _) in zip(solutions, methods, strict=True)
    )
    constrained, _, penalty, _ = solutions
    return Reproduction(
        problem,
        answers,
        _second_plane(constrained),
        _solve(problem, AsPrinted(), Ipopt()),
        searches(problem, constrained, penalty),
        _fitted_b4(),
    )


def table_1_problem() -> Problem:
    """Table 1's points with the standard deviation of their rounding, which is uniform: ``5e-5/sqrt(3)`` mm."""
    return Problem.from_points(paper.table_1(), paper.SETUP, paper.ROUNDING / np.sqrt(3))


def _solve(problem: Problem, formulation: Formulation, solver: Solver) -> Solution:
    return solve_problem(problem, formulation=formulation, solver=solver, start=tuple(paper.START), restart=False)


def _unknowns(solution: Solution) -> Array:
    pose = solution.pose
    if pose is None or pose.beta is None:
        raise RuntimeError(f"{solution.formulation} did not solve the worked example: {solution.message}")
    return np.array([pose.R, pose.z_L, pose.alpha, pose.beta])


def _allowances() -> dict[type, Allowance]:
    """Allowed rounding error of each method, linearised at the stated solution."""
    points, B, plane, k = paper.exact_points(), paper.exact_ellipse(), stated_plane(), paper.SETUP
    by_slopes = rounding.paper_by_slopes(plane, k.r)
    by_ellipse = {
        Constrained: by_slopes @ rounding.constrained_by_ellipse(plane, k, B, points),
        Penalty: rounding.penalty_by_ellipse(paper.TRUTH, k, B),
        ClosedForm: by_slopes @ rounding.closed_form_by_ellipse(k, B),
    }
    by_points = rounding.ellipse_by_points(B, points)
    return {method: rounding.allowance(rows @ by_points, paper.ROUNDING) for method, rows in by_ellipse.items()}


def _second_plane(solution: Solution) -> SecondPlane:
    if solution.other_plane is None:
        raise RuntimeError("the worked example has a second plane, but none was reported")
    pose = second_pose()
    misfit = relative_misfit(eq.PaperVariables(pose.R, pose.z_L, pose.alpha, pose.beta), paper.exact_ellipse())
    return SecondPlane(pose, solution.other_plane.pose, float(misfit), solution.other_plane.reason)


def _fitted_b4() -> FittedB4:
    fit = fit_conic(paper.table_1(), paper.ROUNDING / np.sqrt(3), "least_squares")
    if fit.covariance is None:
        raise RuntimeError("the fit to Table 1 has no covariance")
    return FittedB4(float(fit.B[3]), float(np.sqrt(fit.covariance[3, 3])))
