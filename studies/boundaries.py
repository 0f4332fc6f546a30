"""A measured boundary held against the true one: its bias, its noise over the bound, and if its sigma is honest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.plane import SpotPose
from planeopt.rig import Rig
from planeopt.spot import Spot
from planeopt.spot.bound import least_covariance, point_sigma
from studies.draws import Lit
from studies.outline import TrueBoundary

Array = NDArray[np.float64]


def least_pose_covariance(lit: Lit) -> Array:
    """Return the least covariance (3, 3) of (z_L, p, q) that the pixels allow; the rig is known."""
    rig, pose, boundary = lit.scene.rig, lit.scene.pose, lit.truth
    plane, step = np.array([pose.z_L, *pose.slopes]), 1e-5 * np.diag([pose.z_L, 1.0, 1.0])
    # The same place round the beam is not the same point of the boundary: only what moves it across counts.
    moves = [
        np.sum((_pixels(rig, plane + d) - _pixels(rig, plane - d)) * boundary.normals, axis=1) / (2 * d.sum())
        for d in step
    ]
    return least_covariance(np.stack(moves, axis=1), boundary.lengths, lit.per_pixel, size_cost=lit.size_cost)


def _pixels(rig: Rig, plane: Array) -> Array:
    z_L, p, q = plane.tolist()
    return TrueBoundary.of(rig, SpotPose.from_slopes(z_L, p, q, rig.require_beam().radius)).pixels


@dataclass(frozen=True)
class Deviation:
    """What the points of one spot say about the measurement.

    Attributes
    ----------
    bias : float
        Mean signed distance of the points from the true boundary, px, positive outwards.
    least_variance : float
        That `bias` could have, px^2.
    points : float
        Mean squared distance about that mean, over the least variance of points as far from each other.
    size : float
        The squared mean distance over its least variance.
    shape : float
        Squared Mahalanobis distance of what else an ellipse can follow (centre, axes: four numbers) by their least
        covariance, over 4.
    own : float
        That of all five, with the covariance that the points' own sigma claims, over 5: chi-squared if that is honest.
    variance : float
        Mean squared distance of the points about `bias`, px^2.
    """

    bias: float
    least_variance: float
    points: float
    size: float
    shape: float
    own: float
    variance: float


def deviation(spot: Spot, offsets: Array, lit: Lit) -> Deviation:
    """Compare the points with the truth.

    Parameters
    ----------
    spot : Spot
        With sigma.
    offsets : (N,) array
        Signed distances of its points from the true boundary, px, positive outwards.
    lit : Lit
        What was rendered.
    """
    assert spot.sigma is not None
    truth = lit.truth
    place, stands = truth.places_of(spot.points)
    least = point_sigma(lit.per_pixel[place], stands)
    bias = float(np.average(offsets, weights=stands))
    least_variance = lit.size_cost**2 * float(np.sum((least * stands) ** 2)) / float(stands.sum()) ** 2
    away = truth.pixels[place] - truth.pixels.mean(axis=0)
    angle = np.arctan2(away[:, 1], away[:, 0])
    waves = np.stack([np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    design = np.concatenate([np.ones((len(angle), 1)), waves], axis=1)
    return Deviation(
        bias=bias,
        least_variance=least_variance,
        points=float(np.mean(((offsets - bias) / least) ** 2)),
        size=bias**2 / least_variance,
        shape=_squared(waves, offsets - bias, least),
        own=_squared(design, offsets, spot.sigma),
        variance=float(np.mean((offsets - bias) ** 2)),
    )


def _squared(design: Array, offsets: Array, sigma: Array) -> float:
    """Squared Mahalanobis norm of the design's fitted coefficients, over their number."""
    whitened, target = design / sigma[:, None], offsets / sigma
    fitted = whitened @ np.linalg.lstsq(whitened, target, rcond=None)[0]
    return float(fitted @ fitted) / design.shape[1]
