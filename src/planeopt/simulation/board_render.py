"""Images of a board with the laser's spot on it, by casting a ray through every sample of every pixel.

A ray is taken through the inverse of the lens's distortion to the board, bowed or not; there the print reflects the
surrounding light and the laser's. Edges are smoothed in closed form where they are sampled, as those of spots on planes
are (see `planeopt.simulation.sampling`), and the rest of the blur and the pixel's area are sums over the samples.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.errors import InputError
from planeopt.rig import Rig
from planeopt.simulation import sensor, surroundings
from planeopt.simulation.board_look import BoardSurface, Pattern
from planeopt.simulation.board_rays import Grid, cast, grid_of
from planeopt.simulation.board_views import BoardPoses, BoardView
from planeopt.simulation.geometry import FAR
from planeopt.simulation.profiles import irradiance, is_even, plateau, reach, softness, unevenness
from planeopt.simulation.sampling import BEND, ENOUGH, Sampling, edge_distance, kernel, smoothed_disc
from planeopt.simulation.tables import BeamProfile, Noise, Optics, Sensor

Array = NDArray[np.float64]
Image = NDArray[np.unsignedinteger]

_FACTORS = (2, 4, 8, 16)
_STRIP = 32
"""Rows of pixels to work on at a time."""

# Each random part has numbers of its own, so that a change of one leaves the others as they are.
_PLATEAU, _SPECKLE, _NOISE, _DARK_NOISE = range(4)


@dataclass(frozen=True, eq=False)
class BoardScene:
    """All that images of a board depend on, but its poses.

    Parameters
    ----------
    rig : Rig
        Its covariance is not used; without a beam there is no spot.
    board : Board
    surface, beam, optics, noise, sensor
        See the classes.
    warp : (float, float)
        Bow of the board, mm, see `BoardView`.
    divergence : float
        Of the beam, see `BoardView`.
    """

    rig: Rig
    board: Board
    surface: BoardSurface = field(default_factory=BoardSurface)
    beam: BeamProfile = field(default_factory=lambda: BeamProfile(height=0.45))
    optics: Optics = field(default_factory=Optics)
    noise: Noise = field(default_factory=Noise)
    sensor: Sensor = field(default_factory=Sensor)
    warp: tuple[float, float] = (0.0, 0.0)
    divergence: float = 0.0

    def view(self, rotation: Array, translation: Array) -> BoardView:
        """Return the geometry of one pose."""
        return BoardView(self.rig, self.board, rotation, translation, self.warp, self.divergence)

    @cached_property
    def pattern(self) -> Pattern:
        """The print."""
        return Pattern.of(self.board, self.surface)

    @cached_property
    def grid(self) -> Grid:
        """The image's samples and their rays, the same in every view."""
        blur = self.optics.blur_px
        finest = blur / 2 if self.beam.kind == "disc" else min(blur / 2, ENOUGH / 4)
        factor = next((factor for factor in _FACTORS if ENOUGH / factor <= finest), _FACTORS[-1])
        closed = ENOUGH / factor
        return grid_of(self.rig.camera, Sampling(factor, closed, math.sqrt(blur**2 - closed**2)))


def render_board(scene: BoardScene, rotation: Array, translation: Array, *, laser: bool = True, seed: int = 0) -> Image:
    """Return the image of one view; the same seed gives the same bytes.

    Parameters
    ----------
    scene : BoardScene
    rotation : (3, 3) ndarray
        From the board frame to the camera frame.
    translation : (3,) ndarray
        mm.
    laser : bool
        False: the image's dark twin, of the same surroundings, with noise of its own.
    seed : int

    Returns
    -------
    ndarray of uint8 or uint16, shape (H, W) or (H, W, 3)
        Colour in the order blue, green, red.

    Raises
    ------
    InputError
        If the spot is too small or a ring's line too thin to be sampled, or the lens cannot be inverted over the image.
    """
    light = board_light(scene, rotation, translation, laser=laser, seed=seed)
    rng = np.random.default_rng((seed, _NOISE if laser else _DARK_NOISE))
    return sensor.expose(light, scene.noise, scene.sensor, rng)


def render_session(scene: BoardScene, poses: BoardPoses, *, laser: bool = True, seed: int = 0) -> Iterator[Image]:
    """Yield the image of each view, as `render_board` does, each with a seed of its own."""
    for index, (rotation, translation) in enumerate(zip(poses.rotations, poses.translations, strict=True)):
        own = int(np.random.SeedSequence((seed, index)).generate_state(1, np.uint32)[0])
        yield render_board(scene, rotation, translation, laser=laser, seed=own)


