"""The pose record: what one input gave, as plain JSON values with every key always present.

Lengths are in mm, angles in degrees, `None` (JSON's null) stands for what is unknown, infinite or has no value; NaN and
infinity never appear. Nested objects keep all their keys as well; only `other_plane` and `mount` are null as a whole,
where there is none.
"""

import json
import math
from collections.abc import Iterable
from enum import Enum
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Mount, Rig
from planeopt.solution import Flag, OtherPlane, Solution
from planeopt.spot import SpotNotFound
from planeopt.uncertainty import Sigmas

RecordStatus = Literal["ok", "degraded", "refused", "error"]
"""A pose; a pose with a reservation; no defensible pose; an input that cannot be used."""

Triple = tuple[float, float, float]


class Intercepts(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the plane cuts the camera's axes, equation (1), mm; null where it is parallel to one."""

    a: float | None = None
    b: float | None = None
    c: float | None = None


class Slopes(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """dz/dx and dz/dy in the laser-parallel frame."""

    p: float | None = None
    q: float | None = None


class SigmaRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations; `normal_deg` is the RMS angle of the normal."""

    z_L_mm: float | None = None
    alpha_deg: float | None = None
    beta_deg: float | None = None
    normal_deg: float | None = None


class CovarianceRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Joint covariance of the spot and the rig together; mm and slopes, as the parameters' names say."""

    parameters: tuple[str, str, str] = ("z_L_mm", "p", "q")
    matrix: tuple[Triple, Triple, Triple] | None = None


class OtherPlaneRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The second exact solution of the ten equations, and why it was excluded."""

    z_L_mm: float | None
    alpha_deg: float | None
    beta_deg: float | None
    R_mm: float | None
    normal: Triple
    point_mm: Triple
    reason: str


class MountRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The plane in the frame of the rig's mount: `normal . x = d_mm`, through `point_mm`."""

    frame: str
    normal: Triple
    point_mm: Triple
    d_mm: float


class PoseRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One line of `planeopt pose`.

    `z_L_mm`, `alpha_deg`, `beta_deg`, `R_mm` and `slopes` are of the laser-parallel frame (`z_L_mm` along the beam from
    (e_x, e_y, 0)); `normal`, `point_mm` and `intercepts_mm` of the camera frame; `mount` is the plane in the frame of
    the rig's mount, where it has one. `sigma` and `covariance` include the rig's part where the rig has a covariance;
    `sigma_spot` is without it. `chi2`, `dof` and `p_value` test the rig against the spot; `chi2_points` and
    `dof_points` the points against the plane's ellipse. `flags` are stable names in lower case: first the cause, where
    `status` is not `ok` and the cause has a name, then what a reader should know.
    """

    input: str
    status: RecordStatus
    message: str
    formulation: str | None = None
    solver: str | None = None
    z_L_mm: float | None = None
    alpha_deg: float | None = None
    beta_deg: float | None = None
    R_mm: float | None = None
    normal: Triple | None = None
    point_mm: Triple | None = None
    intercepts_mm: Intercepts = Intercepts()
    slopes: Slopes = Slopes()
    sigma: SigmaRecord = SigmaRecord()
    sigma_spot: SigmaRecord = SigmaRecord()
    covariance: CovarianceRecord = CovarianceRecord()
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    chi2_points: float | None = None
    dof_points: int | None = None
    other_plane: OtherPlaneRecord | None = None
    mount: MountRecord | None = None
    n_points: int | None = None
    arc_fraction: float | None = None
    flags: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain JSON values, in the order of the keys."""
        return msgspec.to_builtins(self)

    def to_json(self) -> str:
        """Return the record on one line, in ASCII, without the line's end."""
        return json.dumps(self.to_dict(), allow_nan=False)


def record_from_json(line: str | bytes) -> PoseRecord:
    """Return the record of one line of JSON; undoes `PoseRecord.to_json`.

    Raises
    ------
    InputError
        If the line is not a pose record.
    """
    try:
        return msgspec.convert(json.loads(line), PoseRecord)
    except ValueError as error:
        raise InputError(f"not a pose record ({error})") from error


def from_solution(name: str, solution: Solution, rig: Rig | None = None) -> PoseRecord:
    """Return the record of a solve, whatever its status.

    Parameters
    ----------
    name : str
        Of the input, as the user gave it.
    solution : Solution
    rig : Rig, optional
        For the plane in the frame of its mount, where it has one.
    """
    status, message = solution.status.record, solution.message
    cause = () if status == "ok" else (solution.status,)
    if status == "ok" and Flag.RIG_REFUSED in solution.flags:
        status, message, cause = "degraded", Flag.RIG_REFUSED.value, (Flag.RIG_REFUSED,)
    plane, pose = solution.plane, solution.pose
    slopes = (None, None) if pose is None else pose.slopes
    return PoseRecord(
        input=name,
        status=status,
        message=message,
        formulation=solution.formulation,
        solver=solution.solver,
        **_pose(pose),
        normal=None if plane is None else triple(plane.normal),
        point_mm=None if plane is None else triple(plane.point),
        intercepts_mm=Intercepts() if plane is None else _intercepts(plane),
        slopes=Slopes(p=finite(slopes[0]), q=finite(slopes[1])),
        sigma=_sigma(solution.sigma),
        sigma_spot=_sigma(solution.sigma_spot),
        covariance=_covariance(solution.covariance),
        chi2=finite(solution.chi2),
        dof=None if finite(solution.chi2) is None else solution.dof,
        p_value=finite(solution.p_value),
        chi2_points=finite(solution.chi2_points),
        dof_points=solution.dof_points,
        other_plane=_other_plane(solution.other_plane),
        mount=None if rig is None else mounted(rig.mount, plane),
        n_points=solution.n_points,
        arc_fraction=finite(solution.arc_fraction),
        flags=_names((*cause, *solution.flags)),
    )


def spot_not_found(name: str, reason: SpotNotFound) -> PoseRecord:
    """Return the `refused` record of an image without a measurable spot; its one flag names the reason."""
    return PoseRecord(input=name, status="refused", message=str(reason), flags=_names((reason.reason,)))


def refused(name: str, message: str, flag: str) -> PoseRecord:
    """Return the `refused` record of an input that holds no defensible pose, for a reason found before any solve."""
    return PoseRecord(input=name, status="refused", message=message, flags=(flag,))


def input_error(name: str, message: str) -> PoseRecord:
    """Return the `error` record of an input that cannot be read or used."""
    return PoseRecord(input=name, status="error", message=message)


def _names(flags: Iterable[Enum]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(flag.name.lower() for flag in flags))


def _pose(pose: SpotPose | None) -> dict[str, float | None]:
    if pose is None:
        return {"z_L_mm": None, "alpha_deg": None, "beta_deg": None, "R_mm": None}
    angles = {"alpha_deg": math.degrees(pose.alpha), "beta_deg": degrees(pose.beta)}
    return {"z_L_mm": pose.z_L, **angles, "R_mm": pose.R}


def _other_plane(other: OtherPlane | None) -> OtherPlaneRecord | None:
    if other is None:
        return None
    return OtherPlaneRecord(
        **_pose(other.pose),
        normal=triple(other.plane.normal),
        point_mm=triple(other.plane.point),
        reason=other.reason,
    )


def mounted(mount: Mount | None, plane: Plane | None) -> MountRecord | None:
    """Return the plane in the frame of a mount; None where there is no mount or no plane."""
    if mount is None or plane is None:
        return None
    there = mount.carry(plane)
    return MountRecord(
        frame=mount.frame,
        normal=triple(there.normal),
        point_mm=triple(there.point),
        d_mm=float(there.normal @ there.point),
    )


def _intercepts(plane: Plane) -> Intercepts:
    try:
        a, b, c = plane.intercepts
    except InputError:  # a plane through the camera's centre has none
        return Intercepts()
    return Intercepts(a=finite(a), b=finite(b), c=finite(c))


def _sigma(sigma: Sigmas | None) -> SigmaRecord:
    if sigma is None:
        return SigmaRecord()
    return SigmaRecord(
        z_L_mm=finite(sigma.z_L),
        alpha_deg=degrees(sigma.alpha),
        beta_deg=degrees(sigma.beta),
        normal_deg=degrees(sigma.normal),
    )


def _covariance(covariance: NDArray[np.floating] | None) -> CovarianceRecord:
    if covariance is None or not np.all(np.isfinite(covariance)):
        return CovarianceRecord()
    z_L, p, q = (triple(row) for row in covariance)
    return CovarianceRecord(matrix=(z_L, p, q))


def triple(vector: NDArray[np.floating]) -> Triple:
    """Return a vector (3,) as JSON can hold it."""
    x, y, z = vector.tolist()
    return x, y, z


def degrees(angle: float | None) -> float | None:
    """Return an angle in degrees as JSON can hold it: None where there is none or it is not finite."""
    value = finite(angle)
    return None if value is None else math.degrees(value)


def finite(value: float | None) -> float | None:
    """Return the value as JSON can hold it: None where it is not a finite number."""
    return None if value is None or not math.isfinite(value) else float(value)
