"""Boundary points of known planes: what a comparison needs that knows both the truth and the noise."""

import numpy as np
from numpy.typing import NDArray

from planeopt import paper
from planeopt.errors import InputError
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig
from planeopt.spot import Spot

Array = NDArray[np.float64]

_PITCH_MM = 0.005
"""Of the worked example's camera, for which the paper says none."""


_NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


def worked_example() -> tuple[Rig, SpotPose]:
    """Return the paper's rig, with pixels of 5 um, and its plane."""
    k, v = paper.SETUP, paper.TRUTH
    width, height = 6000, 8000
    focal = k.f / _PITCH_MM
    camera = Camera((width, height), focal, focal, (width - 1) / 2, (height - 1) / 2, _NO_DISTORTION, _PITCH_MM)
    return Rig(camera, Beam(k.r, (k.e_x, k.e_y), (0.0, 0.0, 1.0))), SpotPose(v.R, v.z_L, v.alpha, v.beta)


def boundary(rig: Rig, pose: SpotPose, n: int) -> Array:
    """Return n points (n, 2), px, of the spot's boundary, at equal angles round the beam.

    Raises
    ------
    InputError
        If a part of the spot is not in front of the camera, or its lit side faces away.
    """
    beam, plane = rig.require_beam(), rig.plane_from_pose(pose)
    angle = 2 * np.pi * (np.arange(n) + 0.5) / n
    ring = beam.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1) @ rig.Q
    along = np.array(beam.direction)
    begin = np.array([*beam.offset, 0.0]) + ring
    points = begin - (plane.distance_to(begin) / (plane.normal @ along))[:, None] * along
    if not (np.all(points[:, 2] > 0) and plane.normal @ plane.point > 0):
        raise InputError("the camera does not see the lit side of the whole spot of this plane")
    return rig.camera.project(points[:, :2] / points[:, 2:])


def simulated_spot(rig: Rig, pose: SpotPose, *, n: int, noise_px: float, seed: int | tuple[int, ...]) -> Spot:
    """Return boundary points with independent normal noise in x and y, and its standard deviation with them.

    Parameters
    ----------
    rig : Rig
    pose : SpotPose
    n : int
    noise_px : float
    seed : int or tuple of int

    Raises
    ------
    InputError
        If the plane's spot cannot be seen, or there are fewer than five points or no noise.
    """
    if n < 5:
        raise InputError(f"an ellipse needs at least 5 points, not {n}")
    if not (np.isfinite(noise_px) and noise_px > 0):
        raise InputError(f"the noise must be positive, not {noise_px} px")
    points = boundary(rig, pose, n)
    noise = np.random.default_rng(seed).standard_normal(points.shape)
    return Spot(points=points + noise_px * noise, sigma=np.full(n, noise_px))