def board_light(scene: BoardScene, rotation: Array, translation: Array, *, laser: bool = True, seed: int = 0) -> Array:
    """Return the light (H, W) or (H, W, 3) before noise, clipping, response and quantisation, shares of full scale.

    The parameters are those of `render_board`.
    """
    view = scene.view(rotation, translation)
    reflectance = _reflectance(scene, view)
    ground = _pixels(reflectance, scene.grid.sampling) * scene.surface.white * _illumination(scene)
    parts = [(ground, scene.surface.rgb)]
    if laser and scene.rig.beam is not None:
        parts.append((_laser(scene, view, reflectance, seed), scene.beam.rgb))
    light = sensor.channels(parts, scene.sensor)
    if scene.optics.vignetting > 0:
        through = surroundings.falloff(scene.rig.camera, scene.optics.vignetting)
        light = light * (through[..., None] if scene.sensor.color else through)
    return light


def _illumination(scene: BoardScene) -> Array:
    width, height = scene.rig.camera.image_size
    x = (np.arange(width) - (width - 1) / 2) / width
    y = (np.arange(height) - (height - 1) / 2) / height
    return np.maximum(1 + scene.surface.gradient[0] * x + scene.surface.gradient[1] * y[:, None], 0.0)


def _reflectance(scene: BoardScene, view: BoardView) -> Array:
    """Return the reflectance at every sample, edges smoothed by the closed part of the blur."""
    grid = scene.grid
    s, closed = grid.sampling.factor, grid.sampling.closed
    rows = grid.rays.shape[1]
    found = np.empty(grid.rays.shape[1:])
    for top in range(0, rows, _STRIP * s):
        bottom = min(top + _STRIP * s, rows)
        # A line more on either side, for the derivatives.
        first, last = max(0, top - 1), min(rows, bottom + 1)
        met = cast(view, *grid.rays[:, first:last])
        blur_x, blur_y = (closed * s * np.maximum(np.hypot(*_slopes(place)), 1e-9) for place in (met.x, met.y))
        inner = slice(top - first, bottom - first)
        found[top:bottom] = scene.pattern.smoothed(met.x[inner], met.y[inner], blur_x[inner], blur_y[inner])
    return found


def _slopes(values: Array) -> tuple[Array, Array]:
    """Return derivatives along rows and columns, by one sample."""
    return np.gradient(values, axis=1), np.gradient(values, axis=0)


