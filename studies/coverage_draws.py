"""Rigs, planes and boundary points as the posterior's own assumptions say that they come about."""

from dataclasses import dataclass, replace

import numpy as np

from planeopt.equations import Setup
from planeopt.plane import SpotPose
from planeopt.posterior import Prior
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from planeopt.spot import Spot
from studies.draws import Range
from studies.outline import Array, pixels_at

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "e_x", "e_y", "radius", "direction_x", "direction_y")
_SIGMAS = (
    Range(0.5, 4.0),
    Range(0.5, 4.0),
    Range(0.3, 1.5),
    Range(0.3, 1.5),
    Range(5e-4, 3e-3),
    Range(1e-3, 1e-2),
    Range(0.005, 0.05),
    Range(0.005, 0.05),
    Range(0.001, 0.01),
    Range(5e-5, 5e-4),
    Range(5e-5, 5e-4),
)
"""Of what a calibration leaves uncertain, in the order of `PARAMETERS`: px, 1, mm, 1."""

_TILT = np.radians(2.0)
_COMMON = 3  # directions that all parameters share, so that they are correlated


def draw_rig(rng: np.random.Generator, *, covariance: bool) -> Rig:
    """Return a random rig.

    The focal length is 1200 to 3500 px, the beam's radius 2 to 10 mm, its offset half a radius to 6 radii, its
    direction within 2 degrees of the optical axis, the distortion that of ordinary lenses. With a covariance, the
    eleven parameters have a random one, correlated as a calibration's are. The image has no borders.
    """
    fx, radius = Range(1200.0, 3500.0).draw(rng), Range(2.0, 10.0).draw_log(rng)
    distortion = (rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), *rng.uniform(-1e-3, 1e-3, 2), 0.0)
    camera = Camera((1280, 960), fx, fx * rng.uniform(0.998, 1.002), 640.0, 480.0, distortion)
    offset = radius * Range(0.5, 6.0).draw(rng) * np.exp(1j * rng.uniform(-np.pi, np.pi))
    beam = Beam(radius, (float(offset.real), float(offset.imag)), lean(rng))
    return Rig(camera, beam, covariance=draw_covariance(rng) if covariance else None)


def lean(rng: np.random.Generator) -> tuple[float, float, float]:
    """Return a beam's direction within 2 degrees of the optical axis."""
    across = np.sin(_TILT) * np.sqrt(rng.uniform()) * np.exp(1j * rng.uniform(-np.pi, np.pi))
    return float(across.real), float(across.imag), float(np.sqrt(1 - abs(across) ** 2))


def draw_covariance(rng: np.random.Generator) -> RigCovariance:
    """Return a random covariance of a rig's parameters."""
    sigmas = np.array([sigma.draw_log(rng) for sigma in _SIGMAS])
    common = rng.standard_normal((len(sigmas), _COMMON))
    matrix = np.eye(len(sigmas)) + common @ common.T
    scale = sigmas / np.sqrt(np.diag(matrix))
    return RigCovariance(PARAMETERS, scale[:, None] * matrix * scale)


def draw_true_rig(rig: Rig, rng: np.random.Generator) -> Rig:
    """Return the rig that there really is, of which the given one is what a calibration says; without covariance."""
    if rig.covariance is None:
        return rig
    names = rig.covariance.parameters
    moved = np.linalg.cholesky(rig.covariance.matrix) @ rng.standard_normal(len(names))
    values = {name: rig.parameter(name) + float(by) for name, by in zip(names, moved, strict=True)}
    return replace(rig.with_parameters(values), covariance=None)


def setup_of(rig: Rig) -> Setup:
    """Return ``f, e_x, e_y, r`` of the laser-parallel frame."""
    return Setup(rig.focal_length, *rig.laser_offset, rig.require_beam().radius)


_BATCH = 256


def draw_planes(prior: Prior, setup: Setup, count: int, rng: np.random.Generator) -> Array:
    """Return planes (count, 3), ``(z_L, p, q)`` of the laser-parallel frame, that a prior allows and the camera sees.

    Written again from the prior's definition: a direction uniform on the cap round the beam and a uniform log z_L
    together, thrown away together where the spot is not in front or its lit side not seen.
    """
    kept = np.empty((0, 3))
    nearest, farthest = np.log(prior.depth_radii) + np.log(setup.r)
    while len(kept) < count:
        log_z = rng.uniform(nearest, farthest, _BATCH)
        # A normal law's direction is uniform; of the sphere's, those of the cap are kept.
        normal = rng.standard_normal((_BATCH, 3))
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        p, q = -normal[:, 0] / normal[:, 2], -normal[:, 1] / normal[:, 2]
        z_L = np.exp(log_z)
        inside = normal[:, 2] >= np.cos(prior.max_tilt)
        seen = (z_L > setup.r * np.hypot(p, q)) & (z_L - p * setup.e_x - q * setup.e_y > 0)
        kept = np.concatenate([kept, np.stack([z_L, p, q], axis=1)[inside & seen]])
    return kept[:count]


@dataclass(frozen=True)
class Truth:
    """A plane before the rig that there really is.

    Attributes
    ----------
    rig : Rig
    plane : tuple of float
        ``(z_L, p, q)`` of the laser-parallel frame.
    """

    rig: Rig
    plane: tuple[float, float, float]

    @property
    def pose(self) -> SpotPose:
        z_L, p, q = self.plane
        return SpotPose.from_slopes(z_L - self.rig.axial_shift, p, q, self.rig.require_beam().radius)

    @property
    def quantities(self) -> dict[str, float]:
        """What is reported: `QUANTITIES`, mm and rad."""
        pose = self.pose
        return dict(zip(QUANTITIES, (pose.z_L, *self.plane[1:], pose.alpha, pose.R), strict=True))


QUANTITIES = ("z_L", "p", "q", "alpha", "R")


def draw_truth(rig: Rig, prior: Prior, rng: np.random.Generator) -> Truth:
    """Return a plane of the prior before a rig that the given one allows; drawn anew where that rig sees no such spot.

    The prior's bounds are those of the given rig, as in the posterior.
    """
    while True:
        true_rig = draw_true_rig(rig, rng)
        z_L, p, q = draw_planes(prior, setup_of(rig), 1, rng)[0].tolist()
        seen = setup_of(true_rig)
        if z_L > seen.r * np.hypot(p, q) and z_L - p * seen.e_x - q * seen.e_y > 0:
            return Truth(true_rig, (z_L, p, q))


def draw_spot(truth: Truth, *, arc: float, points: int, sigma_px: float, rng: np.random.Generator) -> Spot:
    """Return boundary points with noise across the boundary, as edges have that are found in an image.

    Parameters
    ----------
    truth : Truth
    arc : float
        Share of the turn round the beam that the points cover, beginning anywhere.
    points : int
    sigma_px : float
        Standard deviation along the boundary's normal, raw pixels; the spot has it as its sigma.
    rng : Generator
    """
    steps = np.arange(points) / (points if arc == 1 else points - 1)
    angles = 2 * np.pi * (arc * steps + rng.uniform())
    pixels, normals = pixels_at(truth.rig, truth.pose, angles)
    noisy = pixels + sigma_px * rng.standard_normal(points)[:, None] * normals
    return Spot(noisy, np.full(points, sigma_px), arc_fraction=arc)
