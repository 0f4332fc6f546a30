"""The spot's light on the sensor: the exact outline, blurred by the lens and averaged over the pixels.

The image is the irradiance convolved with the lens's Gaussian and with the pixel's square, at the pixels' centres. The
Gaussian is split in two: sigma^2 = sigma_1^2 + sigma_2^2. The edge is smoothed by sigma_1 in closed form where it is
sampled, s x s times a pixel; that leaves nothing that s samples a pixel could not hold, and the rest of the kernel
(Gaussian sigma_2 and square) is a separable sum over the samples.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.simulation.geometry import FAR, View
from planeopt.simulation.profiles import irradiance, is_even, plateau, reach, softness, unevenness
from planeopt.simulation.sampling import BEND, ENOUGH, Sampling, edge_distance, kernel, smoothed_disc

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FINE, _COARSE = 8, 4
_FACTORS = (_COARSE, _FINE, 16, 32)
_SAMPLES = 4_000_000
"""How many to hold at a time."""
# Beyond this distance from a sharp edge its light is flat to 1e-12, with the error of the distance allowed for.
_NEAR_PX = 3.0


@dataclass(frozen=True, eq=False)
class Patch:
    """The spot's light on a part of the image.

    Attributes
    ----------
    left, top : int
        Its first column and row.
    light : (h, w) ndarray
        Share of the height.
    """

    left: int
    top: int
    light: Array

    @property
    def place(self) -> tuple[slice, slice]:
        """Rows and columns of the image."""
        height, width = self.light.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """What is known at the centres of a box of pixels.

    Attributes
    ----------
    rays : (2, h, w) ndarray
        Normalised coordinates.
    rays_by_px : (2, 2, h, w) ndarray
        Their derivatives with the pixel's x and y.
    xi : (2, h, w) ndarray
    rho : (h, w) ndarray
    distance : (h, w) ndarray
        To `rho = 1`, to second order, px.
    curving, bend : (h, w) ndarray
        Second derivatives of (rho^2 - 1) / 2 along and across its contour, 1/px^2.
    """

    rays: Array
    rays_by_px: Array
    xi: Array
    rho: Array
    distance: Array
    curving: Array
    bend: Array


def spot_patch(view: View, rng: np.random.Generator) -> Patch:
    """Return the noise-free light of the spot, as a share of the beam's height.

    Parameters
    ----------
    view : View
    rng : Generator
        For the random part of an uneven plateau.

    Raises
    ------
    InputError
        If a ring's line or the whole spot is too thin to be sampled, or the lens cannot be inverted round the spot.
    """
    scene = view.scene
    beam, radius = scene.beam, scene.rig.require_beam().radius
    inner, outer = reach(beam, radius)
    sampling = _sampling(view)
    left, top, right, bottom = _box(view, outer, sampling.margin)
    pixels = _survey(
        view, left - sampling.margin, top - sampling.margin, right + sampling.margin, bottom + sampling.margin
    )
    # Far outside there is no light; clipping keeps waves and polynomials of what lies behind the horizon finite.
    across, down = np.clip(pixels.xi, -2 * outer, 2 * outer)
    uneven = unevenness(beam, across, down, rng)
    active = _active(pixels, 0.0 if beam.fringes > 0 else inner, outer)
    flat = (pixels.rho < 1) & (beam.kind != "ring") & ~active
    values = np.where(flat, plateau(beam, radius, across, down, uneven), 0.0)
    fine = _fine_values(view, pixels, uneven, active, sampling)
    light = _sum(values, active, fine, sampling)
    return Patch(left, top, light)


def _sampling(view: View) -> Sampling:
    """Choose how finely to sample a scene.

    Raises
    ------
    InputError
        If a ring's line or the whole spot is too thin to be sampled.
    """
    scene = view.scene
    beam, blur = scene.beam, scene.optics.blur_px
    theta = np.linspace(0, math.tau, 360, endpoint=False)
    outline = view.outline(theta)
    width = _narrowest(view, outline, softness(beam, scene.rig.require_beam().radius))
    for factor in (1, 2, _COARSE, _FINE):
        if width * factor >= 2 * ENOUGH and blur * factor >= ENOUGH:
            return Sampling(factor, 0.0, blur)
    for factor in (_COARSE, _FINE):
        if width * factor >= ENOUGH:
            return Sampling(factor, 0.0, blur)
    if beam.kind == "ring":
        raise InputError(
            f"beam.line_mm: the ring's line is {width:.2g} px wide in the image where it is narrowest (standard "
            f"deviation); at least {ENOUGH / _FINE:.2g} px can be rendered"
        )
    sharpest = view.sharpest()
    if sharpest * ENOUGH > _FACTORS[-1]:
        raise InputError(
            f"plane: the spot is seen so much from the side that its image has tips of radius {1 / sharpest:.1g} px; "
            f"at least {ENOUGH / _FACTORS[-1]:.1g} px can be rendered"
        )
    finest = min(BEND / sharpest, blur / 2)
    factor = next((factor for factor in _FACTORS if ENOUGH / factor <= finest), _FACTORS[-1])
    closed = ENOUGH / factor
    return Sampling(factor, closed, math.sqrt(blur**2 - closed**2))


def _narrowest(view: View, outline: Array, width_mm: float) -> float:
    """Return the least width on the image, px, of something of this width across the beam's circle, mm."""
    if width_mm == 0:
        return 0.0
    normalised, jacobian = view.scene.rig.camera.normalise(outline)
    _, dx, dy = _slope(view, normalised.T, np.moveaxis(jacobian, 0, -1))
    return float(width_mm / view.scene.rig.require_beam().radius / np.hypot(dx, dy).max())


