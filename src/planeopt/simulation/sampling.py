"""How finely light is sampled, and how the samples become pixels; edges that are smoothed before they are sampled.

Shared by the spot's light and by the board's.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]

ENOUGH = 0.65
"""Smoothing in samples at which what lies beyond the sampling limit is below 3e-4 of the edge's own spectrum there."""

BEND = 0.05
"""Curvature times smoothing up to which the closed form, of first order in it, leaves 1e-5 px."""

_TAIL = 5.5


@dataclass(frozen=True)
class Sampling:
    """How finely to sample: s a pixel and axis, and the two parts of the blur, px."""

    factor: int
    closed: float
    summed: float

    @property
    def offsets(self) -> Array:
        """Places of the samples in a pixel (s,), px from its centre."""
        return (np.arange(self.factor) + 0.5) / self.factor - 0.5

    @property
    def margin(self) -> int:
        """How many pixels away the kernel still takes light from."""
        return math.ceil(_TAIL * math.hypot(self.closed, self.summed) + 0.5)


def edge_distance(level: Array, steepness: Array, bend: Array) -> Array:
    """Return the distance from where a quadratic is zero along its gradient: exact for circles."""
    return 2 * level / (steepness + np.sqrt(np.maximum(steepness * steepness - 2 * level * bend, 0.0)))


def smoothed_disc(distance: Array, curvature: Array, soft: Array, level: float, blur: float) -> Array:
    """Return a disc's share of its plateau, smoothed by a Gaussian of this width, px, in closed form.

    Parameters
    ----------
    distance : ndarray, shape (...)
        From the disc's edge, positive outside, px.
    curvature : ndarray, shape (...)
        Of the edge, positive for a disc, 1/px; the result is of first order in curvature times blur.
    soft : ndarray, shape (...)
        The disc's own softness, px.
    level : float
        Share of the plateau at the edge of a disc that is soft.
    blur : float
    """
    # A blurred convex edge draws back by half its curvature times the blur squared; and the profile's middle lies off
    # the edge if that is at another level than half.
    return ndtr((float(ndtri(level)) * soft - distance - 0.5 * blur**2 * curvature) / np.hypot(soft, blur))


def kernel(count: int, sampling: Sampling) -> scipy.sparse.csr_array:
    """Return the matrix that takes samples (count s,) of a line to its pixels (count - 2 margin,)."""
    s, margin = sampling.factor, sampling.margin
    place = (np.arange((2 * margin + 1) * s) + 0.5) / s - 0.5 - margin
    weight = ndtr((place + 0.5) / sampling.summed) - ndtr((place - 0.5) / sampling.summed)
    weight /= weight.sum()
    pixels = count - 2 * margin
    column = np.arange(pixels)[:, None] * s + np.arange(len(place))
    start = np.arange(pixels + 1) * len(place)
    return scipy.sparse.csr_array((np.tile(weight, pixels), column.ravel(), start), shape=(pixels, count * s))
