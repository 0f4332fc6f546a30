"""The rig's covariance, carried to the plane to first order and kept apart from the spot's."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from cases import Array, Case, boundary, circle
from planeopt import equations as eq
from planeopt.estimation import solve
from planeopt.estimation.rig_part import normal_by_rig, sensitivity
from planeopt.formulations import Constrained, Problem, Reprojection
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from planeopt.solution import Flag, Solution, Status
from planeopt.solvers import Ipopt, Sqp
from planeopt.spot import Spot

PARAMETERS = ("f", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "e_x", "e_y", "radius", "direction_x", "direction_y")
SIGMAS = np.array([1.0, 1.0, 1.0, 2e-3, 4e-3, 1e-4, 1e-4, 1e-3, 0.04, 0.04, 0.005, 2e-4, 2e-4])


def covariance(scale: float = 1.0) -> RigCovariance:
    """Correlated as a calibration's are: e_x with cx, e_y with cy, focal length with radius."""
    correlation = np.eye(len(PARAMETERS))
    for one, other, value in (("e_x", "cx", -0.95), ("e_y", "cy", -0.95), ("f", "radius", 0.5)):
        i, j = PARAMETERS.index(one), PARAMETERS.index(other)
        correlation[i, j] = correlation[j, i] = value
    return RigCovariance(PARAMETERS, correlation * np.outer(SIGMAS, SIGMAS) * scale**2)


@pytest.fixture
def case() -> Case:
    camera = Camera((1440, 1080), 3000.0, 3000.0, 725.0, 530.0, (-0.12, 0.09, 3e-4, -2e-4, 0.01), 0.00345)
    direction = np.array([0.012, -0.008, 1.0])
    beam = Beam(6.0, (24.0, -11.0), tuple(direction / np.linalg.norm(direction)))
    rig = Rig(camera, beam, None, covariance())
    pose = SpotPose.from_slopes(250.0, 0.35, -0.5, 6.0)
    k = eq.Setup(rig.focal_length, *rig.laser_offset, 6.0)
    assert pose.beta is not None
    v = eq.PaperVariables(pose.R, pose.z_L + rig.axial_shift, pose.alpha, pose.beta)
    pixels = rig.from_laser_plane(boundary(v, k, circle(120)))
    return Case(rig, pose, rig.plane_from_pose(pose), pixels)


