"""How points scatter about an ellipse: outliers, excess over the expected noise, correlation along the boundary."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline, fit
from planeopt.spot.robust import deviation

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
        Standard deviation of the kept residuals, the ellipse's five parameters allowed for.
    """

    outline: Outline
    keep: Mask
    residuals: Array
    factor: float


def scatter_about_ellipse(points: Array, sigma: Array, use: Mask, start: Outline | None = None) -> Scatter | None:
    """Fit an ellipse, leave out what is more than 4 robust standard deviations and 0.02 px off, twice.

    Parameters
    ----------
    points : (N, 2) array
        px.
    sigma : (N,) array
        Expected standard deviation, px.
    use : (N,) bool array
        Points that are considered at all.
    start : Outline, optional
        An ellipse near them.

    Returns
    -------
    Scatter or None
        ``None`` if the points are not on an ellipse.
    """
    keep, outline = use, start
    for last in (False, False, True):
        outline = fit(points[keep], sigma[keep], outline, turns=2)
        if outline is None:
            return None
        residuals = outline.distances(points) / sigma
        robust = deviation(residuals[keep])
        if last:
            spread = float((residuals[keep] ** 2).sum()) / max(int(keep.sum()) - _PARAMETERS, 1)
            return Scatter(outline, keep, residuals, float(np.sqrt(spread)))
        keep = use & (np.abs(residuals) <= np.maximum(_OUTLIER * robust, _NO_OUTLIER / sigma))
    return None


def inflation_of(scatter: Scatter) -> float:
    """Return by how much the expected sigma has to grow for the points to count as independent ones of that scatter.

    The square root of the scatter's variance over the expected one, times the integrated autocorrelation
    ``1 + 2 sum rho_k`` round the closed boundary, summed over Geyer's initial positive sequence of pairs (Statistical
    Science 7, 1992, section 3.3). Of each only counts what is beyond the standard deviation that it has by chance:
    noise that is as expected and independent is not made larger by looking at it.
    """
    independent, taken = _integrated_autocorrelation(scatter.residuals, scatter.keep)
    count = max(int(scatter.keep.sum()) - _PARAMETERS, 1)
    correlated = 1 + max(independent - 1 - np.sqrt(2 * (2 * taken + 1) / count), 0.0)
    excess = 1 + max(scatter.factor**2 - 1 - np.sqrt(2 * correlated / count), 0.0)
    # Correlated residuals: the ellipse takes away five of the independent ones.
    lost = count / max(count - _PARAMETERS * (correlated - 1), 1.0)
    return float(np.sqrt(excess * correlated * lost))


def _integrated_autocorrelation(residuals: Array, present: Mask) -> tuple[float, int]:
    """Return the sum, and the number of lags in it."""
    count = len(residuals)
    products = np.fft.irfft(np.abs(np.fft.rfft(np.where(present, residuals, 0.0))) ** 2, count)
    pairs_seen = np.fft.irfft(np.abs(np.fft.rfft(present.astype(np.float64))) ** 2, count)
    lags = count // 4 // 2 * 2
    covariance = products[:lags] / np.maximum(np.round(pairs_seen[:lags]), 1)
    if lags < 4 or covariance[0] <= 0:
        return 1.0, 0
    pairs = (covariance / covariance[0]).reshape(-1, 2).sum(axis=1)
    positive = len(pairs) if np.all(pairs > 0) else int(np.argmax(pairs <= 0))
    return float(2 * pairs[:positive].sum() - 1), 2 * positive - 1
