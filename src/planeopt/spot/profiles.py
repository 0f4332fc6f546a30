"""A first, rough boundary: where the grey profiles along the normals of an ellipse cross half their height, or peak."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline, fit
from planeopt.spot.points import Kind, NoSpotReason, SpotNotFound
from planeopt.spot.robust import deviation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEP = 0.5  # px between the samples of a profile
_NORMALS = 256
_ROUNDS = 3
_SETTLED = 0.1  # of the width: an ellipse that moves less is good enough for a start
_HEIGHTS = (0.4, 2.5)  # of the median height: what else is not the spot's edge
_NEAR = 3.0  # robust standard deviations
_NARROWEST = 0.5  # px: of a profile's width, as a start
_MIN_SHARE = 0.25  # of the normals: fewer do not make an ellipse that could be a start


@dataclass(frozen=True, eq=False)
class Start:
    """Where to begin.

    Parameters
    ----------
    outline : Outline
        Good to some tenths of a pixel.
    width : float
        Standard deviation of the profile, px.
    height : float
        Of the plateau (of the ridge) over the background, share of full scale.
    seen : (N,) bool array
        On which of N equal pieces of its boundary it is to be seen.
    """

    outline: Outline
    width: float
    height: float
    seen: Mask


def rough_boundary(values: NDArray[np.float32], outline: Outline, kind: Kind, line_width: float) -> Start:
    """Return a start for the fit of the pixels from an ellipse that is good to a pixel or two.

    Parameters
    ----------
    values : (H, W) float32 array
    outline : Outline
    kind : {"disc", "ring"}
    line_width : float
        Of a ring's line, px.

    Raises
    ------
    SpotNotFound
        If no ellipse can be seen.
    """
    cross = half_level_crossings if kind == "disc" else ridge_peaks
    before, width, seen, heights = outline, 1.0, np.empty(0, dtype=np.bool_), np.empty(0)
    reach = max(6.0, 0.12 * outline.size, 2.0 * line_width)
    for turn in range(_ROUNDS):
        before = outline
        theta = outline.spaced(_NORMALS)
        feet, normals, _ = outline.at(theta)
        # Beyond the middle of a narrow spot lies the opposite edge.
        inner = min(reach if turn == 0 else 3 * width + 2, 0.8 * outline.b)
        t = np.arange(-np.ceil(inner / _STEP), np.ceil(reach / _STEP) + 1) * _STEP
        places = feet[:, None] + normals[:, None] * t[:, None]
        size = np.array(values.shape[::-1])
        whole = np.all((places >= 0) & (places <= size - 1), axis=(1, 2))
        maps = places.astype(np.float32)
        grey = cv2.remap(values, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        position, height, width = cross(np.asarray(grey, dtype=np.float64)[whole], t)
        found = np.full(len(theta), np.nan)
        found[whole] = position
        heights = np.zeros(len(theta))
        heights[whole] = height
        outline, seen = _robust_ellipse(feet, normals, found, heights)
        reach = max(4 * width + 3, 5.0)
        if turn > 0 and before.distance_to(outline) < _SETTLED * width:
            break
    return Start(outline, width, float(np.median(heights[seen])), before.carried(seen, outline))


def _robust_ellipse(feet: Array, normals: Array, position: Array, height: Array) -> tuple[Outline, Mask]:
    """Fit an ellipse to crossings, however many of them are something else's.

    Points count less the further they are off (the weights of a Cauchy distribution), starting from the ellipse that
    the crossings were found with.
    """
    there = np.isfinite(position)
    usual = float(np.median(height[there])) if there.any() else 0.0
    there &= (height > _HEIGHTS[0] * usual) & (height < _HEIGHTS[1] * usual)
    if there.mean() < _MIN_SHARE or there.sum() < 12:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, f"Only {100 * there.mean():.0f} % of it is to be seen.")
    points = (feet + normals * np.where(there, position, 0.0)[:, None])[there]
    current: Outline | None = None
    off = position[there]
    off = off - np.median(off)
    for _ in range(4):
        scale = max(float(np.median(np.abs(off))), 0.1)
        current = fit(points, np.hypot(1.0, off / scale), current, turns=1)
        if current is None:
            raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
        off = current.distances(points)
    assert current is not None  # the loop has run
    scale = max(deviation(off), 0.1)
    seen = np.zeros(len(there), dtype=np.bool_)
    seen[np.flatnonzero(there)[np.abs(off) < _NEAR * scale]] = True
    return current, seen


def half_level_crossings(profiles: Array, t: Array) -> tuple[Array, Array, float]:
    """Return where each edge crosses half its height, its height, and the width of the typical edge.

    Parameters
    ----------
    profiles : (N, M) array
        Bright at the start, dark at the end.
    t : (M,) array
        Places of the samples along the normal, px.

    Returns
    -------
    position : (N,) array
        Linear interpolation at the crossing nearest to the middle; NaN where there is none.
    height : (N,) array
    width : float
        Standard deviation of the error function with the median edge's spread, px.
    """
    fifth = max(2, len(t) // 5)
    inner = np.median(profiles[:, :fifth], axis=1)
    outer = np.median(profiles[:, -fifth:], axis=1)
    height = inner - outer
    safe = np.where(height > 0, height, np.inf)
    relative = (profiles - outer[:, None]) / safe[:, None]
    crossings = {q: _falling_crossing(relative, t, q) for q in (0.25, 0.5, 0.75)}
    spread = crossings[0.25] - crossings[0.75]
    spread = spread[np.isfinite(spread) & (spread > 0)]
    # Between its quartiles an error function of unit standard deviation is 1.349 wide.
    width = float(np.median(spread)) / 1.349 if spread.size else 1.0
    return crossings[0.5], height, max(width, _NARROWEST)


def ridge_peaks(profiles: Array, t: Array) -> tuple[Array, Array, float]:
    """Return where each ridge peaks, its height, and the width of the typical one (as `half_level_crossings`)."""
    fifth = max(2, len(t) // 5)
    base = (np.median(profiles[:, :fifth], axis=1) + np.median(profiles[:, -fifth:], axis=1)) / 2
    peak = profiles.argmax(axis=1)
    height = profiles.max(axis=1) - base
    above = (profiles - base[:, None]) > height[:, None] / 2
    # At half its height a Gaussian of unit standard deviation is 2.355 wide.
    width = float(np.median(above.sum(axis=1))) * (t[1] - t[0]) / 2.355 if len(profiles) else 1.0
    width = max(width, _NARROWEST)
    # The parabola through the peak and what lies a width to its sides: noise moves it less than the highest sample.
    side = max(1, round(width / (t[1] - t[0])))
    rows, middle = np.arange(len(profiles)), np.clip(peak, side, len(t) - 1 - side)
    before, at, after = (profiles[rows, middle + shift] for shift in (-side, 0, side))
    bend = 2 * at - before - after
    shift = np.clip((after - before) / np.where(bend > 0, 2 * bend, np.inf), -1.0, 1.0) * side * (t[1] - t[0])
    return t[middle] + shift, height, width


def _falling_crossing(relative: Array, t: Array, level: float) -> Array:
    falls = (relative[:, :-1] >= level) & (relative[:, 1:] < level)
    distance = np.where(falls, np.abs(t[:-1] + t[1:]), np.inf)
    index = distance.argmin(axis=1)
    rows = np.arange(len(relative))
    before, after = relative[rows, index], relative[rows, index + 1]
    found = falls[rows, index]
    share = (before - level) / np.where(found, before - after, 1.0)
    return np.where(found, t[index] + share * (t[1] - t[0]), np.nan)
