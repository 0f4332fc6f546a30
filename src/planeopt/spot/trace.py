"""Ellipses drawn onto the edges near them, from a coarse scale to a fine one, and how well they hold.

One judge for all that the search comes up with: along the normals of an ellipse there is a fall in brightness, of
the right sign, of about the same height as elsewhere, and where the ellipse says. Too many that are missing, or that
lie off by more than the noise explains, and it is not a spot.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.ellipses import Ellipses, joined
from planeopt.spot.pyramid import Level
from planeopt.spot.robust import MEDIAN_OF_NORMAL

Array = NDArray[np.floating]

_NORMALS, _MORE_NORMALS = 48, 131
_GAPS = 24  # a gap of so small a part of the normals is noise
_WINDOW = 3.0  # px of the level: how far off an edge is looked for
_STEP = 0.75  # px of the level
_ROUNDS = 2
_STRIDE = 2  # levels: what is found at one is good enough for the next but one
FINE = 56.0  # px: no level is needed on which a spot is larger
_HOPELESS = 0.25  # of the boundary
_SOFT = 0.45  # of the height at the level before: an edge that is lower at the finer level has nothing finer to show
_BEND = 0.4  # of that: what the edges may be off by together, RMS
_HEIGHT = 0.35, 2.5  # of the typical height: what is less, or more, is not the same edge
_BRIGHT = 0.8  # of the plateau's height: what is so bright is not the surroundings
_TOLERANCE = 0.25, 0.012  # px of the level, and of the radius: what an ellipse may be off by itself
_JITTER = 2.5  # by what the noise of the edges adds to that,
_MAX_JITTER = 0.5, 0.04  # up to so many px, and of the radius
_UNIT = np.eye(5)


@dataclass(frozen=True, eq=False)
class Traced:
    """K ellipses and what the image says of them.

    Parameters
    ----------
    ellipses : Ellipses
    height : (K,) array
        The typical fall across three pixels of the level, in units of the image.
    support : (K,) array
        Share of the boundary that is seen: of the right height, in the right place.
    beyond : (K,) array
        Share of the boundary beyond which it is as bright as inside.
    runs : (K,) array
        In how many pieces it is seen; one obstacle makes one, a bar two, a pattern of edges many.
    outside : (K,) array
        Share of the boundary that lies off the image.
    sharpness : (K,) array
        The height at the level that the size asks for over the greatest at any: 1 is an edge, 0.1 a soft hill.
    """

    ellipses: Ellipses
    height: Array
    support: Array
    beyond: Array
    runs: Array
    outside: Array
    sharpness: Array

    def __len__(self) -> int:
        return len(self.ellipses)

    def __getitem__(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> "Traced":
        return Traced(
            self.ellipses[index],
            self.height[index],
            self.support[index],
            self.beyond[index],
            self.runs[index],
            self.outside[index],
            self.sharpness[index],
        )


def trace(levels: list[Level], starts: Ellipses, found_at: NDArray[np.intp]) -> Traced:
    """Return all ellipses followed to the finest level that their size asks for and their edge has something for.

    Parameters
    ----------
    levels : list of Level
        From fine to coarse.
    starts : Ellipses
    found_at : (K,) array of int
        The level at which each was found, good to a pixel of it or two.
    """
    done: list[Traced] = []
    moving, due = together([]), np.empty(0, dtype=np.intp)
    for index in range(len(levels) - 1, -1, -1):
        level = levels[index]
        arrived, moving, due = moving[due == index], moving[due != index], due[due != index]
        parts: list[Traced] = []
        if len(arrived):
            followed = _follow(level, arrived.ellipses, _ROUNDS)
            share = followed.height / arrived.height
            # A softer edge than a pixel falls in height as the levels get finer.
            followed = replace(followed, sharpness=np.minimum(arrived.sharpness * np.minimum(share, 1), 1.0))
            done.append(replace(arrived, sharpness=_fallen(followed, level))[share < _SOFT])
            parts.append(followed[share >= _SOFT])
        if np.any(found_at == index):
            parts.append(_follow(level, starts[found_at == index], _ROUNDS))
        if parts:
            here = together(parts)
            finest = _finest(here, len(levels))
            # What has so little for it on a coarse level has no more on a fine one.
            finest = np.where(here.support + here.outside < _HOPELESS, len(levels), finest)
            done.append(here[finest >= index])
            moving = together([moving, here[finest < index]])
            due = np.concatenate([due, np.maximum(finest[finest < index], index - _STRIDE)])
    return together(done)


def confirmed(levels: list[Level], traced: Traced) -> Traced:
    """Return one ellipse, an array of one, followed and judged once more with more normals.

    Their number has no divisor in common with the first: a pattern of squares that happened to have an edge at each of
    those has none at these. A soft edge is left as it is: it was judged on a coarser level.
    """
    if traced.sharpness[0] < _SOFT:
        return traced
    index = int(_finest(traced, len(levels))[0])
    return replace(_follow(levels[index], traced.ellipses, _ROUNDS, _MORE_NORMALS), sharpness=traced.sharpness)


def _finest(traced: Traced, count: int) -> NDArray[np.intp]:
    """Return the level (K,) that the size of each asks for: the finest on which it is not larger than need be."""
    return np.clip(np.ceil(np.log2(np.maximum(traced.ellipses.size / FINE, 1e-9))), 0, count - 1).astype(np.intp)


def _fallen(after: Traced, level: Level) -> Array:
    """Return the sharpness (K,) at the finest level, if the height goes on to fall by half from level to level."""
    finest = np.maximum(np.ceil(np.log2(np.maximum(after.ellipses.size / FINE, 1.0))), 0)
    return after.sharpness * 0.5 ** np.maximum(np.log2(level.factor) - finest, 0)


def together(parts: list[Traced]) -> Traced:
    """Return all of them in one array."""
    names = ("height", "support", "beyond", "runs", "outside", "sharpness")
    rest = {name: np.concatenate([np.empty(0), *(getattr(part, name) for part in parts)]) for name in names}
    return Traced(joined([part.ellipses for part in parts]), **rest)


def _follow(level: Level, ellipses: Ellipses, rounds: int, count: int = _NORMALS) -> Traced:
    """Move ellipses to the edges within a few pixels of a level, and judge them there."""
    for _ in range(rounds):
        offset, height, seen, _, points, normals, share = _edges(level, ellipses, count)
        weight = share * np.minimum(height / _typical(height, seen)[:, None], 1.0) * seen
        ellipses = adjusted(ellipses, points, normals, offset * level.factor, weight, level.factor)
    offset, height, seen, beyond, _, _, share = _edges(level, ellipses, count)
    typical = _typical(height, seen)
    size = ellipses.size / level.factor
    limit = _TOLERANCE[0] + _TOLERANCE[1] * size
    limit = limit + np.minimum(_JITTER * _jitter(offset, height, typical), _MAX_JITTER[0] + _MAX_JITTER[1] * size)
    good = seen & (height > _HEIGHT[0] * typical[:, None]) & (np.abs(offset) < limit[:, None])
    # What crosses the ellipse at an angle is within the limits as well, for a while, but on either side of it.
    good &= (_bend(offset, good) < _BEND * limit)[:, None]
    # The edge that counts is the one that the ellipse is drawn on, not something stronger beside it.
    typical = np.where(good.sum(axis=1) > count // 4, _typical(height, good), typical)
    good &= (height > _HEIGHT[0] * typical[:, None]) & (height < _HEIGHT[1] * typical[:, None])
    plateau = _typical(beyond[..., 1], good)
    return Traced(
        ellipses,
        typical,
        (share * good).sum(axis=1),
        (share * (~good & seen & (beyond[..., 0] > _BRIGHT * plateau[:, None]))).sum(axis=1),
        _runs(good | ~seen),
        (share * ~seen).sum(axis=1),
        np.ones(len(ellipses)),
    )


def _edges(
    level: Level, ellipses: Ellipses, count: int
) -> tuple[Array, Array, NDArray[np.bool_], Array, Array, Array, Array]:
    """Return where along each normal (K, N) the brightness falls most, px of the level, and by how much.

    Further: which normals are on the image, how much brighter than the surroundings it is at their outer end and
    where it is brightest (K, N, 2), the points on the ellipses, the normals (K, N, 2), and the share of each.
    """
    points, normals, share = ellipses.at(count)
    # Past the middle of a narrow ellipse lies its other side.
    reach = np.minimum(_WINDOW, 0.5 * ellipses.semi_axes[:, 1] / level.factor + 1)
    half = int(np.ceil((_WINDOW + 1.5) / _STEP))
    t = np.arange(-half, half + 1) * _STEP
    grey, there = level.sample(points[:, :, None] + level.factor * t[:, None] * normals[:, :, None])
    seen = np.all(there, axis=2)
    # Means of two samples, four apart: the fall across three pixels.
    fall = (grey[..., :-5] + grey[..., 1:-4] - grey[..., 4:-1] - grey[..., 5:]) / 2
    middle = t[:-5] + 2.5 * _STEP
    near = np.clip(1.3 - 0.5 * np.abs(middle) / reach[:, None], 0, 1) * (np.abs(middle) <= reach[:, None])
    best = (fall * near[:, None]).argmax(axis=2)
    rows, columns = np.ogrid[: len(ellipses), :count]
    at = fall[rows, columns, best]
    before = fall[rows, columns, np.maximum(best - 1, 0)]
    after = fall[rows, columns, np.minimum(best + 1, len(middle) - 1)]
    bend = 2 * at - before - after
    fine = np.where(bend > 0, (after - before) / (2 * np.where(bend > 0, bend, 1)), 0)
    offset = middle[best] + _STEP * np.clip(fine, -0.5, 0.5)
    dark = np.partition(grey[..., -1], count // 4, axis=1)[:, count // 4]
    beyond = np.stack([grey[..., -1], grey.max(axis=2)], axis=2) - dark[:, None, None]
    return offset, np.maximum(at, 0), seen, beyond, points, normals, share


def _typical(height: Array, which: NDArray[np.bool_]) -> Array:
    """Return the median height (K,) of those that count, or a little more than nothing."""
    ordered = np.sort(np.where(which, height, np.inf), axis=1)
    count = which.sum(axis=1)
    middle = ordered[np.arange(len(ordered)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, np.maximum(middle, 1e-9), 1e-9)


@cache
def _neighbours(count: int, before: int, after: int) -> NDArray[np.intp]:
    """Return the indices (M, N) of the normals from so many before each to so many after it, round the ellipse."""
    steps = np.arange(-before, after + 1)[:, None]
    indices = (np.arange(count) + steps) % count
    indices.flags.writeable = False
    return indices


def _runs(good: NDArray[np.bool_]) -> Array:
    """Return in how many runs (K,) the normals are good, small gaps that noise makes left aside."""
    count = good.shape[1]
    gap = count // _GAPS
    wide = np.asarray(np.any(good[:, _neighbours(count, gap, 0)], axis=1))
    closed = np.asarray(np.all(wide[:, _neighbours(count, 0, gap)], axis=1))
    return (closed & ~closed[:, _neighbours(count, 1, -1)[0]]).sum(axis=1).astype(np.float64)


def _bend(offset: Array, good: NDArray[np.bool_]) -> Array:
    """Return the RMS (K,) of the edges' places, averaged over a tenth of the normals, which leaves little noise."""
    half = offset.shape[1] // _GAPS
    near = _neighbours(offset.shape[1], half, half)
    total, count = np.where(good, offset, 0)[:, near].sum(axis=1), good[:, near].sum(axis=1)
    mean = total / np.maximum(count, 1)
    use = good & (count > half)
    return np.sqrt((mean**2 * use).sum(axis=1) / np.maximum(use.sum(axis=1), 1))