def outputs(solution: Solution) -> Array:
    """``(z_L, p, q)`` and the normal in the camera frame."""
    assert solution.pose is not None, solution.message
    assert solution.plane is not None
    return np.array([solution.pose.z_L, *solution.pose.slopes, *solution.plane.normal])


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("formulation", [Constrained(), Reprojection()], ids=lambda f: f.name)
def test_sensitivity_is_the_derivative_of_the_solution(
    case: Case, name: str, formulation: Constrained | Reprojection
) -> None:
    """At exact points the first-order formula is exact: compared with central differences of a whole new solve.

    With a step of h sigma the difference quotient is off by h^2 times the third derivative; a hundredth of a sigma
    leaves four digits of it, and solving to 1e-9 leaves more.
    """
    spot = Spot(case.pixels, np.full(len(case.pixels), 0.05))
    problem = Problem.from_spot(spot, case.rig)
    plane = np.array([case.pose.z_L + case.rig.axial_shift, *case.pose.slopes])
    effect = sensitivity(problem, case.rig, plane)
    column = PARAMETERS.index(name)
    turned = normal_by_rig(case.rig, plane, effect.plane_by_rig)
    analytic = np.concatenate([effect.plane_by_rig[:, column], turned[:, column]])
    h = 0.01 * SIGMAS[column]
    moved = [
        outputs(solve(spot, case.rig.with_parameters({name: case.rig.parameter(name) + s}), formulation=formulation))
        for s in (h, -h)
    ]
    numeric = (moved[0] - moved[1]) / (2 * h)
    size = np.array([250.0, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(numeric / size, analytic / size, rtol=1e-3, atol=1e-3 * np.abs(analytic / size).max())


def test_sigma_of_the_long_axis_holds_the_radius_and_what_it_shares_with_the_slopes(case: Case) -> None:
    """Against R = r sqrt(1 + p^2 + q^2) of new solves, the rig a hundredth of a sigma off along its covariance.

    Differences of that size leave four digits.
    """
    spot = Spot(case.pixels, np.full(len(case.pixels), 0.05))
    solution = solve(spot, case.rig)
    assert solution.sigma is not None
    assert solution.sigma_spot is not None
    factor = np.linalg.cholesky(covariance().matrix)
    nominal = np.array([case.rig.parameter(name) for name in PARAMETERS])
    variance, step = 0.0, 0.01
    for axis in factor.T:
        ends = []
        for way in (step, -step):
            rig = case.rig.with_parameters(dict(zip(PARAMETERS, nominal + way * axis, strict=True)))
            pose = solve(spot, rig).pose
            assert pose is not None
            ends.append(pose.R)
        variance += ((ends[0] - ends[1]) / (2 * step)) ** 2
    found = np.sqrt((solution.sigma.R or 0) ** 2 - (solution.sigma_spot.R or 0) ** 2)
    assert found == pytest.approx(np.sqrt(variance), rel=1e-3)


def test_without_a_covariance_the_rig_part_is_zero_and_flagged(case: Case) -> None:
    spot = Spot(case.pixels, np.full(len(case.pixels), 0.05))
    with_rig, without = solve(spot, case.rig), solve(spot, replace(case.rig, covariance=None))
    assert Flag.RIG_WITHOUT_COVARIANCE in without.flags
    assert Flag.RIG_WITHOUT_COVARIANCE not in with_rig.flags
    assert with_rig.uncertainty is not None
    assert without.uncertainty is not None
    assert not without.uncertainty.rig.any()
    np.testing.assert_allclose(with_rig.uncertainty.spot, without.uncertainty.spot, rtol=1e-9)
    assert with_rig.sigma is not None
    assert with_rig.sigma_spot is not None
    assert with_rig.sigma.z_L > with_rig.sigma_spot.z_L
    assert with_rig.sigma.normal > with_rig.sigma_spot.normal


def test_errors_of_a_wrong_rig_have_the_stated_covariance(case: Case) -> None:
    """Rigs drawn from the covariance make the spots; the nominal rig measures them.

    The error over the total covariance is chi-squared with 3 degrees of freedom, the self-test with 2, two-sided at a
    family-wise level of 0.001; without the rig's part both are far too large.
    """
    draws, sigma, level = 400, 0.03, 0.001 / 4
    assert case.rig.covariance is not None
    rng = np.random.default_rng(12)
    root = np.linalg.cholesky(case.rig.covariance.matrix)
    nominal = np.array([case.rig.parameter(name) for name in PARAMETERS])
    errors, tests, naive = [], [], []
    for _ in range(draws):
        values = nominal + root @ rng.normal(size=len(nominal))
        true = replace(case.rig, covariance=None).with_parameters(dict(zip(PARAMETERS, values.tolist(), strict=True)))
        pose = true.pose_from_plane(case.plane)
        k = eq.Setup(true.focal_length, *true.laser_offset, true.require_beam().radius)
        assert pose.beta is not None
        v = eq.PaperVariables(pose.R, pose.z_L + true.axial_shift, pose.alpha, pose.beta)
        pixels = true.from_laser_plane(boundary(v, k, circle(120)))
        spot = Spot(pixels + sigma * rng.normal(size=pixels.shape), np.full(len(pixels), sigma))
        solution = solve(spot, case.rig, solver=Sqp())
        assert solution.pose is not None, solution.message
        assert solution.covariance is not None
        assert solution.uncertainty is not None
        error = np.array([solution.pose.z_L, *solution.pose.slopes]) - np.array([pose.z_L, *pose.slopes])
        errors.append(error @ np.linalg.solve(solution.covariance, error))
        naive.append(error @ np.linalg.solve(solution.uncertainty.spot, error))
        tests.append(solution.chi2)
    for values, dof in ((errors, 3), (tests, 2)):
        low, high = scipy.stats.chi2.ppf([level / 2, 1 - level / 2], dof * draws)
        assert low < np.sum(values) < high, (dof, np.mean(values))
    assert np.mean(naive) > 10


def test_a_rig_off_by_more_than_its_covariance_is_inconsistent(case: Case) -> None:
    spot = Spot(case.pixels, np.full(len(case.pixels), 0.03))
    trusted = replace(case.rig, covariance=covariance(1e-3))
    wrong = trusted.with_parameters({"e_x": 24.0 * 1.05, "e_y": -11.0 * 0.9})
    solution = solve(spot, wrong, solver=Ipopt())
    assert solution.status is Status.INCONSISTENT
    assert "1e-6" in solution.message
    believed = replace(wrong, covariance=covariance(100.0))
    assert solve(spot, believed).ok
