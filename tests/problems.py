"""Noisy problems on the image plane, and planes read off solutions, for the tests of formulations and solvers."""

from dataclasses import replace

import numpy as np

from cases import WORKED, WORKED_SETUP, Array, boundary, circle
from planeopt import equations as eq
from planeopt.formulations import Problem, Start
from planeopt.solution import Solution

PIXEL = 0.005
"""Pixel pitch, mm."""
SIGMA = 0.3 * PIXEL
"""Standard deviation of a boundary point, mm."""


def noisy(
    seed: int,
    *,
    v: eq.PaperVariables = WORKED,
    k: eq.Setup = WORKED_SETUP,
    n: int = 200,
    sigma: float = SIGMA,
    arc: float = 1.0,
) -> Problem:
    """The worked example's spot, or another, with known isotropic noise."""
    noise = sigma * np.random.default_rng(seed).standard_normal((n, 2))
    return Problem.from_points(boundary(v, k, circle(n, arc)) + noise, k, sigma)


def exact_conic(v: eq.PaperVariables, k: eq.Setup) -> Array:
    """B_1 ... B_5 of (6)."""
    b = np.array(eq.image_conic(np, v, k))
    return b[1:] / b[0]


def exact(v: eq.PaperVariables, k: eq.Setup, sigma: float = SIGMA) -> Problem:
    """The exact ellipse of a spot, with the covariance that points with noise would give it."""
    factor = Problem.from_points(boundary(v, k, circle(200)), k, sigma).B_factor
    return replace(Problem.from_conic(exact_conic(v, k), np.eye(5), k), B_factor=factor)


def start_at(v: eq.PaperVariables, *, cold: bool = False) -> Start:
    """A search from a given plane."""
    p, q = eq.slopes(np, v)
    return Start(v.R, (v.z_L, float(p), float(q)), v.beta, cold=cold)


def plane_of(solution: Solution) -> Array:
    """``(z_L, p, q)``; fails with the solution's own message where there is no plane."""
    assert solution.pose is not None, solution.message
    return np.array([solution.pose.z_L, *solution.pose.slopes])


def covariance_of(solution: Solution) -> Array:
    """Of ``(z_L, p, q)``; fails with the reason where there is none."""
    assert solution.covariance is not None, solution.uncertainty_reason
    return solution.covariance
