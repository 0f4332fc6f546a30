"""The bundled rig and targets, and boundary points that its camera would see of a known plane: for tests only."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planeopt.example import example_folder, example_targets
from planeopt.plane import SpotPose
from planeopt.rig import Rig, load_rig
from planeopt.spot import Spot, write_points

RIG_FILE = example_folder() / "truth_rig.toml"
TARGETS = example_targets()

SIGMA_PX = 0.05


def example_rig() -> Rig:
    return load_rig(RIG_FILE)


def pose_at(z_L: float = 240.0, alpha: float = 0.5, beta: float = 0.8) -> SpotPose:
    radius = example_rig().require_beam().radius
    return SpotPose.canonical(radius / np.cos(alpha), z_L, alpha, beta)


def seen(pose: SpotPose, n: int = 60, noise: float = SIGMA_PX, seed: int = 1) -> NDArray[np.float64]:
    """Pixels (n, 2): where the beam's mantle meets the plane, projected, with white noise in both directions."""
    rig = example_rig()
    beam, plane = rig.require_beam(), rig.plane_from_pose(pose)
    theta = 2 * np.pi * np.arange(n) / n
    ring = beam.radius * np.stack([np.cos(theta), np.sin(theta), np.zeros(n)], axis=1) @ rig.Q
    along = np.array(beam.direction)
    start = np.array([*beam.offset, 0.0]) + ring
    points = start - (plane.distance_to(start) / (plane.normal @ along))[:, None] * along
    pixels = rig.camera.project(points[:, :2] / points[:, 2:])
    return pixels + np.random.default_rng(seed).normal(0, noise, pixels.shape)


def spot_of(pose: SpotPose, n: int = 60, seed: int = 1) -> Spot:
    return Spot(points=seen(pose, n, seed=seed), sigma=np.full(n, SIGMA_PX))


def points_file(folder: Path, name: str = "points.csv", pose: SpotPose | None = None, seed: int = 1) -> Path:
    path = folder / name
    write_points(spot_of(pose_at() if pose is None else pose, seed=seed), path)
    return path
