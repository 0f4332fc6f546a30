"""From random starts far from the answer `Constrained` reaches the true plane, or says that it did not.

`studies/basins.py` is the full form: more starts, every formulation, and ten thousand random rigs.
"""

import math

import numpy as np
import pytest

from cases import WORKED, WORKED_SETUP, Array, boundary, circle, random_case, slopes
from planeopt import equations as eq
from planeopt import paper
from planeopt.estimation import solve_problem
from planeopt.formulations import (
    Constrained,
    EitherSide,
    Elastic,
    Formulation,
    LeastSquares,
    Penalty,
    Problem,
    Reprojection,
    Start,
)
from planeopt.nlp import Nlp
from planeopt.solution import Flag, Solution, Status
from planeopt.solvers import Ipopt
from planeopt.spot import Spot

STARTS = 250
SIGMA_PX = 0.2


def random_start(rng: np.random.Generator, r: float) -> tuple[float, float, float, float]:
    """(R, z_L, alpha, beta): any tilt to 80 deg, any azimuth, two decades of depth, R up to ten radii."""
    return (
        r * rng.uniform(0.5, 10),
        math.exp(rng.uniform(math.log(20), math.log(2000))),
        math.radians(rng.uniform(0, 80)),
        rng.uniform(-np.pi, np.pi),
    )


def mahalanobis2(solution: Solution, truth: Array) -> float:
    assert solution.pose is not None
    assert solution.covariance is not None
    error = np.array([solution.pose.z_L, *solution.pose.slopes]) - truth
    return float(error @ np.linalg.solve(solution.covariance, error))


@pytest.fixture(scope="module")
def problems() -> list[tuple[Problem, Array]]:
    """The worked example and 20 random rigs and planes, with noise."""
    rng = np.random.default_rng(3)
    exact = boundary(WORKED, WORKED_SETUP, circle(60))
    sigma_mm = SIGMA_PX * 0.005
    noisy = exact + sigma_mm * rng.normal(size=exact.shape)
    found = [(Problem.from_points(noisy, WORKED_SETUP, sigma_mm), slopes(WORKED))]
    while len(found) < 21:
        case = random_case(rng, n=60)
        pixels = case.pixels + SIGMA_PX * rng.normal(size=case.pixels.shape)
        # A spot narrower than some twenty sigma is beyond the reach of the bound, whatever the start.
        if np.ptp(case.pixels, axis=0).min() < 40 * SIGMA_PX:
            continue
        problem = Problem.from_spot(Spot(pixels, np.full(len(pixels), SIGMA_PX)), case.rig)
        found.append((problem, np.array([case.pose.z_L, *case.pose.slopes])))
    return found


def test_every_cold_start_ends_at_the_true_plane(problems: list[tuple[Problem, Array]]) -> None:
    rng = np.random.default_rng(4)
    restarted = 0
    for i in range(STARTS):
        # Half of the starts go to the worked example, whose second plane is the one the paper's start can land on.
        problem, truth = problems[0] if i % 2 else problems[rng.integers(1, len(problems))]
        start = random_start(rng, problem.setup.r)
        solution = solve_problem(problem, formulation=Constrained(), solver=Ipopt(), start=start)
        assert solution.ok, (start, solution.message)
        # chi-squared with 3 degrees of freedom exceeds 60 with a probability under 1e-12: another plane is far beyond.
        assert mahalanobis2(solution, truth) < 60
        restarted += Flag.RESTARTED in solution.flags
    assert restarted < 0.05 * STARTS


def test_without_a_restart_a_failure_is_said(problems: list[tuple[Problem, Array]]) -> None:
    rng = np.random.default_rng(5)
    for i in range(42):
        problem, truth = problems[i % len(problems)]
        start = random_start(rng, problem.setup.r)
        solution = solve_problem(problem, formulation=Constrained("paper"), solver=Ipopt(), start=start, restart=False)
        assert not solution.ok or mahalanobis2(solution, truth) < 60, (start, solution.message)


@pytest.mark.parametrize("variables", ["slopes", "paper"])
def test_the_second_plane_is_never_the_answer(variables: str) -> None:
    """Started on the plane behind, which solves all ten equations, the search returns the one in front."""
    exact = boundary(WORKED, WORKED_SETUP, circle(24))
    problem = Problem.from_points(exact, WORKED_SETUP, 1e-4)
    first = solve_problem(problem)
    assert first.other_plane is not None
    behind = first.other_plane.pose
    b = eq.image_conic(np, eq.PaperVariables(behind.R, behind.z_L, behind.alpha, behind.beta), WORKED_SETUP)
    np.testing.assert_allclose(np.array(b[1:]) / b[0], problem.B, rtol=1e-9)
    formulation = Constrained("slopes" if variables == "slopes" else "paper")
    solution = solve_problem(problem, formulation=formulation, start=behind)
    assert solution.ok
    assert solution.pose is not None
    assert abs(solution.pose.z_L - WORKED.z_L) < 1e-6


SEARCHED = (Constrained(), Constrained("paper"), LeastSquares(), Elastic(), Reprojection(), Penalty())


def worked_problem() -> Problem:
    return Problem.from_points(paper.exact_points(), WORKED_SETUP, 1e-4)


@pytest.mark.parametrize("formulation", SEARCHED, ids=lambda formulation: formulation.name)
def test_either_side_leaves_out_one_inequality_and_nothing_else(formulation: Formulation) -> None:
    problem = worked_problem()
    start = Start(25.0, (80.0, 0.3, 0.2), 0.1)
    whole, free = formulation.build(problem, start), EitherSide(formulation).build(problem, start)
    assert isinstance(whole, Nlp)
    assert isinstance(free, Nlp)
    kept = [row.equation not in (eq.lit_side, eq.lit_side_in_slopes) for row in whole.model.rows]
    assert free.model.rows == tuple(row for row, keep in zip(whole.model.rows, kept, strict=True) if keep)
    assert len(free.model.rows) == len(whole.model.rows) - 1
    np.testing.assert_array_equal(free.row_scale, whole.row_scale[kept])
    for name in ("start", "lower", "upper", "x_scale", "parameters"):
        np.testing.assert_array_equal(getattr(free, name), getattr(whole, name))
    (f, g), (f_free, g_free) = (nlp.model.values(nlp.start, nlp.parameters) for nlp in (whole, free))
    assert float(f) == float(f_free)
    np.testing.assert_array_equal(np.asarray(g_free).ravel(), np.asarray(g).ravel()[kept])
    assert whole.either_side().model is whole.either_side().model, "compiled again for every case"


@pytest.mark.parametrize("variables", ["slopes", "paper"])
def test_without_the_inequality_the_second_plane_is_found_and_refused(variables: str) -> None:
    problem = worked_problem()
    formulation = EitherSide(Constrained("slopes" if variables == "slopes" else "paper"))
    behind = solve_problem(problem).other_plane
    assert behind is not None
    assert "lit side is not visible" in behind.reason
    solution = solve_problem(problem, formulation=formulation, start=behind.pose, restart=False)
    assert solution.status is Status.UNSEEN
    assert solution.status.record == "refused"
    assert solution.pose is not None
    assert solution.pose.z_L == pytest.approx(behind.pose.z_L, rel=1e-9)
    # The roles are changed: the plane that is not the answer is the one that can be seen.
    assert solution.other_plane is not None
    assert solution.other_plane.pose.z_L == pytest.approx(WORKED.z_L, rel=1e-9)
    assert "can be seen" in solution.other_plane.reason
    again = solve_problem(problem, formulation=formulation, start=behind.pose)
    assert again.ok
    assert Flag.RESTARTED in again.flags
