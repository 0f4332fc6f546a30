"""A measured boundary held against the true one: its bias, its noise over the bound, and if its sigma is honest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planeopt.plane import SpotPose
from planeopt.rig import Rig
from planeopt.spot import Spot
from planeopt.spot.bound import least_covariance, point_sigma
from studies.draws import spot_in_space

Array = NDArray[np.float64]

_PLACES = 4000


@dataclass(frozen=True, eq=False)
class TrueBoundary:
    """The boundary that a rig sees of a plane: N places round it.

    Attributes
    ----------
    pixels : (N, 2) array
        Raw pixels.
    normals : (N, 2) array
        Unit, outwards.
    lengths : (N,) array
        Of the boundary for which each place stands, px.
    """

    pixels: Array
    normals: Array
    lengths: Array

    @classmethod
    def of(cls, rig: Rig, pose: SpotPose, count: int = _PLACES) -> "TrueBoundary":
        """Project the spot; tangents are central differences."""
        space = spot_in_space(rig, pose, count)
        pixels = rig.camera.project(space[:, :2] / space[:, 2:])
        tangent = (np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0)) / 2
        lengths = np.hypot(*tangent.T)
        normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / lengths[:, None]
        outwards = np.sign(np.sum(normals * (pixels - pixels.mean(axis=0)), axis=1))
        return cls(pixels, normals * outwards[:, None], lengths)

    @property
    def length(self) -> float:
        """Perimeter, px."""
        return float(self.lengths.sum())

    def share_of(self, points: Array) -> tuple[Array, Array]:
        """Return the angle (M,) of points (M, 2) round the centre, rad, and the length (M,) for which each stands, px.

        Half the way to either neighbour; across a gap no more than twice the usual.
        """
        nearest = KDTree(self.pixels).query(points)[1]
        along = np.cumsum(self.lengths)[nearest]
        order = np.argsort(along)
        gaps = np.diff(along[order], append=along[order[0]] + self.length)
        gaps = np.minimum(gaps, 2 * np.median(gaps))
        stands = np.empty(len(points))
        stands[order] = (gaps + np.roll(gaps, 1)) / 2
        away = points - self.pixels.mean(axis=0)
        return np.arctan2(away[:, 1], away[:, 0]), np.maximum(stands, 1e-3)


def least_pose_covariance(rig: Rig, pose: SpotPose, per_pixel: float, size_cost: float) -> Array:
    """Return the least covariance (3, 3) of (z_L, p, q) that the pixels allow; the rig is known.

    Parameters
    ----------
    rig, pose
        The truth.
    per_pixel, size_cost : float
        Of `planeopt.spot.bound`.
    """
    boundary = TrueBoundary.of(rig, pose)
    plane, step = np.array([pose.z_L, *pose.slopes]), 1e-5 * np.diag([pose.z_L, 1.0, 1.0])
    # The same place round the beam is not the same point of the boundary: only what moves it across counts.
    moves = [
        np.sum((_pixels(rig, plane + d) - _pixels(rig, plane - d)) * boundary.normals, axis=1) / (2 * d.sum())
        for d in step
    ]
    return least_covariance(np.stack(moves, axis=1), boundary.lengths, per_pixel, size_cost=size_cost)


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
    """

    bias: float
    least_variance: float
    points: float
    size: float
    shape: float
    own: float


def deviation(spot: Spot, offsets: Array, truth: TrueBoundary, per_pixel: float, size_cost: float) -> Deviation:
    """Compare the points with the truth.

    Parameters
    ----------
    spot : Spot
        With sigma.
    offsets : (N,) array
        Signed distances of its points from the true boundary, px, positive outwards.
    truth : TrueBoundary
    per_pixel, size_cost : float
        Of `planeopt.spot.bound`.
    """
    assert spot.sigma is not None
    angle, stands = truth.share_of(spot.points)
    least = point_sigma(per_pixel, stands)
    bias = float(np.average(offsets, weights=stands))
    waves = np.stack([np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    design = np.concatenate([np.ones((len(angle), 1)), waves], axis=1)
    least_variance = (per_pixel * size_cost) ** 2 / float(stands.sum())
    return Deviation(
        bias=bias,
        least_variance=least_variance,
        points=float(np.mean(((offsets - bias) / least) ** 2)),
        size=bias**2 / least_variance,
        shape=_squared(waves, offsets - bias, least),
        own=_squared(design, offsets, spot.sigma),
    )


def _squared(design: Array, offsets: Array, sigma: Array) -> float:
    """Squared Mahalanobis norm of the design's fitted coefficients, over their number."""
    whitened, target = design / sigma[:, None], offsets / sigma
    fitted = whitened @ np.linalg.lstsq(whitened, target, rcond=None)[0]
    return float(fitted @ fitted) / design.shape[1]
