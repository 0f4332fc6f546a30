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
_FILLED = 0.8  # of the directions
_LEAST_HOLE = 0.35  # of the ellipse
_SUDDEN = 0.2  # of the ellipse: within that the hole has to end in nearly all directions


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
    """

    outline: Outline
    kind: Kind
    high: float
    low: float
    line_width: float


def look_at(levels: list[Level], ellipse: Ellipses) -> Look:
    """Look at one ellipse, an array of one, that runs along the outer edge of a spot."""
    size = float(ellipse.size[0])
    index = next((i for i, level in enumerate(levels) if size / level.factor <= _FINE), len(levels) - 1)
    rho, grey = _profiles(levels[index], ellipse)
    shown = _shown(rho, grey)
    middle = np.median(grey[:, shown], axis=1)
    outside = float(middle[rho > 1.0].min())
    line = float(middle[(rho > 0.6) & (rho < 1.15)].max())
    if not _is_hollow(rho, grey[:, shown] > (line + outside) / 2):
        inside = float(np.median(middle[(rho > 0.5) & (rho < 0.85)]))
        return Look(ellipse.outline(0), "disc", inside, outside, 0.0)
    inside = float(np.median(middle[rho < 0.4]))
    line_at = rho[middle.argmax()]
    ring = Ellipses(ellipse.centre, ellipse.shape * line_at)
    width = _half_width(rho, middle, max(inside, outside)) * size
    for level in (levels[index], levels[0]) if index else (levels[0],):
        for _ in range(2):
            ring, width = _onto_line(level, ring, width + level.factor)
    return Look(ring.outline(0), "ring", line, max(inside, outside), width)


def _profiles(level: Level, ellipse: Ellipses) -> tuple[Array, Array]:
    """Return radii (M,), 1 on the ellipse, and the grey values (M, N) at each, for those directions that are seen."""
    size = float(ellipse.size[0]) / level.factor
    rho = np.linspace(0.1, _FURTHEST, int(np.clip(1.5 * size, 31, 160)))
    points, _, _ = ellipse.at(_ANGLES)
    ray = points[0] - ellipse.centre[0]
    grey, there = level.sample(ellipse.centre[0] + rho[:, None, None] * ray)
    grey = grey - _slope(rho[:, None, None] * ray, grey, there & (rho > _CLEAR)[:, None])
    whole = there[rho < _SEEN].all(axis=0)
    return rho, grey[:, whole] if whole.sum() > _ANGLES // 4 else grey


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


def _is_hollow(rho: Array, bright: NDArray[np.bool_]) -> bool:
    """Return whether the inside is dark up to the same radius in all directions.

    A bar across a disc darkens its middle as well, but not as far in one direction as in another.
    """
    share = bright[rho < 1].mean(axis=1)
    filled = np.flatnonzero(share > _FILLED)
    hollow = np.flatnonzero(share < 1 - _FILLED)
    if not filled.size or not hollow.size:
        return False
    hole = hollow[hollow < filled[-1]]
    if not hole.size:
        return False
    first = filled[filled > hole[-1]][0]
    return bool(rho[hole[-1]] > _LEAST_HOLE and rho[first] - rho[hole[-1]] < _SUDDEN)


def _half_width(rho: Array, grey: Array, base: float) -> float:
    """Return the width of the highest part of a profile, at half its height over a base."""
    top = int(grey.argmax())
    low = np.flatnonzero(grey < (grey[top] + base) / 2)
    before, after = low[low < top], low[low > top]
    start = rho[before[-1]] if before.size else rho[0]
    end = rho[after[0]] if after.size else rho[-1]
    return float(end - start)


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
