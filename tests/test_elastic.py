"""A gross error in one image coefficient: `Elastic` names the equation at fault, and accuses none on clean data."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.linalg

from cases import WORKED, Array, random_case, slopes
from planeopt import equations as eq
from planeopt.estimation import solve, solve_problem
from planeopt.formulations import Constrained, Elastic, LeastSquares, Problem
from planeopt.nlp import Nlp
from planeopt.solution import Effort, Status
from planeopt.solvers import Found
from planeopt.solvers.base import NO_TRACE
from planeopt.solvers.kkt import check
from planeopt.spot import Spot
from problems import PIXEL, SIGMA, covariance_of, noisy, plane_of

OUTLIER = 15 * PIXEL
SEEDS = range(8)
INDICES = range(5)


def rms_shift_per_unit(problem: Problem) -> Array:
    """RMS over the points of how far the boundary moves along its normal, mm, per unit of each of B_1 ... B_5."""
    assert problem.points is not None
    x, y = problem.points.T
    B = problem.B
    monomials = np.stack([x * y, y * y, x, y, np.ones_like(x)], axis=1)
    gradient = np.hypot(2 * x + B[0] * y + B[2], B[0] * x + 2 * B[1] * y + B[3])
    return np.sqrt(np.mean((monomials / gradient[:, None]) ** 2, axis=0))


def with_outlier(problem: Problem, i: int, sign: float, size: float = OUTLIER) -> Problem:
    """``B_(i+1)`` is off by so much that the boundary moves by ``size`` mm RMS."""
    B = problem.B.copy()
    B[i] += sign * size / rms_shift_per_unit(problem)[i]
    return replace(problem, B=B)


def test_the_shift_is_what_moves_the_boundary() -> None:
    """A change of B_5 of a circle at the origin moves its radius by dB_5/(2 radius)."""
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    points = 3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    circle = Problem.from_points(points, eq.Setup(25.0, 0.0, 0.0, 10.0), SIGMA)
    assert rms_shift_per_unit(circle)[4] == pytest.approx(1 / 6, rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["above", "below"])
@pytest.mark.parametrize("i", INDICES, ids=[f"B_{i + 1}" for i in INDICES])
def test_an_outlier_of_15_px_is_found_in_its_equation(i: int, sign: float) -> None:
    culprit = eq.IMAGE_BLOCK[i]
    for seed in SEEDS:
        problem = with_outlier(noisy(seed), i, sign)
        solution = solve_problem(problem, formulation=Elastic())
        assert solution.worst is not None, (seed, solution.message)
        assert solution.worst.equation == f"({culprit.number})", (seed, solution.message)
        assert solution.status is Status.INCONSISTENT
        assert f"At fault: ({culprit.number}) {culprit.name}, off by" in solution.message
        assert solution.worst.unit in solution.message
        # 15 px over 0.3 px, times the square root of 200 points, is 700; what the plane can take up is in between.
        assert solution.worst.sigmas is not None
        assert solution.worst.sigmas > 6
        # The error is left where it is: the plane is that of the other four equations, which are clean, so its residual
        # is the error itself, to what the noise leaves open.
        added = sign * OUTLIER / rms_shift_per_unit(noisy(seed))[i]
        assert solution.worst.value == pytest.approx(-added, rel=0.1), seed


@pytest.mark.parametrize("i", INDICES, ids=[f"B_{i + 1}" for i in INDICES])
def test_constrained_says_that_such_data_are_inconsistent(i: int) -> None:
    for seed in SEEDS:
        for sign in (1.0, -1.0):
            solution = solve_problem(with_outlier(noisy(seed), i, sign), formulation=Constrained())
            assert solution.status is Status.INCONSISTENT, (seed, sign, solution.message)
            assert "chi-squared" in solution.message
            assert "At fault" not in solution.message
            assert not solution.ok


def test_the_plane_without_the_bad_equation_is_better_than_the_one_with_it() -> None:
    """That is why it is worth naming: L1 keeps the plane where the four good equations have it."""
    truth = slopes(WORKED)
    for seed in SEEDS:
        for i in INDICES:
            problem = with_outlier(noisy(seed), i, 1.0)
            elastic, spread = solve_problem(problem, formulation=Elastic()), solve_problem(problem)
            assert np.abs(plane_of(elastic) - truth)[0] < np.abs(plane_of(spread) - truth)[0], (seed, i)


def test_clean_data_are_ok_and_the_plane_is_near_the_efficient_one() -> None:
    for seed in range(20):
        problem = noisy(seed)
        elastic, best = solve_problem(problem, formulation=Elastic()), solve_problem(problem)
        assert elastic.ok, (seed, elastic.message)
        assert "At fault" not in elastic.message
        # An unbiased estimate differs from the efficient one by a part of its own variance (Hausman): 5 sigma is a
        # chance of 1e-6 a component.
        sigma = np.sqrt(np.diag(covariance_of(elastic)))
        assert np.all(np.abs(plane_of(elastic) - plane_of(best)) < 5 * sigma), seed


def test_clean_data_of_other_rigs_accuse_no_equation() -> None:
    """Over the range of rigs and planes, as often as `Constrained` finds the data consistent."""
    rng = np.random.default_rng(0)
    for i in range(25):
        case = random_case(rng, n=100)
        spot = Spot(case.pixels + 0.1 * rng.standard_normal(case.pixels.shape), np.full(100, 0.1))
        assert solve(spot, case.rig).ok, i
        solution = solve(spot, case.rig, formulation=Elastic())
        assert solution.status is not Status.INCONSISTENT, (i, solution.message)


def left_over_directions(problem: Problem) -> Array:
    """How an error of one unit in B_1 ... B_5 shows in what the plane cannot take up: (2, 5), in sigmas."""
    columns = []
    for i in range(3):
        z_L, p, q = slopes(WORKED) + 1e-30j * np.eye(3)[i]
        b = np.array(eq.image_conic_in_slopes(np, eq.SlopeVariables(None, z_L, p, q), problem.setup))
        columns.append((b[1:] / b[0]).imag / 1e-30)
    whitened = np.linalg.solve(problem.B_factor, np.stack(columns, axis=1))
    return scipy.linalg.null_space(whitened.T).T @ np.linalg.inv(problem.B_factor)


def nearest_angles(directions: Array) -> Array:
    """Angle (5,) of each direction to the nearest of the others, signs left aside."""
    unit = directions / np.linalg.norm(directions, axis=0)
    cosines = np.abs(unit.T @ unit) - 2 * np.eye(5)
    return np.arccos(cosines.max(axis=1))


def test_an_error_is_named_as_soon_as_noise_cannot_turn_it_towards_another() -> None:
    """The L1 vertex changes half way to the next direction: an error of s sigmas needs s sin(half angle) > 5."""
    for seed in SEEDS:
        base = noisy(seed)
        directions = left_over_directions(base)
        needed = 6 / np.sin(nearest_angles(directions) / 2)
        for i in INDICES:
            B = base.B.copy()
            B[i] += needed[i] / np.linalg.norm(directions[:, i])
            solution = solve_problem(replace(base, B=B), formulation=Elastic())
            assert solution.worst is not None, solution.message
            assert solution.worst.equation == f"({eq.IMAGE_BLOCK[i].number})", (seed, i, solution.message)
        # 15 px is beyond that for each of the five: naming it is no luck.
        size = OUTLIER / rms_shift_per_unit(base) * np.linalg.norm(directions, axis=0)
        assert np.all(size > needed)


def test_the_laser_rows_hold_at_the_vertex() -> None:
    for i in INDICES:
        solution = solve_problem(with_outlier(noisy(3), i, 1.0), formulation=Elastic())
        assert all(abs(r.value) < 1e-6 for r in solution.residuals if r.block == eq.Block.LASER)


def test_least_squares_spreads_the_error_instead() -> None:
    """Without weights the largest residual in sigmas points at the wrong equation at least once: L1 is needed."""
    wrong = 0
    for i in INDICES:
        solution = solve_problem(with_outlier(noisy(0), i, 1.0), formulation=LeastSquares())
        wrong += solution.worst is None or solution.worst.equation != f"({eq.IMAGE_BLOCK[i].number})"
        assert "At fault" not in solution.message
    assert wrong > 0


def test_a_slack_below_zero_is_called_by_its_equation() -> None:
    @dataclass(frozen=True)
    class Below:
        name: str = "Below"

        def prepare(self, nlp: Nlp) -> None:
            pass

        def solve(self, nlp: Nlp) -> Found:
            x = nlp.start.copy()
            x[[nlp.model.variables.index(f"{side}_17") for side in ("above", "below")]] -= 1.0
            return Found(nlp, x, "stopped", check(nlp, x), Effort(), NO_TRACE)

    solution = solve_problem(noisy(1, n=20), formulation=Elastic(), solver=Below())
    assert solution.status is Status.INFEASIBLE
    assert "The slack of (17) is beyond its bound by 1" in solution.message
