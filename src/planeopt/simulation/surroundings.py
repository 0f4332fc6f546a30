"""What else is in the image: background, texture, speckle, halo, clutter, obstacles."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from planeopt.errors import InputError
from planeopt.rig import Camera
from planeopt.simulation.geometry import View, arc_points, view_distances
from planeopt.simulation.tables import Clutter, Occlusion

Array = NDArray[np.float64]

# Independent patterns that are summed at most: beyond, a steady share takes the place of more.
_PATTERNS = 16
_PIXEL_VARIANCE = 1 / 12
_TRIES = 2000
# Standard deviations from an edge at which its light is flat to 1e-15.
_TAIL = 8.0


def background(view: View) -> Array:
    """Return the background without texture (H, W), share of full scale; not negative."""
    width, height = view.scene.rig.camera.image_size
    surface = view.scene.surface
    x = (np.arange(width) - (width - 1) / 2) / width
    y = (np.arange(height) - (height - 1) / 2) / height
    return np.maximum(surface.background + surface.gradient[0] * x + surface.gradient[1] * y[:, None], 0.0)


def falloff(camera: Camera, lost: float) -> Array:
    """Return the share (H, W) of the light that a lens lets through that loses so much in the furthest corner."""
    width, height = camera.image_size
    x, y = np.arange(width) - camera.cx, np.arange(height) - camera.cy
    squares = x**2 + (y**2)[:, None]
    return 1 - lost * squares / squares.max()


def smooth_field(shape: tuple[int, int], width: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return normal random numbers of unit variance, filtered by a Gaussian of this standard deviation, px."""
    if width == 0:
        return rng.standard_normal(shape, dtype=np.float32)
    half = math.ceil(4 * width)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
    kernel /= np.sqrt(np.sum(kernel**2))
    noise = rng.standard_normal((shape[0] + 2 * half, shape[1] + 2 * half), dtype=np.float32)
    filtered = np.asarray(cv2.sepFilter2D(noise, cv2.CV_32F, kernel, kernel), dtype=np.float32)
    return filtered[half : half + shape[0], half : half + shape[1]]


def speckle(shape: tuple[int, int], contrast: float, grain: float, rng: np.random.Generator) -> Array:
    """Return the relative intensity of speckle: mean 1, standard deviation `contrast`.

    The mean of n independent intensities |E|^2, of circular complex Gaussian fields E (so gamma distributed with shape
    n), with n the most whose contrast 1 / sqrt(n) is not below the one asked for, 16 at most; a steady share makes up
    the difference. Filtering E by a Gaussian of standard deviation `grain` gives the intensity an autocovariance
    exp(-d^2 / (2 grain^2)).

    Parameters
    ----------
    shape : (int, int)
    contrast : float
        0 to 1.
    grain : float
        px.
    """
    count = max(1, min(_PATTERNS, math.floor(contrast**-2 + 1e-9)))
    total = np.zeros(shape)
    for _ in range(2 * count):
        total += smooth_field(shape, grain, rng) ** 2
    varying = contrast * math.sqrt(count)
    return 1 - varying + varying * total / (2 * count)


def texture(view: View, rng: np.random.Generator) -> Array | float:
    """Return the relative reflectance (H, W), not negative."""
    surface = view.scene.surface
    if surface.texture == 0:
        return 1.0
    width, height = view.scene.rig.camera.image_size
    # The autocorrelation of filtered noise is wider than the filter by the square root of 2.
    field = smooth_field((height, width), surface.texture_px / math.sqrt(2), rng)
    return np.maximum(1 + surface.texture * field.astype(np.float64), 0.0)


