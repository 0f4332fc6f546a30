"""Where a spot can be: what the rig, a region, or the frame before say."""

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.rig import Rig, Silhouette, silhouette
from planeopt.spot.ellipses import Ellipses
from planeopt.spot.grey import Box
from planeopt.spot.points import Spot

Array = NDArray[np.floating]

_log = logging.getLogger(__name__)

_SLACK = 4.0, 0.1  # px, and of the size: what the rig's prediction may be off by
_EXPECTED = 1.0, 0.02  # px, and of the size: what it is off by as a rule
_OUTSIDE = 6.0  # px: seeds may lie that far outside of the beam's image
_GRID = 33  # points along a side, to find the part of the image that the beam's image crosses
_ROUND_POINTS = 64
_NEAR = 2.5  # times the size of the spot before: where it is looked for first
_NEAR_RADIUS = 60.0  # px round a place whose size is not known


class BeamHint:
    """What the rig says about where the spot can lie; without a beam, or a camera inside it, nothing.

    Parameters
    ----------
    rig : Rig, optional
    """

    def __init__(self, rig: Rig | None) -> None:
        self._lines: Silhouette | None = None if rig is None or rig.beam is None else silhouette(rig)

    @property
    def known(self) -> bool:
        """Whether it says anything."""
        return self._lines is not None

    def box(self, within: Box) -> Box:
        """Return the part of a box that the beam's image crosses; empty (x0 = x1) if it misses it."""
        if self._lines is None:
            return within
        x0, y0, x1, y1 = within
        x, y = np.meshgrid(np.linspace(x0, x1 - 1, _GRID), np.linspace(y0, y1 - 1, _GRID))
        steps = np.array([x1 - x0, y1 - y0]) / (_GRID - 1)
        inside = self.allows(np.stack([x.ravel(), y.ravel()], axis=1), float(np.hypot(*steps)))
        if not inside.any():
            return x0, y0, x0, y0
        columns, rows = x.ravel()[inside], y.ravel()[inside]
        low = np.floor([columns.min() - steps[0], rows.min() - steps[1]]).astype(int)
        high = np.ceil([columns.max() + steps[0], rows.max() + steps[1]]).astype(int) + 1
        return max(int(low[0]), x0), max(int(low[1]), y0), min(int(high[0]), x1), min(int(high[1]), y1)

    def allows(self, places: Array, slack: float = _OUTSIDE) -> NDArray[np.bool_]:
        """Return which places (N, 2), px, lie on the beam's image or at most `slack` px off it."""
        if self._lines is None or not len(places):
            return np.ones(len(places), dtype=bool)
        try:
            sides, before = self._lines.distances(places)
        except InputError:
            # A lens that cannot be inverted somewhere in the image says nothing there.
            _log.debug("the camera's distortion cannot be inverted everywhere: the rig is no hint")
            return np.ones(len(places), dtype=bool)
        return (sides > -slack).all(axis=1) & (before > -slack)

    def misfit(self, ellipses: Ellipses) -> Array:
        """Return by how much (K,) each ellipse fails to touch the lines that bound the beam's image.

        In what is expected of a good rig and a rough ellipse; 0 is perfect, and infinity is what no calibration's error
        explains.
        """
        if self._lines is None or not len(ellipses):
            return np.zeros(len(ellipses))
        points, _, _ = ellipses.at(_ROUND_POINTS)
        try:
            sides, before = self._lines.distances(points.reshape(-1, 2))
        except InputError:
            _log.debug("the camera's distortion cannot be inverted round a candidate: the rig is no hint")
            return np.zeros(len(ellipses))
        gap = np.abs(sides.reshape(len(ellipses), _ROUND_POINTS, 2).min(axis=1)).max(axis=1)
        behind = before.reshape(len(ellipses), _ROUND_POINTS).mean(axis=1) < 0
        possible = (gap < _SLACK[0] + _SLACK[1] * ellipses.size) & ~behind
        return np.where(possible, gap / (_EXPECTED[0] + _EXPECTED[1] * ellipses.size), np.inf)


def region_box(region: Sequence[float] | None, shape: tuple[int, int]) -> Box:
    """Return a region as whole pixels of an image of this shape; all of the image if there is none.

    Raises
    ------
    InputError
        If the region is not four numbers in order, or does not lie in the image.
    """
    height, width = shape
    if region is None:
        return 0, 0, width, height
    try:
        numbers = np.asarray(region, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (4,) or not np.all(np.isfinite(numbers)):
        raise InputError(f"region must be four numbers of pixels (x0, y0, x1, y1), not {region!r}")
    x0, y0, x1, y1 = numbers.tolist()
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"region ({x0:g}, {y0:g}, {x1:g}, {y1:g}) is empty: give (x0, y0, x1, y1), x0 < x1, y0 < y1")
    if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
        raise InputError(
            f"region ({x0:g}, {y0:g}, {x1:g}, {y1:g}) does not lie in the image of {width} x {height} pixels"
        )
    return int(np.floor(x0)), int(np.floor(y0)), int(np.ceil(x1)), int(np.ceil(y1))


def box_of_previous(previous: Spot | ArrayLike | None, within: Box) -> Box | None:
    """Return the part of a box round the spot of the frame before; ``None`` if it is not known, or was elsewhere.

    Parameters
    ----------
    previous : Spot, (2,) or (N, 2) array_like, optional
        The spot, its centre, or points of its boundary, px.
    within : tuple of int

    Raises
    ------
    InputError
        If it is neither a spot nor finite points.
    """
    if previous is None:
        return None
    try:
        points = np.asarray(previous.points if isinstance(previous, Spot) else previous, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.shape == (2,):
        points = points[None]
    if points.ndim != 2 or points.shape[-1] != 2 or not len(points) or not np.all(np.isfinite(points)):
        raise InputError("previous must be a spot, its centre (x, y), or points of its boundary (N, 2), in pixels")
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2 * _NEAR + 16 if len(points) > 1 else np.full(2, _NEAR_RADIUS)
    middle = np.clip((low + high) / 2, -1e6, 1e6)
    x0, y0, x1, y1 = within
    box = (
        max(int(middle[0] - half[0]), x0),
        max(int(middle[1] - half[1]), y0),
        min(int(middle[0] + half[0]) + 1, x1),
        min(int(middle[1] + half[1]) + 1, y1),
    )
    return box if box[2] - box[0] > 0 and box[3] - box[1] > 0 else None
