"""From random starts far from the answer `Constrained` reaches the true plane, or says that it did not."""

import math

import numpy as np
import pytest

from cases import WORKED, WORKED_SETUP, Array, boundary, circle, random_case, slopes
from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.formulations import Constrained, Problem
from planeopt.solution import Flag, Solution
from planeopt.solvers import Ipopt
from planeopt.spot import Spot

STARTS = 1000
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
    for i in range(100):
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
