"""SWIFT, the paper's method: what its rising weight does, and what it does not."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from cases import WORKED, WORKED_SETUP, Array
from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.estimation import solve_problem
from planeopt.estimation.starts import from_closed_form
from planeopt.formulations import Constrained, LeastSquares, Penalty, Problem
from planeopt.nlp import Nlp
from planeopt.solution import Status
from planeopt.solvers import Ipopt, Swift
from problems import covariance_of, exact, noisy, plane_of, start_at


def programme(reading: str, problem: Problem) -> Nlp:
    penalty = Penalty() if reading == "printed" else Penalty("image objective")
    return penalty.build(problem, from_closed_form(problem))


def inconsistent() -> Problem:
    """A beam believed half as wide again as it is: the laser block and the image block pull against each other."""
    problem = exact(WORKED, WORKED_SETUP)
    return replace(problem, setup=problem.setup._replace(r=1.5 * problem.setup.r))


def laser_violation(x: Array, k: eq.Setup) -> float:
    return abs(float(x[0]) * math.cos(float(x[2])) - k.r)


# --- (29) as printed, J = 0 -------------------------------------------------------------------------------------------


def test_with_no_objective_the_weight_is_only_a_unit() -> None:
    """Scaled by a power of two, every comparison of the simplex comes out the same: the same path, to the byte."""
    nlp = programme("printed", noisy(1))
    light, heavy = (Swift(weights=(weight,), record=True).solve(nlp) for weight in (1.0, 1024.0))
    assert light.trace.x is not None
    assert heavy.trace.x is not None
    np.testing.assert_array_equal(light.trace.x, heavy.trace.x)
    np.testing.assert_array_equal(light.x, heavy.x)


def test_with_no_objective_raising_the_weight_does_not_move_the_minimiser() -> None:
    problem = noisy(1)
    least_squares = solve_problem(problem, formulation=LeastSquares(), solver=Ipopt())
    sigma = np.sqrt(np.diag(covariance_of(least_squares)))
    for n in (1, 3, 6):
        schedule = tuple(10.0**i for i in range(n))
        found = solve_problem(problem, formulation=Penalty(), solver=Swift(weights=schedule))
        # The minimiser of the unweighted sum of squares, to what comparing rounded values can tell.
        assert np.all(np.abs(plane_of(found) - plane_of(least_squares)) < 1e-3 * sigma)


def test_with_no_objective_the_residuals_do_not_vanish_either() -> None:
    """Under noise ten equations have no common solution, whatever the weight."""
    nlp = programme("printed", inconsistent())
    violations = [Swift(weights=(weight,)).solve(nlp).trace.infeasibility[-1] for weight in (1.0, 1024.0)]
    assert violations[0] == violations[1] > 1e-3


# --- The image block as objective -------------------------------------------------------------------------------------


def test_with_the_image_as_objective_the_violation_falls_as_one_over_the_weight() -> None:
    """A penalty's minimiser misses its constraint by ``multiplier/(2 weight)``; here by Newton's method on (29)."""
    problem = inconsistent()
    nlp = programme("image objective", problem)
    weights = [10.0**i for i in range(5)]
    violations = [laser_violation(Ipopt().solve(nlp.penalised(w)).x, problem.setup) for w in weights]
    ratios = np.array(violations[:-1]) / violations[1:]
    # The multiplier changes by as little as the violation (1e-6 mm of 15); Newton's answers are right to some 1e-12 mm.
    np.testing.assert_allclose(ratios, 10, rtol=1e-2)
    assert violations[0] < 1e-5


def test_swift_follows_the_same_path_of_minimisers() -> None:
    problem = inconsistent()
    nlp = programme("image objective", problem)
    for n in range(1, 4):
        schedule = tuple(10.0**i for i in range(n))
        swift, newton = Swift(weights=schedule).solve(nlp), Ipopt().solve(nlp.penalised(schedule[-1]))
        # The simplex is 1e-9 of the unknowns at its end; the violation sees its part across the valley.
        expected = laser_violation(newton.x, problem.setup)
        assert laser_violation(swift.x, problem.setup) == pytest.approx(expected, rel=1e-2)
        assert swift.nlp.parameters[-1] == schedule[-1]


def test_at_a_heavy_weight_it_solves_the_constrained_problem() -> None:
    """The limit: the unweighted image residuals over planes whose spot lies on the beam, by a solver of its own."""
    problem = inconsistent()

    def image(plane: Array) -> Array:
        v = eq.SlopeVariables(None, *(plane * [WORKED.z_L, 1, 1]))
        return np.array(eq.image_residuals_in_slopes(np, v, problem.setup, problem.B))

    limit = scipy.optimize.least_squares(image, np.array([1.0, -0.8, 1.4]), method="lm", xtol=1e-14, ftol=1e-14)
    swift = Swift().solve(programme("image objective", problem))
    np.testing.assert_allclose(swift.nlp.plane(swift.x), limit.x * [WORKED.z_L, 1, 1], rtol=1e-4)
    # Not the weighted answer: without the covariance of B the plane is another one.
    weighted = solve_problem(problem, formulation=Constrained())
    assert np.max(np.abs(plane_of(weighted) / (limit.x * [WORKED.z_L, 1, 1]) - 1)) > 1e-3


# --- The search -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "weights", [(), (1.0, 1.0), (2.0, 1.0), (0.0, 1.0), (-1.0,), (math.nan,), (1.0, math.inf), ((1.0, 2.0),)]
)
def test_a_schedule_must_be_positive_finite_and_rising(weights: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="rising"):
        Swift(weights=weights)


def test_a_simplex_may_also_have_to_end_at_equal_values() -> None:
    """With a simplex of almost any size the values decide, and what they differ by is the weight's to say."""
    nlp = programme("printed", noisy(1))
    nlp = replace(nlp, start=1.05 * nlp.start)
    best = Ipopt().solve(nlp.penalised(1.0))
    least = float(best.nlp.model.values(best.x, best.nlp.parameters)[0])
    for weight in (1.0, 1e4):
        found = Swift(weights=(weight,), tol=0.5, value_tol=1e-6).solve(nlp)
        value = float(found.nlp.model.values(found.x, found.nlp.parameters)[0])
        # Near the minimum the best vertex is no farther below the others than above the minimum, to a power of ten.
        assert 0 <= value - weight * least < 1e-5
    with pytest.raises(InputError, match="value_tol"):
        Swift(value_tol=0.0)


