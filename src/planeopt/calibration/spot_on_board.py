"""The laser's spot on a board: in the board's blank window, or, without one, by difference with the laser off.

In the window the squares beyond are taken out of the picture, and a spot that comes near them is refused. Without one
the spot lies on print: the image without the laser shows what the print reflects, and the difference is divided by it.
"""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.calibration.board_image import BoardImage
from planeopt.conic import fit_conic, geometric_from_conic
from planeopt.spot import Kind, Spot, SpotNotFound, find_spot
from planeopt.spot.grey import Box, to_grey

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GUARD = 2.5, 1.0  # blurs and px from the window's edge: nearer the squares beyond are seen
_ROOM = 3.0, 2.0  # blurs and px that a boundary needs about it
_ALONG = 64  # points along a side of the window
_ROUND = 128  # points round the spot
_LEAST = 0.15  # of the window: less of it in the image is no place to look
_PAPER = 0.3  # quantile of the window's grey values that is paper, not spot, for certain
_BRIGHT = 0.25  # of the way from the paper to the brightest: light of the laser
_TOUCHED = 8  # px along the window's edge
_CLIPPED = 0.01  # of the spot's pixels
_QUIETED = 0.7  # px: blur against the noise of what is divided by
_WHITE = 0.95  # quantile of the board's grey values that is paper
_DARKEST, _BRIGHTEST = 0.02, 4.0  # of the paper's reflectance; of full scale, after the division
_FEWEST = 16  # pixels that hold a plane


class SpotRefused(Exception):  # noqa: N818 - an answer with a reason, not an error
    """There is no spot on this board that a rig could be calibrated with; the message says why."""


def find_spot_on_board(
    image: NDArray[Any], board: Board, mapped: BoardImage, blur: float, kind: Kind, dark: NDArray[Any] | None = None
) -> Spot:
    """Measure the spot in a board's window.

    Parameters
    ----------
    image : (H, W), (H, W, 3) or (H, W, 4) array
    board : Board
    mapped : BoardImage
        Where the board is in the image.
    blur : float
        Standard deviation of the blur of the board's edges, px.
    kind : {"disc", "ring"}
    dark : array, optional
        The same view with the laser off.

    Raises
    ------
    SpotRefused
        If there is none, or it cannot be measured there.
    """
    if board.window_mm is None and dark is None:
        raise SpotRefused("the board has no window, and there is no image of it with the laser off")
    area = board.window_mm or (0.0, 0.0, *board.size_mm)
    outline = mapped(window_outline(area))
    inner, box = _within(outline, image.shape[:2], blur)
    x0, y0, x1, y1 = box
    part, seen = image[y0:y1, x0:x1], inner[y0:y1, x0:x1]
    off = None if dark is None else dark[y0:y1, x0:x1]
    edge = "window" if board.window_mm is not None else "board"
    try:
        if board.window_mm is None and off is not None:
            found = find_spot(_laser_alone(part, off, seen), kind=kind)
        else:
            found = find_spot(_papered(part, seen), kind=kind, dark=None if off is None else _papered(off, seen))
    except SpotNotFound as nothing:
        if off is None and _touches_edge(part, seen):
            raise SpotRefused("the spot reaches over the window's edge") from None
        raise SpotRefused(str(nothing)) from None
    origin = np.array([x0, y0], dtype=np.float64)
    spot = replace(found, points=found.points + origin, rejected=found.rejected + origin)
    _require_room(spot, outline, edge)
    return spot


def _within(outline: Array, shape: tuple[int, ...], blur: float) -> tuple[Mask, Box]:
    """Return which pixels (H, W) see an area of the board and not its edge, and the smallest box with them."""
    mask = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(outline * 16).astype(np.int32)], (1,), shift=4)
    reach = int(np.ceil(_GUARD[0] * blur + _GUARD[1]))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    inner = np.asarray(cv2.erode(mask, disc, borderType=cv2.BORDER_CONSTANT, borderValue=(1,))) > 0
    if inner.sum() < max(_LEAST * abs(float(cv2.contourArea(outline.astype(np.float32)))), 64):
        raise SpotRefused("the part of the board where the spot should be lies outside the image")
    rows, columns = np.flatnonzero(inner.any(axis=1)), np.flatnonzero(inner.any(axis=0))
    return inner, (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)