def _jitter(offset: Array, height: Array, typical: Array) -> Array:
    """Return the scatter (K,) of the edges' places from one normal to the next, which no smooth shape makes."""
    # Normals closer together than those of the first look share pixels, and their noise.
    step = offset.shape[1] // _NORMALS
    near = _neighbours(offset.shape[1], step, step)[::step]
    before, here, after = near
    second = np.abs(offset[:, before] - 2 * offset[:, here] + offset[:, after])
    there = height > _HEIGHT[0] * typical[:, None]
    return _typical(second, np.asarray(np.all(there[:, near], axis=1))) / (MEDIAN_OF_NORMAL * np.sqrt(6.0))


def adjusted(ellipses: Ellipses, points: Array, normals: Array, offset: Array, weight: Array, pixel: float) -> Ellipses:
    """Return ellipses moved to fit the offsets (K, N) along their normals, what lies off counting less and less."""
    local = points - ellipses.centre[:, None, :]
    scale = np.maximum(ellipses.size, 1e-6)[:, None]
    x, y = local[..., 0] / scale, local[..., 1] / scale
    nx, ny = normals[..., 0], normals[..., 1]
    design = np.stack([nx, ny, nx * x, ny * y, nx * y + ny * x], axis=-1)
    change, middle = np.zeros((len(ellipses), 5)), offset.shape[1] // 2
    for _ in range(3):
        residual = offset - (design @ change[..., None])[..., 0]
        # The upper median: numpy's own takes longer than all the rest.
        spread = np.partition(np.abs(residual), middle, axis=1)[:, middle, None] * 1.5 + 0.25 * pixel
        use = weight * np.clip(1 - (residual / (3 * spread)) ** 2, 0, 1) ** 2
        weighted = (design * use[..., None]).transpose(0, 2, 1)
        normal = weighted @ design
        ridge = 1e-3 * np.einsum("kii->k", normal)[:, None, None] + 1e-9
        change = np.linalg.solve(normal + ridge * _UNIT, weighted @ offset[..., None])[..., 0]
    limit = _WINDOW * pixel
    change = np.clip(change, -limit, limit)
    s = change[:, 2:] / scale
    stretch = np.stack([s[:, 0], s[:, 2], s[:, 2], s[:, 1]], axis=-1).reshape(-1, 2, 2)
    return ellipses.moved(change[:, :2], np.clip(stretch, -0.5, 0.5))
