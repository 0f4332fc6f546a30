"""Optimality and covariance recomputed from the model: what a solver says is not believed."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

from cases import WORKED, WORKED_SETUP, Array
from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.estimation.starts import from_closed_form
from planeopt.formulations import (
    ClosedForm,
    Constrained,
    Elastic,
    Formulation,
    LeastSquares,
    Penalty,
    Problem,
    Reprojection,
)
from planeopt.nlp import Model, Nlp, Row
from planeopt.solution import RESOLUTION, Effort, Status
from planeopt.solvers import Found, Ipopt, Sqp
from planeopt.solvers.base import NO_TRACE
from planeopt.solvers.kkt import NoCovariance, check, plane_covariance, polish
from problems import covariance_of, exact, noisy, plane_of, start_at

ACCURATE = [Constrained(), Constrained("paper"), LeastSquares(), Reprojection()]


def programme(formulation: Formulation, problem: Problem) -> Nlp:
    nlp = formulation.build(problem, from_closed_form(problem))
    assert isinstance(nlp, Nlp)
    return nlp


# --- Toys with known answers ------------------------------------------------------------------------------------------

AT_LEAST = eq.Equation("1", "depth is at least 1", "mm", eq.Block.GEOMETRY, lambda _: None)
ALIKE = eq.Equation("11", "both slopes are alike", "1", eq.Block.LASER, lambda _: None)


def toy(data: tuple[float, float, float], *, alike: bool = False, saddle: bool = False) -> Nlp:
    """The plane nearest to measured ``(z_L, p, q)``, with ``z_L >= 1`` and perhaps ``p = q``."""
    x, d = ca.SX.sym("x", 3), ca.SX.sym("d", 3)
    rows: list[tuple[ca.SX, Row]] = [(x[0] - 1, Row(AT_LEAST, equality=False))]
    if alike:
        rows.insert(0, (x[1] - x[2], Row(ALIKE)))
    objective = ca.sumsqr(x - d) / 2 - (3 * x[1] ** 2 if saddle else 0)
    expressions, named = zip(*rows, strict=True)
    model = Model("toy", ("z_L", "p", "q"), x, d, objective, ca.vertcat(*expressions), tuple(named), x, d)
    covariance = np.array([[4.0, 0.5, 0.2], [0.5, 1.0, 0.1], [0.2, 0.1, 2.0]])
    n, free = len(named), np.full(3, np.inf)
    return Nlp(
        model, (np.array(data),), np.zeros(3), -free, free, np.ones(3), np.ones(n), np.linalg.cholesky(covariance)
    )


def test_the_toy_s_answer_passes_and_its_neighbours_fail() -> None:
    nlp = toy((3.0, 0.5, -0.5))
    assert check(nlp, np.array([3.0, 0.5, -0.5])).ok
    for direction in np.eye(3):
        moved = check(nlp, np.array([3.0, 0.5, -0.5]) + 1e-6 * direction)
        assert not moved.ok
        assert moved.feasible
        assert moved.step == pytest.approx(1e-6 / (3 if direction[0] else 1.5), rel=1e-4)


def test_a_multiplier_of_the_wrong_sign_tells_a_wrong_active_set() -> None:
    """At ``z_L = 1`` the Newton step stays on the active constraint: only the multiplier says that it should leave."""
    wrong = check(toy((3.0, 0.5, -0.5)), np.array([1.0, 0.5, -0.5]))
    assert wrong.feasible
    assert wrong.step < RESOLUTION
    assert wrong.dual == pytest.approx(1.0)
    assert not wrong.ok
    right = check(toy((-2.0, 0.5, -0.5)), np.array([1.0, 0.5, -0.5]))
    assert right.dual == 0
    assert right.ok


def test_an_infeasible_point_fails_even_where_the_objective_is_stationary() -> None:
    found = check(toy((-2.0, 0.5, -0.5)), np.array([-2.0, 0.5, -0.5]))
    assert found.feasibility == pytest.approx(3.0)
    assert not found.feasible
    assert not found.ok
    unequal = check(toy((3.0, 0.5, -0.5), alike=True), np.array([3.0, 0.5, -0.5]))
    assert unequal.feasibility == pytest.approx(1.0)
    assert not unequal.ok
    assert check(toy((3.0, 0.5, -0.5), alike=True), np.array([3.0, 0.0, 0.0])).ok


def test_a_saddle_is_stationary_and_no_minimum() -> None:
    """There the Newton step vanishes as it does at a minimum: ``p - d_2 - 6 p = 0``."""
    found = check(toy((3.0, 0.5, -0.5), saddle=True), np.array([3.0, -0.1, -0.5]))
    assert found.feasible
    assert found.step < RESOLUTION
    assert not found.ok
    # Where the constraint p = q takes the bad direction's half away, what is left still curves down.
    assert not check(toy((3.0, 0.5, -0.5), saddle=True, alike=True), np.array([3.0, 0.0, 0.0])).ok


def test_a_point_that_is_not_finite_fails() -> None:
    found = check(toy((3.0, 0.5, -0.5)), np.array([np.nan, 0.5, -0.5]))
    assert not found.ok
    assert not found.feasible


def test_a_toy_s_covariance_is_the_data_s_carried_through_its_constraint() -> None:
    nlp = toy((3.0, 0.5, -0.5))
    sigma = nlp.data_factor @ nlp.data_factor.T
    free = plane_covariance(nlp, np.array([3.0, 0.5, -0.5]))
    assert not isinstance(free, NoCovariance)
    np.testing.assert_allclose(free, sigma, rtol=1e-12)
    alike = toy((3.0, 0.5, -0.5), alike=True)
    # p = q = (d_2 + d_3)/2 always: rank 2, which is no covariance of a plane.
    found = plane_covariance(alike, np.array([3.0, 0.0, 0.0]))
    assert isinstance(found, NoCovariance)
    assert "positive definite" in found.reason


def test_an_active_inequality_is_the_reason_for_no_covariance() -> None:
    found = plane_covariance(toy((-2.0, 0.5, -0.5)), np.array([1.0, 0.5, -0.5]))
    assert isinstance(found, NoCovariance)
    assert found.status is Status.AT_BOUND
    assert AT_LEAST.name in found.reason


def test_a_bound_of_the_search_is_a_reason_too() -> None:
    """The plane cannot move both ways there, and what the bound holds would look certain."""
    free = toy((3.0, 0.5, -0.5))
    nlp = replace(free, lower=np.full(3, -10.0), upper=np.array([3.0, 10.0, 10.0]))
    found = plane_covariance(nlp, np.array([3.0, 0.5, -0.5]))
    assert isinstance(found, NoCovariance)
    assert found.status is Status.AT_BOUND
    assert "z_L" in found.reason


# --- The real programmes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("formulation", ACCURATE, ids=lambda f: f.name)
def test_a_perturbed_solution_is_not_ok(formulation: Formulation) -> None:
    nlp = programme(formulation, noisy(1, n=40))
    x = Ipopt().solve(nlp).x
    assert check(nlp, x).ok
    for name in {"R", "z_L", "p", "q", "alpha", "beta"} & set(nlp.model.variables):
        i = nlp.model.variables.index(name)
        moved = x.copy()
        moved[i] += 1e-3 * nlp.x_scale[i]
        assert not check(nlp, moved).ok, name


@pytest.mark.parametrize("formulation", [Constrained(), Constrained("paper"), LeastSquares()], ids=lambda f: f.name)
def test_the_step_that_is_left_is_the_distance_to_the_solution_to_second_order(formulation: Formulation) -> None:
    """Newton's method converges quadratically: from 1/10 of the distance the step errs by 1/100 as much."""
    nlp = programme(formulation, noisy(1))
    x = Ipopt().solve(nlp).x
    z_L, p, q = nlp.plane(x)
    size = np.array([z_L, 1 + p**2 + q**2, 1 + p**2 + q**2])
    direction = np.zeros(len(x))
    direction[:4] = nlp.x_scale[:4] * [0.3, 1.0, -0.7, 0.5]
    errors = []
    for length in (1e-4, 1e-5):
        moved = x + length * direction
        distance = np.max(np.abs(nlp.plane(moved) - nlp.plane(x)) / size)
        errors.append(abs(check(nlp, moved).step - distance))
    # 100 in theory; third order and rounding take their part.
    assert errors[0] / errors[1] > 50


