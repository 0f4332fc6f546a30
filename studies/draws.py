"""Random rigs, planes and scenes whose spot has a wanted size and look in the image, from a seed."""

from dataclasses import dataclass, replace
from functools import cached_property

import msgspec
import numpy as np

from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig, SpotDefinition
from planeopt.simulation import BeamProfile, Noise, Optics, Scene, Surface
from planeopt.spot.bound import boundary_sigma, size_cost
from planeopt.spot.points import Kind
from studies.outline import Array, TrueBoundary, spot_in_space


@dataclass(frozen=True)
class Range:
    """Of what is drawn; both ends the same: fixed."""

    low: float
    high: float

    @classmethod
    def at(cls, value: float) -> "Range":
        """Return the range of one value."""
        return cls(value, value)

    def draw(self, rng: np.random.Generator) -> float:
        """Return a uniform value."""
        return float(rng.uniform(self.low, self.high))

    def draw_log(self, rng: np.random.Generator) -> float:
        """Return a value with a uniform logarithm."""
        return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))


@dataclass(frozen=True)
class View:
    """What a spot may look like.

    Parameters
    ----------
    radius_px : Range
        Of the beam's radius as the camera sees it at the plane's distance, fx r / z_L.
    tilt_deg : Range
        Of the plane against the beam; its direction is uniform.
    kind : {"disc", "ring"}
    image_size : tuple of int, optional
        Width and height, px, with the spot somewhere in it; just large enough for the spot unless given.
    """

    radius_px: Range
    tilt_deg: Range = Range(0.0, 65.0)
    kind: Kind = "disc"
    image_size: tuple[int, int] | None = None


_MARGIN = 40.0  # px round the spot
_MARGIN_SHARE = 0.3  # of the beam's radius in the image, on top of it
_TRIES = 200


def draw_view(view: View, rng: np.random.Generator) -> tuple[Rig, SpotPose]:
    """Return a rig without covariance and a plane that it sees whole and from its lit side.

    The focal length is 900 to 2500 px, the distance 100 to 500 mm, the beam's offset 5 to 25 % of it, its direction
    within 2 degrees of the optical axis, the distortion that of ordinary lenses (k1 within 0.15, k2 within 0.1,
    tangential terms within 0.001). The principal point lies where the image has to be for the spot to be in it.
    """
    for _ in range(_TRIES):
        fx = rng.uniform(900, 2500)
        z_L = Range(100.0, 500.0).draw_log(rng)
        radius = view.radius_px.draw_log(rng) * z_L / fx
        away, around = z_L * rng.uniform(0.05, 0.25), rng.uniform(-np.pi, np.pi)
        lean = np.radians(2.0) * np.sqrt(rng.uniform()) * np.exp(1j * rng.uniform(-np.pi, np.pi))
        beam = Beam(
            radius,
            (float(away * np.cos(around)), float(away * np.sin(around))),
            (float(lean.real), float(lean.imag), float(np.sqrt(1 - abs(lean) ** 2))),
        )
        distortion = (rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), *rng.uniform(-1e-3, 1e-3, 2), 0.0)
        alpha, beta = np.radians(view.tilt_deg.draw(rng)), rng.uniform(-np.pi, np.pi)
        pose = SpotPose.canonical(radius / np.cos(alpha), z_L, alpha, beta)
        rig = _framed(Camera((2, 2), fx, fx * rng.uniform(0.998, 1.002), 0.0, 0.0, distortion), beam, pose, view, rng)
        if rig is not None:
            return rig, pose
    raise RuntimeError(f"no plane with such a spot in {_TRIES} tries: {view}")


def _framed(camera: Camera, beam: Beam, pose: SpotPose, view: View, rng: np.random.Generator) -> Rig | None:
    """Place the image round the spot; None where the plane cannot be seen or the lens folds over."""
    rig = Rig(camera, beam)
    plane = rig.plane_from_pose(pose)
    boundary = spot_in_space(rig, pose, 256)
    # The plane's lit side is seen where camera and laser are on one side of it.
    if plane.normal @ plane.point < 0.05 * pose.z_L * np.cos(pose.alpha) or boundary[:, 2].min() < 0.2 * pose.z_L:
        return None
    normalised = boundary[:, :2] / boundary[:, 2:]
    if np.hypot(*normalised.T).max() > 0.7 * camera.invertible_radius:
        return None
    pixels = camera.project(normalised)
    margin = _MARGIN + _MARGIN_SHARE * beam.radius * camera.fx / pose.z_L
    low, high = pixels.min(axis=0) - margin, pixels.max(axis=0) + margin
    wanted = np.ceil(high - low).astype(int) if view.image_size is None else np.array(view.image_size)
    room = wanted - (high - low)
    if np.any(room < -1):
        return None
    corner = low - rng.uniform(0, np.maximum(room, 1e-9))
    width, height = wanted.tolist()
    framed = Camera((width, height), camera.fx, camera.fy, -float(corner[0]), -float(corner[1]), camera.distortion)
    return Rig(framed, beam, SpotDefinition(kind=view.kind))


