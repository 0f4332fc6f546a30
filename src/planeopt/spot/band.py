"""The pixels round a spot's boundary, in the boundary's own coordinates."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline
from planeopt.spot.points import NoSpotReason, SpotNotFound

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BLACK = 0.02  # of the pixels at nought: with fewer noise hardly ends there
_RUN = 8  # segments side by side, where not all are taken
_SPARSEST = 8  # of these, at least one of so many is: few would not hold an ellipse
_MAX_SEGMENTS = 3000  # of a perimeter beyond that, each is longer than a pixel


@dataclass(frozen=True, eq=False)
class Band:
    """Pixels near an ellipse; M pixels, in S segments of equal length along the boundary.

    Parameters
    ----------
    outline : Outline
        The ellipse.
    box : tuple of int
        ``x0, y0, x1, y1`` of the part of the image that holds them, upper ends excluded.
    rows, columns : (M,) int array
        Places within the box.
    values : (M,) array
        Grey values.
    clipped, black : (M,) bool array
        At full scale; at nought, where that many are that noise ends there.
    u : (M,) array
        Distance from the ellipse, px, positive outside.
    turn : (2, M) array
        Cosine and sine of the eccentric angle of the nearest point of the ellipse.
    theta : (M,) array
        That angle, from 0 to 2 pi.
    normals : (2, M) array
        Outward, at that point.
    curvature : (M,) array
        Of the ellipse at that point, 1/px.
    segment : (M,) int array
        Number of the segment of that point.
    count : int
        S.
    chosen : (S,) bool array
        Segments whose pixels are here.
    """

    outline: Outline
    box: tuple[int, int, int, int]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    values: Array
    clipped: Mask
    black: Mask
    u: Array
    turn: Array
    theta: Array
    normals: Array
    curvature: Array
    segment: NDArray[np.intp]
    count: int
    chosen: Mask

    def part(self, keep: Mask) -> "Band":
        """Return the band with these pixels (M,) alone."""
        return Band(
            self.outline,
            self.box,
            self.rows[keep],
            self.columns[keep],
            self.values[keep],
            self.clipped[keep],
            self.black[keep],
            self.u[keep],
            self.turn[:, keep],
            self.theta[keep],
            self.normals[:, keep],
            self.curvature[keep],
            self.segment[keep],
            self.count,
            self.chosen,
        )

    def widened(self, mask: Mask, reach: int) -> Mask:
        """Return which pixels (M,) lie within `reach` px, along rows and columns, of those of a mask (M,)."""
        x0, y0, x1, y1 = self.box
        picture = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
        picture[self.rows[mask], self.columns[mask]] = 1
        wide = cv2.dilate(picture, np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8))
        return np.asarray(wide)[self.rows, self.columns] > 0

    @property
    def places(self) -> Array:
        """(2, M) array: the pixels' centres relative to the ellipse's, in units of the ellipse's size."""
        x = self.columns + (self.box[0] - self.outline.x)
        y = self.rows + (self.box[1] - self.outline.y)
        return np.asarray(np.stack([x, y]) / self.outline.size, dtype=np.float64)


def band_round(
    values: NDArray[np.float32],
    clipped: Mask | None,
    black: Mask | None,
    outline: Outline,
    inner: float,
    outer: float,
    *,
    most: int | None = None,
) -> Band:
    """Return the pixels from `inner` px inside an ellipse to `outer` px outside it.

    Where they would be more than `most`, of every second, third ... run of segments alone.

    Raises
    ------
    SpotNotFound
        If the ellipse lies outside the image.
    """
    height, width = values.shape
    wide, high = outline.extent
    x0, y0 = max(int(outline.x - wide - outer), 0), max(int(outline.y - high - outer), 0)
    x1, y1 = min(int(outline.x + wide + outer) + 2, width), min(int(outline.y + high + outer) + 2, height)
    if x1 - x0 < 4 or y1 - y0 < 4:
        raise SpotNotFound(NoSpotReason.TOUCHES_BORDER)
    rows, columns = _near(outline, (x0, y0, x1, y1), inner, outer)
    count = int(np.clip(np.ceil(outline.perimeter), 16, _MAX_SEGMENTS))
    every = 1 if most is None else min(max(1, len(rows) // most), _SPARSEST)
    if every > 1:
        # By the angle of the pixel itself: at the ends of a run it says nearly the same as that of the nearest point.
        local = outline.local(np.stack([columns + x0, rows + y0], axis=1).astype(np.float64))
        run = (outline.share_before(np.arctan2(local[:, 1] / outline.b, local[:, 0] / outline.a)) * count) // _RUN
        some = np.flatnonzero(run % every == 0)
        rows, columns = rows[some], columns[some]
    u, turn = outline.nearest(np.stack([columns + x0, rows + y0], axis=1).astype(np.float64))
    theta = np.arctan2(turn[1], turn[0])
    theta += np.where(theta < 0, 2 * np.pi, 0.0)
    segment = np.minimum((outline.share_before(theta) * count).astype(np.intp), count - 1)
    keep = np.flatnonzero((u >= -inner) & (u <= outer) & (segment // _RUN % every == 0))
    rows, columns, segment = rows[keep], columns[keep], segment[keep]
    u, turn, theta = u[keep], turn[:, keep], theta[keep]
    normals, curvature = outline.bearing(turn)
    part = values[y0:y1, x0:x1]
    nothing = np.zeros(len(rows), dtype=np.bool_)
    full = nothing if clipped is None else clipped[y0:y1, x0:x1][rows, columns]
    dark = nothing if black is None else black[y0:y1, x0:x1][rows, columns]
    if dark.mean() < _BLACK:
        dark = nothing
    return Band(
        outline,
        (x0, y0, x1, y1),
        rows,
        columns,
        part[rows, columns].astype(np.float64),
        full,
        dark,
        u,
        turn,
        theta,
        normals,
        curvature,
        segment,
        count,
        np.arange(count) // _RUN % every == 0,
    )


def _near(
    outline: Outline, box: tuple[int, int, int, int], inner: float, outer: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pixels between two ellipses that hold the band between them.

    Where both semi-axes grow by d, the boundary moves by d at the axes' ends and by down to 2 sqrt(ab)/(a+b) of that
    between them: that much further the two have to be.
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


def _span(outline: Outline, a: float, b: float, y: Array) -> tuple[Array, Array]:
    """Return where rows at heights `y` (N,) enter and leave an ellipse of other semi-axes; twice its middle outside."""
    (c, _), (s, _) = outline.axes
    # The points (x, y) with (c x + s y)^2 / a^2 + (c y - s x)^2 / b^2 <= 1, a quadratic in x.
    square, y = (c / a) ** 2 + (s / b) ** 2, y - outline.y
    middle = outline.x - y * c * s * (a**-2 - b**-2) / square
    half = np.sqrt(np.maximum(square - (y / (a * b)) ** 2, 0.0)) / square
    return middle - half, middle + half
