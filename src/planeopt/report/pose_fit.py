"""The boundary points beside the image of the spot on the plane that was found."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.formulations import Problem
from planeopt.plane import SpotPose
from planeopt.report.spot_judged import Judged
from planeopt.rig import Rig
from planeopt.spot import Spot

Array = NDArray[np.float64]

_ROUND = 721  # points of a closed curve


@dataclass(frozen=True, eq=False)
class PoseFit:
    """Residuals of a pose.

    Attributes
    ----------
    judged : Judged
        In pixels; the curve is the image of the plane's spot.
    whitened : (N,) array
        The residuals over their standard deviations (given, or estimated with the fit).
    """

    judged: Judged
    whitened: Array


def pose_fit(spot: Spot, rig: Rig, pose: SpotPose) -> PoseFit | None:
    """Hold a spot's points against the image of the spot on a plane; None where the lens cannot show all of that.

    Distances are Sampson's, right to first order, as in the likelihood of `docs/model.md`.
    """
    problem = Problem.from_spot(spot, rig)
    p, q = pose.slopes
    variables = eq.SlopeVariables(pose.R, pose.z_L + problem.axial_shift, p, q)
    conic = np.array(eq.image_conic_in_slopes(np, variables, problem.setup), dtype=np.float64)
    residuals, normals, sigma = _distances(spot.points, rig, conic, np.asarray(problem.noise))
    try:
        turn = np.linspace(0, 2 * np.pi, _ROUND)
        in_space = eq.spot_point_in_slopes(np, variables, problem.setup, turn)
        curve = rig.from_laser_plane(np.stack(eq.image_point(np, problem.setup, *in_space), axis=1))
        rejected = _distances(spot.rejected, rig, conic)[0] if len(spot.rejected) else np.empty(0)
    except InputError:
        return None
    centre = (curve.min(axis=0) + curve.max(axis=0)) / 2
    angles, rejected_angles = (_angles(points - centre) for points in (spot.points, spot.rejected))
    return PoseFit(Judged(curve, residuals, normals, angles, rejected, rejected_angles), residuals / sigma)


def _distances(pixels: Array, rig: Rig, conic: Array, noise: Array | None = None) -> tuple[Array, Array, Array]:
    """Signed distances (N,) from a conic (6,) of the laser-parallel plane and normals (N, 2), in px of the image.

    Also the standard deviations (N,) of the distances, from the points' covariances (N, 2, 2) in mm.
    """
    points, jacobian = rig.to_laser_plane(pixels)
    x, y = points.T
    b0, b1, b2, b3, b4, b5 = conic
    value = b0 * x * x + b1 * x * y + b2 * y * y + b3 * x + b4 * y + b5
    gradient = np.stack([2 * b0 * x + b1 * y + b3, b1 * x + 2 * b2 * y + b4], axis=1)
    in_pixels = np.einsum("nij,ni->nj", jacobian, gradient)
    # Positive outside, whatever the sign of the conic: at its matrix's first entry it opens outwards.
    in_pixels, value = np.sign(b0) * in_pixels, np.sign(b0) * value
    steepness = np.linalg.norm(in_pixels, axis=1)
    sigma = np.ones(len(x))
    if noise is not None:
        sigma = np.sqrt(np.einsum("ni,nij,nj->n", gradient, noise, gradient)) / steepness
    return value / steepness, in_pixels / steepness[:, None], sigma


def _angles(offsets: Array) -> Array:
    return np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360