@pytest.mark.parametrize("reading", ["printed", "image objective"])
def test_the_record_ends_at_the_solution_and_rises_through_the_schedule(reading: str) -> None:
    nlp = programme(reading, noisy(1))
    found = Swift(weights=(1.0, 10.0, 100.0), record=True).solve(nlp)
    trace = found.trace
    assert trace.x is not None
    np.testing.assert_array_equal(trace.x[-1], found.x)
    assert len(trace.x) == len(trace.objective) == len(trace.infeasibility) == len(trace.stage)
    # SciPy counts a simplex's first evaluation as an iteration: one a stage.
    assert 0 <= found.effort.iterations - len(trace.x) <= 3
    assert set(trace.stage) == {0, 1, 2}
    assert np.all(np.diff(trace.stage) >= 0)
    f, g = nlp.model.values(found.x, nlp.parameters)
    assert trace.objective[-1] == float(f)
    rows = np.asarray(g).ravel()[nlp.model.equalities]
    assert trace.infeasibility[-1] == np.max(np.abs(rows))
    # Within a stage the best vertex never gets worse.
    penalised = np.asarray(
        nlp.penalised(1.0).model.values.map(len(trace.x))(trace.x.T, np.append(nlp.parameters, 1.0))[0]
    )
    assert np.all(np.diff(penalised.ravel()[trace.stage == 0]) <= 0)
    plain = Swift(weights=(1.0, 10.0, 100.0)).solve(nlp)
    np.testing.assert_array_equal(plain.x, found.x)
    assert plain.trace.x is None


def test_derivatives_are_never_used() -> None:
    found = Swift().solve(programme("printed", noisy(1)))
    assert found.effort.derivative_evaluations == 0
    assert found.effort.evaluations > found.effort.iterations > 0


@pytest.mark.parametrize("budget", [1, 3, 50])
def test_a_budget_that_runs_out_is_no_answer(budget: int) -> None:
    solution = solve_problem(
        noisy(1),
        formulation=Penalty(),
        solver=Swift(max_evaluations=budget),
        start=(10.0, 250.0, 0.35, 0.35),
        restart=False,
    )
    assert solution.status.record == "refused"
    assert "evaluations used up" in solution.message
    assert solution.effort.evaluations <= 6 * (budget + 5)


def test_from_the_paper_s_start_it_finds_a_plane_and_newton_agrees_which() -> None:
    """Far from the plane the search takes many more steps and may end on the second plane; it then must not be ok."""
    problem = noisy(1)
    start = (10.0, 250.0, math.radians(20), math.radians(20))
    swift = solve_problem(
        problem, formulation=Penalty(), solver=Swift(max_evaluations=20000), start=start, restart=False
    )
    if swift.ok:
        least_squares = solve_problem(problem, formulation=LeastSquares())
        np.testing.assert_allclose(plane_of(swift), plane_of(least_squares), rtol=1e-6)
    else:
        assert swift.message.startswith(swift.status.value)
    restarted = solve_problem(problem, formulation=Penalty(), solver=Swift(), start=start)
    assert restarted.status in (Status.CONVERGED, Status.NOT_CONVERGED)


def test_the_second_plane_is_no_resting_place() -> None:
    """There the ten equations hold exactly, and only the penalty on ``c > 0`` says that it cannot be seen."""
    problem = exact(WORKED, WORKED_SETUP)
    other = solve_problem(problem).other_plane
    assert other is not None
    second = eq.PaperVariables(other.pose.R, other.pose.z_L, other.pose.alpha, other.pose.beta)
    nlp = Penalty().build(problem, start_at(second, cold=True))
    f, g = nlp.penalised(1.0).model.values(nlp.start, np.append(nlp.parameters, 1.0))
    assert float(f) < 1e-9
    assert np.min(np.asarray(g)) < -1
    solution = solve_problem(problem, formulation=Penalty(), solver=Swift(), start=other.pose, restart=False)
    if solution.pose is not None:
        assert solution.pose.z_L == pytest.approx(WORKED.z_L, rel=1e-6)
    else:
        assert solution.status in (Status.INFEASIBLE, Status.NOT_CONVERGED)
    # By default the closed form is tried after that, and found right.
    restarted = solve_problem(problem, formulation=Penalty(), solver=Swift(), start=other.pose)
    assert plane_of(restarted)[0] == pytest.approx(WORKED.z_L, rel=1e-6)
