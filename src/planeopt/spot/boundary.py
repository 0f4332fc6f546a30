"""From a candidate to sub-pixel boundary points with their noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from planeopt.spot import ellipse as ell
from planeopt.spot import profiles as pro
from planeopt.spot.candidates import Candidate
from planeopt.spot.ellipse import Ellipse
from planeopt.spot.points import Kind, NoSpotReason, SpotNotFound

Array = NDArray[np.float64]

_ROUNDS = 3
_MAX_NORMALS = 4000  # a spot beyond 1,200 px across gains nothing from more
_OUTLIER = 4.0  # robust standard deviations about the ellipse: 6 in 100,000 points of clean noise
_BAD_PROFILE = 3.0  # times the median residual
_MIN_HEIGHT = 0.3  # of the median height
_MIN_SHARE = 0.5  # of the boundary, else there is no saying what it is
_MAX_SCATTER = 0.04  # of the ellipse's size: what scatters more is not one
_SIGMA_FLOOR = 1e-3  # px: the interpolation's own error
_RING_BLUR = 1.0  # px: what a focused camera blurs; the rest of a laser line's width is its own


@dataclass(frozen=True, eq=False)
class Boundary:
    """What was measured; N points.

    Parameters
    ----------
    points : (N, 2) array
        Raw pixels.
    sigma : (N,) array
        px, inflated for correlation.
    width : float
        Standard deviation of the profile, px.
    height, background : float
        Medians, share of full scale.
    ellipse : Ellipse
        Fitted to the points.
    share : float
        Of the boundary that could be measured.
    outliers : float
        Share of profiles that were there but did not fit.
    excess : float
        Scatter about the ellipse over what the pixels' noise explains.
    inflation : float
        By which `sigma` exceeds the scatter because of correlation.
    curvature : float
        Largest curvature times `width`.
    ambiguity : float
        Largest difference that the split of `width` into the beam's own softness and blur can make, px.
    """

    points: Array
    sigma: Array
    width: float
    height: float
    background: float
    ellipse: Ellipse
    share: float
    outliers: float
    excess: float
    inflation: float
    curvature: float
    ambiguity: float


def measure_boundary(values: NDArray[np.float32], candidate: Candidate, level: float = 0.5) -> Boundary:
    """Measure the boundary of a candidate along about one normal per pixel of its perimeter.

    Parameters
    ----------
    values : (H, W) float32 array
        Linear grey.
    candidate : Candidate
    level : float
        Of a disc: the share of the plateau's height at which the boundary is; 0.5 is the half height.

    Raises
    ------
    SpotNotFound
        If too little of the boundary can be measured, or it is not an ellipse.
    """
    kind = candidate.kind
    ellipse, width = _rough(values, candidate)
    result = _measure(values, kind, ellipse, width, level)
    for _ in range(_ROUNDS - 1):
        before, result = ellipse, _measure(values, kind, result.ellipse, result.width, level)
        ellipse = result.ellipse
        if _moved(before, ellipse) < 0.02 * result.width:
            break
    return result


def ring_blur(width: float) -> float:
    """Return the part of a ring's width, px, that is taken to be the camera's blur."""
    return min(width, _RING_BLUR)


def inflation_of(residuals: Array, present: NDArray[np.bool_]) -> float:
    """Return by how much the sigma of correlated residuals has to grow for them to count as independent.

    The square root of the integrated autocorrelation ``1 + 2 sum rho_k`` round the closed boundary, summed over Geyer's
    initial positive sequence of pairs (Statistical Science 7, 1992, section 3.3); never below 1.

    Parameters
    ----------
    residuals : (N,) array
        In order along the boundary, in units of their sigma; ignored where not `present`.
    present : (N,) bool array
    """
    mask = present.astype(np.float64)
    clean = np.where(present, residuals, 0.0)
    products = np.fft.irfft(np.abs(np.fft.rfft(clean)) ** 2, len(clean))
    counts = np.fft.irfft(np.abs(np.fft.rfft(mask)) ** 2, len(clean))
    lags = min(len(clean) // 4, 200)
    covariance = products[:lags] / np.maximum(np.round(counts[:lags]), 1)
    if lags < 4 or covariance[0] <= 0:
        return 1.0
    rho = covariance / covariance[0]
    pairs = rho[: lags // 2 * 2].reshape(-1, 2).sum(axis=1)
    positive = len(pairs) if np.all(pairs > 0) else int(np.argmax(pairs <= 0))
    return float(np.sqrt(max(2 * pairs[:positive].sum() - 1, 1.0)))


def _moved(before: Ellipse, after: Ellipse) -> float:
    return max(abs(getattr(before, name) - getattr(after, name)) for name in ("x", "y", "a", "b"))


def _sampler(values: NDArray[np.float32], ellipse: Ellipse, reach: float) -> pro.Sampler:
    half = np.array(ellipse.extent) + reach + 3
    low = np.maximum(np.floor(np.array([ellipse.x, ellipse.y]) - half), 0).astype(int)
    high = np.minimum(np.ceil(np.array([ellipse.x, ellipse.y]) + half) + 1, values.shape[::-1]).astype(int)
    if np.any(high - low < 4):
        raise SpotNotFound(NoSpotReason.TOUCHES_BORDER)
    return pro.Sampler(values, (int(low[0]), int(low[1]), int(high[0]), int(high[1])))


def _lines(ellipse: Ellipse, inner: float, outer: float) -> tuple[Array, Array, Array, Array]:
    """Return feet (N, 2), normals (N, 2), curvatures (N,) and places along the normals (M,)."""
    count = int(np.clip(np.ceil(ellipse.perimeter), 24, _MAX_NORMALS))
    t = np.arange(-np.ceil(inner / pro.STEP), np.ceil(outer / pro.STEP) + 1) * pro.STEP
    return *ellipse.normals_at(count), t


def _rough(values: NDArray[np.float32], candidate: Candidate) -> tuple[Ellipse, float]:
    """Return the ellipse and the width from simple profile crossings, good to some tenths of a pixel."""
    ellipse, width = candidate.ellipse, 1.0
    reach = max(6.0, 0.12 * ellipse.size, 2.0 * candidate.line_width)
    start = pro.half_level_start if candidate.kind == "disc" else pro.ridge_start
    for _ in range(2):
        # Half of a narrow spot belongs to the opposite edge.
        feet, normals, _, t = _lines(ellipse, min(reach, 0.8 * ellipse.b), reach)
        sample = _sampler(values, ellipse, reach)
        places = feet[:, None, :] + normals[:, None, :] * t[:, None]
        position, height, width = start(sample(places), t)
        use = np.isfinite(position) & (height > _MIN_HEIGHT * np.median(height))
        if use.mean() < _MIN_SHARE:
            raise SpotNotFound(NoSpotReason.NO_BOUNDARY)
        points = feet + normals * np.where(use, position, 0.0)[:, None]
        found = _fit_robustly(points, np.ones(len(points)), use, ellipse)
        if found is None:
            raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
        ellipse, _, _ = found
        reach = max(4 * width + 3, 5.0)
    return ellipse, width


def _measure(values: NDArray[np.float32], kind: Kind, ellipse: Ellipse, start_width: float, level: float) -> Boundary:
    outer = 4 * start_width + 3
    # The plateau's slope needs a longer lever inside than the background does outside.
    inner = min(outer + (2 if kind == "disc" else 0), 0.8 * ellipse.b)
    feet, normals, curvature, t = _lines(ellipse, inner, outer)
    places = feet[:, None, :] + normals[:, None, :] * t[:, None]
    sample = _sampler(values, ellipse, outer)
    whole = np.asarray(sample.inside(places).all(axis=1))
    grey = sample(places)
    fit = pro.fit_profiles(grey, t, kind, np.zeros(len(feet)), start_width, whole)
    there, use = _usable(fit, whole, 0.7 * min(inner, outer))
    fit = pro.fit_profiles(grey, t, kind, np.where(use, fit.position, 0.0), fit.width, use)
    there, use = _usable(fit, whole, 0.7 * min(inner, outer))
    shift, ambiguity = _shift(kind, fit.width, curvature, level)
    points = feet + normals * (fit.position + shift)[:, None]
    # The noise of the image is one; a profile that fits worse than the others says less.
    noise = float(np.sqrt(np.mean(fit.rms[use] ** 2)))
    predicted = np.maximum(np.sqrt(fit.variance) * noise, _SIGMA_FLOOR)
    found = _fit_robustly(points, predicted**-2, use, ellipse)
    if found is None:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    fitted, keep, scatter = found
    residuals = fitted.distances(points)
    if keep.mean() < _MIN_SHARE or np.sqrt(np.mean(residuals[keep] ** 2)) > _MAX_SCATTER * fitted.size:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    inflation = inflation_of(residuals / predicted, keep)
    sigma = predicted * max(scatter, 1.0) * inflation
    return Boundary(
        points=points[keep],
        sigma=sigma[keep],
        width=fit.width,
        height=float(np.median(fit.height[keep])),
        background=float(np.median(fit.background[keep])),
        ellipse=fitted,
        share=float(keep.mean()),
        outliers=float(1 - keep.sum() / max(there.sum(), 1)),
        excess=scatter,
        inflation=inflation,
        curvature=float(curvature[keep].max() * fit.width),
        ambiguity=float(ambiguity[keep].max()),
    )


def _usable(fit: pro.ProfileFit, whole: NDArray[np.bool_], reach: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which normals show the boundary at all, and which of them fit the model as well as the others."""
    height = float(np.median(fit.height[whole])) if whole.any() else 0.0
    there = whole & (fit.height > _MIN_HEIGHT * height) & (np.abs(fit.position) < reach)
    if height <= 0 or there.mean() < _MIN_SHARE:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, f"{100 * there.mean():.0f} % of it could be.")
    use = there & (fit.rms < _BAD_PROFILE * np.median(fit.rms[there]))
    if use.mean() < _MIN_SHARE:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, f"{100 * use.mean():.0f} % of it could be.")
    return there, use


