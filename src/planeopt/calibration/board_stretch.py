"""Is the board as long and as wide as stated? Images cannot tell its size, but they tell its proportion."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.per_view import joined, linearised
from planeopt.calibration.projection import Linear

Array = NDArray[np.float64]

_STEPS = 3
"""Of a share that is small: what a step leaves of it is of the order of its square."""


def board_stretch(adjustment: Adjustment) -> tuple[float, float]:
    """Return by how much the board's height over its width is larger than stated, as a share, and its uncertainty.

    One step of the adjustment with this as one more unknown: x on the board grows by (1 - s/2), y by (1 + s/2).
    """
    _, weights, here = linearised(adjustment)
    board = adjustment.observations.board
    selection = adjustment.model.selection
    half = (board.corners - np.array(board.size_mm) / 2) * [-0.5, 0.5]
    # d residual / d place in the camera frame, which is what a shift of the board is.
    by_place = here.corners.pose[..., 3:].reshape(len(adjustment.rotations), -1, 2, 3)
    moved = np.einsum("vij,kj->vki", adjustment.rotations[..., :2], half)
    column = np.einsum("vkci,vki->vkc", by_place, moved).reshape(len(adjustment.rotations), -1, 1)
    more = np.eye(selection.shape[1] + 1)
    parts = [(_with(here.corners, selection, column), np.repeat(weights.corners, 2, axis=1))]
    if here.boundaries is not None:
        # The window is where it was printed, and a boundary on it knows nothing of the corners round it.
        found = here.boundaries.linear
        parts.append((_with(found, selection, np.zeros((*found.residual.shape, 1))), weights.boundary))
    evidence = joined(parts, more)
    information, pull = evidence.information.sum(axis=0), evidence.pull.sum(axis=0)
    scale = 1 / np.sqrt(np.diagonal(information))
    inverse = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    covariance = inverse * np.outer(scale, scale)
    return float(covariance[-1] @ pull), float(np.sqrt(covariance[-1, -1]))


def in_proportion(adjustment: Adjustment) -> tuple[Adjustment, float]:
    """Adjust again with squares of the proportion that the images say, one focal length, and return that proportion.

    Parameters
    ----------
    adjustment : Adjustment

    Returns
    -------
    Adjustment
        To a board that is stretched so that `board_stretch` of it is zero to rounding.
    share : float
        By how much its height over its width is larger than stated.

    Raises
    ------
    AdjustmentError
        If there is no such adjustment.
    """
    model, stated = replace(adjustment.model, focal="shared"), adjustment.observations.board
    share, found = 0.0, adjustment
    for _ in range(_STEPS):
        share += board_stretch(found)[0]
        observations = replace(adjustment.observations, board=stated.stretched(1 - share / 2, 1 + share / 2))
        found = adjust(observations, model, prior=adjustment.prior, start=found.state, held=adjustment.held)
    return found, share


def _with(linear: Linear, selection: Array, column: Array) -> Linear:
    """Return the residuals with the free parameters and one more."""
    return Linear(linear.residual, np.concatenate([linear.shared @ selection, column], axis=-1), linear.pose)
