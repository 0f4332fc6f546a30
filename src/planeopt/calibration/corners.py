"""A board's corners in an image: found with OpenCV's markers, measured along their edges, judged one by one."""

from collections.abc import Iterator, Mapping
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

MIN_SIDE = 32
"""px: of an image that can hold a board."""

_FIRST, _LONGEST = 10.0, 40.0  # px along the edges: roughly, and as far as it gains much
_FEW, _SHORT = 12, 15.0  # corners, with fewer of which it is hardly known how the edges bend, and px that hardly bend
_START_BLUR = 1.2  # px
_WINDOW = 0.3, 3, 7  # of the side of a square, and px: half the window of OpenCV's refinement
_SMALLEST = 6.0  # px: no square is smaller
_MOST = 0.6  # of the markers lie as on the board: else it is another
_CENTRED = 0.15  # of a square: how far a marker may be off the middle of its square
_CONTRADICTIONS = 0.05  # of the markers
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

    def marker_share(self, board: Board) -> float | None:
        """Return the side of the markers over that of the squares as seen, to a few hundredths; ``None``: not seen."""
        known = marker_corners(board)
        there = np.array([number in known for number in self.found.markers.ids.tolist()], dtype=np.bool_)
        if self.map is None or not there.any():
            return None
        fours = self.map.places(self.found.markers.corners[there].reshape(-1, 2)).reshape(-1, 4, 2)
        sides = np.linalg.norm(fours - np.roll(fours, 1, axis=1), axis=2)
        return float(np.median(sides)) / min(board.square_mm)

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
    if min(height, width) < MIN_SIDE:
        return Corners.none(_NOTHING, None)
    best, mapped, grey = _NOTHING, None, np.empty((0, 0), dtype=np.uint8)
    for image in eight_bits(values):
        found = find_board(image, board)
        first = _first_map(found, board, (width, height))
        if first is not None and (mapped is None or len(found.markers) > len(best.markers)):
            best, mapped, grey = found, first, image
        if mapped is not None and len(best.ids) >= _ENOUGH:
            break
    return Corners.none(best, None) if mapped is None else _measured(values, grey, board, best, mapped)


def eight_bits(values: NDArray[np.float32]) -> Iterator[NDArray[np.uint8]]:
    """Yield an image as OpenCV's detector wants it: as it is, then sharpened, then evened out where that is no help."""
    plain = np.clip(values * 255 + 0.5, 0, 255)
    yield plain.astype(np.uint8)
    low, high = np.quantile(values[::4, ::4], [0.01, 0.99])
    stretched = np.clip((values - low) / max(float(high - low), 1e-6), 0, 1).astype(np.float32)
    smooth = np.asarray(cv2.GaussianBlur(stretched, (0, 0), _SHARPENED))
    yield (np.clip(stretched + _SHARPENED * (stretched - smooth), 0, 1) * 255).astype(np.uint8)
    evened = cv2.createCLAHE(4.0, (8, 8)).apply((np.sqrt(stretched) * 255).astype(np.uint8))
    yield np.asarray(evened, dtype=np.uint8)


_SHARPENED = 3.0  # px, and times: markers that are blurred or small can be read so
_ENOUGH = 12  # corners: with these OpenCV's detector is not asked again
_NO_IDS = np.empty(0, dtype=np.int64)
_NOTHING = Found(Markers(_NO_IDS, np.empty((0, 4, 2))), _NO_IDS, np.empty((0, 2)))


def _first_map(found: Found, board: Board, size: tuple[int, int]) -> BoardImage | None:
    """Return the map through markers and corners as OpenCV found them; ``None`` if most do not lie as on the board."""
    known = marker_corners(board)
    there = np.array([number in known for number in found.markers.ids.tolist()], dtype=np.bool_)
    places = np.array([known[number] for number in found.markers.ids[there].tolist()]).reshape(-1, 4, 2)
    fours = found.markers.corners[there]
    printed = board.printed[found.ids]
    # Where markers are of another size than said their middles still lie where they should.
    for points, pixels in (
        (places.reshape(-1, 2), fours.reshape(-1, 2)),
        (places.mean(axis=1), fours.mean(axis=1)),
    ):
        points = np.concatenate([board.corners[found.ids][printed], points])
        pixels = np.concatenate([found.corners[printed], pixels])
        mapped = fit_board_image(points, pixels, size, board.square_mm)
        if mapped is None or mapped.mirrored or np.mean(mapped.fits(points, pixels)) < _MOST:
            continue
        if not _contradicted(mapped, found.markers, known, board):
            return mapped
    return None


def _contradicted(mapped: BoardImage, markers: Markers, known: Mapping[int, Array], board: Board) -> bool:
    """Return whether markers lie in the middle of the board's squares, or of squares beyond it, but in wrong ones.

    What was taken for a marker somewhere else is no sign of another board.
    """
    middles = mapped.places(markers.corners.mean(axis=1)) / board.square_mm - 0.5
    in_square = np.abs(middles - np.rint(middles)).max(axis=1) < _CENTRED
    nowhere = np.full((4, 2), np.inf)
    said = (
        np.array([known.get(number, nowhere).mean(axis=0) for number in markers.ids.tolist()]) / board.square_mm - 0.5
    )
    wrong = in_square & (np.abs(said - middles).max(axis=1) > 0.5)
    return int(wrong.sum()) >= 2 and float(wrong.mean()) > _CONTRADICTIONS


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
    fits = _fitted(values, board, mapped, ids, pixels, blurs, _LONGEST if len(ids) >= _FEW else _SHORT)
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
