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
_RING = 0.5  # of the line's height: a darker inside is that of a ring


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
    rho, grey = _profile(levels[index], ellipse)
    inside = float(np.median(grey[(rho > 0.2) & (rho < 0.7)]))
    line = float(grey[(rho > 0.6) & (rho < 1.15)].max())
    outside = float(grey[rho > 1.0].min())
    if inside - outside > _RING * (line - outside):
        return Look(ellipse.outline(0), "disc", inside, outside, 0.0)
    line_at = rho[grey.argmax()]
    middle = Ellipses(ellipse.centre, ellipse.shape * line_at)
    width = _half_width(rho, grey, max(inside, outside)) * size
    for level in (levels[index], levels[0]) if index else (levels[0],):
        for _ in range(2):
            middle, width = _onto_line(level, middle, width + level.factor, outside)
    return Look(middle.outline(0), "ring", line, max(inside, outside), width)


def _profile(level: Level, ellipse: Ellipses) -> tuple[Array, Array]:
    """Return radii, 1 on the ellipse, and the median grey value round the ellipse at each, as far as it is seen."""
    size = float(ellipse.size[0]) / level.factor
    rho = np.linspace(0.1, _FURTHEST, int(np.clip(1.5 * size, 24, 160)))
    points, _, _ = ellipse.at(_ANGLES)
    ray = points[0] - ellipse.centre[0]
    grey, there = level.sample(ellipse.centre[0] + rho[:, None, None] * ray)
    enough = there.sum(axis=1) >= _ANGLES // 4
    return rho[enough], np.array([np.median(row[seen]) for row, seen in zip(grey[enough], there[enough], strict=True)])


def _half_width(rho: Array, grey: Array, base: float) -> float:
    """Return the width of the highest part of a profile, at half its height over a base."""
    top = int(grey.argmax())
    low = np.flatnonzero(grey < (grey[top] + base) / 2)
    before, after = low[low < top], low[low > top]
    start = rho[before[-1]] if before.size else rho[0]
    end = rho[after[0]] if after.size else rho[-1]
    return float(end - start)


def _onto_line(level: Level, ellipse: Ellipses, width: float, outside: float) -> tuple[Ellipses, float]:
    """Return the ellipse moved to the middle of the line within about its width, and that width."""
    points, normals, share = ellipse.at(_ANGLES)
    reach = min(width + 1.5 * level.factor, 0.7 * float(ellipse.semi_axes[0, 1]))
    t = np.linspace(-reach, reach, 25)
    grey, there = level.sample(points[:, :, None] + t[:, None] * normals[:, :, None])
    height = grey - max(outside, float(np.median(grey[..., 0])))
    top = height.max(axis=2)
    above = np.maximum(height - 0.5 * top[..., None], 0)
    total = above.sum(axis=2)
    seen = there.all(axis=2) & (total > 0)
    offset = (above @ t) / np.where(total > 0, total, 1)
    typical = max(float(np.median(top)), 1e-9)
    weight = share * seen * (top > 0.4 * typical)
    found = float(np.median((above > 0).sum(axis=2)) * (t[1] - t[0]))
    return adjusted(ellipse, points, normals, offset, weight, level.factor), found
