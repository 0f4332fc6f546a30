"""The problems of the study of SWIFT: the paper's worked example and random rigs and planes, exact and with noise."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.estimation import starts
from planeopt.formulations import Problem, Start

Array = NDArray[np.float64]

PITCH_MM = 0.005
N_POINTS = 200
_SEED = 29
_START_RADII = 25.0
"""Depth of the paper's start in beam radii: 250 mm for 10 mm."""


@dataclass(frozen=True)
class Case:
    """A problem by what makes it.

    Attributes
    ----------
    index : int
        0 is the worked example; 1, 2, ... are random.
    noise_px : float
        Standard deviation of a boundary point in each direction, in pixels of 5 um; 0 for the exact boundary.
    """

    index: int
    noise_px: float

    @property
    def name(self) -> str:
        return "worked example" if self.index == 0 else f"random {self.index}"


@dataclass(frozen=True)
class Truth:
    """A rig and a plane ``(z_L, p, q)`` (3,) whose spot it sees."""

    setup: eq.Setup
    plane: Array


@cache
def truth_of(index: int) -> Truth:
    """Return the rig and the plane of a case: depths of 60 to 400 mm, tilts of 10 to 65 degrees, cameras off the beam.

    The beam's radius is 5 to 15 mm, its offset 1.5 to 6 radii; the plane is clear of the edge of what can be seen.
    """
    if index == 0:
        return Truth(paper.SETUP, np.array([paper.TRUTH.z_L, *eq.slopes(np, paper.TRUTH)]))
    rng = np.random.default_rng([_SEED, index])
    for _ in range(10_000):
        r = rng.uniform(5, 15)
        away, around = r * rng.uniform(1.5, 6), rng.uniform(-np.pi, np.pi)
        setup = eq.Setup(paper.SETUP.f, away * np.cos(around), away * np.sin(around), r)
        z_L, slope = np.exp(rng.uniform(np.log(60), np.log(400))), np.tan(np.radians(rng.uniform(10, 65)))
        azimuth = rng.uniform(-np.pi, np.pi)
        v = eq.SlopeVariables(None, z_L, slope * np.cos(azimuth), slope * np.sin(azimuth))
        if z_L - r * slope > 0.2 * z_L and eq.lit_side_in_slopes(np, v, setup) > 0.2 * z_L:
            return Truth(setup, np.array(v[1:]))
    raise RuntimeError("no plane that can be seen")


def boundary(truth: Truth) -> Array:
    """Return the exact boundary (N, 2) of the spot's image, mm."""
    phi = 2 * np.pi * np.arange(N_POINTS) / N_POINTS
    point = eq.spot_point_in_slopes(np, eq.SlopeVariables(None, *truth.plane), truth.setup, phi)
    return np.stack(eq.image_point(np, truth.setup, *point), axis=1)


def problem_of(case: Case, draw: int = 0) -> Problem:
    """Return the problem; draws differ in their noise."""
    truth = truth_of(case.index)
    # Without noise the points keep the weights that a tenth of a pixel would give them.
    sigma = PITCH_MM * (case.noise_px or 0.1)
    rng = np.random.default_rng([_SEED, case.index, draw, 1])
    noise = PITCH_MM * case.noise_px * rng.standard_normal((N_POINTS, 2))
    return Problem.from_points(boundary(truth) + noise, truth.setup, sigma)


def start_of(problem: Problem, where: str) -> Start:
    """Return the closed form, or the paper's start: ``(r, 25 r, 20 deg, 20 deg)``."""
    if where == "closed form":
        return starts.from_closed_form(problem)
    r = problem.setup.r
    return starts.given((r, _START_RADII * r, paper.START.alpha, paper.START.beta), problem)


def apart(plane: Array, other: Array) -> float:
    """How far two planes (3,) are apart: the larger of their depths' difference over the depth and the angle, rad."""
    normals = np.stack([-plane[1:], -other[1:]])
    lengths = np.sqrt(1 + np.sum(normals**2, axis=1))
    unit = np.column_stack([normals, np.ones(2)]) / lengths[:, None]
    angle = 2 * np.arcsin(min(1.0, float(np.linalg.norm(unit[0] - unit[1])) / 2))
    return float(max(abs(plane[0] - other[0]) / abs(other[0]), angle))
