"""A rig with a covariance, and solutions of frames that it takes: for the tests of many images."""

from dataclasses import replace

import numpy as np

from cases import Array, boundary, circle
from example_rig import example_rig
from planeopt import equations as eq
from planeopt.estimation import solve_batch
from planeopt.plane import Plane
from planeopt.rig import Rig, RigCovariance
from planeopt.solution import Solution
from planeopt.spot import Spot

NAMES = ("f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
SIGMAS = np.array([1.0, 0.5, 0.5, 0.04, 0.04, 0.005, 2e-4, 2e-4])
NOISE = 0.1
N_POINTS = 40


def uncertain_rig() -> Rig:
    correlation = np.eye(len(NAMES))
    for one, other, value in (("e_x", "cx", -0.9), ("e_y", "cy", -0.9), ("f", "radius", 0.5)):
        i, j = NAMES.index(one), NAMES.index(other)
        correlation[i, j] = correlation[j, i] = value
    return replace(example_rig(), covariance=RigCovariance(NAMES, correlation * np.outer(SIGMAS, SIGMAS)))


def outline(rig: Rig, plane: Plane, n: int = N_POINTS) -> Array:
    """Exact pixels of the spot that this rig's beam draws on a plane."""
    pose = rig.pose_from_plane(plane)
    k = eq.Setup(rig.focal_length, *rig.laser_offset, rig.require_beam().radius)
    v = eq.PaperVariables(pose.R, pose.z_L + rig.axial_shift, pose.alpha, pose.beta or 0.0)
    return rig.from_laser_plane(boundary(v, k, circle(n)))


def frames(rig: Rig, pixels: Array, n: int, rng: np.random.Generator, noise: float = NOISE) -> list[Solution]:
    """Solutions of frames that differ by their points' noise alone."""
    sigma = np.full(len(pixels), noise)
    return list(solve_batch([Spot(pixels + rng.normal(0, noise, pixels.shape), sigma) for _ in range(n)], rig))
