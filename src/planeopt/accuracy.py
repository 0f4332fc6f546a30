"""How far one plane is from another, and from the truth where an image comes with it."""

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.solution import Solution


@dataclass(frozen=True)
class Truth:
    """A known plane.

    Attributes
    ----------
    pose : SpotPose
        In the laser-parallel frame of the true rig.
    plane : Plane
        In the camera frame.
    """

    pose: SpotPose
    plane: Plane


@dataclass(frozen=True)
class Deviation:
    """One plane minus another.

    Attributes
    ----------
    depth : float
        Difference of z_L, mm.
    normal : float
        Angle between the normals, rad, never negative.
    """

    depth: float
    normal: float


@dataclass(frozen=True)
class TiltError:
    """The error of a normal in two directions at right angles, rad, for plots with a sign.

    Attributes
    ----------
    along : float
        Error of alpha: about the axis that the plane is tilted about.
    across : float or None
        Error of beta times sin(alpha); None where beta has no value.
    """

    along: float
    across: float | None


def deviation(pose: SpotPose, plane: Plane, other_pose: SpotPose, other_plane: Plane) -> Deviation:
    """Return how far a plane is from another one; the normals are compared in the camera frame."""
    return Deviation(pose.z_L - other_pose.z_L, plane.angle_to(other_plane))


def error_of(solution: Solution, truth: Truth) -> Deviation | None:
    """Return the solution's error; None where it has no plane."""
    if solution.pose is None or solution.plane is None:
        return None
    return deviation(solution.pose, solution.plane, truth.pose, truth.plane)


def tilt_error(pose: SpotPose, truth: SpotPose) -> TiltError:
    """Return the error of a pose's angles, as arcs on the sphere of normals."""
    across = None
    if pose.beta is not None and truth.beta is not None:
        across = math.sin(truth.alpha) * math.remainder(pose.beta - truth.beta, math.tau)
    return TiltError(pose.alpha - truth.alpha, across)


def truth_beside(path: str | os.PathLike[str]) -> Truth | None:
    """Return the truth of the JSON file beside an image (same name, `.json`); None where there is no such file.

    Raises
    ------
    InputError
        If the file is there and is no truth.
    """
    file = Path(path).with_suffix(".json")
    return read_truth(file) if file.is_file() else None


class _File(msgspec.Struct):
    """The keys of a pose record that say where the plane is; any others are let pass."""

    z_L_mm: float
    alpha_deg: float
    beta_deg: float | None
    R_mm: float
    normal: tuple[float, float, float]
    point_mm: tuple[float, float, float]


def read_truth(path: str | os.PathLike[str]) -> Truth:
    """Read a known plane from JSON in the keys of a pose record (`z_L_mm` ... `point_mm`).

    Raises
    ------
    InputError
        If the file cannot be read, or a key is missing or impossible.
    """
    try:
        truth = msgspec.convert(json.loads(Path(path).read_bytes()), _File)
        beta = None if truth.beta_deg is None else math.radians(truth.beta_deg)
        pose = SpotPose.canonical(truth.R_mm, truth.z_L_mm, math.radians(truth.alpha_deg), beta)
        return Truth(pose, Plane(np.array(truth.normal), np.array(truth.point_mm)))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: not the true pose of a target ({' '.join(str(error).split())})") from error