@dataclass(frozen=True)
class Look:
    """How bright and how sharp a spot is; grey levels of 8 bits.

    Parameters
    ----------
    contrast : Range
        Height of the blurred edge or ridge over the background, where it is highest.
    noise : Range
        Standard deviation of a pixel, the same everywhere.
    blur_px : Range
        Standard deviation of the optics' blur; the pixel's own area comes on top of it.
    background : Range
        As far as noise leaves room for it.
    line_px : Range
        Standard deviation of a ring's own line, as the camera sees it at the plane's distance.
    over : float
        By how much the light exceeds full scale; 1 and below: `contrast` counts.
    full_well_electrons : float, optional
        With it there is shot noise as well.
    """

    contrast: Range
    noise: Range
    blur_px: Range = Range(0.7, 2.0)
    background: Range = Range(8.0, 20.0)
    line_px: Range = Range(0.8, 1.6)
    over: float = 1.0
    full_well_electrons: float | None = None


FULL_SCALE = 255.0
PIXEL_VARIANCE = 1 / 12
"""Of a pixel's own area, px^2; and of rounding, squared grey levels."""


@dataclass(frozen=True)
class Lit:
    """A scene with what the bound of its boundary needs.

    Attributes
    ----------
    scene : Scene
    contrast, noise : float
        Height of the blurred edge or ridge where it is highest, and a pixel's standard deviation, grey levels.
    """

    scene: Scene
    contrast: float
    noise: float

    def changed(self, **parts: object) -> "Lit":
        """Return this with parts of the scene replaced."""
        return replace(self, scene=msgspec.structs.replace(self.scene, **parts))

    @property
    def known_blur(self) -> float | None:
        """The camera's own blur, px, which has to be known to measure a ring: see docs/measurement.md."""
        return self._blur if self.scene.beam.kind == "ring" else None

    @property
    def _blur(self) -> float:
        return float(np.hypot(self.scene.optics.blur_px, np.sqrt(PIXEL_VARIANCE)))

    @property
    def _clip(self) -> float:
        return FULL_SCALE * (1 - self.scene.surface.background) / self.contrast

    @cached_property
    def truth(self) -> TrueBoundary:
        """The true boundary; N places."""
        return TrueBoundary.of(self.scene.rig, self.scene.pose)

    @property
    def per_pixel(self) -> Array:
        """Least standard deviation (N,) of one pixel of boundary, px, without shot noise.

        A ring's line is as wide as the perspective makes it at each place, and as high as the blur leaves it.
        """
        noise = float(np.hypot(self.noise, np.sqrt(PIXEL_VARIANCE)))
        if self.scene.beam.kind == "ring":
            line = self.scene.beam.line_mm * self.truth.stretch
            width = np.hypot(line, self._blur)
            share = (line / width) / np.max(line / width)
            return boundary_sigma("ring", self.contrast * share, noise, width, clip=self._clip / share)
        return np.full(
            len(self.truth.pixels), boundary_sigma("disc", self.contrast, noise, self._blur, clip=self._clip)
        )

    @property
    def size_cost(self) -> float:
        """By what factor the size is known worse."""
        if self.scene.beam.kind == "ring":
            return 1.0
        return size_cost(self.truth.length / (2 * np.pi), self._blur, clip=self._clip)


def draw_scene(view: View, look: Look, rng: np.random.Generator) -> Lit:
    """Return a scene of a random rig and plane with a random look; its seed is drawn as well."""
    return light(*draw_view(view, rng), view.kind, look, rng)


def light(rig: Rig, pose: SpotPose, kind: Kind, look: Look, rng: np.random.Generator) -> Lit:
    """Return the scene of a rig and a plane with a random look; its seed is drawn as well."""
    noise, blur, line = look.noise.draw(rng), look.blur_px.draw(rng), look.line_px.draw(rng)
    contrast = look.contrast.draw(rng)
    # Three standard deviations from black and, unless it is to be over-exposed, from full scale.
    top = FULL_SCALE - 3 * noise - (0.0 if look.over > 1 else contrast)
    low, high = max(look.background.low, 3 * noise), min(look.background.high, top)
    background = Range(low, high).draw(rng) if low < high else (low + high) / 2
    if look.over > 1:
        contrast = look.over * (FULL_SCALE - background)
    line_mm = line * pose.z_L / rig.camera.fx
    height = contrast / FULL_SCALE
    if kind == "ring":
        # Blurring spreads the line's light over its new width; least where the line is widest.
        widest = line_mm * float(TrueBoundary.of(rig, pose).stretch.max())
        height *= float(np.sqrt(widest**2 + blur**2 + PIXEL_VARIANCE)) / widest
    scene = Scene.of(
        rig,
        pose,
        beam=BeamProfile(kind=kind, height=height, line_mm=line_mm),
        optics=Optics(blur_px=blur),
        surface=Surface(background=background / FULL_SCALE),
        noise=Noise(full_well_electrons=look.full_well_electrons, read=noise / FULL_SCALE),
        seed=int(rng.integers(2**31)),
    )
    return Lit(scene, contrast, noise)
