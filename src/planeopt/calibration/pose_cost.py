"""What the calibration alone costs a plane: its joint covariance, carried through the estimate of the plane.

The beam's offset e is known no better than the principal point, since the two move together: corr(e_x, cx) comes near
-1. A plane hardly suffers from it, for a rig whose cx and e_x are off together sees the same rays meet the same beam.
That is what the joint covariance says and independent ones cannot.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.estimation.rig_part import axial_shift_by_rig, free_parameters, normal_by_rig, point_derivatives
from planeopt.rig import BEAM_PARAMETERS, Rig

Array = NDArray[np.float64]

TILTS = (0.0, math.radians(30), math.radians(50))
"""Of the planes that `working_planes` sets at each distance: seen face on, ordinary, steep."""

_ANGLES = 180
"""Places round the spot's boundary: its derivatives are trigonometric polynomials over a smooth function."""


@dataclass(frozen=True)
class PoseCost:
    """Standard deviations of one plane from the calibration alone; the spot's own noise is not in them.

    Attributes
    ----------
    z_L : float
        Of the plane, along the beam, mm.
    alpha : float
        Its tilt, rad.
    beta : float or None
        Direction of the tilt, rad; None without a tilt.
    sigma_z_L : float
        mm.
    sigma_normal : float
        RMS angle of the normal, rad.
    independent_z_L, independent_normal : float
        What they would seem to be if each parameter's standard deviation were kept and camera and beam taken as
        independent of each other: wrong, and here to show what the joint covariance is for.
    offset_z_L, offset_normal : float
        What they would seem to be from the standard deviations of e_x and e_y alone.
    """

    z_L: float
    alpha: float
    beta: float | None
    sigma_z_L: float
    sigma_normal: float
    independent_z_L: float
    independent_normal: float
    offset_z_L: float
    offset_normal: float


def pose_cost(rig: Rig, planes: ArrayLike) -> tuple[PoseCost, ...]:
    """Return what a rig's covariance costs at planes; nothing where the rig has no beam or no covariance.

    Parameters
    ----------
    rig : Rig
    planes : array_like, shape (M, 3)
        (z_L, alpha, beta) each: mm along the beam, rad, rad. From `working_planes`, for example.

    Raises
    ------
    InputError
        If the camera cannot see a plane's spot.
    """
    if rig.beam is None or rig.covariance is None:
        return ()
    poses = np.atleast_2d(np.asarray(planes, dtype=np.float64))
    plane_by_rig, normal_rows = plane_sensitivity(rig, poses)
    joint = rig.covariance.matrix
    of_beam = np.array([name in BEAM_PARAMETERS for name in rig.covariance.parameters])
    apart = np.where(of_beam[:, None] == of_beam, joint, 0.0)
    of_offset = np.array([name in ("e_x", "e_y") for name in rig.covariance.parameters])
    offset = np.diag(np.where(of_offset, np.diagonal(joint), 0.0))
    found = [
        (np.sqrt(_variance(plane_by_rig[:, :1], matrix)), np.sqrt(_variance(normal_rows, matrix)))
        for matrix in (joint, apart, offset)
    ]
    columns = np.stack([part for pair in found for part in pair], axis=1)
    return tuple(
        PoseCost(z_L, alpha, beta if alpha > 0 else None, *row)
        for (z_L, alpha, beta), row in zip(poses.tolist(), columns.tolist(), strict=True)
    )


def working_planes(distances: ArrayLike, tilts: ArrayLike = TILTS) -> Array:
    """Return planes (M, 3), (z_L, alpha, beta): each tilt at each distance, in two directions.

    Parameters
    ----------
    distances : array_like
        Along the beam, mm.
    tilts : array_like
        rad.
    """
    rows = [
        (float(z_L), float(alpha), beta)
        for z_L in np.ravel(distances)
        for alpha in np.ravel(tilts)
        for beta in ((0.0, math.pi / 2) if alpha > 0 else (0.0,))
    ]
    return np.array(rows).reshape(-1, 3)


def plane_sensitivity(rig: Rig, planes: Array) -> tuple[Array, Array]:
    """Differentiate planes, estimated from their whole boundaries, by the free parameters of the rig's covariance.

    `planeopt.estimation.rig_part.sensitivity` at exact spots: the boundary is sampled all round, with noise that is the
    same everywhere along it in the image.

    Parameters
    ----------
    rig : Rig
        With a beam and a covariance.
    planes : (M, 3) array
        (z_L, alpha, beta).

    Returns
    -------
    plane_by_rig : (M, 3, n) array
        Of (z_L, p, q), z_L along the beam.
    normal_by_rig : (M, 3, n) array
        Of the unit normal in the camera frame.

    Raises
    ------
    InputError
        If the camera cannot see a plane's spot.
    """
    z_L, alpha, beta = planes.T
    if np.any(z_L <= 0) or np.any(alpha < 0) or np.any(alpha >= math.pi / 2):
        raise InputError("a plane needs a positive distance and a tilt from 0 to below 90 degrees")
    slopes = np.tan(alpha)[:, None] * np.stack([-np.sin(beta), np.cos(beta)], axis=1)
    inside = np.column_stack([z_L + rig.axial_shift, slopes])
    pixels, lengths = _boundary(rig, inside)
    count = pixels.shape[1]
    flat = pixels.reshape(-1, 2)
    normalised = np.asarray(rig.camera.normalise(flat)[0])
    _, jacobian = rig.to_laser_plane(flat)
    noise = jacobian @ np.swapaxes(jacobian, -1, -2) / lengths.reshape(-1, 1, 1)
    by_plane, by_all = point_derivatives(rig, normalised, noise, np.repeat(inside, count, axis=0))
    by_rig = (by_all @ free_parameters(rig)).reshape(len(planes), count, -1)
    by_plane = by_plane.reshape(len(planes), count, 3)
    # Columns of unit length: mm and slopes stand side by side.
    scale = np.linalg.norm(by_plane, axis=1, keepdims=True)
    unit = by_plane / scale
    across = np.swapaxes(unit, -1, -2)
    moved = -np.linalg.solve(across @ unit, across @ by_rig) / np.swapaxes(scale, -1, -2)
    moved[:, 0] -= axial_shift_by_rig(rig)
    turned = np.stack([normal_by_rig(rig, plane, rows) for plane, rows in zip(inside, moved, strict=True)])
    return moved, turned


def _boundary(rig: Rig, planes: Array) -> tuple[Array, Array]:
    """Return pixels (M, N, 2) on the spots' boundaries, and the length (M, N) of boundary that each stands for, px."""
    angles = np.linspace(0, math.tau, _ANGLES, endpoint=False)
    radius, centre = rig.require_beam().radius, np.array(rig.laser_offset)
    circle = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    depth = planes[:, None, 0] + planes[:, 1:] @ circle.T
    if np.any(depth <= 0):
        raise InputError("part of a plane's spot would be behind the camera: tilt it less, or put it farther away")
    image = rig.focal_length * (centre + circle) / depth[..., None]
    pixels = rig.from_laser_plane(image.reshape(-1, 2)).reshape(*depth.shape, 2)
    steps = np.roll(pixels, -1, axis=1) - np.roll(pixels, 1, axis=1)
    return pixels, np.linalg.norm(steps, axis=-1) / 2


def _variance(rows: Array, covariance: Array) -> Array:
    """Return the summed variances (M,) of quantities with derivatives (M, k, n)."""
    return np.einsum("mkn,np,mkp->m", rows, covariance, rows)
