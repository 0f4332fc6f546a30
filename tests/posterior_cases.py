"""Boundary points of known planes on the image plane, for the tests of the posterior."""

import math
from dataclasses import replace

import numpy as np
import scipy.stats

from cases import Array, boundary, circle
from planeopt import equations as eq
from planeopt.formulations import Problem
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from planeopt.spot import Spot

SETUP = eq.Setup(12.0, 21.4, 15.8, 6.0)
PIXEL = 0.0055
"""mm."""

LEVEL = 0.001
"""Family-wise probability that a right posterior fails a test."""


def seen(
    z_L: float = 240.0,
    alpha: float = 0.5,
    beta: float = 0.8,
    *,
    n: int = 60,
    sigma_px: float = 0.05,
    arc: float = 1.0,
    known: bool = True,
    setup: eq.Setup = SETUP,
    seed: int = 0,
) -> Problem:
    """Points of a spot with isotropic noise of known or unknown scale."""
    v = eq.PaperVariables(setup.r / math.cos(alpha), z_L, alpha, beta)
    points, sigma = boundary(v, setup, circle(n, arc)), sigma_px * PIXEL
    noise = sigma * np.random.default_rng(seed).standard_normal(points.shape)
    return Problem.from_points(points + noise, setup, sigma if known else None)


PARAMETERS = ("f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
SIGMAS = np.array([1.0, 1.0, 1.0, 0.04, 0.04, 0.005, 2e-4, 2e-4])


def uncertain_rig() -> Rig:
    """A rig with a covariance, correlated as a calibration's is: e_x with cx, e_y with cy."""
    correlation = np.eye(len(PARAMETERS))
    for one, other in (("e_x", "cx"), ("e_y", "cy")):
        i, j = PARAMETERS.index(one), PARAMETERS.index(other)
        correlation[i, j] = correlation[j, i] = -0.95
    direction = np.array([0.012, -0.008, 1.0])
    camera = Camera((1440, 1080), 3000.0, 3000.0, 725.0, 530.0, (-0.12, 0.09, 3e-4, -2e-4, 0.01), 0.00345)
    beam = Beam(6.0, (24.0, -11.0), tuple(direction / np.linalg.norm(direction)))
    return Rig(camera, beam, None, RigCovariance(PARAMETERS, correlation * np.outer(SIGMAS, SIGMAS)))


TRUE_POSE = SpotPose.from_slopes(250.0, 0.35, -0.5, 6.0)


def spot_through(rig: Rig, sigma_px: float, n: int = 60, seed: int = 3, z_L: float = TRUE_POSE.z_L) -> Spot:
    """The spot of `TRUE_POSE`, or farther away, seen through a rig."""
    beam = rig.require_beam()
    pose = SpotPose.from_slopes(z_L, *TRUE_POSE.slopes, beam.radius)
    setup = eq.Setup(rig.focal_length, *rig.laser_offset, beam.radius)
    assert pose.beta is not None
    v = eq.PaperVariables(pose.R, pose.z_L + rig.axial_shift, pose.alpha, pose.beta)
    pixels = rig.from_laser_plane(boundary(v, setup, circle(n)))
    noise = sigma_px * np.random.default_rng(seed).standard_normal(pixels.shape)
    return Spot(pixels + noise, np.full(n, sigma_px))


def without_covariance(rig: Rig) -> Rig:
    return replace(rig, covariance=None)


def along(planes: Array, rig: Rig) -> Array:
    """Planes (..., 3), given with z_L along the beam, as the equations have them."""
    return planes + np.array([rig.axial_shift, 0.0, 0.0])


def same_law(one: Array, other: Array) -> float:
    """The p-value of Kolmogorov and Smirnov's test for two samples."""
    return float(np.asarray(scipy.stats.ks_2samp(one, other))[1])