def _shift(kind: Kind, width: float, curvature: Array, level: float) -> tuple[Array, Array]:
    """Return what has to be added to the measured positions (N,), px outwards, and how uncertain that is (N,), px.

    Blurring by a Gaussian of standard deviation ``s`` moves the half height of a disc, and likewise the ridge of a
    ring, towards the centre of curvature by ``curvature s^2 / 2``: along the tangent ``u`` the boundary recedes by
    ``curvature u^2 / 2``, whose mean is that. Softness that the beam has itself moves nothing, so ``s`` is the blur
    alone; a disc's width is taken to be all blur, a ring's up to a limit.
    """
    blur = width if kind == "disc" else ring_blur(width)
    shift = curvature * blur**2 / 2
    ambiguity = curvature * (width**2 if kind == "disc" else max(blur**2, width**2 - blur**2)) / 2
    if kind == "disc" and level != 0.5:
        # An iso-level of the edge's own error function.
        shift = shift + width * ndtri(1 - level)
    return shift, ambiguity


def _fit_robustly(
    points: Array, weights: Array, use: NDArray[np.bool_], start: Ellipse
) -> tuple[Ellipse, NDArray[np.bool_], float] | None:
    """Fit an ellipse, leave out what is more than `_OUTLIER` robust standard deviations off, and repeat.

    Returns the ellipse, the points kept, and the robust standard deviation of their residuals in units of their own.
    """
    keep, ellipse, scale = use, start, 1.0
    off = np.zeros(len(points))
    for _ in range(3):
        if keep.sum() < 8:
            return None
        found = ell.fit(points, np.where(keep, weights, 0.0), ellipse)
        if found is None:
            return None
        ellipse = found
        off = ellipse.distances(points) * np.sqrt(weights)
        scale = float(np.median(np.abs(off[keep]))) / 0.6745
        keep = use & (np.abs(off) <= _OUTLIER * max(scale, 1e-12))
    return ellipse, keep, max(scale, float(np.sqrt(np.mean(off[keep] ** 2))))
