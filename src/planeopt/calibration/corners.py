"""A board's corners in an image: found with OpenCV's markers, measured along their edges, judged one by one."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.calibration.board_image import BoardImage, fit_board_image
from planeopt.calibration.charuco import Found, Markers, find_board, marker_corners
from planeopt.calibration.corner_fit import CornerFits, Crossings, Print, fit_corners

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FIRST, _LONGEST = 10.0, 40.0  # px along the edges: roughly, and as far as it gains much
_START_BLUR = 1.2  # px
_WINDOW = 0.3, 3, 7  # of the side of a square, and px: half the window of OpenCV's refinement
_SMALLEST = 6.0  # px: no square is smaller
_OWN_ERROR = 0.003  # px: of the model, on images without noise
_COVERED = 0.6  # of each arm's pixels
_CONTRAST = 0.3  # of the view's usual
_MISFIT = 2.5  # times the view's usual,
_RESIDUAL = 0.03  # and of the contrast: less is good enough
_ASTRAY = 0.15, 2.0  # of a square, and px: further from the map, or from where it was looked for, is something else
_BLUR = 2.5  # times the view's usual
_LEAST_SIGNAL = 3.0  # contrast over noise


@dataclass(frozen=True, eq=False)
class Corners:
    """What was seen of a board.

    Parameters
    ----------
    found : Found
        By OpenCV.
    ids : (N,) array of int
    pixels : (N, 2) array
    sigma : (N,) array
        px.
    map : BoardImage or None
        ``None`` if what was found is no board, or not this one.
    blur : float
        Usual standard deviation of the blur, px; 0 if there are no corners.
    """

    found: Found
    ids: NDArray[np.int64]
    pixels: Array
    sigma: Array
    map: BoardImage | None
    blur: float

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def none(cls, found: Found, mapped: BoardImage | None) -> "Corners":
        """Return that there are none."""
        return cls(found, np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty(0), mapped, 0.0)


def find_corners(values: NDArray[np.float32], board: Board) -> Corners:
    """Find and measure a board's corners.

    Parameters
    ----------
    values : (H, W) array
        Grey values, share of full scale.
    board : Board
    """
    height, width = values.shape
    found, first = None, None
    for eight in eight_bits(values):
        seen = find_board(eight, board)
        mapped = _first_map(seen, board, (width, height))
        if found is None or (mapped is not None and (first is None or len(seen.markers) > len(found.markers))):
            found, first, grey = seen, mapped, eight
        if first is not None and len(found.ids) >= _ENOUGH:
            break
    if found is None or first is None:
        return Corners.none(found or _NOTHING, None)
    return _measured(values, grey, board, found, first)


def eight_bits(values: NDArray[np.float32]) -> Iterator[NDArray[np.uint8]]:
    """Yield an image as OpenCV's detector wants it: as it is, then evened out, for where that is not enough."""
    yield np.clip(values * 255 + 0.5, 0, 255).astype(np.uint8)
    low, high = np.quantile(values[::4, ::4], [0.01, 0.99])
    stretched = np.sqrt(np.clip((values - low) / max(float(high - low), 1e-6), 0, 1))
    evened = cv2.createCLAHE(4.0, (8, 8)).apply((stretched * 255).astype(np.uint8))
    yield np.asarray(evened, dtype=np.uint8)


_ENOUGH = 12  # corners: with these OpenCV's detector is not asked again
_NOTHING = Found(
    Markers(np.empty(0, dtype=np.int64), np.empty((0, 4, 2))), np.empty(0, dtype=np.int64), np.empty((0, 2))
)


def _first_map(found: Found, board: Board, size: tuple[int, int]) -> BoardImage | None:
    """Return the map through markers and corners as OpenCV found them."""
    known = marker_corners(board)
    pairs = [
        (known[number], four)
        for number, four in zip(found.markers.ids.tolist(), found.markers.corners, strict=True)
        if number in known
    ]
    points = np.concatenate([board.corners[found.ids], *(places for places, _ in pairs)])
    pixels = np.concatenate([found.corners, *(four for _, four in pairs)])
    mapped = fit_board_image(points, pixels, size, board.square_mm)
    if mapped is None or np.mean(mapped.fits(points, pixels)) < 0.6:
        return None
    return mapped


