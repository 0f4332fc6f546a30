"""A part of an image in a figure: cut out, thinned to what a screen can show, its grey levels stretched."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

_MOST = 700  # pixels across: more than a panel has on the screen
_QUANTILES = (0.1, 99.9)  # percent: what is darker or brighter is shown black or white


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of an image, px; pixel centres at integers."""

    left: float
    top: float
    right: float
    bottom: float

    def around(self, factor: float) -> "Window":
        """Return the square about the same middle, its side `factor` times the longer one of this."""
        x, y = (self.left + self.right) / 2, (self.top + self.bottom) / 2
        half = factor * max(self.right - self.left, self.bottom - self.top) / 2
        return Window(x - half, y - half, x + half, y + half)


def show(
    axes: Axes, image: NDArray[Any], window: Window | None = None, channel: str | None = None
) -> tuple[float, float]:
    """Show the part of an image that lies in a window, all of it if none is given.

    Parameters
    ----------
    axes : Axes
    image : (H, W) or (H, W, C) array
        Colour in the order blue, green, red; further channels are left out.
    window : Window, optional
        May reach beyond the image.
    channel : {"gray", "red", "green", "blue"}, optional
        What to show of a colour image, in grey; its colours unless given.

    Returns
    -------
    tuple of float
        The stored values that are shown black and white.
    """
    height, width = image.shape[:2]
    seen = Window(-0.5, -0.5, width - 0.5, height - 0.5) if window is None else window
    x0, x1 = _inside(seen.left, seen.right, width)
    y0, y1 = _inside(seen.top, seen.bottom, height)
    part = _of_channel(image[y0:y1, x0:x1], channel)
    step = -(-max(x1 - x0, y1 - y0) // _MOST)
    part = np.nan_to_num(_means(part, step), nan=0.0, posinf=0.0, neginf=0.0)
    low, high = (float(value) for value in np.percentile(part, _QUANTILES))
    if not low < high:
        low, high = 0.0, max(high, 1.0)
    scaled = np.clip((part - low) / (high - low), 0, 1)
    rows, columns = (step * count for count in part.shape[:2])
    extent = (x0 - 0.5, x0 + columns - 0.5, y0 + rows - 0.5, y0 - 0.5)
    axes.imshow(scaled, cmap="gray", vmin=0, vmax=1, interpolation="nearest", extent=extent)
    axes.set(xlim=(seen.left, seen.right), ylim=(seen.bottom, seen.top), facecolor="0.8")
    axes.spines[:].set_visible(False)
    return low, high


def _of_channel(part: NDArray[Any], channel: str | None) -> NDArray[Any]:
    if part.ndim == 2:
        return part
    if channel is None:
        return part[:, :, 2::-1]
    return part[:, :, :3].mean(axis=2) if channel == "gray" else part[:, :, ("blue", "green", "red").index(channel)]


def _inside(low: float, high: float, size: int) -> tuple[int, int]:
    """Return the pixels of a row that an interval touches, at least one, the upper end excluded."""
    first = min(max(int(np.floor(low + 0.5)), 0), size - 1)
    return first, max(min(int(np.ceil(high + 0.5)), size), first + 1)


def _means(part: NDArray[Any], step: int) -> NDArray[np.float32]:
    """Return the means of blocks of pixels; the odd rest at the right and the bottom is repeated to a whole block."""
    if step == 1:
        return part.astype(np.float32)
    rows, columns = (-size % step for size in part.shape[:2])
    padding = [(0, rows), (0, columns)] + [(0, 0)] * (part.ndim - 2)
    padded = np.pad(part, padding, mode="edge")
    height, width = padded.shape[0] // step, padded.shape[1] // step
    blocks = padded.reshape(height, step, width, step, *part.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))