def _laser_alone(part: NDArray[Any], off: NDArray[Any], seen: Mask) -> NDArray[np.float32]:
    """Return the laser's light on the board as if all of it were white, and nothing beside it.

    Without the laser the board shows what each place reflects: by that the difference is divided. On black little
    light is left, and the noise is that much larger; the measurement says so.
    """
    grey = to_grey(part, dark=off)
    clipped = grey.crop_clipped((0, 0, part.shape[1], part.shape[0]))
    laser = grey.values
    if clipped is not None and float((clipped & seen).sum()) > _CLIPPED * float(
        (laser[seen] > laser[seen].max() / 2).sum()
    ):
        raise SpotRefused("the spot is over-exposed, and nothing is known of it where the print is dark")
    print_ = cv2.GaussianBlur(to_grey(off).values, (0, 0), _QUIETED)
    white = float(np.quantile(print_[seen], _WHITE))
    if white <= 0:
        raise SpotRefused("the image with the laser off is black: the board must be lit in it as in the other")
    even = laser / np.maximum(print_, _DARKEST * white) * white
    return np.where(seen, np.clip(even, -1, _BRIGHTEST), 0).astype(np.float32)


def window_outline(window: tuple[float, float, float, float]) -> Array:
    """Return points (N, 2) along a window's edge, mm, in order."""
    x, y, width, height = window
    share = np.arange(_ALONG) / _ALONG
    low, high = np.zeros(_ALONG), np.ones(_ALONG)
    across = np.concatenate([share, high, 1 - share, low])
    down = np.concatenate([low, share, high, 1 - share])
    return np.stack([x + width * across, y + height * down], axis=1)


def _papered(part: NDArray[Any], seen: Mask) -> NDArray[Any]:
    """Return an image whose pixels outside the window (H, W) look like its paper, as noisy and as unevenly lit."""
    values = part.reshape(*part.shape[:2], -1).astype(np.float64)
    filled = values.copy()
    rng = np.random.default_rng(0)
    y, x = np.nonzero(seen)
    rows, columns = np.nonzero(~seen)
    for channel in range(values.shape[2]):
        inside = values[y, x, channel]
        plane = _paper(x, y, inside)
        expected = np.stack([np.ones(len(rows)), columns, rows], axis=1) @ plane
        second = values[:, :-2, channel] - 2 * values[:, 1:-1, channel] + values[:, 2:, channel]
        calm = second[seen[:, :-2] & seen[:, 1:-1] & seen[:, 2:]]
        noise = float(np.median(np.abs(calm))) / 0.6745 / np.sqrt(6.0) if len(calm) else 0.0
        filled[rows, columns, channel] = expected + noise * rng.standard_normal(len(rows))
    if part.dtype.kind == "u":
        filled = np.clip(np.rint(filled), 0, np.iinfo(part.dtype).max)
    return filled.astype(part.dtype).reshape(part.shape)


def _paper(x: NDArray[np.intp], y: NDArray[np.intp], values: Array) -> Array:
    """Return the plane (3,) through the grey values of the paper, which the spot's are not."""
    rows = np.stack([np.ones(len(x)), x, y], axis=1)
    dark = values <= np.quantile(values, _PAPER)
    level, spread = float(np.median(values[dark])), float(np.ptp(values[dark]))
    among = values < level + 3 * max(spread, 1e-12)
    plane = np.array([level, 0.0, 0.0])
    for _ in range(3):
        if among.sum() < _FEWEST:
            break
        plane = np.asarray(np.linalg.lstsq(rows[among], values[among], rcond=None)[0], dtype=np.float64)
        left = np.abs(values - rows @ plane)
        among = left < 4 * max(float(np.median(left[among])) / 0.6745, 1e-12)
    return plane


def _touches_edge(part: NDArray[Any], seen: Mask) -> bool:
    """Return whether the laser's light reaches the edge of the window."""
    grey = part.reshape(*part.shape[:2], -1)[:, :, :3].astype(np.float64).mean(axis=2)
    low, high = np.quantile(grey[seen], [_PAPER, 0.999])
    rim = seen & ~(cv2.erode(seen.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0)
    return int((grey[rim] > low + _BRIGHT * (high - low)).sum()) > _TOUCHED and high > 1.2 * low


def _require_room(spot: Spot, outline: Array, edge: str) -> None:
    """Refuse a spot so near to the window's edge that the squares beyond are seen round it."""
    ellipse = geometric_from_conic(fit_conic(spot.points).B)
    angle = 2 * np.pi * np.arange(_ROUND) / _ROUND
    turn = np.array([[np.cos(ellipse.angle), np.sin(ellipse.angle)], [-np.sin(ellipse.angle), np.cos(ellipse.angle)]])
    round_it = ellipse.centre + (np.stack([np.cos(angle), np.sin(angle)], axis=1) * ellipse.semi_axes) @ turn
    polygon = outline.astype(np.float32).reshape(-1, 1, 2)
    room = min(cv2.pointPolygonTest(polygon, (float(x), float(y)), measureDist=True) for x, y in round_it.tolist())
    needed = _ROOM[0] * (spot.blur or 0.0) + _ROOM[1]
    if room < 0:
        raise SpotRefused(f"the spot reaches over the {edge}'s edge")
    if room < needed:
        raise SpotRefused(f"the spot comes within {room:.1f} px of the {edge}'s edge, and needs {needed:.1f} px")
