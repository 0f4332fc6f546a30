"""A calibration against the truth that its session was simulated with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from planeopt.board import Observations
from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.ladder import adjust_all
from planeopt.calibration.model import Model
from planeopt.estimation import solve
from planeopt.plane import SpotPose
from planeopt.rig import BEAM_PARAMETERS, Rig, RigCovariance
from planeopt.simulation import SimulatedSession
from planeopt.spot import Spot
from studies.outline import Array, pixels_at

NAN = float("nan")

QUANTITIES = ("f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
"""Whose intervals are counted."""

POSE = ("z_L", "p", "q")


def fit_default(observations: Observations) -> Adjustment:
    """Adjust as `calibrate` does unless told otherwise: every term free, with what all cameras have in common."""
    return adjust_all(observations, Model())


def truth_of(session: SimulatedSession) -> dict[str, float]:
    """Return the true value of every parameter that a model may have: px, mm, 1."""
    rig = session.rig
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", *BEAM_PARAMETERS)
    true = {name: rig.parameter(name) for name in names}
    warp_x, warp_y = session.warp
    return true | {"f": true["fx"], "warp_x": warp_x, "warp_y": warp_y, "divergence": session.divergence}


def errors_of(adjustment: Adjustment, truth: Mapping[str, float]) -> dict[str, float]:
    """Return the error of each of `QUANTITIES` in its own standard deviations; NaN where it is not free."""
    found: dict[str, float] = dict.fromkeys(QUANTITIES, NAN)
    for name in QUANTITIES:
        if name in adjustment.names:
            found[name] = (adjustment.value(name) - truth[name]) / adjustment.sigma(name)
    return found


def joint_chi2(rig: Rig, truth: Mapping[str, float]) -> tuple[float, int]:
    """Return the squared error of all parameters of a rig over its joint covariance, and their number."""
    if rig.covariance is None:
        return NAN, 0
    names = rig.covariance.parameters
    error = np.array([rig.parameter(name) - truth[name] for name in names]) / rig.covariance.sigmas
    return float(error @ np.linalg.solve(rig.covariance.correlation, error)), len(names)


def independent(rig: Rig) -> Rig:
    """Return a rig whose camera and beam are as uncertain as they are, but as if one said nothing of the other."""
    if rig.covariance is None:
        return rig
    beam = np.isin(rig.covariance.parameters, BEAM_PARAMETERS)
    matrix = np.where(beam[:, None] == beam, rig.covariance.matrix, 0.0)
    return replace(rig, covariance=RigCovariance(rig.covariance.parameters, matrix))


_BOUNDARY = 90
_EXACT_PX = 1e-3
"""What the boundary of a plane is measured to, so that all that is uncertain of it is the calibration."""


@dataclass(frozen=True)
class PoseErrors:
    """A plane measured by a calibrated rig from a boundary without noise: z_L (mm) and both slopes.

    Attributes
    ----------
    errors : (3,) ndarray
    joint, apart : (3,) ndarray
        Standard deviations by the rig's joint covariance, and by one without what camera and beam have in common.
    """

    errors: Array
    joint: Array
    apart: Array


def pose_errors(rig: Rig, true_rig: Rig, pose: SpotPose) -> PoseErrors | None:
    """Measure a plane with a calibrated rig; None where there is no covariance to judge by."""
    theta = 2 * np.pi * np.arange(_BOUNDARY) / _BOUNDARY
    spot = Spot(pixels_at(true_rig, pose, theta)[0], np.full(_BOUNDARY, _EXACT_PX), arc_fraction=1.0)
    found, apart = solve(spot, rig), solve(spot, independent(rig))
    if found.pose is None or found.covariance is None or apart.covariance is None:
        return None
    errors = np.array([found.pose.z_L, *found.pose.slopes]) - [pose.z_L, *pose.slopes]
    return PoseErrors(errors, np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(apart.covariance)))


def chi2_p(squares: float, dof: int) -> float:
    """Return the chance of a chi-squared as large; NaN without degrees of freedom."""
    return float(scipy.stats.chi2.sf(squares, dof)) if dof else NAN


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of a calibration in own standard deviations; NaN where a parameter is not free.

    Attributes
    ----------
    f_sigmas, cx_sigmas, cy_sigmas : float
    e_x_sigmas, e_y_sigmas, radius_sigmas, direction_x_sigmas, direction_y_sigmas : float
    chi2 : float
        Squared error of all parameters over the joint covariance.
    dof : int
        Their number.
    p_value : float
        Of that chi-squared.
    """

    f_sigmas: float
    cx_sigmas: float
    cy_sigmas: float
    e_x_sigmas: float
    e_y_sigmas: float
    radius_sigmas: float
    direction_x_sigmas: float
    direction_y_sigmas: float
    chi2: float
    dof: int
    p_value: float


def errors_row(adjustment: Adjustment, session: SimulatedSession) -> Errors:
    """Return the errors of an adjustment."""
    truth = truth_of(session)
    chi2, dof = joint_chi2(adjustment.rig, truth)
    sigmas = {f"{name}_sigmas": error for name, error in errors_of(adjustment, truth).items()}
    return Errors(**sigmas, chi2=chi2, dof=dof, p_value=chi2_p(chi2, dof))


NO_ERRORS = Errors(**{f"{name}_sigmas": NAN for name in QUANTITIES}, chi2=NAN, dof=0, p_value=NAN)


def of(rows: Sequence[object], name: str) -> Array:
    """Return the finite values of a field of rows."""
    values = np.array([getattr(row, name) for row in rows], dtype=np.float64)
    return values[np.isfinite(values)]
