"""Are the board's corners where they are stated to be? What they miss alike in every view is the board's own."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.per_view import linearised

Array = NDArray[np.float64]

_OFTEN = 3
"""Views that a corner is seen in, for its place to be told from the views' noise."""


@dataclass(frozen=True)
class Misplaced:
    """How far corners lie off their places on the board, the same in all views.

    Attributes
    ----------
    share : float
        Of the corners' sum of squares: what such places explain, beyond what chance lets them.
    p_value : float
        Of an F test that corners lie in their places.
    across_mm, out_mm : float
        Root mean square of the offsets in the board's plane and out of it, without what noise puts there.
    """

    share: float
    p_value: float
    across_mm: float
    out_mm: float


def misplaced_corners(adjustment: Adjustment) -> Misplaced | None:
    """Return how far corners lie off their places; None where too few are seen often enough to tell.

    To first order, each corner by itself and the rig and the poses as they were found: what these have taken up of the
    offsets is not seen, so the test is a cautious one.
    """
    _, weights, here = linearised(adjustment)
    views, count = weights.corners.shape
    residual = here.corners.residual.reshape(views, count, 2)
    # d residual / d place on the board: that of the place in the camera's frame, turned.
    by_place = here.corners.pose[..., 3:].reshape(views, count, 2, 3) @ adjustment.rotations[:, None]
    often = np.count_nonzero(weights.corners, axis=0) >= _OFTEN
    information = np.einsum("vk,vkci,vkcj->kij", weights.corners, by_place, by_place)[often]
    pull = np.einsum("vk,vkci,vkc->ki", weights.corners, by_place, residual)[often]
    squares = float(np.sum(weights.corners[:, often, None] * residual[:, often] ** 2))
    numbers = 2 * np.count_nonzero(weights.corners[:, often])
    # The unknowns are paid for by all corners alike.
    freedom = numbers * adjustment.dof_corners / max(2 * np.count_nonzero(weights.corners), 1)
    terms = 3 * int(np.count_nonzero(often))
    if terms == 0 or freedom <= 2 * terms or squares <= 0:
        return None
    covariance = np.linalg.pinv(information, rcond=1e-9, hermitian=True)
    offsets = np.einsum("kij,kj->ki", covariance, pull)
    gain = float(np.sum(offsets * pull))
    left = max(squares - gain, np.finfo(np.float64).tiny)
    statistic = gain / terms / (left / (freedom - terms))
    scatter = np.diagonal(covariance, axis1=1, axis2=2) * squares / freedom
    true = np.maximum(np.mean(offsets**2 - scatter, axis=0), 0.0)
    return Misplaced(
        share=float(max(gain / squares - terms / freedom, 0.0)),
        p_value=float(fisher.sf(statistic, terms, freedom - terms)),
        across_mm=float(np.sqrt(true[0] + true[1])),
        out_mm=float(np.sqrt(true[2])),
    )
