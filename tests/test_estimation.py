"""One spot to one plane: statuses, flags, starts, noise scales and what is recomputed at the solution."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from cases import WORKED, WORKED_SETUP, Array, boundary, circle, random_case, slopes
from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.estimation import solve, solve_problem
from planeopt.formulations import (
    AsPrinted,
    ClosedForm,
    Constrained,
    Elastic,
    LeastSquares,
    Penalty,
    Problem,
    Reprojection,
)
from planeopt.formulations.snooping import detectability
from planeopt.plane import SpotPose
from planeopt.solution import Flag, SolveError, Status
from planeopt.solvers import Sqp
from planeopt.spot import Spot, SpotFlag
from planeopt.uncertainty import sigmas

SIGMA = 1e-3


def noisy(n: int = 100, sigma: float = SIGMA, arc: float = 1.0, seed: int = 0) -> Array:
    exact = boundary(WORKED, WORKED_SETUP, circle(n, arc))
    return exact + sigma * np.random.default_rng(seed).normal(size=exact.shape)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.from_points(noisy(), WORKED_SETUP, SIGMA)


def test_the_default_is_constrained_with_ipopt(problem: Problem) -> None:
    solution = solve_problem(problem)
    assert (solution.formulation, solution.solver) == ("Constrained", "Ipopt")
    assert solution.ok
    assert solution.kkt is not None
    assert solution.kkt.ok
    assert solution.flags == ()
    assert solution.message == Status.CONVERGED.value


def test_all_ten_residuals_are_evaluated_again(problem: Problem) -> None:
    solution = solve_problem(problem)
    assert [r.equation for r in solution.residuals] == [f"({n})" for n in (11, 12, 13, 14, 15, 17, 18, 19, 20, 21)]
    assert [r.block for r in solution.residuals] == ["laser"] * 5 + ["image"] * 5
    laser, image = solution.residuals[:5], solution.residuals[5:]
    # The laser block holds by construction: what is left is the rounding of numbers up to |e|^2 = 2500.
    assert max(abs(r.value) for r in laser) < 2500 * 100 * np.finfo(float).eps
    # Whitened by the covariance of B, the image block's residuals are chi-squared itself.
    whitened = np.linalg.solve(problem.B_factor, [r.value for r in image])
    assert whitened @ whitened == pytest.approx(solution.chi2, rel=1e-6)


def test_the_points_chi_squared_has_its_degrees_of_freedom(problem: Problem) -> None:
    solution = solve_problem(problem)
    assert solution.dof_points == 97
    assert solution.chi2_points is not None
    assert scipy.stats.chi2(97).ppf(0.0005) < solution.chi2_points < scipy.stats.chi2(97).ppf(0.9995)


def test_points_that_scatter_more_than_their_sigma_are_flagged() -> None:
    solution = solve_problem(Problem.from_points(noisy(), WORKED_SETUP, SIGMA / 2))
    assert solution.ok
    assert Flag.POINTS_SCATTER in solution.flags
    # Such points are no image that agrees with the rig.
    assert solution.message == f"A plane was found. {Flag.POINTS_SCATTER.value}"


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ((1.0, 2.0, 3.0), "four finite numbers"),
        ((10.0, 250.0, math.nan, 0.0), "four finite numbers"),
        ((10.0, -250.0, 0.3, 0.0), "z_L > 0"),
        ((0.0, 250.0, 0.3, 0.0), "R > 0"),
        ((10.0, 250.0, 2.0, 0.0), "|alpha| < pi/2"),
    ],
)
def test_an_unusable_start_is_refused_in_one_line(problem: Problem, start: tuple[float, ...], words: str) -> None:
    with pytest.raises(InputError) as caught:
        solve_problem(problem, start=start)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pose_is_a_start_too(problem: Problem) -> None:
    solution = solve_problem(problem, start=SpotPose(10.0, 250.0, 0.3, 0.3))
    assert solution.ok


def test_throw_raises_what_would_be_returned() -> None:
    case = random_case(np.random.default_rng(1))
    spot = Spot(case.pixels, np.full(len(case.pixels), 0.1))
    returned = solve(spot, case.rig, formulation=AsPrinted())
    assert returned.status is Status.OVERDETERMINED
    assert returned.pose is None
    with pytest.raises(SolveError) as caught:
        solve(spot, case.rig, formulation=AsPrinted(), throw=True)
    assert caught.value.solution.message == returned.message == str(caught.value)


def test_the_spots_flags_come_first() -> None:
    case = random_case(np.random.default_rng(1))
    spot = Spot(case.pixels, np.full(len(case.pixels), 0.1), flags=(SpotFlag.SATURATED,))
    assert solve(spot, case.rig).flags[0] is SpotFlag.SATURATED


def test_an_unknown_scale_is_estimated_and_said() -> None:
    known = solve_problem(Problem.from_points(noisy(400), WORKED_SETUP, SIGMA))
    unknown = solve_problem(Problem.from_points(noisy(400), WORKED_SETUP))
    assert Flag.SCALE_ESTIMATED in unknown.flags
    assert unknown.chi2_points is None
    assert known.sigma is not None
    assert unknown.sigma is not None
    # chi-squared with 395 degrees of freedom: its root is within 4 x 1/sqrt(2 x 395) of 1.
    assert unknown.sigma.z_L == pytest.approx(known.sigma.z_L, rel=4 / math.sqrt(2 * 395))


def test_with_an_estimated_scale_the_p_value_is_that_of_f() -> None:
    """Eight points leave 3 degrees of freedom for the scale: a chi-squared law would reject far too often."""
    draws = 400
    p_values = [
        solve_problem(Problem.from_points(noisy(8, seed=seed), WORKED_SETUP), solver=Sqp()).p_value
        for seed in range(draws)
    ]
    assert all(p is not None for p in p_values)
    assert scipy.stats.kstest(np.array(p_values, dtype=float), "uniform").pvalue > 0.001


def test_five_points_without_sigma_give_a_plane_without_an_error_bar() -> None:
    solution = solve_problem(Problem.from_points(boundary(WORKED, WORKED_SETUP, circle(5)), WORKED_SETUP))
    assert solution.status is Status.NO_NOISE_SCALE
    assert solution.status.record == "degraded"
    assert solution.pose is not None
    assert solution.pose.z_L == pytest.approx(75, rel=1e-8)
    assert (solution.covariance, solution.chi2, solution.p_value, solution.sigma) == (None, None, None, None)
    assert "sigma_px" in solution.message


def test_five_points_with_sigma_are_enough() -> None:
    solution = solve_problem(Problem.from_points(noisy(5), WORKED_SETUP, SIGMA))
    assert solution.ok
    assert solution.dof_points == 2


def test_exact_points_are_weighted_by_a_floor_not_by_their_rounding() -> None:
    exact = boundary(WORKED, WORKED_SETUP, circle(50))
    solution = solve_problem(Problem.from_points(exact, WORKED_SETUP))
    assert Flag.SCALE_AT_FLOOR in solution.flags
    assert solution.ok
    assert solution.chi2 is not None
    assert solution.chi2 < 1e-6
    given = solve_problem(Problem.from_points(exact, WORKED_SETUP, 1e-14))
    assert Flag.SCALE_AT_FLOOR in given.flags
    assert given.ok


def test_at_zero_tilt_beta_and_the_angles_sigmas_are_undefined() -> None:
    flat = eq.PaperVariables(10.0, 250.0, 0.0, 0.0)
    solution = solve_problem(Problem.from_points(boundary(flat, WORKED_SETUP, circle(80)), WORKED_SETUP, 1e-4))
    assert solution.ok
    assert solution.pose is not None
    assert (solution.pose.alpha, solution.pose.beta) == (0.0, None)
    assert Flag.BETA_UNDEFINED in solution.flags
    assert solution.sigma is not None
    assert (solution.sigma.alpha, solution.sigma.beta, solution.sigma.R) == (None, None, None)
    assert solution.sigma.normal > 0


def test_the_paper_variables_say_why_they_have_no_covariance_at_zero_tilt() -> None:
    flat = eq.PaperVariables(10.0, 250.0, 0.0, 0.0)
    case = Problem.from_points(boundary(flat, WORKED_SETUP, circle(80)), WORKED_SETUP, 1e-4)
    solution = solve_problem(case, formulation=Constrained("paper"))
    assert solution.pose is not None, solution.message
    assert solution.pose.z_L == pytest.approx(250, rel=1e-9)
    assert (solution.covariance is None) == (solution.uncertainty_reason is not None)


def test_sigmas_are_the_derivatives_of_the_pose() -> None:
    """Against central differences of `SpotPose.from_slopes` with a step of 1e-6: good to 1e-8."""
    plane, radius = np.array([250.0, 0.4, -0.3]), 10.0
    covariance = np.array([[0.04, 1e-3, -2e-3], [1e-3, 1e-3, 2e-4], [-2e-3, 2e-4, 2e-3]])
    pose = SpotPose.from_slopes(250.0, 0.4, -0.3, radius)
    steps = 1e-6 * np.eye(3)

    def angles(at: Array) -> Array:
        z_L, p, q = (float(value) for value in at)
        moved = SpotPose.from_slopes(z_L, p, q, radius)
        return np.array([moved.z_L, moved.alpha, moved.beta or 0.0, moved.R])

    jacobian = np.array([(angles(plane + s) - angles(plane - s)) / 2e-6 for s in steps]).T
    expected = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
    found = sigmas(pose, covariance, np.eye(3), radius)
    values = np.array([found.z_L, found.alpha, found.beta, found.R], dtype=float)
    np.testing.assert_allclose(values, expected, rtol=1e-7)


def test_the_second_plane_outside_inside_and_on_the_beam() -> None:
    outside = solve_problem(Problem.from_points(boundary(WORKED, WORKED_SETUP, circle(24)), WORKED_SETUP, 1e-4))
    assert outside.other_plane is not None
    assert "lit side" in outside.other_plane.reason
    for offset, words in ((4.0, "behind the camera"), (10.0, None)):
        k = eq.Setup(25.0, offset, 0.0, 10.0)
        solution = solve_problem(Problem.from_points(boundary(WORKED, k, circle(24)), k, 1e-4))
        assert solution.ok
        if words is None:
            assert solution.other_plane is None
        else:
            assert solution.other_plane is not None
            assert words in solution.other_plane.reason
            assert solution.other_plane.pose.z_L < 0


def test_an_ellipse_alone_gives_the_same_plane_as_its_points(problem: Problem) -> None:
    alone = Problem.from_conic(problem.B, problem.B_factor @ problem.B_factor.T, WORKED_SETUP)
    one, other = solve_problem(alone), solve_problem(problem)
    assert one.pose is not None
    assert other.pose is not None
    assert one.pose.z_L == pytest.approx(other.pose.z_L, rel=1e-9)
    np.testing.assert_allclose(np.asarray(one.covariance), np.asarray(other.covariance), rtol=1e-6)
    assert solve_problem(alone, formulation=Reprojection()).status is Status.UNIDENTIFIABLE


@pytest.mark.parametrize(
    ("B", "covariance", "words"),
    [
        (np.zeros(4), np.eye(5), "(5,)"),
        (np.full(5, np.nan), np.eye(5), "finite"),
        (np.ones(5), -np.eye(5), "positive definite"),
    ],
)
def test_an_unusable_ellipse_is_refused(B: Array, covariance: Array, words: str) -> None:
    with pytest.raises(InputError) as caught:
        Problem.from_conic(B, covariance, WORKED_SETUP)
    assert words in str(caught.value)


def test_an_ellipse_that_no_plane_explains_is_never_ok(problem: Problem) -> None:
    """A spot far off the image of the beam: the closed form refuses, the others find no plane that fits."""
    shifted = noisy() + np.array([-12.0, 9.0])
    far = Problem.from_points(shifted, WORKED_SETUP, SIGMA)
    for formulation in (ClosedForm(), Constrained(), Reprojection()):
        solution = solve_problem(far, formulation=formulation)
        assert not solution.ok
        assert solution.status.record in ("degraded", "refused")
        assert solution.message
    assert solve_problem(problem, formulation=ClosedForm()).ok


def test_a_local_minimum_that_chi_squared_cannot_see_is_refused() -> None:
    """On the beam's surface unweighted least squares can stop far away, its left-over misfit small by chance."""
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(12):
        case = random_case(rng, 100, "on the beam")
        spot = Spot(case.pixels + 0.1 * rng.normal(size=case.pixels.shape), np.full(100, 0.1))
        solution = solve(spot, case.rig, formulation=LeastSquares())
        refused += solution.status is Status.LOCAL_MINIMUM
        if solution.ok:
            assert solution.pose is not None
            assert solution.covariance is not None
            error = np.array([solution.pose.z_L, *solution.pose.slopes]) - [case.pose.z_L, *case.pose.slopes]
            # chi-squared with 3 degrees of freedom exceeds 40 once in a hundred million.
            assert error @ np.linalg.solve(solution.covariance, error) < 40
        assert solve(spot, case.rig).ok
    assert refused


