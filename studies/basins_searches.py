"""Searches whose ends the study of basins compares, and where one ends."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.closed_form import other_plane
from planeopt.estimation import evidence, starts
from planeopt.formulations import (
    Constrained,
    DirectAnswer,
    EitherSide,
    Elastic,
    Formulation,
    LeastSquares,
    Penalty,
    Problem,
    Refusal,
    Reprojection,
    Start,
)
from planeopt.formulations.snooping import image_misfit
from planeopt.nlp import Nlp
from planeopt.reproduction.unguarded import Unguarded
from planeopt.solution import Solution, Status
from planeopt.solvers import Ipopt, Solver, Sqp, Swift
from planeopt.solvers.kkt import NoCovariance, plane_covariance

Array = NDArray[np.float64]

PLANE, BEHIND, ELSEWHERE, UNSAID = "plane", "behind", "elsewhere", "elsewhere unsaid"
AT_BOUND, NOT_CONVERGED, INFEASIBLE, REFUSED = "at bound", "not converged", "infeasible", "refused"
ENDS = {
    PLANE: "the plane",
    BEHIND: "the plane behind",
    ELSEWHERE: "a minimum elsewhere, which the tests of the answer refuse or degrade",
    UNSAID: "a minimum elsewhere, which the tests of the answer let pass",
    AT_BOUND: "the edge of an inequality or bound",
    NOT_CONVERGED: "no minimum: not converged",
    INFEASIBLE: "no minimum: the constraints do not hold",
    REFUSED: "not searched: refused",
}
"""Where a search can end. The first three and the edge are minima, the others failures."""

AGREES = float(scipy.stats.chi2.isf(1e-9, 2))
"""Largest squared misfit of a plane's ellipse, in standard deviations of the measured one, for which the plane has this
image. At the best plane it is chi-squared with 2 degrees of freedom. No other plane but the one behind has it."""

NEAR = float(scipy.stats.chi2.isf(1e-9, 3))
"""Largest squared distance from the true plane, or the one behind it, in standard deviations of an answer whose
formulation does not weigh by the noise, and whose ellipse may therefore be off the measured one."""


@dataclass(frozen=True)
class AtOnce:
    """A formulation without its mild first stage: the final weights from the start on."""

    formulation: Formulation

    @property
    def name(self) -> str:
        return f"{self.formulation.name}, at once"

    def build(self, problem: Problem, start: Start) -> Nlp | DirectAnswer | Refusal:
        built = self.formulation.build(problem, start)
        return replace(built, stages=built.stages[-1:]) if isinstance(built, Nlp) else built


@dataclass(frozen=True)
class Search:
    """A formulation with a solver.

    Attributes
    ----------
    formulation : Formulation
    solver : Solver
    seen : bool or None
        Whether ``c > 0`` is among its rows; None for the programme that never had it.
    """

    formulation: Formulation
    solver: Solver
    seen: bool | None = True

    @property
    def method(self) -> str:
        return f"{self.formulation.name} {self.solver.name}"

    @property
    def inequality(self) -> str:
        """``with`` or ``without`` the inequality ``c > 0``."""
        return "with" if self.seen else "without"

    def begin(self, problem: Problem, start: Start) -> Nlp | DirectAnswer | Refusal:
        """Build the programme, with or without the inequality."""
        formulation = EitherSide(self.formulation) if self.seen is False else self.formulation
        return formulation.build(problem, start)


OBVIOUS = Search(Unguarded(), Ipopt(), None)
"""The programme of model.md's worked example: residuals over |B_i|, squared; no inequality and no bound at all."""

FAST = (Search(Constrained(), Ipopt()), Search(Constrained("paper"), Ipopt()), Search(LeastSquares(), Ipopt()))
"""Searches cheap enough for a fine grid."""

SLOW = (
    Search(Constrained(), Sqp()),
    Search(Constrained("paper"), Sqp()),
    Search(Elastic(), Ipopt()),
    Search(LeastSquares(), Sqp()),
    Search(Reprojection(), Ipopt()),
    Search(Reprojection(), Sqp()),
    Search(Penalty(), Swift()),
    Search(Penalty("image objective"), Swift()),
)
"""Searches that take two to five times as long from a cold start: a coarse grid."""

AT_ONCE = (Search(AtOnce(Constrained()), Ipopt()), Search(AtOnce(Constrained("paper")), Ipopt()))
"""The final weights at once, from random starts only."""


def without(search: Search) -> Search:
    """Return the same search without the inequality ``c > 0``."""
    return replace(search, seen=False)


def end_of(search: Search, problem: Problem, start: starts.StartLike | None, truth: Array) -> str:
    """Return where a search ends, one of `ENDS`.

    Parameters
    ----------
    search : Search
    problem : Problem
    start : start or None
        ``(R, z_L, alpha, beta)``, mm and rad; the closed form where it is None.
    truth : (3,)
        ``(z_L, p, q)`` of the plane that made the image.
    """
    first = starts.from_closed_form(problem) if start is None else starts.given(start, problem)
    built = search.begin(problem, first)
    if not isinstance(built, Nlp):
        return REFUSED
    found = search.solver.solve(built)
    if found.refused is not None:
        return REFUSED
    plane = found.nlp.plane(found.x)
    if not (np.isfinite(plane).all() and found.kkt.feasible):
        return INFEASIBLE
    if not found.kkt.ok:
        return NOT_CONVERGED
    if _agrees(problem, plane):
        return _side(problem, plane)
    covariance = plane_covariance(found.nlp, found.x)
    if isinstance(covariance, NoCovariance):
        return AT_BOUND if covariance.status is Status.AT_BOUND else ELSEWHERE
    return _apart(problem, plane, covariance, truth)


def end_of_solution(solution: Solution, problem: Problem, truth: Array) -> str:
    """Return where `planeopt.solve` ended, by the same rules."""
    failed = {Status.INFEASIBLE: INFEASIBLE, Status.NOT_CONVERGED: NOT_CONVERGED, Status.AT_BOUND: AT_BOUND}
    if solution.status in failed:
        return failed[solution.status]
    if solution.pose is None:
        return REFUSED
    plane = np.array([solution.pose.z_L, *solution.pose.slopes])
    if _agrees(problem, plane):
        return _side(problem, plane)
    return ELSEWHERE if solution.covariance is None else _apart(problem, plane, solution.covariance, truth)


def _agrees(problem: Problem, plane: Array) -> bool:
    misfit = scipy.linalg.solve(problem.B_factor, image_misfit(problem, plane))
    return float(misfit @ misfit) <= AGREES


def _side(problem: Problem, plane: Array) -> str:
    return PLANE if _intercept(problem, plane) > 0 else BEHIND


def _intercept(problem: Problem, plane: Array) -> float:
    v = evidence.slope_variables(plane, problem.setup)
    return float(eq.lit_side_in_slopes(np, v, problem.setup))


def _apart(problem: Problem, plane: Array, covariance: Array, truth: Array) -> str:
    """Return where a plane is that has not the measured image: an inefficient answer, or another minimum.

    Of another minimum it says whether what `planeopt.solve` tests of every answer tells it.
    """
    off = plane - (truth if _intercept(problem, plane) > 0 else other_plane(truth, problem.setup))
    if float(off @ scipy.linalg.solve(covariance, off)) <= NEAR:
        return _side(problem, plane)
    told = _intercept(problem, plane) < 0 or evidence.fit_quality(problem, plane, None).improbable
    told = told or evidence.excess(problem, plane, covariance) > evidence.EXCESS
    return ELSEWHERE if told else UNSAID
