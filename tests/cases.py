"""Rigs, planes and exact boundary points for the tests: made from (3) and (5) alone, in the paper's variables."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Beam, Camera, Rig

Array = NDArray[np.float64]

WORKED_SETUP = eq.Setup(25.0, 30.0, 40.0, 10.0)
WORKED = eq.PaperVariables(20.0, 75.0, math.radians(60), math.radians(30))


def circle(n: int, arc: float = 1.0, start: float = 0.0) -> Array:
    """``n`` angles over a share of the full turn, without repeating the first."""
    return start + 2 * np.pi * arc * (np.arange(n) / n if arc == 1 else np.linspace(0, 1, n))


def boundary(v: eq.PaperVariables, k: eq.Setup, theta: Array) -> Array:
    """Exact image points (n, 2) in mm."""
    return np.stack(eq.image_point(np, k, *eq.spot_point(np, v, k, theta)), axis=1)


def slopes(v: eq.PaperVariables) -> Array:
    """``(z_L, p, q)`` of a spot."""
    return np.array([v.z_L, *eq.slopes(np, v)])


@dataclass(frozen=True)
class Case:
    """A rig, a plane, and exact pixels of the spot's boundary."""

    rig: Rig
    pose: SpotPose
    plane: Plane
    pixels: Array


def random_case(rng: np.random.Generator, n: int = 40, kind: str = "any") -> Case:
    """Draw a rig and a plane whose lit side the camera sees.

    ``kind`` is "any", or one of the degenerate places: "on the beam" (|e| = r), "on the axis" (e = 0),
    "frontal" (alpha = 0), "beta 180".
    """
    while True:
        radius, offset, turn = rng.uniform(1, 20), rng.uniform(0, 40), rng.uniform(-np.pi, np.pi)
        if kind == "on the beam":
            offset = radius
        elif kind == "on the axis":
            offset = 0.0
        misaligned = math.radians(rng.uniform(0, 2)) if kind not in ("on the beam", "on the axis") else 0.0
        azimuth = rng.uniform(-np.pi, np.pi)
        lx, ly = math.sin(misaligned) * math.cos(azimuth), math.sin(misaligned) * math.sin(azimuth)
        fx = rng.uniform(1000, 4000)
        pitch = (0.005, None)[rng.integers(2)]
        camera = Camera((2000, 1500), fx, fx * rng.uniform(0.99, 1.01), 1000.0, 750.0, (0.0, 0.0, 0.0, 0.0, 0.0), pitch)
        beam = Beam(radius, (offset * math.cos(turn), offset * math.sin(turn)), (lx, ly, math.sqrt(1 - lx**2 - ly**2)))
        rig = Rig(camera, beam)
        alpha = 0.0 if kind == "frontal" else math.radians(rng.uniform(0, 75))
        beta = math.pi if kind == "beta 180" else rng.uniform(-np.pi, np.pi)
        z_L = rng.uniform(60, 1000)
        k = eq.Setup(rig.focal_length, *rig.laser_offset, radius)
        v = eq.PaperVariables(radius / math.cos(alpha), z_L + rig.axial_shift, alpha, beta)
        if v.z_L <= radius * math.tan(alpha) * 1.001 or eq.lit_side(np, v, k) <= 0.001 * z_L:
            continue
        pose = SpotPose.canonical(v.R, z_L, alpha, beta)
        pixels = rig.from_laser_plane(boundary(v, k, circle(n, start=rng.uniform(0, 1))))
        return Case(rig, pose, rig.plane_from_pose(pose), pixels)