def test_an_equation_is_accused_with_what_else_would_explain_it() -> None:
    """In the worked example (17) and (19) point nearly alike: a small error in one can be told from neither."""
    right = Problem.from_points(noisy(200), WORKED_SETUP, SIGMA)
    B_3 = right.B + np.array([0, 0, 40 / detectability(right, slopes(WORKED))[2], 0, 0])
    solution = solve_problem(replace(right, B=B_3), formulation=Elastic())
    assert solution.status is Status.INCONSISTENT
    assert "At fault: (1" in solution.message
    assert "(17)" in solution.message
    assert "(19)" in solution.message
    assert "the rest would agree as well" in solution.message


def test_an_inefficient_plane_is_not_taken_for_scattered_points() -> None:
    """chi-squared of the points is that of the efficient plane, whoever found the one reported."""
    short = Problem.from_points(noisy(120, arc=0.4), WORKED_SETUP, SIGMA)
    best, rough = solve_problem(short), solve_problem(short, formulation=ClosedForm())
    assert best.chi2_points is not None
    assert rough.chi2_points == pytest.approx(best.chi2_points, rel=1e-2)
    assert Flag.POINTS_SCATTER not in rough.flags


def test_penalty_has_swift_for_its_usual_solver(problem: Problem) -> None:
    solution = solve_problem(problem, formulation=Penalty())
    assert (solution.solver, solution.status) == ("Swift", Status.CONVERGED)