@pytest.mark.parametrize("formulation", ACCURATE, ids=lambda f: f.name)
def test_polish_brings_a_near_miss_home_in_two_steps(formulation: Formulation) -> None:
    nlp = programme(formulation, noisy(1, n=40))
    x = Ipopt(tol=1e-10).solve(nlp).x
    # So little that the rows, in standard deviations, still count as nearly feasible; the unknowns of Reprojection are
    # standard deviations themselves and its rows far from active.
    length = 1e-2 if formulation == Reprojection() else 1e-7
    moved = x + length * nlp.x_scale * np.cos(np.arange(len(x)))
    assert not check(nlp, moved).ok
    polished, found, steps = polish(nlp, moved)
    assert found.ok
    assert steps <= 2
    np.testing.assert_allclose(nlp.plane(polished), nlp.plane(x), rtol=1e-9)


def test_polish_is_no_search() -> None:
    nlp = programme(Constrained(), noisy(1))
    far = Ipopt().solve(nlp).x * 1.05
    untouched, found, steps = polish(nlp, far)
    np.testing.assert_array_equal(untouched, far)
    assert steps == 0
    assert not found.ok


@dataclass(frozen=True)
class Liar:
    """A solver that does nothing and says it succeeded; its check is an honest one."""

    by: float = 0.0

    @property
    def name(self) -> str:
        return "Liar"

    def prepare(self, nlp: Nlp) -> None:
        pass

    def solve(self, nlp: Nlp) -> Found:
        x = nlp.start + self.by * nlp.x_scale
        return Found(nlp, x, "Solve_Succeeded", check(nlp, x), Effort(), NO_TRACE)


