"""How noisy the observations are, told from their own residuals, and which of them are wrong, told by rule."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from planeopt.calibration.equations import Equations, Task, Weights
from planeopt.calibration.packed import Packed
from planeopt.calibration.start import LEAST_CORNERS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REJECT = 4.0
"""Standard deviations beyond which an observation is left out; where it is several numbers, the same probability."""
MOST_CORNERS = 0.03
"""The largest share of all corners that may be left out; the worst ones are."""
MOST_SPOTS = 0.1
"""The largest share of all spots that may be left out, but always one where there are three or more."""
ELLIPSE = 5
"""Numbers of an ellipse: what a spot tells of the rig."""

_TAIL = 2 * float(norm.sf(REJECT))
_MEDIAN_NORM = float(np.sqrt(2 * np.log(2)))  # of the length of a vector of two unit normals
_MEDIAN_ELLIPSE = float(chi2.median(ELLIPSE))
_TINY = float(np.sqrt(np.finfo(np.float64).tiny))
_LEAST_SHARE = 0.1  # of the numbers observed, left after the unknowns: medians of fewer say little


@dataclass(frozen=True)
class Noise:
    """How much larger the noise is than the sigmas that were given.

    Parameters
    ----------
    corners : float
        Of the corners; estimated from their residuals.
    spots : float
        Of what ellipses can show of the spots' boundaries, 1 or more.
    """

    corners: float = 1.0
    spots: float = 1.0

    def weights(self, given: Weights) -> Weights:
        """Return weights by the true sigmas, from those by the sigmas given."""
        return Weights(given.corners / self.corners**2, given.boundary / self.spots**2)


def weights_given(packed: Packed) -> Weights:
    """Return the weights by the sigmas given, of all that was seen."""
    return Weights(packed.corner_seen / packed.corner_sigma**2, packed.boundary_seen / packed.boundary_sigma**2)


def robust_noise(task: Task, here: Equations) -> Noise:
    """Return the factors by medians, which a minority of outliers does not move."""
    packed, given = task.packed, weights_given(task.packed)
    sigmas = corner_norms(here) * np.sqrt(given.corners)
    unknown = 6 * len(packed) + len(task.model.names)
    left = np.sqrt(max(1 - unknown / (2 * np.count_nonzero(packed.corner_seen)), _LEAST_SHARE))
    corners = float(np.median(sigmas[packed.corner_seen])) / _MEDIAN_NORM / left
    spots = 1.0
    if here.boundaries is not None:
        misfits = ellipse_misfits(here, given)[packed.with_spot]
        spots = float(np.sqrt(np.median(misfits) / _MEDIAN_ELLIPSE))
    return Noise(max(corners, _TINY), max(spots, 1.0))


def noise_from(chi2_corners: float, dof_corners: float, chi2_spots: float, dof_spots: float) -> Noise:
    """Return the factors that make both chi-squareds, over the sigmas given, equal to their degrees of freedom."""
    corners = float(np.sqrt(chi2_corners / max(dof_corners, 1.0)))
    spots = float(np.sqrt(chi2_spots / dof_spots)) if dof_spots >= 1 else 1.0
    return Noise(max(corners, _TINY), max(spots, 1.0))


def corner_norms(here: Equations) -> Array:
    """Return the lengths (V, K) of the corners' residuals, px."""
    return np.hypot(here.corners.residual[:, 0::2], here.corners.residual[:, 1::2])


def ellipse_misfits(here: Equations, weights: Weights) -> Array:
    """Return what of each spot's misfit (V,) an ellipse can show: the part of chi-squared in five directions.

    A change of an ellipse moves its boundary on the beam by a0 + a1 cos + a2 sin + a3 cos 2 + a4 sin 2 of the angle
    round the beam, and in the image by that over the length of g's gradient.
    """
    found = here.boundaries
    if found is None:
        return np.zeros(len(weights.corners))
    angle, weight = found.around, weights.boundary
    shapes = [np.ones_like(angle), np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]
    basis = np.stack(shapes, axis=-1) / found.scale[..., None]
    left = np.swapaxes(basis * weight[..., None], -1, -2)
    pull = (left @ found.linear.residual[..., None])[..., 0]
    # Views without a spot have no equations, and short arcs nearly dependent ones.
    inverse = np.linalg.pinv(left @ basis, rcond=1e-12, hermitian=True)
    return np.einsum("vi,vij,vj->v", pull, inverse, pull)


def without_outliers(task: Task, here: Equations, noise: Noise) -> Weights:
    """Return the weights by the sigmas given, zero for what is wrong by rule: the worst, and at most a share of all."""
    packed, given = task.packed, weights_given(task.packed)
    squares = (corner_norms(here) / noise.corners) ** 2 * given.corners
    seen = packed.corner_seen
    bad = _worst(squares, 2, int(MOST_CORNERS * np.count_nonzero(seen)))
    # A view keeps what its pose needs.
    bad &= (np.count_nonzero(seen & ~bad, axis=1) >= LEAST_CORNERS)[:, None]
    count = int(np.count_nonzero(packed.with_spot))
    most = max(1, int(MOST_SPOTS * count)) if count > 2 else 0
    wrong = _worst(ellipse_misfits(here, given) / noise.spots**2, ELLIPSE, most)
    return Weights(np.where(bad, 0.0, given.corners), np.where(wrong[:, None], 0.0, given.boundary))


def _worst(squares: Array, dof: int, most: int) -> Mask:
    """Return which chi-squareds are less likely than the rule allows, but at most so many, the largest."""
    bad = squares > chi2.isf(_TAIL, dof)
    if np.count_nonzero(bad) > most:
        largest = np.argsort(-squares, axis=None, kind="stable")[:most]
        bad = np.zeros_like(bad)
        bad.flat[largest] = True
    return bad
