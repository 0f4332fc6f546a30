"""The spot's light on the sensor: the exact outline, blurred by the lens and averaged over the pixels.

The image is the irradiance convolved with the lens's Gaussian and with the pixel's square, at the pixels' centres. The
Gaussian is split in two: sigma^2 = sigma_1^2 + sigma_2^2. The edge is smoothed by sigma_1 in closed form where it is
sampled, s x s times a pixel; that leaves nothing that s samples a pixel could not hold, and the rest of the kernel
(Gaussian sigma_2 and square) is a separable sum over the samples.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.special import ndtr

from planeopt.errors import InputError
from planeopt.simulation.geometry import FAR, View
from planeopt.simulation.profiles import irradiance, plateau, reach

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Smoothing in samples at which what lies beyond the sampling limit is below 3e-4 of the edge's own spectrum there.
_ENOUGH = 0.65
_TAIL = 5.5
_FINE, _COARSE = 8, 4
_SMALL_PX = 25.0
_ROWS = 64


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


@dataclass(frozen=True)
class _Sampling:
    """How finely to sample: s a pixel and axis, and the two parts of the blur, px."""

    factor: int
    closed: float
    summed: float

    @property
    def offsets(self) -> Array:
        """Places of the samples in a pixel (s,), px from its centre."""
        return (np.arange(self.factor) + 0.5) / self.factor - 0.5

    @property
    def margin(self) -> int:
        """How many pixels away the kernel still takes light from."""
        return math.ceil(_TAIL * self.summed + 0.5)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """What is known at the centres of a box of pixels, each (h, w, ...)."""

    left: int
    top: int
    normalised: Array
    normalised_jacobian: Array
    xi: Array
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
        If a ring's line or a disc's blur is too thin to be sampled, or the lens cannot be inverted round the spot.
    """
    scene = view.scene
    beam, radius = scene.beam, scene.rig.require_beam().radius
    inner, outer = reach(beam, radius)
    sampling = _sampling(view)
    left, top, right, bottom = _box(view, outer, sampling.margin)
    pixels = _survey(
        view, left - sampling.margin, top - sampling.margin, right + sampling.margin, bottom + sampling.margin
    )
    level = plateau(beam, radius, np.clip(pixels.xi, -2 * outer, 2 * outer), rng)
    rho = np.hypot(pixels.xi[..., 0], pixels.xi[..., 1])
    inside = (rho < 1) & (beam.kind != "ring")
    active = _active(pixels, rho, inner, outer)
    values = np.where(inside & ~active, level, 0.0)
    fine = _fine_values(view, pixels, level, active, sampling)
    light = _sum(values, active, fine, sampling)
    return Patch(left, top, light)


def _sampling(view: View) -> _Sampling:
    """Choose how finely to sample a scene."""
    scene = view.scene
    beam, blur = scene.beam, scene.optics.blur_px
    theta = np.linspace(0, math.tau, 360, endpoint=False)
    outline = view.outline(theta)
    size = float(np.min(np.linalg.norm(outline - outline.mean(axis=0), axis=1)))
    factor = _FINE if size < _SMALL_PX or blur < 0.4 else _COARSE
    width = _narrowest(view, outline, {"ring": beam.line_mm, "disc": beam.edge_mm}.get(beam.kind, math.inf))
    if beam.kind == "ring" and width * factor < _ENOUGH:
        factor = _FINE
        if width * factor < _ENOUGH:
            raise InputError(
                f"beam.line_mm: the ring's line is {width:.2g} px wide in the image where it is narrowest (standard "
                f"deviation); at least {_ENOUGH / factor:.2g} px can be rendered"
            )
    closed = _ENOUGH / factor if width * factor < _ENOUGH else 0.0
    return _Sampling(factor, closed, math.sqrt(blur**2 - closed**2))


def _narrowest(view: View, outline: Array, width_mm: float) -> float:
    """Return the least width on the image, px, of something of this width across the beam's circle, mm."""
    if not 0 < width_mm < math.inf:
        return width_mm
    normalised, jacobian = view.scene.rig.camera.normalise(outline)
    xi, outer = view.xi(normalised)
    slope = np.linalg.norm(np.einsum("ni,nij,njk->nk", xi, outer, jacobian), axis=1)
    return float(width_mm / view.scene.rig.require_beam().radius / slope.max())


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
    xi, outer = view.xi(normalised)
    rho, slope = _slope(xi, outer, jacobian)
    steepness = np.linalg.norm(slope, axis=-1)
    safe = np.maximum(steepness, 1e-12)
    nx, ny = slope[..., 0] / safe, slope[..., 1] / safe
    # Second derivatives of rho serve small corrections only: differences from pixel to pixel will do.
    xx = np.gradient(slope[..., 0], axis=1)
    xy = np.gradient(slope[..., 0], axis=0)
    yy = np.gradient(slope[..., 1], axis=0)
    along = nx * nx * xx + 2 * nx * ny * xy + ny * ny * yy
    across = ny * ny * xx - 2 * nx * ny * xy + nx * nx * yy
    return _Pixels(left, top, normalised, jacobian, xi, (rho - 1) / safe, across / safe, along / safe)


