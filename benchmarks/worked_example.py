"""The problem that is timed: the paper's worked example with noise, its reference answer, and the start all share."""

import math

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.estimation.starts import from_closed_form
from planeopt.formulations import Constrained, Formulation, Problem
from planeopt.nlp import Nlp
from planeopt.solvers import Ipopt

Array = NDArray[np.float64]

SETUP = eq.Setup(25.0, 30.0, 40.0, 10.0)
SPOT = eq.PaperVariables(20.0, 75.0, math.radians(60), math.radians(30))
SIGMA = 0.3 * 0.005
"""0.3 px of 5 um, in mm."""


def problem(n: int = 200, seed: int = 1) -> Problem:
    """Boundary points of the worked example with isotropic noise."""
    theta = 2 * np.pi * np.arange(n) / n
    points = np.stack(eq.image_point(np, SETUP, *eq.spot_point(np, SPOT, SETUP, theta)), axis=1)
    noise = SIGMA * np.random.default_rng(seed).standard_normal(points.shape)
    return Problem.from_points(points + noise, SETUP, SIGMA)


def programme(formulation: Formulation, of: Problem) -> Nlp:
    """From the closed form, as every method here starts."""
    built = formulation.build(of, from_closed_form(of))
    assert isinstance(built, Nlp)
    return built


def reference(of: Problem) -> Array:
    """``(z_L, p, q)`` of the weighted problem."""
    pose = solve_problem(of, formulation=Constrained(), solver=Ipopt(tol=1e-10)).pose
    assert pose is not None
    return np.array([pose.z_L, *pose.slopes])


def difference(plane: Array, of: Array) -> float:
    """The largest difference relative to depth, and in slopes to 1 + tan^2(alpha)."""
    tilt = 1 + of[1] ** 2 + of[2] ** 2
    return float(np.max(np.abs(plane - of) / [of[0], tilt, tilt]))