@pytest.mark.parametrize(("slope_sigma", "flagged"), [(0.19, False), (0.21, True)])
def test_slopes_are_weak_beyond_a_standard_deviation_of_a_fifth(slope_sigma: float, flagged: bool) -> None:
    """The covariance scales with the noise, so the noise that makes any slope sigma follows from one solve."""
    faint = eq.PaperVariables(10.0 / math.cos(0.2), 900.0, 0.2, 0.5)
    exact = boundary(faint, WORKED_SETUP, circle(60))
    unit = solve_problem(Problem.from_points(exact, WORKED_SETUP, SIGMA)).covariance
    assert unit is not None
    largest = math.sqrt(np.linalg.eigvalsh(unit[1:, 1:])[-1])
    solution = solve_problem(Problem.from_points(exact, WORKED_SETUP, SIGMA * slope_sigma / largest))
    assert (Flag.WEAK in solution.flags) == flagged


@pytest.mark.parametrize(("arc", "flagged"), [(0.32, True), (0.35, False)])
def test_an_arc_is_short_under_a_third(arc: float, flagged: bool) -> None:
    problem = Problem.from_points(noisy(200, sigma=1e-5), WORKED_SETUP, 1e-5)
    solution = solve_problem(replace(problem, arc=arc))
    assert (Flag.SHORT_ARC in solution.flags) == flagged


def test_weak_data_are_flagged() -> None:
    faint = eq.PaperVariables(10.0 / math.cos(0.2), 900.0, 0.2, 0.5)
    exact = boundary(faint, WORKED_SETUP, circle(60))
    rough = exact + 5e-3 * np.random.default_rng(2).normal(size=exact.shape)
    solution = solve_problem(Problem.from_points(rough, WORKED_SETUP, 5e-3))
    assert {Flag.WEAK, Flag.ANGLES_NONLINEAR} & set(solution.flags)
    short = solve_problem(Problem.from_points(noisy(arc=0.25, sigma=1e-4), WORKED_SETUP, 1e-4))
    assert Flag.SHORT_ARC in short.flags


def test_the_same_input_gives_the_same_bytes(problem: Problem) -> None:
    first, second = solve_problem(problem), solve_problem(replace(problem))
    assert first.pose == second.pose
    assert np.asarray(first.covariance).tobytes() == np.asarray(second.covariance).tobytes()


def test_slopes_of_the_worked_example_are_those_of_its_angles() -> None:
    pose = SpotPose.canonical(*WORKED)
    np.testing.assert_allclose([pose.z_L, *pose.slopes], slopes(WORKED), rtol=1e-15)
