"""A board's corners in an image: found with OpenCV's markers, measured along their edges, judged one by one."""

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
        empty = np.empty(0)
        return Corners(found or _NOTHING, empty.astype(np.int64), np.empty((0, 2)), empty, None, 0.0)
    return _measured(values, grey, board, found, first)


def eight_bits(values: NDArray[np.float32]) -> list[NDArray[np.uint8]]:
    """Return an image as OpenCV's detector wants it: as it is, and evened out where that is not enough."""
    plain = np.clip(values * 255 + 0.5, 0, 255).astype(np.uint8)
    low, high = np.quantile(values[::4, ::4], [0.01, 0.99])
    stretched = np.clip((values - low) / max(float(high - low), 1e-6), 0, 1)
    evened = cv2.createCLAHE(4.0, (8, 8)).apply(np.asarray(np.sqrt(stretched) * 255, dtype=np.uint8))
    return [plain, np.asarray(evened, dtype=np.uint8)]


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
    values: NDArray[np.float32], grey: NDArray[np.uint8], board: Board, found: Found, first: BoardImage
) -> Corners:
    size = values.shape[1], values.shape[0]
    ids = np.arange(len(board.corners))
    mapped = first
    for _ in range(2):
        ids = _in_sight(mapped, board, size)
        if not len(ids):
            break
        fits = _fitted(values, grey, board, mapped, ids)
        good = judged(fits, mapped, board.corners[ids])
        again = fit_board_image(board.corners[ids[good]], fits.pixel[good], size, board.square_mm)
        if again is None:
            break
        good &= _near(again, board.corners[ids], fits.pixel)
        mapped = again
        chosen = (
            ids[good],
            fits.pixel[good],
            np.hypot(fits.sigma, _OWN_ERROR)[good] * np.maximum(fits.misfit[good], 1.0),
        )
        blur = float(np.median(fits.blur[good])) if good.any() else 0.0
        last = Corners(found, *chosen, mapped, blur)
    else:
        return last
    empty = np.empty(0)
    return Corners(found, empty.astype(np.int64), np.empty((0, 2)), empty, mapped, 0.0)


def _in_sight(mapped: BoardImage, board: Board, size: tuple[int, int]) -> NDArray[np.int64]:
    """Return the ids of the corners that are printed and within the image."""
    pixels = mapped(board.corners)
    inside = np.all((pixels > 1) & (pixels < np.array(size) - 2), axis=1) & mapped.in_front(board.corners)
    inside &= board.printed
    inside[inside] = mapped.side(board.corners[inside]) > _SMALLEST
    return np.flatnonzero(inside)


def _fitted(
    values: NDArray[np.float32], grey: NDArray[np.uint8], board: Board, mapped: BoardImage, ids: NDArray[np.int64]
) -> CornerFits:
    places = board.corners[ids]
    first, second = mapped.slopes(places)
    side = mapped.side(places)
    half = int(np.clip(_WINDOW[0] * side.min(), *_WINDOW[1:]))
    start = mapped(places)
    rough = cv2.cornerSubPix(
        grey,
        start.astype(np.float32).reshape(-1, 1, 2),
        (half, half),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.005),
    )
    rough = np.asarray(rough, dtype=np.float64).reshape(-1, 2)
    # What ran off is no better than where it was expected.
    lost = np.linalg.norm(rough - start, axis=1) > np.maximum(_ASTRAY[0] * side, _ASTRAY[1])
    columns = board.squares[0] - 1
    swapped = board.legacy and board.squares[1] % 2 == 0
    white = ((ids // columns + ids % columns) % 2 == 1) != swapped
    margin = (min(board.square_mm) - board.marker_mm) / 2
    crossings = Crossings(places, np.where(lost[:, None], start, rough), first, second, white)
    return fit_corners(values, crossings, Print(board.square_mm, margin, board.window_mm))


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
