"""Tail of a sum of weighted squares of standard normal numbers."""

import math

import numpy as np
import scipy.optimize
import scipy.stats
from numpy.typing import NDArray


def weighted_chi2_sf(value: float, weights: NDArray[np.float64]) -> float:
    """Probability that ``sum w_j x_j^2``, ``x_j`` standard normal, exceeds a value.

    By the saddle point of its cumulant function ``K(t) = -1/2 sum log(1 - 2 w_j t)`` (Lugannani and Rice, *Advances in
    Applied Probability* 12, 1980), which is right to some per cent of itself, far into the tail too.

    Parameters
    ----------
    value : float
    weights : (n,)
        Positive, at least one.
    """
    if value <= 0:
        return 1.0
    largest = float(np.max(weights))
    if largest == np.min(weights):
        return float(scipy.stats.chi2.sf(value / largest, len(weights)))

    def slope_gap(t: float) -> float:
        return float(np.sum(weights / (1 - 2 * weights * t))) - value

    # K' is at most n / (-2 t) for t < 0, and at least the largest weight's share, which grows without limit.
    low, high = -len(weights) / (2 * value), (1 - min(0.5, largest / (2 * value))) / (2 * largest)
    t = float(scipy.optimize.root_scalar(slope_gap, bracket=(low, high), xtol=1e-14 / largest).root)
    spread = weights / (1 - 2 * weights * t)
    height = t * value + 0.5 * float(np.sum(np.log1p(-2 * weights * t)))
    curvature = 2 * float(np.sum(spread**2))
    w = math.copysign(math.sqrt(2 * max(height, 0.0)), t)
    if abs(w) < _AT_THE_MEAN:
        skewness = 8 * float(np.sum(spread**3)) / curvature**1.5
        return 0.5 - skewness / (6 * math.sqrt(2 * math.pi))
    tail = scipy.stats.norm.sf(w) + scipy.stats.norm.pdf(w) * (1 / (t * math.sqrt(curvature)) - 1 / w)
    return float(np.clip(tail, 0.0, 1.0))


_AT_THE_MEAN = 1e-3
"""Where both of the formula's terms are infinite, their limit is taken; its own error there is of this size squared."""