def halo(light: Array, width: float) -> Array:
    """Return the light blurred by a Gaussian of this standard deviation, px, sampled as coarsely as that allows."""
    height, across = light.shape
    factor = max(1, int(width // 4))
    small: tuple[int, int] = (max(1, round(across / factor)), max(1, round(height / factor)))
    coarse = cv2.resize(light, small, interpolation=cv2.INTER_AREA) if factor > 1 else light
    blurred = cv2.GaussianBlur(
        coarse, (0, 0), width * small[0] / across, sigmaY=width * small[1] / height, borderType=cv2.BORDER_CONSTANT
    )
    full = cv2.resize(blurred, (across, height), interpolation=cv2.INTER_LINEAR) if factor > 1 else blurred
    return np.asarray(full, dtype=np.float64)


def occlusion(view: View, obstacle: Occlusion, rng: np.random.Generator) -> Array:
    """Return how much of each pixel (H, W) an obstacle hides, 0 to 1.

    Parameters
    ----------
    view : View
    obstacle : Occlusion
    rng : Generator
        For a direction that is not given.
    """
    width, height = view.scene.rig.camera.image_size
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    blur = view.scene.optics.blur_px if obstacle.blur_px is None else obstacle.blur_px
    depth = _depth(view, obstacle, np.stack([x, y], axis=-1), rng) / math.hypot(blur, math.sqrt(_PIXEL_VARIANCE))
    cover = (depth < 0).astype(np.float64)
    edge = np.abs(depth) < _TAIL
    cover[edge] = ndtr(-depth[edge])
    return cover


def hidden(view: View, obstacle: Occlusion, points: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which points (N, 2), raw px, an obstacle hides; `rng` in the state that it had for `occlusion`."""
    return _depth(view, obstacle, points, rng) < 0


def _depth(view: View, obstacle: Occlusion, px: Array, rng: np.random.Generator) -> Array:
    """Return signed distances (...) of pixels (..., 2) from the obstacle's edge, px, negative behind it."""
    drawn = float(rng.uniform(0, 360))
    angle = math.radians(drawn if obstacle.direction_deg is None else obstacle.direction_deg)
    if obstacle.shape == "polygon":
        return _polygon_distance(np.array(obstacle.points_px), px)
    boundary = arc_points(view)
    middle = boundary.mean(axis=0)
    direction = np.array([math.cos(angle), math.sin(angle)])
    offset = obstacle.offset_px or 0.0

    def measure(points: Array) -> Array:
        """What is below some level is hidden."""
        if obstacle.shape == "half_plane":
            return -((points - middle) @ direction)
        if obstacle.shape == "bar":
            return np.abs((points - middle) @ direction - offset)
        at = obstacle.centre_px
        centre = boundary[int(np.argmax((boundary - middle) @ direction))] if at is None else np.array(at)
        return np.linalg.norm(points - centre, axis=-1)

    return measure(px) - _level(view, obstacle, measure(boundary), boundary)


def _level(view: View, obstacle: Occlusion, measured: Array, boundary: Array) -> float:
    if obstacle.share is not None:
        seen = measured[view.in_image(boundary)]
        return float(np.quantile(seen, obstacle.share))
    if obstacle.shape == "half_plane":
        return -(obstacle.offset_px or 0.0)
    size = obstacle.size_px or 0.0
    return size / 2 if obstacle.shape == "bar" else size


def _polygon_distance(corners: Array, px: Array) -> Array:
    flat = px.reshape(-1, 2)
    best = np.full(len(flat), np.inf)
    crossed = np.zeros(len(flat), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = b - a
        share = np.clip((flat - a) @ edge / max(float(edge @ edge), 1e-300), 0, 1)
        best = np.minimum(best, np.linalg.norm(flat - a - share[:, None] * edge, axis=1))
        if a[1] != b[1]:
            between = (flat[:, 1] < a[1]) != (flat[:, 1] < b[1])
            crossed ^= between & (flat[:, 0] < a[0] + (flat[:, 1] - a[1]) * (edge[0] / edge[1]))
    return np.where(crossed, -best, best).reshape(px.shape[:-1])


def clutter(view: View, rng: np.random.Generator) -> Array | float:
    """Return the light (H, W) of other things in view, share of full scale.

    Raises
    ------
    InputError
        If there is no room for them at the distance asked for.
    """
    table = view.scene.clutter
    if table.count == 0:
        return 0.0
    width, height = view.scene.rig.camera.image_size
    total = np.zeros((height, width))
    blur = math.hypot(view.scene.optics.blur_px, math.sqrt(_PIXEL_VARIANCE))
    for number in range(table.count):
        kind = table.kinds[number % len(table.kinds)]
        bright = rng.uniform(*table.height_range)
        size = rng.uniform(*table.size_range_px)
        angle, ratio = rng.uniform(0, math.pi), rng.uniform(0.2, 1.0)
        extent = 3 * size if kind == "blob" else size * 1.5
        centre = _free_place(view, table, extent + 3 * blur, rng)
        reach = extent + 6 * blur
        rows = slice(max(0, math.floor(centre[1] - reach)), max(0, math.ceil(centre[1] + reach) + 1))
        columns = slice(max(0, math.floor(centre[0] - reach)), max(0, math.ceil(centre[0] + reach) + 1))
        part = total[rows, columns]
        y, x = np.mgrid[rows.start : rows.start + part.shape[0], columns.start : columns.start + part.shape[1]]
        part += bright * _item(kind, x - centre[0], y - centre[1], size, angle, ratio, blur)
    return total


def _free_place(view: View, table: Clutter, extent: float, rng: np.random.Generator) -> Array:
    """Draw a centre whose item of this extent keeps away from the spot."""
    width, height = view.scene.rig.camera.image_size
    places = rng.uniform(0, 1, (_TRIES, 2)) * [width - 1, height - 1]
    boundary = arc_points(view, 180)
    distance = view_distances(view, places[:64])
    free = np.flatnonzero(distance > extent + table.keep_away_px)
    if not free.size:
        distance = view_distances(view, places)
        free = np.flatnonzero(distance > extent + table.keep_away_px)
    if not free.size:
        raise InputError(
            f"clutter: there is no room for an item of {extent:.0f} px at {table.keep_away_px:.0f} px from a spot of "
            f"{np.ptp(boundary[:, 0]):.0f} x {np.ptp(boundary[:, 1]):.0f} px: lower size_range_px or keep_away_px"
        )
    return places[free[0]]


def _item(kind: str, x: Array, y: Array, size: float, angle: float, ratio: float, blur: float) -> Array:
    """Return the shape of one thing at offsets from its centre, 0 to 1."""
    u, v = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    if kind == "blob":
        return np.exp(-0.5 * ((u / size) ** 2 + (v / (size * ratio)) ** 2))
    if kind == "disc":
        return ndtr((size - np.hypot(u, v)) / blur)
    half = size * ratio
    if kind == "rectangle":
        sides = [ndtr((c + w) / blur) - ndtr((c - w) / blur) for c, w in ((u, size), (v, half))]
        return sides[0] * sides[1]
    return (ndtr((u + size) / blur) - ndtr((u - size) / blur)) * np.exp(-0.5 * (v / blur) ** 2)