def _box(view: View, outer: float, margin: int) -> tuple[int, int, int, int]:
    """Return the part of the image that the light can reach: first column and row, and the ones after the last."""
    width, height = view.scene.rig.camera.image_size
    theta = np.linspace(0, math.tau, 180, endpoint=False)
    depth = view.centre[2] - outer * math.hypot(view.cosine_axis[2], view.sine_axis[2])
    # Where the outermost light comes near the camera's own plane its outline says nothing.
    if depth < 0.05 * view.centre[2]:
        return 0, 0, width, height
    outline = view.outline(theta, outer)
    pad = margin + 3
    low, high = np.floor(outline.min(axis=0)) - pad, np.ceil(outline.max(axis=0)) + pad + 1
    left, top = np.clip(low, 0, [width, height])
    right, bottom = np.clip(high, 0, [width, height])
    return int(left), int(top), int(right), int(bottom)


def _survey(view: View, left: int, top: int, right: int, bottom: int) -> _Pixels:
    """Look at all pixels of a box: where they lie in the cross-section, and how the outline runs past them."""
    y, x = np.mgrid[top:bottom, left:right].astype(np.float64)
    normalised, jacobian = view.scene.rig.camera.normalise(np.stack([x, y], axis=-1))
    rays = np.ascontiguousarray(np.moveaxis(normalised, -1, 0))
    by_px = np.ascontiguousarray(np.moveaxis(jacobian, (-2, -1), (0, 1)))
    xi = np.stack(view.xi(*rays)[:2])
    level, dx, dy = _slope(view, rays, by_px)
    steepness = np.maximum(np.hypot(dx, dy), 1e-12)
    nx, ny = dx / steepness, dy / steepness
    # Second derivatives of what is nearly quadratic: differences from pixel to pixel will do.
    xx, xy, yy = np.gradient(dx, axis=1), np.gradient(dx, axis=0), np.gradient(dy, axis=0)
    bend = nx * nx * xx + 2 * nx * ny * xy + ny * ny * yy
    curving = ny * ny * xx - 2 * nx * ny * xy + nx * nx * yy
    return _Pixels(rays, by_px, xi, np.hypot(*xi), edge_distance(level, steepness, bend), curving, bend)


