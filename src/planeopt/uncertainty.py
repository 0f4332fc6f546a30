"""Covariances of a plane, split into what spot and rig contribute, and the standard deviations that they give."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.plane import SpotPose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Uncertainty:
    """Covariances of first order, split into what the spot and what the rig contributes.

    Attributes
    ----------
    spot, rig : (3, 3)
        Of ``(z_L, p, q)``; ``rig`` is zero where the rig has no covariance.
    normal_spot, normal_rig : (3, 3)
        Of the unit normal in the camera frame; the rig's part includes the beam direction's turn of the frame.
    plane_by_rig, normal_by_rig : (3, n) or None
        Derivatives by the parameters of the rig's covariance: what images of one rig have in common. None where the
        rig has no covariance.
    radius : (4,) or None
        Covariance of the beam's radius with ``(z_L, p, q)``, and its variance, mm; None where the radius is certain.
    """

    spot: Array
    rig: Array
    normal_spot: Array
    normal_rig: Array
    plane_by_rig: Array | None = None
    normal_by_rig: Array | None = None
    radius: Array | None = None


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations: mm and rad; an angle's is None where it has no first-order value (``alpha = 0``)."""

    z_L: float
    alpha: float | None
    beta: float | None
    R: float | None
    normal: float


def sigmas(
    pose: SpotPose,
    covariance: Array,
    normal_covariance: Array,
    radius: float,
    radius_covariance: Array | None = None,
) -> Sigmas:
    """Carry a covariance of ``(z_L, p, q)`` to the reported quantities.

    Parameters
    ----------
    pose : SpotPose
    covariance : (3, 3)
        Of ``(z_L, p, q)``; mm, 1, 1.
    normal_covariance : (3, 3)
        Of the unit normal; its trace is the squared RMS angle.
    radius : float
        Of the beam, mm.
    radius_covariance : (4,), optional
        As `Uncertainty.radius`.
    """
    alpha_sigma = beta_sigma = None
    p, q = pose.slopes
    tangent, slopes = math.hypot(p, q), covariance[1:, 1:]
    if pose.beta is not None:
        to_alpha = np.array([p, q]) / (tangent * (1 + tangent**2))
        to_beta = np.array([-q, p]) / tangent**2
        alpha_sigma, beta_sigma = (math.sqrt(max(row @ slopes @ row, 0.0)) for row in (to_alpha, to_beta))
    # R = r sqrt(1 + p^2 + q^2)
    length = math.sqrt(1 + tangent**2)
    to_long_axis = radius * np.array([p, q]) / length
    long_axis = float(to_long_axis @ slopes @ to_long_axis)
    if radius_covariance is not None:
        long_axis += 2 * length * float(to_long_axis @ radius_covariance[1:3]) + length**2 * float(radius_covariance[3])
    known = pose.beta is not None or radius_covariance is not None
    return Sigmas(
        math.sqrt(covariance[0, 0]),
        alpha_sigma,
        beta_sigma,
        math.sqrt(max(long_axis, 0.0)) if known else None,
        math.sqrt(np.trace(normal_covariance)),
    )
