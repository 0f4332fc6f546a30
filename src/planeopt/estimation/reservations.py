"""What a reader of planes should know about them though nothing failed: flags, for one plane or for many."""

import numpy as np
import scipy.special
from numpy.typing import NDArray

from planeopt.estimation.evidence import IMPROBABLE
from planeopt.plane import BETA_TOLERANCE
from planeopt.solution import Flag

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Beyond these a first-order interval is too short: the image's dependence on the slopes is no longer linear over a
# standard deviation (docs/model.md, section 9); R, alpha and beta leave the linear regime earlier than the slopes.
WEAK_SLOPE_SIGMA = 0.2
NONLINEAR_ANGLE_SHARE = 0.1
SHORT_ARC = 1 / 3


def reservations(
    planes: Array,
    covariance: Array,
    reached: Array,
    arc: Array,
    chi2_points: Array,
    dof_points: NDArray[np.int64],
) -> list[tuple[Flag, ...]]:
    """Flags of M planes; what is NaN raises none. Equal tuples are one object.

    Parameters
    ----------
    planes : (M, 3)
        ``(z_L, p, q)``.
    covariance : (M, 3, 3)
        Of the planes, spot and rig together.
    reached : (M,)
        `planeopt.estimation.efficiency.Reach.excess`.
    arc : (M,)
        Covered fractions of the ellipses.
    chi2_points : (M,)
    dof_points : (M,)
    """
    tangent = np.hypot(planes[:, 1], planes[:, 2])
    slope_sigma = slope_sigmas(covariance)
    flat = np.arctan(tangent) < BETA_TOLERANCE
    weak = slope_sigma > WEAK_SLOPE_SIGMA
    marks = {
        Flag.BETA_UNDEFINED: flat,
        Flag.WEAK: weak,
        Flag.ANGLES_NONLINEAR: ~weak & ~flat & (slope_sigma > NONLINEAR_ANGLE_SHARE * tangent),
        Flag.BOUND_OUT_OF_REACH: reached > 1,
        Flag.SHORT_ARC: arc < SHORT_ARC,
        Flag.POINTS_SCATTER: scipy.special.chdtrc(np.maximum(dof_points, 1), chi2_points) < IMPROBABLE,
    }
    raised = np.zeros(len(planes), dtype=np.int64)
    for place, mark in enumerate(marks.values()):
        raised |= np.asarray(mark, dtype=np.int64) << place
    sets = {code: tuple(flag for place, flag in enumerate(marks) if code >> place & 1) for code in set(raised.tolist())}
    return [sets[code] for code in raised.tolist()]


def slope_sigmas(covariance: Array) -> Array:
    """Largest standard deviation (M,) of a slope in any direction; NaN where there is no covariance."""
    xx, xy, yy = covariance[:, 1, 1], covariance[:, 1, 2], covariance[:, 2, 2]
    return np.sqrt((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy))
