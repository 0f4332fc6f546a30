"""One plane from one ellipse: our solvers and SciPy's on the weighted problem, from the closed form.

Times are never asserted, since they are the machine's; that all find the same plane, and by how many evaluations, is.
"""

from collections.abc import Callable
from dataclasses import dataclass

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import rivals
from planeopt.estimation import solve_problem
from planeopt.formulations import ClosedForm, Constrained, Formulation, Penalty, Reprojection
from planeopt.solvers import Ipopt, Solver, Sqp, Swift
from planeopt.solvers.kkt import check
from worked_example import difference, problem, programme, reference

PROBLEM = problem()
ANSWER = reference(PROBLEM)
SAME = 1e-8
"""Relative difference below which two answers to one problem count as the same."""


@dataclass(frozen=True)
class Searched:
    """A formulation with a solver; ``same`` is None where it is another problem with another answer.

    ``evaluations`` is far more than the search takes: counts do not depend on the machine, and a search that has lost
    its second-order convergence shows here.
    """

    what: str
    formulation: Formulation
    solver: Solver
    evaluations: int
    same: float | None = SAME


SEARCHED = [
    Searched("Constrained + Sqp", Constrained(), Sqp(), 20),
    Searched("Constrained + Ipopt", Constrained(), Ipopt(), 60),
    Searched("Constrained(paper) + Sqp", Constrained("paper"), Sqp(), 20),
    Searched("Constrained(paper) + Ipopt", Constrained("paper"), Ipopt(), 1000),
    Searched("Reprojection (200 points) + Sqp", Reprojection(), Sqp(), 60, None),
    Searched("Reprojection (200 points) + Ipopt", Reprojection(), Ipopt(), 200, None),
    Searched("(29) with J = 0 + Swift", Penalty(), Swift(), 10000, None),
]
RIVALS = [
    ("SciPy least_squares", rivals.least_squares, 20),
    ("SciPy SLSQP", rivals.slsqp, 200),
    ("SciPy trust-constr", rivals.trust_constr, 1000),
]


@pytest.mark.parametrize("case", SEARCHED, ids=lambda case: case.what)
def test_search(benchmark: BenchmarkFixture, case: Searched) -> None:
    """The programme is built; what is timed is the search with our own check of optimality."""
    nlp = programme(case.formulation, PROBLEM)
    case.solver.solve(nlp)
    found = benchmark(case.solver.solve, nlp)
    away = difference(found.nlp.plane(found.x), ANSWER)
    benchmark.group = "One plane, started from the closed form"
    benchmark.extra_info.update(
        what=case.what,
        iterations=found.effort.iterations,
        evaluations=found.effort.evaluations,
        derivative_evaluations=found.effort.derivative_evaluations,
        difference=away,
    )
    assert found.kkt.ok
    assert found.effort.evaluations <= case.evaluations
    # Another problem's answer is within a few sigma, 1e-4 of the depth here.
    assert away < (1e-3 if case.same is None else case.same)


@pytest.mark.parametrize(("what", "solve", "evaluations"), RIVALS, ids=[what for what, _, _ in RIVALS])
def test_rival(
    benchmark: BenchmarkFixture, what: str, solve: Callable[[rivals.Weighted], rivals.Outcome], evaluations: int
) -> None:
    """SciPy's answer to the same problem; its optimality is taken on its word."""
    weighted = rivals.weighted(PROBLEM)
    found = benchmark(solve, weighted)
    away = difference(found.plane, ANSWER)
    benchmark.group = "One plane, started from the closed form"
    benchmark.extra_info.update(
        what=what,
        iterations=found.iterations,
        evaluations=found.evaluations,
        derivative_evaluations=found.derivative_evaluations,
        difference=away,
    )
    assert away < SAME
    assert found.evaluations <= evaluations


def test_own_check(benchmark: BenchmarkFixture) -> None:
    """The part of each of our rows that no rival has."""
    nlp = programme(Constrained(), PROBLEM)
    x = Sqp().solve(nlp).x
    found = benchmark(check, nlp, x)
    benchmark.group = "One plane, started from the closed form"
    benchmark.extra_info.update(what="of our rows: the check of optimality")
    assert found.ok


WHOLE = [
    Searched("Constrained + Ipopt", Constrained(), Ipopt(), 60),
    Searched("Constrained + Sqp", Constrained(), Sqp(), 20),
    Searched("Reprojection + Ipopt", Reprojection(), Ipopt(), 200, None),
    Searched("ClosedForm", ClosedForm(), Ipopt(), 0, None),
]


@pytest.mark.parametrize("case", WHOLE, ids=lambda case: case.what)
def test_whole_solution(benchmark: BenchmarkFixture, case: Searched) -> None:
    """Ranks before, search, covariance, the ten residuals, chi-squared, the second plane: what a user gets."""
    solution = benchmark(solve_problem, PROBLEM, formulation=case.formulation, solver=case.solver)
    benchmark.group = "The whole solution, evidence and covariance included"
    benchmark.extra_info.update(
        what=case.what, iterations=solution.effort.iterations, evaluations=solution.effort.evaluations
    )
    assert solution.ok
    assert solution.covariance is not None
    assert solution.effort.evaluations <= case.evaluations