def _pixels(samples: Array, sampling: Sampling) -> Array:
    """Return the light of the pixels inside the margin: the kernel's sum over all samples."""
    height, width = (count // sampling.factor for count in samples.shape)
    columns = (kernel(width, sampling) @ samples.T).T
    return np.asarray(kernel(height, sampling) @ columns)


def _laser(scene: BoardScene, view: BoardView, reflectance: Array, seed: int) -> Array:
    """Return the laser's light (H, W)."""
    width, height = scene.rig.camera.image_size
    light = np.zeros((height, width))
    box = _box(scene, view)
    if box is None:
        return light
    left, top, right, bottom = box
    place = scene.grid.box(*box)
    rng = np.random.default_rng((seed, _PLATEAU))
    shone, sampling = _shone(scene, view, scene.grid.rays[:, *place], rng)
    patch = _pixels(shone * reflectance[place], sampling)
    here = slice(top, bottom), slice(left, right)
    light[here] = patch
    wide = surroundings.halo(light, scene.optics.halo_px) if scene.optics.halo > 0 else 0.0
    if scene.noise.speckle > 0:
        light[here] *= surroundings.speckle(
            patch.shape, scene.noise.speckle, scene.noise.speckle_grain_px, np.random.default_rng((seed, _SPECKLE))
        )
    return scene.beam.height * ((1 - scene.optics.halo) * light + scene.optics.halo * wide)


def _box(scene: BoardScene, view: BoardView) -> tuple[int, int, int, int] | None:
    """Return the part of the image that the laser's light can reach: first column and row, and the ones after the last.

    None where there is none: the beam misses the board, or meets its back, or outside of the image.
    """
    beam = scene.rig.require_beam()
    theta = np.linspace(0, math.tau, 180, endpoint=False)
    _, outer = reach(scene.beam, beam.radius)
    space = view.spot_on_board(theta, outer) @ view.rotation.T + view.translation
    lit = float(np.array(beam.direction) @ view.rotation[:, 2]) > 0
    if not (lit and view.faces and np.all(np.isfinite(space)) and np.all(space[:, 2] > 0)):
        return None
    px, _ = view.pixels(space)
    pad = scene.grid.sampling.margin + 3
    size = np.array(scene.rig.camera.image_size)
    left, top = np.clip(np.floor(px.min(axis=0)) - pad, 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(px.max(axis=0)) + pad + 1, 0, size).astype(int).tolist()
    return (left, top, right, bottom) if left < right and top < bottom else None


def _shone(scene: BoardScene, view: BoardView, rays: Array, rng: np.random.Generator) -> tuple[Array, Sampling]:
    """Return the beam's irradiance at the samples of a box, share of its height, and how to sum it to pixels.

    Beyond the paper there is none.
    """
    beam = scene.rig.require_beam()
    met = cast(view, *rays)
    x, y, along = _in_beam(view, met.depth * rays[0], met.depth * rays[1], met.depth)
    radius = beam.radius + view.divergence * along
    first, second = (np.where(met.depth > 0, place / radius, FAR) for place in (x, y))
    light, sampling = _profile(scene, first, second)
    if not is_even(scene.beam):
        _, outer = reach(scene.beam, beam.radius)
        first, second = np.clip(first, -2 * outer, 2 * outer), np.clip(second, -2 * outer, 2 * outer)
        light *= plateau(scene.beam, beam.radius, first, second, unevenness(scene.beam, first, second, rng))
    margin, (across, down) = scene.surface.margin_mm, view.board.size_mm
    on_paper = (met.x > -margin) & (met.x < across + margin) & (met.y > -margin) & (met.y < down + margin)
    return np.where(on_paper, light, 0.0), sampling


def _in_beam(view: BoardView, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Return places across the beam and along it from (e_x, e_y, 0), mm, of points in the camera frame, mm."""
    e_x, e_y = view.rig.require_beam().offset
    a, b, c = (row[0] * (x - e_x) + row[1] * (y - e_y) + row[2] * z for row in view.rig.Q)
    return a, b, c


def _profile(scene: BoardScene, x: Array, y: Array) -> tuple[Array, Sampling]:
    """Return the irradiance at places of the cross-section, radii, known sample by sample, and what is left to sum.

    What is smooth enough is sampled as it is, and the whole blur is left; a sharper edge is smoothed in closed form.
    """
    sampling, beam, radius = scene.grid.sampling, scene.beam, scene.rig.require_beam().radius
    s = sampling.factor
    # Smooth everywhere, the axis included; on the boundary its slope is that of the radius.
    level = np.minimum(0.5 * (x * x + y * y - 1), FAR)
    dx, dy = (s * slope for slope in _slopes(level))
    steepness = np.maximum(np.hypot(dx, dy), 1e-12)
    edge = np.abs(level) < 0.5
    width = softness(beam, radius) / radius / float(np.max(steepness[edge], initial=1e-12))
    if width * s >= 2 * ENOUGH or beam.kind != "disc":
        if width * s < ENOUGH:
            raise InputError(
                f"beam: in this view the spot's line or edge is {width:.2g} px wide (standard deviation) where it is "
                f"narrowest; at least {ENOUGH / s:.2g} px can be rendered"
            )
        return irradiance(beam, radius, x, y), Sampling(s, 0.0, math.hypot(sampling.closed, sampling.summed))
    (xx, xy), (_, yy) = (tuple(s * part for part in _slopes(slope)) for slope in (dx, dy))
    nx, ny = dx / steepness, dy / steepness
    bend = nx * nx * xx + 2 * nx * ny * xy + ny * ny * yy
    curvature = (ny * ny * xx - 2 * nx * ny * xy + nx * nx * yy) / steepness
    limit = 2 * BEND / sampling.closed
    sharpest = float(np.max(np.abs(curvature[np.abs(level) < 0.5 / s * steepness]), initial=0.0))
    if sharpest > limit:
        raise InputError(
            f"beam: in this view the spot's image has tips of radius {1 / sharpest:.2g} px; "
            f"at least {1 / limit:.2g} px can be rendered"
        )
    # The level's slope is that of the radius times the radius.
    soft = beam.edge_mm / radius * np.hypot(x, y) / steepness
    distance = edge_distance(level, steepness, bend)
    # Far from the edge, where it no longer counts, the curvature may be anything.
    curvature = np.clip(curvature, -limit, limit)
    return smoothed_disc(distance, curvature, soft, beam.level, sampling.closed), sampling
