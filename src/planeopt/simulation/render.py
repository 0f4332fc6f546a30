"""Images of scenes, with the truth beside them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.plane import SpotPose
from planeopt.record import Intercepts, PoseRecord, Slopes, mounted
from planeopt.simulation import sensor, surroundings
from planeopt.simulation.geometry import View, arc_points, view
from planeopt.simulation.light import spot_patch
from planeopt.simulation.scene import Scene

Array = NDArray[np.float64]

MESSAGE = "The true plane of a simulated image."

# Each random part has numbers of its own, so that a change of one leaves the others as they are.
_PLATEAU, _SPECKLE, _TEXTURE, _CLUTTER, _OCCLUSION, _NOISE, _DARK_NOISE, _PLANE = range(8)
_TRIES = 1000


@dataclass(frozen=True, eq=False)
class Simulated:
    """An image and its truth.

    Attributes
    ----------
    image : (H, W) or (H, W, 3) ndarray of uint8 or uint16
        Colour in the order blue, green, red.
    truth : PoseRecord
    """

    image: NDArray[np.unsignedinteger]
    truth: PoseRecord


def render(scene: Scene, seed: int | None = None, *, laser: bool = True, name: str = "simulated") -> Simulated:
    """Return the image of a scene; the same seed gives the same bytes.

    Parameters
    ----------
    scene : Scene
        Its `frames` and `sweep` have no part in it: see `frame`.
    seed : int, optional
        Instead of the scene's.
    laser : bool
        False: the image without laser, of the same surroundings, with noise of its own.
    name : str
        Of the image, for the record.

    Raises
    ------
    InputError
        If the spot cannot be seen (see `view`) or drawn, or clutter finds no room.
    """
    look = view(scene)
    seed = scene.seed if seed is None else seed
    light = _light(look, seed, laser)
    image = sensor.expose(light, scene.noise, scene.sensor, _rng(seed, _NOISE if laser else _DARK_NOISE))
    return Simulated(image, _record(look, seed, name))


def clean_light(scene: Scene, seed: int | None = None, *, laser: bool = True) -> Array:
    """Return the light of a scene before shot noise, read noise, clipping, response and quantisation.

    Returns
    -------
    ndarray, shape (H, W) or (H, W, 3)
        Shares of full scale, float64; with the speckle, texture and clutter of that seed.
    """
    return _light(view(scene), scene.seed if seed is None else seed, laser)


def true_record(scene: Scene, name: str = "simulated") -> PoseRecord:
    """Return the true plane in the keys of a pose record.

    What only a measurement has (`formulation`, `sigma`, `chi2` ...) is null; `arc_fraction` is the share of the
    boundary, by its length in the image, that is in the image and behind no obstacle.
    """
    return _record(view(scene), scene.seed, name)


def frame(scene: Scene, index: int) -> Scene:
    """Return the scene of one image of a series, index from 0: its seed, and its plane if the series has a sweep.

    Raises
    ------
    InputError
        If none of 1,000 planes drawn from the sweep can be seen.
    """
    seed = int(np.random.SeedSequence((scene.seed, index)).generate_state(1, np.uint32)[0])
    single = msgspec.structs.replace(scene, seed=seed, frames=1, sweep=None)
    if scene.sweep is None:
        return single
    rng = _rng(seed, _PLANE)
    reason = ""
    for _ in range(_TRIES):
        drawn = msgspec.structs.replace(single, plane=_drawn(scene, rng))
        try:
            view(drawn)
        except InputError as error:
            reason = str(error)
        else:
            return drawn
    raise InputError(f"sweep: none of {_TRIES} planes drawn can be seen; of the last: {reason}")


def frames(scene: Scene) -> Iterator[Scene]:
    """Yield the scene of each image of a series."""
    for index in range(scene.frames):
        yield frame(scene, index)


def _drawn(scene: Scene, rng: np.random.Generator) -> SpotPose:
    pose, sweep = scene.pose, scene.sweep
    z_L, alpha, beta = rng.uniform(size=3)

    def between(limits: tuple[float, float] | None, share: float, fixed: float) -> float:
        return fixed if limits is None else limits[0] + share * (limits[1] - limits[0])

    if sweep is None:
        return pose
    tilt = between(sweep.alpha_deg, alpha, math.degrees(pose.alpha))
    direction = between(sweep.beta_deg, beta, math.degrees(pose.beta or 0.0))
    return SpotPose.canonical(pose.R, between(sweep.z_L_mm, z_L, pose.z_L), math.radians(tilt), math.radians(direction))


def _rng(seed: int, part: int, *more: int) -> np.random.Generator:
    return np.random.default_rng((seed, part, *more))


def _light(look: View, seed: int, laser: bool) -> Array:
    scene = look.scene
    width, height = scene.rig.camera.image_size
    reflectance = surroundings.texture(look, _rng(seed, _TEXTURE))
    ground = surroundings.background(look) * reflectance + surroundings.clutter(look, _rng(seed, _CLUTTER))
    parts = [(ground, scene.surface.rgb)]
    if laser:
        parts.append((_laser(look, seed, (height, width)) * reflectance, scene.beam.rgb))
    light = sensor.channels(parts, scene.sensor)
    for number, obstacle in enumerate(scene.occlusions):
        cover = surroundings.occlusion(look, obstacle, _rng(seed, _OCCLUSION, number))
        if scene.sensor.color:
            cover = cover[..., None]
        light = light + cover * (obstacle.brightness - light)
    if scene.optics.vignetting > 0:
        through = surroundings.falloff(scene.rig.camera, scene.optics.vignetting)
        light = light * (through[..., None] if scene.sensor.color else through)
    return light


def _laser(look: View, seed: int, shape: tuple[int, int]) -> Array:
    scene = look.scene
    patch = spot_patch(look, _rng(seed, _PLATEAU))
    light = np.zeros(shape)
    light[patch.place] = patch.light
    wide = surroundings.halo(light, scene.optics.halo_px) if scene.optics.halo > 0 else 0.0
    if scene.noise.speckle > 0:
        grains = surroundings.speckle(
            patch.light.shape, scene.noise.speckle, scene.noise.speckle_grain_px, _rng(seed, _SPECKLE)
        )
        light[patch.place] *= grains
    return scene.beam.height * ((1 - scene.optics.halo) * light + scene.optics.halo * wide)


def _record(look: View, seed: int, name: str) -> PoseRecord:
    scene = look.scene
    pose, plane = scene.pose, scene.true_plane
    points = arc_points(look)
    seen = look.in_image(points)
    for number, obstacle in enumerate(scene.occlusions):
        seen &= ~surroundings.hidden(look, obstacle, points, _rng(seed, _OCCLUSION, number))
    p, q = pose.slopes
    a, b, c = (value if math.isfinite(value) else None for value in plane.intercepts)
    nx, ny, nz = plane.normal.tolist()
    x, y, z = plane.point.tolist()
    return PoseRecord(
        input=name,
        status="ok",
        message=MESSAGE,
        z_L_mm=pose.z_L,
        alpha_deg=math.degrees(pose.alpha),
        beta_deg=None if pose.beta is None else math.degrees(pose.beta),
        R_mm=pose.R,
        normal=(nx, ny, nz),
        point_mm=(x, y, z),
        intercepts_mm=Intercepts(a=a, b=b, c=c),
        slopes=Slopes(p=p, q=q),
        mount=mounted(scene.rig.mount, plane),
        arc_fraction=float(np.mean(seen)),
    )