def _measured(
    values: NDArray[np.float32], grey: NDArray[np.uint8], board: Board, found: Found, mapped: BoardImage
) -> Corners:
    size = values.shape[1], values.shape[0]
    rough: dict[int, tuple[Array, Array]] = {}
    # First roughly: along short arms, which hardly bend. What was expected in the wrong place gets a second chance.
    for _ in range(2):
        ids = np.array([k for k in _in_sight(mapped, board, size) if k not in rough], dtype=np.int64)
        if not len(ids):
            break
        fits = _fitted(values, board, mapped, ids, _started(grey, board, mapped, ids), _START_BLUR, _FIRST)
        good = judged(fits, mapped, board.corners[ids])
        rough |= {
            k: (pixel, blur)
            for k, pixel, blur in zip(ids[good].tolist(), fits.pixel[good], fits.blur[good], strict=True)
        }
        mapped = _again(mapped, board, rough, size)
    if not rough:
        return Corners.none(found, mapped)
    ids = np.array(sorted(rough))
    pixels, blurs = (np.array([rough[k][i] for k in ids.tolist()]) for i in range(2))
    fits = _fitted(values, board, mapped, ids, pixels, blurs, _LONGEST)
    good = judged(fits, mapped, board.corners[ids])
    ids, fits = ids[good], fits[good]
    if not len(ids):
        return Corners.none(found, mapped)
    sigma = np.hypot(fits.sigma * np.maximum(fits.misfit, 1.0), _OWN_ERROR)
    return Corners(found, ids, fits.pixel, sigma, mapped, float(np.median(fits.blur)))


def _again(
    mapped: BoardImage, board: Board, rough: dict[int, tuple[Array, Array]], size: tuple[int, int]
) -> BoardImage:
    """Return the map through measured corners; the one before if they hold none."""
    ids = np.array(sorted(rough), dtype=np.int64)
    pixels = np.array([rough[k][0] for k in ids.tolist()]).reshape(-1, 2)
    return fit_board_image(board.corners[ids], pixels, size, board.square_mm) or mapped


def _in_sight(mapped: BoardImage, board: Board, size: tuple[int, int]) -> list[int]:
    """Return the ids of the corners that are printed and within the image."""
    pixels = mapped(board.corners)
    inside = np.all((pixels > 1) & (pixels < np.array(size) - 2), axis=1) & mapped.in_front(board.corners)
    inside &= board.printed
    inside[inside] = mapped.side(board.corners[inside]) > _SMALLEST
    return np.flatnonzero(inside).tolist()


def _started(grey: NDArray[np.uint8], board: Board, mapped: BoardImage, ids: NDArray[np.int64]) -> Array:
    """Return about where corners (K,) are, px: where OpenCV's refinement goes from where they are expected."""
    places = board.corners[ids]
    side, start = mapped.side(places), mapped(places)
    half = int(np.clip(_WINDOW[0] * side.min(), *_WINDOW[1:]))
    stop = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.005
    found = cv2.cornerSubPix(grey, start.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), stop)
    found = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    # What ran off is no better than where it was expected.
    lost = np.linalg.norm(found - start, axis=1) > np.maximum(_ASTRAY[0] * side, _ASTRAY[1])
    return np.where(lost[:, None], start, found)


def _fitted(
    values: NDArray[np.float32],
    board: Board,
    mapped: BoardImage,
    ids: NDArray[np.int64],
    pixels: Array,
    blur: Array | float,
    longest: float,
) -> CornerFits:
    places = board.corners[ids]
    first, second = mapped.slopes(places)
    columns = board.squares[0] - 1
    swapped = board.legacy and board.squares[1] % 2 == 0
    white = ((ids // columns + ids % columns) % 2 == 1) != swapped
    margin = (min(board.square_mm) - board.marker_mm) / 2
    blurs = np.broadcast_to(blur, (len(ids), 2)).astype(np.float64)
    crossings = Crossings(places, pixels, first, second, white, blurs)
    return fit_corners(values, crossings, Print(board.square_mm, margin, board.window_mm), longest)


def judged(fits: CornerFits, mapped: BoardImage, places: Array) -> Mask:
    """Return which of the fits (K,) are corners of this board, undisturbed."""
    noise = fits.residual / np.maximum(fits.misfit, 1e-12)
    whole = fits.converged & (fits.covered > _COVERED) & (fits.contrast > _LEAST_SIGNAL * noise)
    if not whole.any():
        return whole
    usual = float(np.median(fits.contrast[whole]))
    misfit, blur = float(np.median(fits.misfit[whole])), np.median(fits.blur[whole])
    whole &= fits.contrast > _CONTRAST * usual
    whole &= (fits.misfit < _MISFIT * misfit) | (fits.residual < _RESIDUAL * fits.contrast)
    whole &= (fits.blur.max(axis=1) < _BLUR * blur) & (fits.sigma < 0.5)
    return whole & _near(mapped, places, fits.pixel)


def _near(mapped: BoardImage, places: Array, pixels: Array) -> Mask:
    off = np.linalg.norm(mapped(places) - pixels, axis=1)
    return off < np.maximum(_ASTRAY[0] * mapped.side(places), _ASTRAY[1])
