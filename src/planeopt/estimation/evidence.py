"""What is recomputed at a plane, whoever found it: chi-squared, the ten residuals, the second plane, the covariance."""

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.closed_form import other_plane
from planeopt.conic import sampson_distances
from planeopt.estimation.rig_part import Sensitivity, normal_by_rig
from planeopt.estimation.second_order import fineness, misfit_covariance, typical_sigma
from planeopt.formulations.problem import Problem
from planeopt.formulations.snooping import detectability, image_misfit, space_left_by_plane, whitened_by_plane
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig
from planeopt.solution import OtherPlane, Residual, RigTest
from planeopt.uncertainty import Uncertainty

Array = NDArray[np.float64]

IMPROBABLE = 1e-6
"""A chi-squared that a right rig exceeds this rarely is evidence against it."""

DOF = 2
"""Five image coefficients minus three freedoms of the plane."""


@dataclass(frozen=True)
class Fit:
    """How well the plane's ellipse agrees with the measured one, and with the points.

    ``p_value`` is of chi-squared with 2 degrees of freedom, or of its F counterpart where the noise scale was
    estimated; with a rig covariance the rig's part is in the statistic's covariance. None where no scale is known.
    ``rig_test`` is what the statistic is made of; None where the rig is not known.
    """

    chi2: float | None
    p_value: float | None
    chi2_points: float | None
    dof_points: int | None
    rig_test: RigTest | None = None

    @property
    def improbable(self) -> bool:
        return self.p_value is not None and not self.p_value >= IMPROBABLE


def slope_variables(plane: Array, setup: eq.Setup) -> eq.SlopeVariables:
    """``(R, z_L, p, q)`` with the R that puts the spot on the beam."""
    z_L, p, q = (float(value) for value in plane)
    return eq.SlopeVariables(eq.long_axis(math, p, q, setup.r), z_L, p, q)


def fit_quality(problem: Problem, plane: Array, effect: Sensitivity | None) -> Fit:
    """Test the plane's ellipse against the measured one and against the points.

    Of the five directions of the whitened misfit of B a plane can move three. The statistic is the part in the two left
    over: to first order the same for every plane near the best, so that an inefficient formulation is not blamed for
    its own error, and at the weighted programme's solution all of the misfit, that is twice its objective. A rig's
    covariance is added to the statistic's.

    Parameters
    ----------
    problem : Problem
    plane : (3,)
        ``(z_L, p, q)`` as in the equations.
    effect : Sensitivity or None
        Of the rig at this plane, where there is a rig.
    """
    if problem.scale_dof == 0:
        return Fit(None, None, None, None)
    left_over = space_left_by_plane(problem, plane)
    statistic = left_over @ np.linalg.solve(problem.B_factor, image_misfit(problem, plane))
    covariance, rig_test = np.eye(DOF), None
    if effect is not None and problem.rig is not None:
        by_beam, by_rig = (
            left_over @ np.linalg.solve(problem.B_factor, _B_by(problem, plane, moved))
            for moved in (effect.residual_by_beam, effect.residual_by_rig)
        )
        noise = np.eye(2)[None] if problem.noise is None else problem.noise
        fine = float(fineness(float(typical_sigma(noise)) / problem.minor_axis, problem.n_points))
        rig_test = RigTest(statistic, by_rig, by_beam, fine)
        if problem.rig.covariance is not None:
            covariance = misfit_covariance(by_rig, problem.rig.covariance.matrix, fine)
    chi2 = float(statistic @ np.linalg.solve(covariance, statistic))
    p_value = float(
        scipy.stats.chi2.sf(chi2, DOF)
        if problem.scale_dof is None
        else scipy.stats.f.sf(chi2 / DOF, DOF, problem.scale_dof)
    )
    if problem.points is None or problem.scale_dof is not None:
        return Fit(chi2, p_value, None, None, rig_test)
    # An inefficient plane's own error is in its points' distances too: only at the efficient one is their law known.
    nearest = plane + _step_to_efficient(problem, plane)
    distances = sampson_distances(_ellipse(problem, nearest), problem.points, problem.noise)
    return Fit(chi2, p_value, float(distances @ distances), problem.n_points - 3, rig_test)