@pytest.mark.parametrize("formulation", ACCURATE, ids=lambda f: f.name)
def test_a_solver_s_word_is_not_evidence(formulation: Formulation) -> None:
    solution = solve_problem(noisy(1), formulation=formulation, solver=Liar(0.01))
    assert solution.status in (Status.INFEASIBLE, Status.NOT_CONVERGED)
    assert solution.status.record == "refused"
    assert solution.pose is None
    assert solution.covariance is None
    assert solution.message.startswith(solution.status.value)
    assert "Solve_Succeeded" in solution.message


def test_an_infeasible_answer_names_the_equation_and_by_how_much_it_is_off() -> None:
    problem = exact(WORKED, WORKED_SETUP)
    solution = solve_problem(problem, solver=Liar(), start=(21.0, 75.0, WORKED.alpha, WORKED.beta), restart=False)
    assert solution.status is Status.INFEASIBLE
    # R = 21 for 20: R^2 - r^2 (1 + p^2 + q^2) = 41 mm^2; every image equation holds.
    assert "(11-15)" in solution.message
    assert "41 mm^2" in solution.message


# --- The covariance ---------------------------------------------------------------------------------------------------

STEP = 0.1
"""In standard deviations of the data. The plane's curvature over one of them is 1e-2 of its slope at most, so central
differences are right to (1e-2 x 0.1)^2; solutions are right to 1e-9, which is 1e-4 of their sigma at worst, and 1e-3
over the step."""


def propagated_from_conic(problem: Problem, formulation: Formulation, solver: Ipopt | Sqp) -> Array:
    """``dx/dB Sigma_B dx/dB'`` by solving again with each column of the covariance's factor added and taken off."""
    columns = []
    for column in problem.B_factor.T:
        up, down = (
            plane_of(solve_problem(replace(problem, B=problem.B + h * column), formulation=formulation, solver=solver))
            for h in (STEP, -STEP)
        )
        columns.append((up - down) / (2 * STEP))
    return np.array(columns).T @ np.array(columns)


def propagated_from_points(problem: Problem, formulation: Formulation, solver: Ipopt | Sqp) -> Array:
    """The same with every coordinate of every point moved."""
    assert problem.points is not None
    assert problem.noise is not None
    columns = []
    for i in np.ndindex(problem.points.shape):
        sigma = np.sqrt(problem.noise[i[0], i[1], i[1]])
        planes = []
        for h in (STEP, -STEP):
            points = problem.points.copy()
            points[i] += h * sigma
            shifted = replace(problem, points=points)
            planes.append(plane_of(solve_problem(shifted, formulation=formulation, solver=solver)))
        columns.append((planes[0] - planes[1]) / (2 * STEP))
    return np.array(columns).T @ np.array(columns)


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [
        (Constrained(), Ipopt()),
        (Constrained(), Sqp()),
        (Constrained("paper"), Ipopt()),
        (LeastSquares(), Ipopt()),
        (ClosedForm(), Ipopt()),
        (Elastic(), Ipopt()),
        (Reprojection(), Ipopt()),
        (Reprojection(), Sqp()),
    ],
    ids=lambda value: value.name,
)
def test_the_covariance_is_what_happens_when_the_data_move(formulation: Formulation, solver: Ipopt | Sqp) -> None:
    problem = noisy(3, n=8) if formulation == Reprojection() else noisy(3)
    solution = solve_problem(problem, formulation=formulation, solver=solver)
    moved = propagated_from_points if formulation == Reprojection() else propagated_from_conic
    covariance = covariance_of(solution)
    sigma = np.sqrt(np.diag(covariance))
    error = (moved(problem, formulation, solver) - covariance) / np.outer(sigma, sigma)
    assert np.max(np.abs(error)) < 2e-3