def _slope(view: View, rays: Array, by_px: Array) -> tuple[Array, Array, Array]:
    """Return the level and its derivatives with the pixel's x and y, of rays (2, ...) that change by (2, 2, ...)."""
    level, by_x, by_y = view.level(rays[0], rays[1])
    return level, by_x * by_px[0, 0] + by_y * by_px[1, 0], by_x * by_px[0, 1] + by_y * by_px[1, 1]


def _active(pixels: _Pixels, inner: float, outer: float) -> Mask:
    """Return which pixels need samples of their own: those where the irradiance is not flat."""
    near = np.abs(pixels.distance) < _NEAR_PX
    return (near | ((pixels.rho > inner) & (pixels.rho < outer))) & (pixels.rho < FAR)


def _fine_values(view: View, pixels: _Pixels, uneven: Array, active: Mask, sampling: Sampling) -> Array:
    """Return the light at the samples (n, s, s) of the active pixels: rows, then columns."""
    scene = view.scene
    beam, radius = scene.beam, scene.rig.require_beam().radius
    x, y = (part.ravel() for part in np.meshgrid(sampling.offsets, sampling.offsets))
    by_px = pixels.rays_by_px[:, :, active]
    # The lens is smooth: to second order over half a pixel it is exact to 1e-9 px. The homography is not expanded.
    by_x, by_y = (np.gradient(pixels.rays_by_px, axis=axis)[:, :, active] for axis in (3, 2))
    changes = np.concatenate([by_px, by_x[:, :1], by_x[:, 1:] + by_y[:, :1], by_y[:, 1:]], axis=1)
    terms = np.stack([x, y, x * x / 2, x * y / 2, y * y / 2])
    rays = pixels.rays[:, active, None] + np.swapaxes(changes, 1, 2) @ terms
    if sampling.closed == 0:
        first, second, _ = view.xi(rays[0], rays[1])
        edge = irradiance(beam, radius, first, second)
    else:
        edge = _smoothed_edge(view, pixels, active, rays, sampling.closed)
    if not is_even(beam):
        # The random part is smooth: linear within a pixel will do.
        down, right = (np.gradient(uneven, axis=axis)[active, None] for axis in (0, 1))
        edge *= plateau(beam, radius, *view.xi(rays[0], rays[1])[:2], uneven[active, None] + right * x + down * y)
    return edge.reshape(-1, sampling.factor, sampling.factor)


def _smoothed_edge(view: View, pixels: _Pixels, active: Mask, rays: Array, blur: float) -> Array:
    """Return a disc at samples (2, n, s * s) of the active pixels, smoothed by a Gaussian of this width, px."""
    scene = view.scene
    level, dx, dy = _slope(view, rays, pixels.rays_by_px[:, :, active, None])
    steepness = np.maximum(np.hypot(dx, dy), 1e-12)
    soft = scene.beam.edge_mm / scene.rig.require_beam().radius / steepness
    distance = edge_distance(level, steepness, pixels.bend[active, None])
    return smoothed_disc(distance, pixels.curving[active, None] / steepness, soft, scene.beam.level, blur)


def _sum(values: Array, active: Mask, fine: Array, sampling: Sampling) -> Array:
    """Return the light of the pixels inside the margin: the kernel's sum over all samples."""
    s = sampling.factor
    height, width = values.shape
    across = kernel(width, sampling)
    columns = np.empty((height * s, width - 2 * sampling.margin))
    last = 0
    strip = max(1, _SAMPLES // (width * s * s))
    for top in range(0, height, strip):
        rows = slice(top, min(top + strip, height))
        samples = np.repeat(np.repeat(values[rows, None, :, None], s, axis=1), s, axis=3)
        here = active[rows]
        count = int(np.count_nonzero(here))
        row, column = np.nonzero(here)
        samples[row, :, column, :] = fine[last : last + count]
        last += count
        columns[rows.start * s : rows.stop * s] = (across @ samples.reshape(-1, width * s).T).T
    return np.asarray(kernel(height, sampling) @ columns)
