"""Which pixels lie along an ellipse, or inside it: row by row, without a look at the others."""

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline

Array = NDArray[np.float64]
Places = NDArray[np.intp]
Mask = NDArray[np.bool_]

Box = tuple[int, int, int, int]
"""``x0, y0, x1, y1`` of a part of an image, upper ends excluded."""


def pixels_near(outline: Outline, box: Box, inner: float, outer: float) -> tuple[Places, Places]:
    """Return rows and columns, within a box, of pixels from `inner` px inside an ellipse to `outer` px outside it.

    All of those, and some more: they are between two ellipses that hold the band between them. Where both semi-axes
    grow by d, the boundary moves by d at the axes' ends and by down to 2 sqrt(ab)/(a+b) of that between them: that much
    further the two have to be.
    """
    reach = (outline.a + outline.b) / (2 * outline.size)
    inner, outer = inner * reach, outer * reach
    x0, y0, x1, y1 = box
    y = np.arange(y0, y1, dtype=np.float64)
    first, last = _span(outline, outline.a + outer, outline.b + outer, y)
    first = np.clip(np.ceil(first), x0, x1).astype(np.intp)
    last = np.clip(np.floor(last) + 1, first, x1).astype(np.intp)
    a, b = outline.a - inner, outline.b - inner
    if b > 0 and outline.b**2 / outline.a > inner:
        begin, end = _span(outline, a, b, y)
        begin = np.clip(np.floor(begin) + 1, first, last).astype(np.intp)
        end = np.clip(np.ceil(end), begin, last).astype(np.intp)
    else:
        begin = end = last
    # Of each row, what lies before the inner ellipse and what lies behind it.
    starts, ends = np.stack([first, end], axis=1).ravel(), np.stack([begin, last], axis=1).ravel()
    lengths = ends - starts
    rows = np.repeat(np.repeat(np.arange(y1 - y0), 2), lengths)
    columns = np.arange(lengths.sum()) + np.repeat(starts - x0 - np.cumsum(lengths) + lengths, lengths)
    return rows, columns


def pixels_inside(outline: Outline, box: Box) -> Mask:
    """Return which pixels (y1 - y0, x1 - x0) of a box lie inside an ellipse."""
    x0, y0, x1, y1 = box
    first, last = _span(outline, outline.a, outline.b, np.arange(y0, y1, dtype=np.float64))
    columns = np.arange(x0, x1, dtype=np.float32)
    return (columns > first.astype(np.float32)[:, None]) & (columns < last.astype(np.float32)[:, None])


def _span(outline: Outline, a: float, b: float, y: Array) -> tuple[Array, Array]:
    """Return where rows at heights `y` (N,) enter and leave an ellipse of other semi-axes; twice its middle outside."""
    (c, _), (s, _) = outline.axes
    # The points (x, y) with (c x + s y)^2 / a^2 + (c y - s x)^2 / b^2 <= 1, a quadratic in x.
    square, y = (c / a) ** 2 + (s / b) ** 2, y - outline.y
    middle = outline.x - y * c * s * (a**-2 - b**-2) / square
    half = np.sqrt(np.maximum(square - (y / (a * b)) ** 2, 0.0)) / square
    return middle - half, middle + half