def _ellipse(problem: Problem, plane: Array) -> Array:
    """B_1 ... B_5 (5,) of the image of the plane's spot."""
    b = eq.image_conic_in_slopes(np, slope_variables(plane, problem.setup), problem.setup)
    return np.array(b[1:]) / b[0]


def _B_by(problem: Problem, plane: Array, moved: Array) -> Array:
    """Changes of B (5, n) that move the points' whitened distances (N, n) as given, by least squares."""
    by_B = _by_ellipse(problem, _ellipse(problem, plane))
    size = np.linalg.norm(by_B, axis=0)
    return np.linalg.lstsq(by_B / size, moved, rcond=None)[0] / size[:, None]


def _by_ellipse(problem: Problem, ellipse: Array) -> Array:
    """Derivative (N, 5) of the whitened Sampson distances by the coefficients of (16), for points on the ellipse.

    Off it the denominator changes too; for the small misfits of a test that is of second order.
    """
    x, y = np.asarray(problem.points).T
    gradient = np.stack([2 * x + ellipse[0] * y + ellipse[2], ellipse[0] * x + 2 * ellipse[1] * y + ellipse[3]], axis=1)
    height = np.sqrt(np.einsum("ni,nij,nj->n", gradient, np.asarray(problem.noise), gradient))
    return np.stack([x * y, y * y, x, y, np.ones_like(x)], axis=1) / height[:, None]


def residuals(problem: Problem, plane: Array) -> tuple[Residual, ...]:
    """All ten equations at the solution, left minus right, in the paper's variables."""
    R, z_L, p, q = slope_variables(plane, problem.setup)
    v = eq.PaperVariables(R, z_L, math.atan(math.hypot(p, q)), math.atan2(-p, q))
    values = eq.ten_residuals(np, v, problem.setup, problem.B)
    image = np.abs(values[len(eq.LASER_BLOCK) :]) * detectability(problem, plane)
    sigmas = [None] * len(eq.LASER_BLOCK) + [float(size) for size in image]
    return tuple(
        Residual(f"({e.number})", e.name, str(e.block), e.unit, float(value), size)
        for e, value, size in zip(eq.TEN, values, sigmas, strict=True)
    )


def excess(problem: Problem, plane: Array, covariance: Array) -> float:
    """Squared distance of a plane from the efficient one, in its own standard deviations (a Hausman test).

    The efficient plane is one Gauss-Newton step on the whitened image block away. An inefficient formulation's plane
    differs from it by no more than its own covariance allows: the statistic is at most chi-squared with 3 degrees of
    freedom, unless the search ended at a local minimum, of which the misfit that no plane explains says nothing.
    """
    step = _step_to_efficient(problem, plane)
    return float(step @ np.linalg.solve(covariance, step))


def _step_to_efficient(problem: Problem, plane: Array) -> Array:
    """The Gauss-Newton step (3,) on the whitened image block."""
    whitened = np.linalg.solve(problem.B_factor, image_misfit(problem, plane))
    return np.asarray(np.linalg.lstsq(whitened_by_plane(problem, plane), -whitened, rcond=None)[0], dtype=float)


EXCESS = float(scipy.stats.chi2.isf(IMPROBABLE, 3))
"""What `excess` of a right answer hardly ever reaches."""


def pose_and_plane(problem: Problem, plane: Array) -> tuple[SpotPose, Plane]:
    """The paper's pose, with ``z_L`` along the beam, and the plane in the camera frame.

    Without a rig the camera frame is the laser-parallel frame.
    """
    z_L, p, q = (float(value) for value in plane)
    pose = SpotPose.from_slopes(z_L - problem.axial_shift, p, q, problem.setup.r)
    if problem.rig is not None:
        return pose, problem.rig.plane_from_pose(pose)
    return pose, Plane(np.array([-p, -q, 1.0]), np.array([problem.setup.e_x, problem.setup.e_y, z_L]))


