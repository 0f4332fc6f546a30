"""The Cramér-Rao bound, the criterion of its reach, and the flag that tells of it."""

from dataclasses import replace

import numpy as np
import pytest

import planeopt as po
from cases import WORKED, WORKED_SETUP, boundary, circle, slopes
from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.estimation.efficiency import CURVATURE, NOISE_SHARE, SLOPE_SIGMA, bound, minor_axes, within_reach
from planeopt.formulations import Problem
from planeopt.solution import Flag
from planeopt.solvers import Sqp
from planeopt.spot import Spot
from test_efficiency import CASES, SIGMA, cramer_rao_bound
from test_solve_batch import rig, spot


@pytest.mark.parametrize("case", CASES)
def test_the_bound_is_the_inverse_of_the_information(case: str) -> None:
    """Against central differences of (5), good to the square of their step of 1e-6, and rounding over it."""
    v, theta = CASES[case]
    problem = Problem.from_points(boundary(v, WORKED_SETUP, theta), WORKED_SETUP, SIGMA)
    expected = cramer_rao_bound(v, WORKED_SETUP, theta, SIGMA)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(bound(problem, slopes(v)) / size, expected / size, atol=1e-6)


def test_noise_does_not_move_the_bound_of_the_boundary() -> None:
    """The points are put on the boundary first: what they are off it is of the order of noise over size, 1e-3."""
    exact = boundary(WORKED, WORKED_SETUP, circle(100))
    noisy = exact + SIGMA * np.random.default_rng(0).standard_normal(exact.shape)
    one, other = (bound(Problem.from_points(p, WORKED_SETUP, SIGMA), slopes(WORKED)) for p in (exact, noisy))
    np.testing.assert_allclose(other, one, rtol=0.02)


def test_the_minor_axis_is_the_images() -> None:
    problem = Problem.from_points(boundary(WORKED, WORKED_SETUP, circle(100)), WORKED_SETUP, SIGMA)
    assert minor_axes(WORKED_SETUP, slopes(WORKED)[None])[0] == pytest.approx(problem.minor_axis)


def reach_at(sigma: float, arc: float = 1.0, v: eq.PaperVariables = WORKED) -> tuple[float, float, float]:
    problem = Problem.from_points(boundary(v, WORKED_SETUP, circle(200, arc)), WORKED_SETUP, sigma)
    found = within_reach(problem, slopes(v))
    return float(found.sigma_over_axis[0]), float(found.curvature[0]), float(found.slope_sigma[0])


def test_all_three_go_with_the_noise() -> None:
    """Second differences over steps of one sigma go with its square, over sigma with sigma."""
    ratios = np.array(reach_at(2 * SIGMA)) / reach_at(SIGMA)
    np.testing.assert_allclose(ratios, 2.0, rtol=0.01)


def test_curvature_is_that_of_the_images() -> None:
    """Against second differences of (5) across the boundary: where each normal of it meets the other images."""
    v, k, n = WORKED, WORKED_SETUP, 200
    plane, phi, sigma = slopes(v), circle(n, 0.4) + v.beta, 0.02
    exact = boundary(v, k, circle(n, 0.4))
    problem = Problem.from_points(exact, k, sigma)
    covariance = bound(problem, plane)
    unit = np.array([plane[0], 1.0, 1.0])
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))

    def images(at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        sv = eq.SlopeVariables(None, *at)
        return np.stack(eq.image_point(np, k, *eq.spot_point_in_slopes(np, sv, k, angles)), axis=1)

    tangent = images(plane, phi + 1e-6) - images(plane, phi - 1e-6)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]

    def moved(at: np.ndarray) -> np.ndarray:
        """Where the line through each point across the boundary meets the boundary of another plane."""
        angles = phi.copy()
        for _ in range(20):
            off = images(at, angles) - exact
            rate = (images(at, angles + 1e-6) - images(at, angles - 1e-6)) / 2e-6
            across = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
            angles -= np.sum(off * across, axis=1) / np.sum(rate * across, axis=1)
        return np.sum((images(at, angles) - exact) * normal, axis=1)

    def after(step: np.ndarray) -> np.ndarray:
        return np.array([plane[0] * np.exp(step[0]), *(plane[1:] + step[1:])])

    jacobian = np.stack([moved(after(h)) - moved(after(-h)) for h in 1e-3 * np.eye(3)], axis=1)
    basis = np.linalg.qr(jacobian)[0]
    second = [moved(after(step)) + moved(after(-step)) for step in (vectors * np.sqrt(values)).T]
    expected = max(np.linalg.norm(basis.T @ s) for s in second) / sigma
    # Distances along the normal of the old boundary and along the new one differ in the second order by the square of
    # the turn between them, which is small against the bending itself here.
    assert float(within_reach(problem, plane).curvature[0]) == pytest.approx(expected, rel=0.3)


def test_each_limit_takes_the_bound_out_of_reach() -> None:
    problem = Problem.from_points(boundary(WORKED, WORKED_SETUP, circle(200)), WORKED_SETUP, SIGMA)
    found = within_reach(problem, slopes(WORKED))
    assert found.ok.all()
    for name, limit in (("sigma_over_axis", NOISE_SHARE), ("curvature", CURVATURE), ("slope_sigma", SLOPE_SIGMA)):
        assert replace(found, **{name: np.array([0.99 * limit])}).ok.all()
        assert not replace(found, **{name: np.array([1.01 * limit])}).ok.any()
        assert not replace(found, **{name: np.array([np.inf])}).ok.any()


def test_only_points_have_a_bound() -> None:
    problem = Problem.from_points(boundary(WORKED, WORKED_SETUP, circle(100)), WORKED_SETUP, SIGMA)
    ellipse_only = Problem.from_conic(problem.B, problem.B_factor @ problem.B_factor.T, WORKED_SETUP)
    with pytest.raises(ValueError, match="boundary points"):
        bound(ellipse_only, slopes(WORKED))
    assert Flag.BOUND_OUT_OF_REACH not in solve_problem(ellipse_only, solver=Sqp()).flags


def test_solve_and_solve_batch_tell() -> None:
    rng, used = np.random.default_rng(1), rig()
    clear = spot(rng, 100)
    # Twice a fiftieth of a radius of at least 45 px, and noise to match.
    coarse = Spot(clear.points + 3.0 * rng.standard_normal(clear.points.shape), np.full(100, 3.0))
    batch = po.solve_batch([clear, coarse], used)
    for row, (given, told) in enumerate(((clear, False), (coarse, True))):
        assert (Flag.BOUND_OUT_OF_REACH in po.solve(given, used).flags) is told
        assert (Flag.BOUND_OUT_OF_REACH in batch.flags[row]) is told
