"""Standard deviations that a few outliers do not touch."""

import numpy as np
from numpy.typing import ArrayLike

MEDIAN_OF_NORMAL = 0.6745
"""Median size of a standard normal variable."""


def deviation(residuals: ArrayLike) -> float:
    """Return the standard deviation of normal residuals, from the median of their size."""
    return float(np.median(np.abs(residuals))) / MEDIAN_OF_NORMAL