def second_plane(problem: Problem, plane: Array) -> OtherPlane | None:
    """The other exact solution of the ten, and why it is not the answer; None where it is at infinity."""
    other = other_plane(plane, problem.setup)
    if not np.isfinite(other).all() or np.max(np.abs(other[1:])) > _EDGE_ON:
        return None
    e_x, e_y, r = problem.setup.e_x, problem.setup.e_y, problem.setup.r
    if eq.lit_side_in_slopes(np, slope_variables(other, problem.setup), problem.setup) > 0:
        reason = "it is the plane that can be seen; the search was left free to end on the one that cannot (c < 0)"
    elif e_x**2 + e_y**2 > r**2:
        reason = "the camera would be behind it while the laser is before it: its lit side is not visible (c < 0)"
    else:
        reason = "its spot would be behind the camera (c < 0)"
    pose, in_camera = pose_and_plane(problem, other)
    return OtherPlane(pose, in_camera, reason)


_EDGE_ON = 1e9
"""Slopes beyond which a plane is parallel to the beam to double precision."""


def uncertainty(problem: Problem, plane: Array, spot: Array, effect: Sensitivity | None) -> Uncertainty:
    """Split covariances of ``(z_L, p, q)`` and of the normal in the camera frame.

    Parameters
    ----------
    problem : Problem
    plane : (3,)
    spot : (3, 3)
        Covariance of ``(z_L, p, q)`` from the boundary points.
    effect : Sensitivity or None
        Of the rig at this plane.
    """
    if problem.rig is not None:
        return split(problem.rig, plane, spot, None if effect is None else effect.plane_by_rig)
    by_slopes = normal_by_slopes(plane)
    return Uncertainty(spot, np.zeros((3, 3)), by_slopes @ spot[1:, 1:] @ by_slopes.T, np.zeros((3, 3)))


def split(rig: Rig, plane: Array, spot: Array, plane_by_rig: Array | None) -> Uncertainty:
    """Return what the spot and what the rig contributes to a plane's covariances.

    Parameters
    ----------
    rig : Rig
    plane : (3,)
        ``(z_L, p, q)``.
    spot : (3, 3)
        Covariance of ``(z_L, p, q)`` from the boundary points.
    plane_by_rig : (3, n) or None
        Derivative of ``(z_L along the beam, p, q)`` by the parameters of the rig's covariance.
    """
    by_slopes = rig.Q.T @ normal_by_slopes(plane)
    normal_spot = by_slopes @ spot[1:, 1:] @ by_slopes.T
    if rig.covariance is None or plane_by_rig is None:
        return Uncertainty(spot, np.zeros((3, 3)), normal_spot, np.zeros((3, 3)))
    sigma, turned, radius = rig.covariance.matrix, normal_by_rig(rig, plane, plane_by_rig), None
    if "radius" in rig.covariance.parameters:
        place = rig.covariance.parameters.index("radius")
        radius = np.append(plane_by_rig @ sigma[:, place], sigma[place, place])
    by_rig = plane_by_rig @ sigma @ plane_by_rig.T
    return Uncertainty(spot, by_rig, normal_spot, turned @ sigma @ turned.T, plane_by_rig, turned, radius)


def normal_by_slopes(plane: Array) -> Array:
    """Derivative (3, 2) of the unit normal ``(-p, -q, 1)/|.|`` in the laser-parallel frame by ``(p, q)``."""
    _, p, q = plane
    length = math.sqrt(1 + p**2 + q**2)
    normal = np.array([-p, -q, 1.0]) / length
    return (np.array([[-1.0, 0.0], [0.0, -1.0], [0.0, 0.0]]) - np.outer(normal, [p, q]) / length) / length
