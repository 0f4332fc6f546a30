"""What an uncertain rig does to second order: its size, and that no test takes it for evidence against the rig."""

import math

import numpy as np
import pytest
import scipy.stats

from cases import boundary, circle
from planeopt import equations as eq
from planeopt.estimation import solve_batch
from planeopt.estimation.drift import LEVEL, drift
from planeopt.estimation.second_order import bend, fineness, misfit_covariance, typical_sigma
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from planeopt.spot import Spot

SIGMA, POINTS = 0.05, 90


def test_the_second_order_of_a_shifted_circle() -> None:
    radius, shift, n = 40.0, 1.0, 180
    angle = 2 * np.pi * np.arange(n) / n
    moved = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [shift, 0.0]
    distance = np.linalg.norm(moved, axis=1) - radius
    linear = shift * np.cos(angle)
    misfit = float(np.linalg.norm(linear)) / SIGMA
    left = np.linalg.norm(distance - linear) / SIGMA
    fine = fineness(SIGMA / radius, n)
    # Of one shift all of it is there, of which `bend` is a third; and that is for shifts of a normal law, whose mean
    # fourth power is three times its squared variance. The next order is shift/radius of this one.
    assert left == pytest.approx(float(bend(misfit**2, fine)), rel=2 * shift / radius)


def test_an_exact_rig_has_no_second_order() -> None:
    by_rig = np.array([[1.0, 2.0], [0.5, -1.0]])
    np.testing.assert_array_equal(misfit_covariance(by_rig, np.zeros((2, 2)), 0.3), np.eye(2))
    far = misfit_covariance(by_rig, np.eye(2), 0.3)
    np.testing.assert_allclose(far, by_rig @ by_rig.T + (1 + 3 / 8 * (6.25 * 0.3) ** 2) * np.eye(2))
    noise = np.array([[4.0, 0.0], [0.0, 4.0]])
    assert typical_sigma(np.tile(noise, (1, 5, 1, 1)))[0] == 2.0


def test_rigs_as_calibrated_are_not_called_degraded_where_a_principal_point_is_known_to_a_pixel() -> None:
    """To first order alone one in eight batches of such rigs was: of 60, no more are than chance calls so."""
    names = ("fx", "fy", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
    sigmas = np.array([2.0, 2.0, 1.0, 1.0, 0.04, 0.04, 0.01, 3e-4, 3e-4])
    correlation = np.eye(len(names))
    for i, j, value in ((0, 1, 0.98), (2, 4, -0.9), (3, 5, -0.9)):
        correlation[i, j] = correlation[j, i] = value
    covariance = correlation * np.outer(sigmas, sigmas)
    direction = np.array([0.02, -0.05, 1.0])
    camera = Camera((1440, 1080), 3000.0, 3000.0, 725.0, 530.0, (-0.12, 0.09, 3e-4, -2e-4, 0.01), 0.00345)
    beam = Beam(6.0, (24.0, -11.0), tuple(direction / np.linalg.norm(direction)))
    rig = Rig(camera, beam, None, RigCovariance(names, covariance))
    nominal, root = np.array([rig.parameter(name) for name in names]), np.linalg.cholesky(covariance)
    rng, batches, called = np.random.default_rng(5), 60, 0
    for _ in range(batches):
        true = rig.with_parameters(dict(zip(names, nominal + root @ rng.standard_normal(len(names)), strict=True)))
        called += not drift(solve_batch([_spot(true, rng) for _ in range(6)], rig), rig).ok
    assert called <= scipy.stats.binom.isf(1e-3, batches, LEVEL)


def _spot(rig: Rig, rng: np.random.Generator) -> Spot:
    """A spot of a random plane, its points off along the boundary's normals."""
    slope, azimuth = math.tan(rng.uniform(0.05, 1.0)), rng.uniform(-math.pi, math.pi)
    radius = rig.require_beam().radius
    pose = SpotPose.from_slopes(rng.uniform(150, 900), slope * math.cos(azimuth), slope * math.sin(azimuth), radius)
    assert pose.beta is not None
    k = eq.Setup(rig.focal_length, *rig.laser_offset, radius)
    v = eq.PaperVariables(pose.R, pose.z_L + rig.axial_shift, pose.alpha, pose.beta)
    pixels = rig.from_laser_plane(boundary(v, k, circle(POINTS)))
    along = np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0)
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    return Spot(pixels + SIGMA * rng.standard_normal(POINTS)[:, None] * normals, np.full(POINTS, SIGMA))
