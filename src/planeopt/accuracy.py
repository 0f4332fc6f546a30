"""How far one plane is from another, and from the truth where an image comes with it; likewise one rig."""

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig, RigCovariance
from planeopt.solution import Solution
from planeopt.uncertainty import Sigmas


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


def deviation(pose: SpotPose, plane: Plane, other_pose: SpotPose, other_plane: Plane) -> Deviation:
    """Return how far a plane is from another one; the normals are compared in the camera frame."""
    return Deviation(pose.z_L - other_pose.z_L, plane.angle_to(other_plane))


def error_of(solution: Solution, truth: Truth) -> Deviation | None:
    """Return the solution's error; None where it has no plane."""
    if solution.pose is None or solution.plane is None:
        return None
    return deviation(solution.pose, solution.plane, truth.pose, truth.plane)


@dataclass(frozen=True, eq=False)
class Score:
    """A solution that has a plane, held against the truth.

    Attributes
    ----------
    name : str
        Of the target.
    pose, plane : SpotPose, Plane
        Measured.
    sigma : Sigmas or None
        Standard deviations of the measurement, mm and rad.
    truth : Truth
    """

    name: str
    pose: SpotPose
    plane: Plane
    sigma: Sigmas | None
    truth: Truth

    @classmethod
    def of(cls, name: str, solution: Solution, truth: Truth) -> "Score | None":
        """Return the score of a solution; None where it has no plane."""
        if solution.pose is None or solution.plane is None:
            return None
        return cls(name, solution.pose, solution.plane, solution.sigma, truth)

    @property
    def error(self) -> Deviation:
        return deviation(self.pose, self.plane, self.truth.pose, self.truth.plane)

    @property
    def depth_sigmas(self) -> float | None:
        """Error of z_L in its own standard deviations."""
        return None if self.sigma is None else self.error.depth / self.sigma.z_L

    @property
    def normal_sigmas(self) -> float | None:
        """Angle between the normals over its own RMS."""
        return None if self.sigma is None else self.error.normal / self.sigma.normal

    @property
    def along(self) -> tuple[float, float]:
        """Error of alpha and its standard deviation, rad (NaN if unknown): of the normal along the tilt."""
        sigma = math.nan if self.sigma is None or self.sigma.alpha is None else self.sigma.alpha
        return self.pose.alpha - self.truth.pose.alpha, sigma

    @property
    def across(self) -> tuple[float, float]:
        """sin(alpha) times the error of beta, as `along`: of the normal at right angles to that."""
        if self.pose.beta is None or self.truth.pose.beta is None:
            return math.nan, math.nan
        sine = math.sin(self.truth.pose.alpha)
        sigma = math.nan if self.sigma is None or self.sigma.beta is None else self.sigma.beta
        return sine * math.remainder(self.pose.beta - self.truth.pose.beta, math.tau), sine * sigma


@dataclass(frozen=True)
class ParameterScore:
    """One parameter of a calibrated rig, held against the truth; px, mm or 1.

    Attributes
    ----------
    name : str
    value, sigma : float
        As calibrated, and its standard deviation.
    truth : float
    """

    name: str
    value: float
    sigma: float
    truth: float

    @property
    def error(self) -> float:
        return self.value - self.truth

    @property
    def sigmas(self) -> float:
        """The error in its own standard deviations."""
        return self.error / self.sigma


def rig_scores(rig: Rig, truth: Rig) -> tuple[ParameterScore, ...]:
    """Hold each free parameter of a calibrated rig against the true rig's.

    Raises
    ------
    InputError
        If the rig has no covariance, or the true rig lacks one of the parameters.
    """
    return tuple(
        ParameterScore(name, rig.parameter(name), float(sigma), truth.parameter(name))
        for name, sigma in zip(_covariance(rig).parameters, _covariance(rig).sigmas, strict=True)
    )


def rig_chi2(rig: Rig, truth: Rig) -> tuple[float, int]:
    """Return chi-squared of all errors of a calibrated rig together, by its joint covariance, and their number.

    Raises
    ------
    InputError
        As `rig_scores`.
    """
    errors = np.array([score.error for score in rig_scores(rig, truth)])
    return float(errors @ np.linalg.solve(_covariance(rig).matrix, errors)), len(errors)


def _covariance(rig: Rig) -> RigCovariance:
    if rig.covariance is None:
        raise InputError("the rig has no covariance: how far from the truth it may be is not known")
    return rig.covariance


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
