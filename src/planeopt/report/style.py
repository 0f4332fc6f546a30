"""What all figures of reports share: one palette, one look, and how a figure becomes bytes."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from planeopt.look import FRAME
from planeopt.report.content import Picture

# Far apart in lightness as well as in hue, like all colours here; the ellipse's lies between the black and the white of
# an image.
ELLIPSE = "#e4471f"
POINT = "#ffd23f"
REJECTED = "#1fa2e0"
BAND = ("0.92", "0.82")  # two standard deviations, one

_LOOK: dict[Any, Any] = {**FRAME, "lines.solid_capstyle": "round"}
PAGE_WIDTH = 10.0  # inches: a figure as wide as the page
_PAGE_SIZE = 9.0  # pt, at the page's full width
_PAGE_DPI = 170  # sharp on paper at the width of a page, and twice what a column of the screen has
_COLOURS = 256  # of a PNG's palette
_COMPRESSION = 6  # of zlib's 9: ten times as fast, and 5 % larger
_BEYOND_FONT = 0x590


@contextmanager
def look(size: float, *, titles: float = 1.0) -> Iterator[None]:
    """Let what is drawn inside have the common look.

    Parameters
    ----------
    size : float
        Of the letters, pt.
    titles : float
        By how many pt titles are larger.
    """
    sizes: dict[Any, Any] = {"font.size": size, "axes.titlesize": size + titles, "legend.fontsize": size}
    with mpl.rc_context(_LOOK | sizes):
        yield


@contextmanager
def page_figure(width: float, height: float, *, constrained: bool = True) -> Iterator[Figure]:
    """Yield a figure for a page (inches), not attached to any window; draw and `picture` it inside the context."""
    with look(_PAGE_SIZE):
        yield Figure(figsize=(width, height), layout="constrained" if constrained else None, dpi=_PAGE_DPI)


def picture(figure: Figure, words: str, *, photograph: bool = False) -> Picture:
    """Return a figure as the bytes of a PNG, the same each time.

    With a palette that takes a third to a tenth of an SVG with its letters as outlines, which it would need to look the
    same everywhere.

    Parameters
    ----------
    figure : Figure
    words : str
        What it shows, for who cannot see it.
    photograph : bool
        Whether it holds an image, whose greys are to stay grey.
    """
    with mpl.rc_context(_LOOK):
        figure.set_dpi(_PAGE_DPI)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    file = BytesIO()
    # Drawings have few colours, images few greys. The median cut keeps the frequent ones, and with them the greys; of
    # drawings maximum coverage is nearer in the worst pixel, takes half the time, and half the room.
    method = Image.Quantize.MEDIANCUT if photograph else Image.Quantize.MAXCOVERAGE
    palette = drawn.quantize(_COLOURS, method, dither=Image.Dither.NONE)
    palette.save(file, "png", compress_level=_COMPRESSION)
    width, height = (float(length) for length in figure.get_size_inches())
    return Picture(file.getvalue(), width, height, words)


def mark_size(size: float, count: int, room: int) -> float:
    """Return the size of marks: the usual one while there is room for so many, then less, but not below a third."""
    return size * max(1 / 3, min(1.0, (room / max(count, 1)) ** 0.5))


def drawable(name: str) -> str:
    """Return a name in the letters that the figures' font has: Latin, Greek, Cyrillic, Armenian."""
    return "".join(letter if letter.isprintable() and ord(letter) < _BEYOND_FONT else "?" for letter in name)
