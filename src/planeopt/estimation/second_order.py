"""What an uncertain rig does to second order, of which no test may make evidence against the rig or a frame.

A rig that is off moves the points of an image ellipse of size ``R`` sideways by some ``delta``, which across the
boundary leaves ``delta^2 sin^2 / 2R`` beside what the derivatives say: 1 px of the principal point on a spot of 40 px
is 0.01 px, no less than the noise of a good measurement. Of N points with standard deviation ``sigma``, a shift that
costs a misfit ``t``, in standard deviations, is ``delta^2 = 2 t^2 sigma^2 / N``; its second order has the length
``sqrt(3/8) t^2 sigma / (R sqrt(N))``, and for normal ``t`` of mean square ``T`` the mean square
``9/8 (T sigma)^2 / (R^2 N)``. It is a change of the ellipse's size and shape, three ways: a third of it is counted in
each.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WAYS = 3  # of change of an ellipse about its centre


def typical_sigma(noise: Array) -> Array:
    """Median standard deviations (M,) of points by their covariances (M, N, 2, 2)."""
    return np.sqrt(np.median((noise[..., 0, 0] + noise[..., 1, 1]) / 2, axis=-1))


def fineness(sigma_over_axis: Array | float, n_points: NDArray[Any] | int) -> Array:
    """Return ``sigma / (R sqrt(N))``, with the shorter semi-axis for ``R``."""
    return np.asarray(sigma_over_axis / np.sqrt(np.maximum(n_points, 1)), dtype=np.float64)


def bend(moved: Array | float, fine: Array | float) -> Array:
    """Return the second order's root mean square in each way of change, in standard deviations.

    Parameters
    ----------
    moved : (...)
        Mean square of what the rig's covariance moves, in standard deviations.
    fine : (...)
        See `fineness`.
    """
    return np.asarray(np.sqrt(9 / 8 / _WAYS) * moved * fine, dtype=np.float64)


def image_bends(by_rig: Array, covariance: Array, fine: Array) -> Array:
    """Return the second order (n,) of the rig's effect on each image's two misfits, whose derivatives are (2n, k)."""
    moved = np.einsum("ik,kl,il->i", by_rig, covariance, by_rig).reshape(-1, 2).sum(axis=1)
    return bend(moved, fine)


def misfit_covariance(by_rig: Array, covariance: Array, fine: Array | float) -> Array:
    """Return the covariance (..., 2, 2) of the two misfits of an image that test the rig.

    Parameters
    ----------
    by_rig : (..., 2, n)
        Derivative by the rig's free parameters.
    covariance : (n, n)
        Of these.
    fine : (...)
        See `fineness`.
    """
    rig = by_rig @ covariance @ np.swapaxes(by_rig, -1, -2)
    own = 1 + bend(np.trace(rig, axis1=-2, axis2=-1), fine) ** 2
    return own[..., None, None] * np.eye(2) + rig
