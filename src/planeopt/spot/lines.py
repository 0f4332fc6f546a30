"""Disc or ring: what is inside of an ellipse, and the line of a ring."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.ellipses import Ellipses
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind
from planeopt.spot.pyramid import Level
from planeopt.spot.trace import adjusted

Array = NDArray[np.floating]

_FINE = 56.0  # px: what is larger is looked at on a coarser level
_ANGLES = 48
_FURTHEST = 1.6  # times the ellipse
_SEEN = 1.3  # times the ellipse: a direction counts that is seen so far
_CLEAR = 1.15  # times the ellipse: from there on there are only surroundings
_HOLLOW = 0.65  # of the directions
_EVEN = 0.25, 0.1  # of the width of the line, and of the ellipse: what half of the directions may differ by
_BARS = 24  # directions of a bar that are tried
_THIN = 0.25  # of the ellipse: a line that is so wide may be what a bar leaves of a disc
_DIP = 0.25  # of the height: what is not darker inside is no ring


@dataclass(frozen=True, slots=True)
class Look:
    """What a closer look at one ellipse shows.

    Parameters
    ----------
    outline : Outline
        Of a disc the ellipse, of a ring the middle of its line.
    kind : {"disc", "ring"}
    high, low : float
        Grey values of the plateau (the line) and of the surroundings (of a ring: of the brighter side).
    line_width : float
        Of a ring, at half its height, px.
    uneven : float
        By how much the plateau (the line) differs from place to place, over the height.
    """

    outline: Outline
    kind: Kind
    high: float
    low: float
    line_width: float
    uneven: float


def look_at(levels: list[Level], ellipse: Ellipses, told: Kind | None = None) -> Look:
    """Look at one ellipse, an array of one, that runs along the outer edge of a spot.

    Where it is told what the spot is, the image has to contradict that clearly to be believed.
    """
    size = float(ellipse.size[0])
    index = next((i for i, level in enumerate(levels) if size / level.factor <= _FINE), len(levels) - 1)
    rho, ray, grey = _profiles(levels[index], ellipse)
    shown = _shown(rho, grey)
    middle = np.median(grey[:, shown], axis=1)
    outside = float(middle[rho > 1.0].min())
    line = float(middle[(rho > 0.6) & (rho < _CLEAR)].max())
    start, end = _highest(rho, middle, outside)
    hole = float(middle[rho < (start + end) / 2].min(initial=line))
    if told == "ring":
        is_ring = line - hole > _DIP * (line - outside)
    else:
        ring, width = _line_of(rho, ray[shown], grey[:, shown] > (line + outside) / 2, levels[index].factor)
        is_ring = ring and (told is None or width < _THIN)
    if not is_ring:
        inside = float(np.median(middle[(rho > 0.5) & (rho < 0.85)]))
        uneven = _spread(grey[(rho > 0.7) & (rho < 0.9)][:, shown]) / max(inside - outside, 1e-9)
        return Look(ellipse.outline(0), "disc", inside, outside, 0.0, uneven)
    base = max(hole, outside)
    start, end = _highest(rho, middle, base)
    uneven = _spread(grey[(rho > start) & (rho < end)].max(axis=0, initial=line)[shown]) / max(line - base, 1e-9)
    ring, width = Ellipses(ellipse.centre, ellipse.shape * (start + end) / 2), (end - start) * size
    for level in (levels[index], levels[0]) if index else (levels[0],):
        for _ in range(2):
            ring, width = _onto_line(level, ring, width + level.factor)
    return Look(ring.outline(0), "ring", line, base, width, uneven)


def _spread(grey: Array) -> float:
    """Return how far apart the greater part of grey values is; what is dark may be an obstacle."""
    low, high = np.quantile(grey, [0.4, 0.9])
    return float(high - low)


def _profiles(level: Level, ellipse: Ellipses) -> tuple[Array, Array, Array]:
    """Return radii (M,), 1 on the ellipse, its points (N, 2) about its centre in the directions that are seen, px.

    And the grey values (M, N) at each radius in each of those directions.
    """
    size = float(ellipse.size[0]) / level.factor
    rho = np.linspace(0.1, _FURTHEST, int(np.clip(1.5 * size, 31, 160)))
    points, _, _ = ellipse.at(_ANGLES)
    ray = points[0] - ellipse.centre[0]
    grey, there = level.sample(ellipse.centre[0] + rho[:, None, None] * ray)
    grey = grey - _slope(rho[:, None, None] * ray, grey, there & (rho > _CLEAR)[:, None])
    whole = there[rho < _SEEN].all(axis=0)
    return (rho, ray[whole], grey[:, whole]) if whole.sum() > _ANGLES // 4 else (rho, ray, grey)


def _slope(offsets: Array, grey: Array, use: NDArray[np.bool_]) -> Array:
    """Return what a plane through the surroundings adds to each place (M, N), 0 in the middle of the ellipse.

    Across a large faint spot the background can change by more than the spot is bright.
    """
    if use.sum() < _ANGLES:
        return np.zeros_like(grey)
    design = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets], axis=2)
    plane = np.zeros(3)
    good = use
    for _ in range(3):
        plane = np.linalg.lstsq(design[good], grey[good], rcond=None)[0]
        residual = np.abs(grey - design @ plane)
        good = use & (residual <= 3.0 * np.median(residual[good]) + 1e-9)
        if good.sum() < _ANGLES // 2:
            break
    return offsets @ plane[1:]


def _shown(rho: Array, grey: Array) -> NDArray[np.bool_]:
    """Return in which directions (N,) there is a fall from the ellipse outwards that is about as high as elsewhere."""
    fall = grey[(rho > 0.75) & (rho < 1.02)].max(axis=0) - grey[(rho > 1.02) & (rho < _SEEN)].min(axis=0)
    return fall >= np.minimum(0.5 * np.quantile(fall, 0.7), np.median(fall))


def _line_of(rho: Array, ray: Array, bright: NDArray[np.bool_], pixel: float) -> tuple[bool, float]:
    """Return whether what is bright (M, N) along the ellipse is a line of even width, and how wide, of its size.

    Going inwards it gets dark after the same way in all directions. A bar across a disc darkens its middle as well, but
    the dark ends at two straight lines.
    """
    steps = np.arange(len(rho))[:, None]
    edge = np.where(bright & (rho < _CLEAR)[:, None], steps, -1).max(axis=0)
    inner = np.where(~bright & (steps < edge), steps, -1).max(axis=0)
    hollow = inner >= 0
    if hollow.mean() < _HOLLOW:
        return False, 1.0
    ray, ends = ray[hollow], rho[inner[hollow]]
    # The way along the normal: less than that along the ray where the ellipse is flat.
    along = np.roll(ray, -1, axis=0) - np.roll(ray, 1, axis=0)
    across = np.abs(ray[:, 0] * along[:, 1] - ray[:, 1] * along[:, 0]) / np.maximum(np.hypot(*along.T), 1e-9)
    widths = (rho[edge[hollow]] - ends) * across
    width, size = float(np.median(widths)), float(np.median(np.hypot(*ray.T)))
    uneven = float(np.median(np.abs(widths - width)))
    is_even = uneven < _EVEN[0] * width + 0.5 * pixel and uneven < _EVEN[1] * size + 0.5 * pixel
    return is_even and uneven < 2 * _off_bar(ray * ends[:, None]) + 0.25 * pixel, width / size


def _off_bar(places: Array) -> float:
    """Return by how much places (N, 2) about a centre are typically off the sides of a bar, of the best one."""
    turn = np.pi * np.arange(_BARS) / _BARS
    across = places @ np.stack([np.cos(turn), np.sin(turn)])
    off = np.zeros_like(across)
    for side in (across > 0, across <= 0):
        value = np.where(side, across, np.nan)
        count = side.sum(axis=0)
        middle = np.where(count > 0, np.nansum(value, axis=0) / np.maximum(count, 1), 0)
        off = np.where(side, np.abs(across - middle), off)
    return float(np.median(off, axis=0).min())


def _highest(rho: Array, grey: Array, base: float) -> tuple[float, float]:
    """Return where the highest part of a profile starts and ends, at half its height over a base."""
    inner = rho < _CLEAR
    top = int(np.where(inner & (rho > 0.5), grey, -np.inf).argmax())
    low = np.flatnonzero(grey < (grey[top] + base) / 2)
    before, after = low[low < top], low[low > top]
    start = rho[before[-1]] if before.size else rho[0]
    end = rho[after[0]] if after.size else rho[-1]
    return float(start), float(end)


def _onto_line(level: Level, ellipse: Ellipses, width: float) -> tuple[Ellipses, float]:
    """Return the ellipse moved to the middle of the line within about its width, and that width."""
    points, normals, share = ellipse.at(_ANGLES)
    reach = min(width + 1.5 * level.factor, 0.7 * float(ellipse.semi_axes[0, 1]))
    t = np.linspace(-reach, reach, 25)
    grey, there = level.sample(points[:, :, None] + t[:, None] * normals[:, :, None])
    ends = np.stack([grey[..., :3].mean(axis=2), grey[..., -3:].mean(axis=2)])
    height = grey - ends.max(axis=0)[..., None]
    top = height.max(axis=2)
    above = np.maximum(height - 0.5 * top[..., None], 0)
    total = above.sum(axis=2)
    seen = there.all(axis=2) & (total > 0)
    offset = (above @ t) / np.where(total > 0, total, 1)
    typical = max(float(np.median(top)), 1e-9)
    weight = share * seen * (top > 0.4 * typical)
    found = float(np.median((above > 0).sum(axis=2)) * (t[1] - t[0]))
    return adjusted(ellipse, points, normals, offset, weight, level.factor), found
