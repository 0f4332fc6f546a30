"""The image at every scale, and what in it is brighter than its surroundings."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.spot.grey import Grey
from planeopt.spot.robust import MEDIAN_OF_NORMAL

Array = NDArray[np.floating]

_INNER, _OUTER = 5, 17  # px of a level: the boxes whose means are compared, for spots of 3 to 8 px
_APART = 5  # px of a level: peaks closer than half of that are one
_VOTES = 3, 15  # px of a level: how far off the middle of a spot may be
_FEW = 0.15  # of the most votes that any place gets
_SIGNIFICANT = 5.0  # standard deviations of white noise
_NOISE_SAMPLE = 30_000  # pixels that say enough about noise
_MARGIN = 2  # px of a level: what smoothing and interpolation need round a place
_ORIGIN = np.zeros(2, dtype=np.float32)
_SMOOTH = np.array([0.25, 0.5, 0.25], dtype=np.float32)
_MIN_LEVEL = 20  # px: the shortest side of a level
_NEIGHBOURS = np.ones((_APART, _APART), np.uint8)


@dataclass(frozen=True, eq=False)
class Level:
    """An image at one scale.

    Parameters
    ----------
    image : (H, W) array
        uint8, uint16 or float32.
    factor : int
        How many pixels of the whole image make one of this, along a side.
    origin : (2,) array
        Where its first pixel's corner lies in the whole image, px; corners are at half integers.
    noise : float
        Standard deviation of a pixel, in units of the image, if it is white at the finest level.
    """

    image: NDArray[Any]
    factor: int
    origin: Array
    noise: float

    @cached_property
    def smooth(self) -> NDArray[Any]:
        """The image smoothed over 3 x 3 pixels; it lowers white noise 2.7 times."""
        return self._smoothed(self.image)

    def _smoothed(self, part: NDArray[Any]) -> NDArray[Any]:
        if self.factor == 1:
            return np.asarray(cv2.GaussianBlur(part, (3, 3), 0))
        return np.asarray(cv2.sepFilter2D(part, self._depth, _SMOOTH, _SMOOTH))

    @property
    def _depth(self) -> int:
        """Of what is computed of the image: its own at the finest level, which is large; means need not be rounded."""
        return -1 if self.factor == 1 else cv2.CV_32F

    def local(self, points: Array) -> Array:
        """Return points of the whole image, (..., 2), in pixels of this level."""
        return (points - self.origin) / self.factor - 0.5

    def sample(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the grey values (..., ) at points (..., 2) of the whole image, and which of them are on this one."""
        maps = self.local(points).astype(np.float32, copy=False)
        height, width = self.image.shape
        x, y = maps[..., 0], maps[..., 1]
        there = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
        if not maps.size:
            return np.empty(there.shape, np.float32), there
        maps = maps.reshape(len(maps), -1, 2)
        smooth, first = self._smooth_round(maps)
        x, y = maps[..., 0] - first[0], maps[..., 1] - first[1]
        found = cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, dtype=np.float32).reshape(there.shape), there

    def _smooth_round(self, maps: NDArray[np.float32]) -> tuple[NDArray[Any], Array]:
        """Return the part of the smoothed image round places (M, N, 2), px of the level, and its first pixel."""
        if "smooth" in self.__dict__:
            return self.smooth, _ORIGIN
        height, width = self.image.shape
        limit = np.array([width, height])
        low = np.clip(np.floor(maps.min(axis=(0, 1))) - _MARGIN, 0, limit - 1 - _MARGIN).astype(np.intp)
        high = np.clip(np.floor(maps.max(axis=(0, 1))) + _MARGIN + 2, low + 1, limit).astype(np.intp)
        if 2 * np.prod(high - low) > self.image.size:
            return self.smooth, _ORIGIN
        part = self.image[low[1] : high[1], low[0] : high[0]]
        return self._smoothed(part), low.astype(np.float32)

    def peaks(self, floor: float, most: int) -> Array:
        """Return the places (N, 2), px of the whole image, that are bright against their surroundings.

        Parameters
        ----------
        floor : float
            The least that counts, in units of the image.
        most : int
            No more than that many, the brightest.
        """
        inner = np.asarray(cv2.boxFilter(self.image, self._depth, (_INNER, _INNER)))
        spread = self.noise * np.sqrt(1 / _INNER**2 - 1 / _OUTER**2)
        # Means of integers are rounded, both of them.
        rounding = 1.0 if inner.dtype.kind == "u" else 0.0
        threshold = max(floor, _SIGNIFICANT * spread) + rounding
        if float(inner.max()) - float(self.image.min()) < threshold:
            return np.empty((0, 2))
        response = np.asarray(cv2.subtract(inner, cv2.boxFilter(self.image, self._depth, (_OUTER, _OUTER))))
        highest = np.asarray(cv2.dilate(response, _NEIGHBOURS))
        found = np.flatnonzero((response == highest) & (response >= threshold))
        if not len(found):
            return np.empty((0, 2))
        places = np.stack([found % response.shape[1], found // response.shape[1]], axis=1)
        heights = response.ravel()[found].astype(np.float64)
        chosen = np.argsort(-heights, kind="stable")[:most]
        return (places[chosen] + 0.5) * self.factor + self.origin

    def brighter(self, floor: float) -> Array:
        """Return the places (N, 2), px of the whole image, that are as bright as that against their surroundings.

        In boxes of half the size of those of `peaks`: what shows at the next finer level shows here, less bright.
        """
        inner, outer = (cv2.blur(self.image, (side, side)) for side in (_INNER // 2 + 1, _OUTER // 2 + 1))
        response = np.asarray(cv2.subtract(inner, outer))
        rounding = 1.0 if response.dtype.kind == "u" else 0.0
        found = np.flatnonzero(response >= floor - rounding)
        places = np.stack([found % response.shape[1], found // response.shape[1]], axis=1)
        return (places + 0.5) * self.factor + self.origin


def centres(level: Level, floor: float, most: int) -> Array:
    """Return the places (N, 2), px of the whole image, that most edges point to: the middles of rings and of parts.

    Each pixel on an edge votes for the places uphill of it (Loy and Zelinsky, IEEE PAMI 25, 2003, without their scales:
    that is what the levels are for). A ring, or what an obstacle leaves of a spot, need not be bright in its middle.
    """
    gx, gy = (np.asarray(cv2.Sobel(level.smooth, cv2.CV_32F, *d, scale=1 / 8)) for d in ((1, 0), (0, 1)))
    steep = np.asarray(cv2.magnitude(gx, gy))
    # Smoothed white noise has gradients of a fifth of its deviation; across an edge the grey value falls in 2 px or so.
    threshold = max(floor / 3, level.noise)
    found = np.flatnonzero(steep > threshold)
    if not len(found):
        return np.empty((0, 2))
    height, width = steep.shape
    rows, columns = np.divmod(found, width)
    strength = steep.ravel()[found]
    reach = np.arange(*_VOTES, dtype=np.float32)
    x, y = (
        np.rint(start[:, None] + (slope.ravel()[found] / strength)[:, None] * reach).astype(np.intp)
        for start, slope in ((columns, gx), (rows, gy))
    )
    there = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    # The root: a faint spot beside bright things still counts. Over the distance: a large circle has more edge.
    weight = np.sqrt(strength)[:, None] / reach
    votes = np.bincount((y * width + x)[there], weight[there], height * width).reshape(height, width)
    smooth = np.asarray(cv2.GaussianBlur(votes.astype(np.float32), (5, 5), 0))
    floor_of_votes = _FEW * float(smooth.max())
    top = np.flatnonzero((smooth >= np.asarray(cv2.dilate(smooth, _NEIGHBOURS))) & (smooth > floor_of_votes))
    top = top[np.argsort(-smooth.ravel()[top], kind="stable")[:most]]
    return (np.stack([top % width, top // width], axis=1) + 0.5) * level.factor + level.origin


def noise_of(grey: Grey) -> float:
    """Return the standard deviation of a pixel's noise, share of full scale, from as many rows as say enough."""
    return pixel_noise(grey.rows(_NOISE_SAMPLE // grey.shape[1] + 1), grey.quantum)


def pixel_noise(values: NDArray[Any], quantum: float = 0.0) -> float:
    """Return the standard deviation of the pixels' noise, robust against the image's content.

    From the second differences along rows, whose noise is sqrt(6) times the pixels' (Immerkaer, Computer Vision and
    Image Understanding 64, 1996, in one dimension, with the median absolute value).

    Parameters
    ----------
    values : (H, W) array
    quantum : float
        The step to which the values were rounded: the median is taken of what they may have been before.
    """
    step = max(1, values.size // _NOISE_SAMPLE)
    sample = values[::step].astype(np.float32)
    second = np.abs(sample[:, :-2] - 2 * sample[:, 1:-1] + sample[:, 2:])
    return _median(second, quantum) / (MEDIAN_OF_NORMAL * np.sqrt(6.0)) if second.size else 0.0


def _median(values: NDArray[np.float32], quantum: float) -> float:
    # The upper median: numpy's own takes twice as long.
    median = float(np.partition(values, values.size // 2, axis=None)[values.size // 2])
    if quantum <= 0 or median < quantum / 2:
        return median
    below, above = float(np.mean(values < median - quantum / 2)), float(np.mean(values < median + quantum / 2))
    return median + quantum * ((0.5 - below) / (above - below) - 0.5) if above > below else median


def pyramid(image: NDArray[Any], origin: tuple[int, int], noise: float) -> list[Level]:
    """Return an image and its halvings, down to the smallest that can hold a spot.

    Parameters
    ----------
    image : (H, W) array
    origin : tuple of int
        The whole image's pixel ``(x, y)`` that is the first of this.
    noise : float
        Standard deviation of a pixel, in units of the image.
    """
    corner = np.array(origin, dtype=np.float32) - np.float32(0.5)
    levels = [Level(image, 1, corner, noise)]
    while min(image.shape) >= 2 * _MIN_LEVEL:
        height, width = image.shape[0] // 2, image.shape[1] // 2
        # An odd last row or column is left out: what remains is halved exactly.
        # Smoothed first, so that fine patterns do not show as coarse ones; the finest level is too large for that.
        image = levels[-1].smooth if len(levels) > 1 else image
        image = np.asarray(cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))
        factor = 2 ** len(levels)
        levels.append(Level(image, factor, corner, noise / factor))
    return levels
