"""How points scatter about an ellipse: outliers, excess over the expected noise, correlation along the boundary."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline, fit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_OUTLIER = 4.0  # robust standard deviations: 6 in 100,000 points of clean noise
_NO_OUTLIER = 0.02  # px: a point that is not further off is not an outlier, however small the noise
_PARAMETERS = 5  # of an ellipse


@dataclass(frozen=True, eq=False)
class Scatter:
    """What an ellipse fitted to N points says about them.

    Parameters
    ----------
    outline : Outline
        The ellipse.
    keep : (N,) bool array
        The points that are no outliers.
    residuals : (N,) array
        Signed distances from it, in units of the expected sigma.
    factor : float
        Standard deviation of the kept residuals, the larger of the plain and the robust (median) estimate.
    """

    outline: Outline
    keep: Mask
    residuals: Array
    factor: float


def scatter_about_ellipse(points: Array, sigma: Array, use: Mask) -> Scatter | None:
    """Fit an ellipse, leave out what is more than 4 robust standard deviations and 0.02 px off, twice.

    Parameters
    ----------
    points : (N, 2) array
        px.
    sigma : (N,) array
        Expected standard deviation, px.
    use : (N,) bool array
        Points that are considered at all.

    Returns
    -------
    Scatter or None
        ``None`` if the points are not on an ellipse.
    """
    keep = use
    for last in (False, False, True):
        outline = fit(points[keep], sigma[keep])
        if outline is None:
            return None
        residuals = outline.distances(points) / sigma
        robust = float(np.median(np.abs(residuals[keep]))) / 0.6745
        if last:
            return Scatter(outline, keep, residuals, max(robust, float(np.sqrt(np.mean(residuals[keep] ** 2)))))
        keep = use & (np.abs(residuals) <= np.maximum(_OUTLIER * robust, _NO_OUTLIER / sigma))
    return None


def inflation_of(residuals: Array, present: Mask) -> float:
    """Return by how much the sigma of correlated residuals has to grow for them to count as independent.

    The square root of the integrated autocorrelation ``1 + 2 sum rho_k`` round the closed boundary, summed over Geyer's
    initial positive sequence of pairs (Statistical Science 7, 1992, section 3.3), never below 1; times what the ellipse
    took away: five of the points that are left when correlated ones are counted as one.

    Parameters
    ----------
    residuals : (N,) array
        In order along the boundary, in units of their sigma; ignored where not `present`.
    present : (N,) bool array
    """
    squared = max(_integrated_autocorrelation(residuals, present), 1.0)
    independent = present.sum() / squared
    return float(np.sqrt(squared * independent / max(independent - _PARAMETERS, 1.0)))


def _integrated_autocorrelation(residuals: Array, present: Mask) -> float:
    count = len(residuals)
    products = np.fft.irfft(np.abs(np.fft.rfft(np.where(present, residuals, 0.0))) ** 2, count)
    pairs_seen = np.fft.irfft(np.abs(np.fft.rfft(present.astype(np.float64))) ** 2, count)
    lags = count // 4 // 2 * 2
    covariance = products[:lags] / np.maximum(np.round(pairs_seen[:lags]), 1)
    if lags < 4 or covariance[0] <= 0:
        return 1.0
    pairs = (covariance / covariance[0]).reshape(-1, 2).sum(axis=1)
    positive = len(pairs) if np.all(pairs > 0) else int(np.argmax(pairs <= 0))
    return float(2 * pairs[:positive].sum() - 1)
