"""The true boundary of a spot in the image, from rig and plane alone, without the simulator."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planeopt.plane import SpotPose
from planeopt.rig import Rig

Array = NDArray[np.float64]

_PLACES = 4000
_WIDER = 1e-4  # of the radius, for a difference quotient
_TURN = 1e-5  # rad, the same


def spot_in_space(rig: Rig, pose: SpotPose, count: int, radii: float = 1.0) -> Array:
    """Return points (count, 3) of the spot's boundary, camera frame, mm: where the beam's mantle meets the plane.

    `radii` is the radius of the mantle over the beam's.
    """
    return spot_at(rig, pose, np.linspace(0, 2 * np.pi, count, endpoint=False), radii)


def spot_at(rig: Rig, pose: SpotPose, angle: Array, radii: float = 1.0) -> Array:
    """As `spot_in_space`, at given angles round the beam."""
    beam, plane = rig.require_beam(), rig.plane_from_pose(pose)
    rim = radii * beam.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1) @ rig.Q
    along, start = np.array(beam.direction), np.array([*beam.offset, 0.0]) + rim
    return start - (plane.distance_to(start) / (plane.normal @ along))[:, None] * along


def pixels_at(rig: Rig, pose: SpotPose, angle: Array) -> tuple[Array, Array]:
    """Return the boundary's pixels (N, 2) at angles (N,) round the beam, and its unit normals there."""
    before, here, after = (project(rig, spot_at(rig, pose, angle + step)) for step in (-_TURN, 0.0, _TURN))
    tangent = after - before
    return here, np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.hypot(*tangent.T)[:, None]


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
    stretch : (N,) array
        Movement of the boundary along its normal, px per mm of the beam's radius.
    """

    pixels: Array
    normals: Array
    lengths: Array
    stretch: Array

    @classmethod
    def of(cls, rig: Rig, pose: SpotPose, count: int = _PLACES) -> "TrueBoundary":
        """Project the spot; tangents are central differences."""
        pixels = project(rig, spot_in_space(rig, pose, count))
        tangent = (np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0)) / 2
        lengths = np.hypot(*tangent.T)
        normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / lengths[:, None]
        outwards = np.sign(np.sum(normals * (pixels - pixels.mean(axis=0)), axis=1))
        normals = normals * outwards[:, None]
        wider = project(rig, spot_in_space(rig, pose, count, 1 + _WIDER))
        stretch = np.sum((wider - pixels) * normals, axis=1) / (_WIDER * rig.require_beam().radius)
        return cls(pixels, normals, lengths, stretch)

    @property
    def length(self) -> float:
        """Perimeter, px."""
        return float(self.lengths.sum())

    def places_of(self, points: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the place (M,) nearest to each of points (M, 2), and the length (M,) for which each stands, px.

        Half the way to either neighbour; across a gap no more than twice the usual.
        """
        nearest = np.asarray(KDTree(self.pixels).query(points)[1], dtype=np.intp)
        along = np.cumsum(self.lengths)[nearest]
        order = np.argsort(along)
        gaps = np.diff(along[order], append=along[order[0]] + self.length)
        gaps = np.minimum(gaps, 2 * np.median(gaps))
        stands = np.empty(len(points))
        stands[order] = (gaps + np.roll(gaps, 1)) / 2
        return nearest, np.maximum(stands, 1e-3)


def project(rig: Rig, space: Array) -> Array:
    """Return the raw pixels (N, 2) of points (N, 3) in the camera frame."""
    return rig.camera.project(space[:, :2] / space[:, 2:])
