"""What one more view would tell, before it is taken: the information of a view without noise."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.projection import beam_on_board, linear_boundaries, linear_corners, predict_corners
from planeopt.calibration.state import State

Array = NDArray[np.float64]

_ANGLES = 90
_MARGIN = 5.0  # px: nearer to the border a corner or a boundary is not measured
_LEAST_CORNERS = 12  # of a view worth taking


@dataclass(frozen=True, eq=False)
class Expected:
    """What candidates would add.

    Parameters
    ----------
    information : (C, g, g) array
        About the free parameters, the pose of the candidate being unknown; zero where it shows too few corners.
    corners : (C,) array of int
        Corners in the image.
    spot : (C,) array of bool
        Whether the whole spot lies in the image and in the board's window, or on the board if it has none.
    """

    information: Array
    corners: NDArray[np.int64]
    spot: NDArray[np.bool_]


def expected_information(adjustment: Adjustment, rotations: Array, translations: Array) -> Expected:
    """Return what views of boards in these poses would add to `Adjustment.information`.

    Parameters
    ----------
    adjustment : Adjustment
    rotations, translations : (C, 3, 3) and (C, 3) arrays
        Board to camera, mm.

    Raises
    ------
    InputError
        If a corner of a board would be behind the camera.
    """
    board = adjustment.observations.board
    state = replace(adjustment.state, rotations=rotations, translations=translations)
    selection = adjustment.model.selection
    px = predict_corners(board, state)
    seen = board.printed & _in_image(px, state)
    weight = np.repeat(seen / adjustment.corner_sigma**2, 2, axis=1)
    linear = linear_corners(board, px, state)
    by_shared, by_pose = [linear.shared @ selection], [linear.pose]
    weights = [weight]
    spot = np.zeros(len(rotations), dtype=np.bool_)
    if adjustment.model.beam != "none":
        boundary, spot = _boundary(board, state)
        which = np.broadcast_to(spot[:, None], boundary.shape[:2])
        found = linear_boundaries(board, boundary, which, state).linear
        by_shared.append(found.shared @ selection)
        by_pose.append(found.pose)
        weights.append(which / _spot_variance(adjustment, boundary)[:, None])
    enough = np.count_nonzero(seen, axis=1) >= _LEAST_CORNERS
    information = _reduced(
        np.concatenate(by_shared, axis=1)[enough],
        np.concatenate(by_pose, axis=1)[enough],
        np.concatenate(weights, axis=1)[enough],
    )
    every = np.zeros((len(rotations), selection.shape[1], selection.shape[1]))
    every[enough] = information
    return Expected(every, np.count_nonzero(seen, axis=1), spot & enough)


def _in_image(px: Array, state: State) -> NDArray[np.bool_]:
    limits = np.array(state.image_size) - 1 - _MARGIN
    return np.all((px >= _MARGIN) & (px <= limits), axis=-1)


def _boundary(board: Board, state: State) -> tuple[Array, NDArray[np.bool_]]:
    """Return the pixels (C, M, 2) of the spots' boundaries, and which spots are whole, in the image and on white."""
    points = beam_on_board(state, np.linspace(0, 2 * np.pi, _ANGLES, endpoint=False))
    on_board = ((points - state.translations[:, None]) @ state.rotations)[..., :2]
    x, y, width, height = board.window_mm or (0.0, 0.0, *board.size_mm)
    white = np.all((on_board >= [x, y]) & (on_board <= [x + width, y + height]), axis=(1, 2))
    ahead = np.all(points[..., 2] > 0, axis=1)
    depth = np.where(points[..., 2:] > 0, points[..., 2:], 1.0)
    middle = (np.array(state.image_size) - 1) / 2
    px = state.camera.project(points[..., :2] / depth)
    whole = np.asarray(white & ahead & _in_image(px, state).all(axis=1), dtype=np.bool_)
    return np.where(whole[:, None, None], px, middle), whole


def _spot_variance(adjustment: Adjustment, boundary: Array) -> Array:
    """Return the variance (C,) of each of the boundary's points, px^2: as many points as there are pixels round it."""
    spots = [view.spot for view in adjustment.observations.views]
    sigmas = [spot.sigma for spot in spots if spot is not None and spot.sigma is not None]
    sigma = adjustment.noise.spots * (float(np.sqrt(np.mean(np.concatenate(sigmas) ** 2))) if sigmas else 1.0)
    length = np.linalg.norm(np.roll(boundary, -1, axis=1) - boundary, axis=-1).sum(axis=1)
    counts = [len(spot) / _length(spot.points) for spot in spots if spot is not None]
    density = float(np.median(counts)) if counts else 1.0
    return sigma**2 * _ANGLES / np.maximum(length * density, 1.0)


def _length(points: Array) -> float:
    return float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=-1).sum())


def _reduced(by_shared: Array, by_pose: Array, weight: Array) -> Array:
    left, below = (np.swapaxes(part * weight[..., None], -1, -2) for part in (by_shared, by_pose))
    W = below @ by_shared
    return left @ by_shared - np.swapaxes(W, -1, -2) @ np.linalg.solve(below @ by_pose, W)
