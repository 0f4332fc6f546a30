"""What the calibration alone costs a plane: against estimation and Monte Carlo, and why poses hardly suffer."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibrated import good
from planeopt.calibration.pose_cost import plane_sensitivity, pose_cost, working_planes
from planeopt.errors import InputError
from planeopt.estimation import solve, solve_batch
from planeopt.rig import Rig
from planeopt.spot import Spot


def exact_spot(rig: Rig, z_L: float, alpha: float, beta: float, points: int = 360) -> Spot:
    """Return the noise-free boundary of a plane's spot: equation (3), in the laser-parallel frame."""
    p, q = -math.tan(alpha) * math.sin(beta), math.tan(alpha) * math.cos(beta)
    angle = np.linspace(0, math.tau, points, endpoint=False)
    circle = rig.require_beam().radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    depth = z_L + rig.axial_shift + circle @ [p, q]
    px = rig.from_laser_plane(rig.focal_length * (np.array(rig.laser_offset) + circle) / depth[:, None])
    # Points that stand for equal lengths of boundary.
    length = np.linalg.norm(np.roll(px, -1, axis=0) - np.roll(px, 1, axis=0), axis=1)
    return Spot(px, 0.1 / np.sqrt(length / length.mean()), kind="disc")


def distances() -> tuple[float, float]:
    depths = good().translations[:, 2]
    return float(depths.min()), float(depths.max())


@pytest.mark.parametrize("alpha_deg", [0.0, 25.0, 50.0])
def test_sensitivity_is_that_of_the_solution(alpha_deg: float):
    rig = good().rig
    plane = (sum(distances()) / 2, math.radians(alpha_deg), 0.7)
    found = solve(exact_spot(rig, *plane), rig).uncertainty
    assert found is not None
    assert found.plane_by_rig is not None
    assert found.normal_by_rig is not None
    by_plane, by_normal = plane_sensitivity(rig, np.array([plane]))
    # Both differentiate the same formula; 180 and 360 points of a smooth closed curve agree to rounding of its size.
    scale = np.sqrt(np.diagonal(rig.covariance_matrix))
    np.testing.assert_allclose(by_plane[0] * scale, found.plane_by_rig * scale, rtol=1e-4, atol=1e-6 * scale.max())
    np.testing.assert_allclose(by_normal[0] * scale, found.normal_by_rig * scale, rtol=1e-4, atol=1e-6 * scale.max())


def test_cost_is_what_rigs_drawn_from_the_covariance_scatter():
    rig = good().rig
    assert rig.covariance is not None
    plane = (sum(distances()) / 2, math.radians(30), 1.0)
    spot = exact_spot(rig, *plane, points=60)
    white = np.random.default_rng(4).standard_normal((100, len(rig.covariance.parameters)))
    draws = white @ np.linalg.cholesky(rig.covariance_matrix).T
    truth = solve_batch([spot], rig).normal[0]
    depths, angles = [], []
    for draw in draws:
        moved = rig.with_parameters(
            {name: rig.parameter(name) + step for name, step in zip(rig.covariance.parameters, draw, strict=True)}
        )
        found = solve_batch([spot], replace(moved, covariance=None))
        depths.append(found.planes[0, 0])
        angles.append(np.linalg.norm(np.cross(found.normal[0], truth)))
    (cost,) = pose_cost(rig, plane)
    # 4.9 sigma of a standard deviation from 100 draws, which is 1/sqrt(200); of an angle in two dimensions it is less.
    assert np.std(depths) == pytest.approx(cost.sigma_z_L, rel=4.9 / math.sqrt(200))
    assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(cost.sigma_normal, rel=4.9 / math.sqrt(200))


def test_poses_hardly_suffer_from_what_the_offset_is_uncertain_by():
    """The principal point and the beam are known badly and together: apart, they would seem to cost far more."""
    rig = good().rig
    assert rig.covariance is not None
    names = rig.covariance.parameters
    correlation = rig.covariance.correlation[names.index("cx"), names.index("direction_x")]
    assert correlation < -0.9
    for cost in pose_cost(rig, working_planes(distances())):
        assert cost.sigma_normal < 0.5 * cost.independent_normal
        assert cost.sigma_z_L < 1.01 * cost.independent_z_L


def test_the_costs_of_parts_are_those_of_the_blocks():
    rig = good().rig
    assert rig.covariance is not None
    plane = np.array([[distances()[0], 0.4, 0.2]])
    by_plane, by_normal = plane_sensitivity(rig, plane)
    offset = [rig.covariance.parameters.index(name) for name in ("e_x", "e_y")]
    variance = np.diagonal(rig.covariance.matrix)
    (cost,) = pose_cost(rig, plane)
    assert cost.offset_z_L == pytest.approx(math.sqrt(sum(by_plane[0, 0, k] ** 2 * variance[k] for k in offset)))
    assert cost.offset_normal == pytest.approx(
        math.sqrt(sum((by_normal[0, :, k] ** 2).sum() * variance[k] for k in offset))
    )


def test_nothing_is_known_of_a_rig_without_beam_or_covariance():
    rig = good().rig
    assert pose_cost(replace(rig, covariance=None), working_planes([300.0])) == ()
    assert pose_cost(replace(rig, covariance=None, beam=None), working_planes([300.0])) == ()


def test_working_planes_and_their_refusals():
    planes = working_planes([200.0, 300.0], np.radians([0.0, 30.0]))
    assert planes.shape == (6, 3)
    assert pose_cost(good().rig, planes[:1] * [2.0, 1, 1])[0].beta is None
    with pytest.raises(InputError, match="tilt"):
        pose_cost(good().rig, (300.0, math.pi / 2, 0.0))
    with pytest.raises(InputError, match="behind"):
        pose_cost(good().rig, (1.0, math.radians(88), 0.0))
