"""The pixels round a spot's boundary, in the boundary's own coordinates."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline
from planeopt.spot.points import NoSpotReason, SpotNotFound
from planeopt.spot.strip import pixels_near

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
    rows, columns = pixels_near(outline, (x0, y0, x1, y1), inner, outer)
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