@pytest.mark.parametrize("alpha", [0.0, 1e-12, 1e-9])
@pytest.mark.parametrize("formulation", [Constrained("paper"), LeastSquares(), Elastic()], ids=lambda f: f.name)
def test_at_alpha_zero_the_paper_s_variables_give_the_right_covariance_or_none(
    formulation: Formulation, alpha: float
) -> None:
    v = eq.PaperVariables(WORKED_SETUP.r / np.cos(alpha), 100.0, alpha, 0.3)
    tilted = eq.PaperVariables(WORKED_SETUP.r / np.cos(1e-3), 100.0, 1e-3, 0.3)
    right = covariance_of(solve_problem(exact(tilted, WORKED_SETUP), formulation=formulation))
    solution = solve_problem(exact(v, WORKED_SETUP), formulation=formulation)
    if solution.covariance is None:
        assert solution.status in (Status.NO_COVARIANCE, Status.NOT_CONVERGED)
        if solution.status is Status.NO_COVARIANCE:
            assert solution.uncertainty_reason is not None
            assert "alpha = 0" in solution.uncertainty_reason
        return
    # The covariance is a smooth function of the plane in slopes: a tilt of 1e-3 changes it by some 1e-3.
    sigma = np.sqrt(np.diag(right))
    np.testing.assert_allclose(solution.covariance / np.outer(sigma, sigma), right / np.outer(sigma, sigma), atol=2e-2)


def test_at_alpha_zero_the_slopes_give_the_covariance() -> None:
    v = eq.PaperVariables(WORKED_SETUP.r, 100.0, 0.0, 0.0)
    problem = exact(v, WORKED_SETUP)
    solution = solve_problem(problem)
    assert solution.ok
    covariance = covariance_of(solution)
    sigma = np.sqrt(np.diag(covariance))
    error = (propagated_from_conic(problem, Constrained(), Ipopt()) - covariance) / np.outer(sigma, sigma)
    assert np.max(np.abs(error)) < 2e-3


def test_no_covariance_where_the_answer_lies_on_the_edge_of_what_can_be_seen() -> None:
    """An ellipse that only a plane seen from behind would explain: the visible side's best lies on ``c = 0``."""
    problem = exact(WORKED, WORKED_SETUP)
    nlp = programme(Constrained(), problem)
    # z_L, p, q with z_L = p e_x + q e_y: the plane goes through the camera.
    p, q = 1.0, 1.0
    x = np.concatenate([[WORKED_SETUP.r * np.sqrt(3), 70.0, p, q], np.zeros(5)])
    found = plane_covariance(nlp, x)
    assert isinstance(found, NoCovariance)
    assert found.status is Status.AT_BOUND
    assert "lit side" in found.reason


def test_start_at_is_where_the_search_begins() -> None:
    nlp = Constrained().build(exact(WORKED, WORKED_SETUP), start_at(WORKED))
    assert check(nlp, nlp.start).ok


def test_a_search_that_ran_off_to_depth_zero_is_no_answer_and_no_warning() -> None:
    """As far off as SQP ends from the paper's start: a step over that depth is beyond the numbers that there are."""
    nlp = programme(Penalty("image objective"), exact(WORKED, WORKED_SETUP)).penalised(1e5)
    # Not so near a bound on R that it would hold the step.
    nlp = replace(nlp, lower=np.full(4, -np.inf), upper=np.full(4, np.inf))
    assert not check(nlp, np.array([1.136e5, 0.0, 1.6034, -58.757])).ok