def _slope(xi: Array, outer: Array, inner: Array) -> tuple[Array, Array]:
    """Return rho (...) and its gradient (..., 2) per px."""
    rho = np.hypot(xi[..., 0], xi[..., 1])
    direction = xi / np.maximum(rho, 1e-12)[..., None]
    return rho, np.einsum("...i,...ij,...jk->...k", direction, outer, inner)


def _active(pixels: _Pixels, rho: Array, inner: float, outer: float) -> Mask:
    """Return which pixels need samples of their own: those where the irradiance is not flat."""
    # The distance is of first order; pixels further than this from the edge are flat whatever its curvature.
    near = np.abs(pixels.distance) < 3.0
    smooth = (rho > inner) & (rho < outer) if outer > inner else np.zeros_like(near)
    return (near | smooth) & (rho < FAR)


def _fine_values(view: View, pixels: _Pixels, level: Array, active: Mask, sampling: _Sampling) -> Array:
    """Return the light at the samples (n, s, s) of the active pixels: rows, then columns."""
    scene = view.scene
    beam, radius = scene.beam, scene.rig.require_beam().radius
    step = sampling.offsets
    offset = np.stack(np.broadcast_arrays(step[None, :], step[:, None]), axis=-1)
    inner = pixels.normalised_jacobian[active]
    # The lens is smooth: to second order over half a pixel it is exact to 1e-9 px. The homography is not expanded.
    bent = _lens_bend(pixels)[active]
    normalised = (
        pixels.normalised[active][:, None, None, :]
        + np.einsum("nij,abj->nabi", inner, offset)
        + 0.5 * np.einsum("nijk,abj,abk->nabi", bent, offset, offset)
    )
    xi, outer = view.xi(normalised)
    if sampling.closed == 0:
        edge = irradiance(beam, radius, xi)
    else:
        rho, slope = _slope(xi, outer, inner[:, None, None])
        steepness = np.linalg.norm(slope, axis=-1)
        distance = (rho - 1) / steepness
        bend, curving = (part[active][:, None, None] for part in (pixels.bend, pixels.curving))
        distance = distance + 0.5 * bend * distance**2
        soft = beam.edge_mm / radius / steepness
        # A blurred convex edge draws back by half its curvature times the blur squared.
        moved = distance + 0.5 * curving * sampling.closed**2
        edge = ndtr(-moved / np.sqrt(soft**2 + sampling.closed**2))
    down, right = (np.gradient(level, axis=axis)[active][:, None, None] for axis in (0, 1))
    local = level[active][:, None, None] + right * offset[..., 0] + down * offset[..., 1]
    return edge * np.maximum(local, 0.0)


def _lens_bend(pixels: _Pixels) -> Array:
    """Return d^2 normalised_i / d px_j d px_k (h, w, 2, 2, 2)."""
    return np.stack([np.gradient(pixels.normalised_jacobian, axis=axis) for axis in (1, 0)], axis=-1)


def _sum(values: Array, active: Mask, fine: Array, sampling: _Sampling) -> Array:
    """Return the light of the pixels inside the margin: the kernel's sum over all samples."""
    s = sampling.factor
    height, width = values.shape
    across = _kernel(width, sampling)
    columns = np.empty((height * s, width - 2 * sampling.margin))
    last = 0
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        samples = np.repeat(np.repeat(values[rows, None, :, None], s, axis=1), s, axis=3)
        here = active[rows]
        count = int(np.count_nonzero(here))
        row, column = np.nonzero(here)
        samples[row, :, column, :] = fine[last : last + count]
        last += count
        columns[rows.start * s : rows.stop * s] = (across @ samples.reshape(-1, width * s).T).T
    return np.asarray(_kernel(height, sampling) @ columns)


def _kernel(count: int, sampling: _Sampling) -> scipy.sparse.csr_array:
    """Return the matrix that takes samples (count s,) of a line to its pixels (count - 2 margin,)."""
    s, margin = sampling.factor, sampling.margin
    place = (np.arange((2 * margin + 1) * s) + 0.5) / s - 0.5 - margin
    weight = ndtr((place + 0.5) / sampling.summed) - ndtr((place - 0.5) / sampling.summed)
    weight /= weight.sum()
    pixels = count - 2 * margin
    column = np.arange(pixels)[:, None] * s + np.arange(len(place))
    start = np.arange(pixels + 1) * len(place)
    return scipy.sparse.csr_array((np.tile(weight, pixels), column.ravel(), start), shape=(pixels, count * s))
