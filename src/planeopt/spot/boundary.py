"""From a candidate to sub-pixel boundary points with their noise."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from planeopt.spot import profiles as pro
from planeopt.spot.candidates import Candidate
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind, NoSpotReason, SpotNotFound
from planeopt.spot.scatter import inflation_of, scatter_about_ellipse

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Straighten = Callable[[Array], tuple[Array, Array]]
"""Raw pixels (N, 2) to pixels without distortion (N, 2) and the local stretch (N,)."""

_ROUNDS = 3
_MAX_NORMALS = 4000  # a spot beyond 1,200 px across gains nothing from more
_BAD_PROFILE = 3.0  # times the median residual
_GOOD_PROFILE = 0.02  # of the median height: a residual that is good enough, however small the noise
_MIN_HEIGHT = 0.3  # of the median height
_MIN_SHARE = 0.5  # of the boundary, else there is no saying what it is
_MAX_SCATTER = 0.04  # of the ellipse's size: what scatters more is not one
_MIN_BAND = 50  # pixels that can tell a slope
_MIN_WIDTHS = 3.0  # of the profile, in half the spot: less never reaches a plateau
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
    outline : Outline
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
    outline: Outline
    share: float
    outliers: float
    excess: float
    inflation: float
    curvature: float
    ambiguity: float


def measure_boundary(
    values: NDArray[np.float32],
    candidate: Candidate,
    *,
    level: float = 0.5,
    camera_blur: float | None = None,
    straighten: Straighten | None = None,
) -> Boundary:
    """Measure the boundary of a candidate along about one normal per pixel of its perimeter.

    Parameters
    ----------
    values : (H, W) float32 array
        Linear grey.
    candidate : Candidate
    level : float
        Of a disc: the share of the plateau's height at which the boundary is; 0.5 is the half height.
    camera_blur : float, optional
        Standard deviation of the blur of optics and pixel, px.
    straighten : callable, optional
        Removes the lens's distortion: an ellipse is one only without it.

    Raises
    ------
    SpotNotFound
        If too little of the boundary can be measured, or it is not an ellipse.
    """
    outline, width = _rough(values, candidate)
    values = _levelled(values, outline, width)
    result = _measure(_lines(values, candidate.kind, outline, width), level, camera_blur, straighten)
    for _ in range(_ROUNDS - 1):
        if _moved(outline, result.outline) < 0.02 * result.width:
            break
        outline = result.outline
        result = _measure(_lines(values, candidate.kind, outline, result.width), level, camera_blur, straighten)
    if result.outline.b < _MIN_WIDTHS * result.width:
        raise SpotNotFound(NoSpotReason.TOO_SMALL, f"It is {2 * result.outline.b:.1f} px across.")
    return result


def _moved(before: Outline, after: Outline) -> float:
    return max(abs(getattr(before, name) - getattr(after, name)) for name in ("x", "y", "a", "b"))


@dataclass(frozen=True, eq=False)
class _Lines:
    """Normals of an outline and the grey profiles along them; N normals, M samples each."""

    kind: Kind
    width: float
    feet: Array
    normals: Array
    curvature: Array
    t: Array
    grey: Array
    whole: Mask

    @classmethod
    def of(
        cls, values: NDArray[np.float32], kind: Kind, outline: Outline, width: float, reach: tuple[float, float]
    ) -> "_Lines":
        """Sample from `reach[0]` px inside to `reach[1]` px outside; `width` is what is known of the profile's."""
        # Beyond the middle of a narrow spot lies the opposite edge.
        inner = min(reach[0], 0.8 * outline.b)
        count = int(np.clip(np.ceil(outline.perimeter), 24, _MAX_NORMALS))
        feet, normals, curvature = outline.normals_at(count)
        t = np.arange(-np.ceil(inner / pro.STEP), np.ceil(reach[1] / pro.STEP) + 1) * pro.STEP
        places = feet[:, None, :] + normals[:, None, :] * t[:, None]
        sample = pro.Sampler(values, _box(values, outline, reach[1]))
        whole = np.asarray(sample.inside(places).all(axis=1))
        return cls(kind, width, feet, normals, curvature, t, sample(places), whole)

    def at(self, position: Array) -> Array:
        """Return the points (N, 2) at these places (N,) along the normals."""
        return self.feet + self.normals * position[:, None]


def _box(values: NDArray[np.float32], outline: Outline, reach: float) -> tuple[int, int, int, int]:
    centre, half = np.array([outline.x, outline.y]), np.array(outline.extent) + reach + 3
    low = np.maximum(np.floor(centre - half), 0).astype(int)
    high = np.minimum(np.ceil(centre + half) + 1, values.shape[::-1]).astype(int)
    if np.any(high - low < 4):
        raise SpotNotFound(NoSpotReason.TOUCHES_BORDER)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _rough(values: NDArray[np.float32], candidate: Candidate) -> tuple[Outline, float]:
    """Return the ellipse and the width from simple profile crossings, good to some tenths of a pixel."""
    outline, width = candidate.outline, 1.0
    reach = max(6.0, 0.12 * outline.size, 2.0 * candidate.line_width)
    start = pro.half_level_start if candidate.kind == "disc" else pro.ridge_start
    for _ in range(2):
        lines = _Lines.of(values, candidate.kind, outline, width, (reach, reach))
        position, height, width = start(lines.grey, lines.t)
        use = np.isfinite(position) & (height > _MIN_HEIGHT * np.median(height))
        _require_share(use)
        points = lines.at(np.where(use, position, 0.0))
        found = scatter_about_ellipse(points, np.ones(len(points)), use)
        if found is None:
            raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
        outline = found.outline
        reach = max(4 * width + 3, 5.0)
    return outline, width


def _levelled(values: NDArray[np.float32], outline: Outline, width: float) -> NDArray[np.float32]:
    """Return the image less the slope of its background round the spot.

    A slope of the background would move the boundary: on each normal it is taken to be level. A plane through the band
    just outside the spot, where the profiles' own background lies; a third of it may be something else.
    """
    x0, y0, x1, y1 = _box(values, outline, 4 * width + 3)
    x, y = np.meshgrid(np.arange(x0, x1, dtype=np.float64), np.arange(y0, y1, dtype=np.float64))
    offset = outline.distances(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(x.shape)
    band = (offset > 2.5 * width + 1) & (offset < 4 * width + 3)
    if band.sum() < _MIN_BAND:
        return values
    level = values[y0:y1, x0:x1][band].astype(np.float64)
    design = np.stack([np.ones_like(x), x - outline.x, y - outline.y], axis=-1)
    residual, plane = level - np.median(level), np.zeros(3)
    for _ in range(3):
        good = np.abs(residual) <= 4 / 0.6745 * np.median(np.abs(residual))
        plane = np.linalg.lstsq(design[band][good], level[good], rcond=None)[0]
        residual = level - design[band] @ plane
    flat = values.copy()
    flat[y0:y1, x0:x1] -= (design[..., 1:] @ plane[1:]).astype(np.float32)
    return flat


def _lines(values: NDArray[np.float32], kind: Kind, outline: Outline, width: float) -> _Lines:
    outer = 4 * width + 3
    # The plateau's slope needs a longer lever inside than the background does outside.
    return _Lines.of(values, kind, outline, width, (outer + 2 if kind == "disc" else outer, outer))


def _measure(lines: _Lines, level: float, camera_blur: float | None, straighten: Straighten | None) -> Boundary:
    reach = 0.7 * float(np.minimum(-lines.t[0], lines.t[-1]))
    fit = pro.fit_profiles(lines.grey, lines.t, lines.kind, np.zeros(len(lines.feet)), lines.width, lines.whole)
    there, use = _usable(fit, lines.whole, reach)
    fit = pro.fit_profiles(lines.grey, lines.t, lines.kind, np.where(use, fit.position, 0.0), fit.width, use)
    there, use = _usable(fit, lines.whole, reach)
    shift, ambiguity = _shift(lines, fit.width, level, camera_blur)
    points = lines.at(fit.position + shift)
    # One noise for the whole image; what differs from normal to normal is the edge.
    noise = float(np.sqrt(np.mean(fit.rms[use] ** 2)))
    expected = np.maximum(np.sqrt(fit.variance) * noise, _SIGMA_FLOOR)
    raw = scatter_about_ellipse(points, expected, use)
    straight = raw
    if straighten is not None:
        flat, stretch = straighten(np.where(use[:, None], points, lines.feet))
        straight = scatter_about_ellipse(flat, expected * stretch, use)
    if raw is None or straight is None:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    keep = straight.keep
    _require_share(keep)
    if straight.factor * float(np.median(expected[keep])) > _MAX_SCATTER * raw.outline.size:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    inflation = inflation_of(straight.residuals, keep)
    return Boundary(
        points=points[keep],
        sigma=expected[keep] * max(straight.factor, 1.0) * inflation,
        width=fit.width,
        height=float(np.median(fit.height[keep])),
        background=float(np.median(fit.background[keep])),
        outline=raw.outline,
        share=float(keep.mean()),
        outliers=float(1 - keep.sum() / there.sum()),
        excess=straight.factor,
        inflation=inflation,
        curvature=float(lines.curvature[keep].max() * fit.width),
        ambiguity=float(ambiguity[keep].max()),
    )


def _require_share(use: Mask) -> None:
    if use.mean() < _MIN_SHARE:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, f"{100 * use.mean():.0f} % of it could be.")


def _usable(fit: pro.ProfileFit, whole: Mask, reach: float) -> tuple[Mask, Mask]:
    """Return which normals show the boundary at all, and which of them fit the model as well as the others."""
    height = float(np.median(fit.height[whole])) if whole.any() else 0.0
    there = whole & (fit.height > _MIN_HEIGHT * height) & (np.abs(fit.position) < reach)
    _require_share(there)
    use = there & (fit.rms < max(_BAD_PROFILE * float(np.median(fit.rms[there])), _GOOD_PROFILE * height))
    _require_share(use)
    return there, use


def _shift(lines: _Lines, width: float, level: float, camera_blur: float | None) -> tuple[Array, Array]:
    """Return what has to be added to the measured positions (N,), px outwards, and how far off it may be (N,), px.

    Blurring by a Gaussian of standard deviation ``s`` moves the half height of a disc, and likewise the ridge of a
    ring, towards the centre of curvature by ``curvature s^2 / 2``: along the tangent ``u`` the boundary recedes by
    ``curvature u^2 / 2``, whose mean is that. Softness that the beam has itself moves nothing, so ``s`` is the camera's
    blur alone. Where that is not known, a disc's width is taken to be all blur, a ring's up to a limit.
    """
    if camera_blur is not None:
        blur, doubt = min(width, camera_blur), 0.0
    elif lines.kind == "disc":
        blur, doubt = width, width**2
    else:
        blur = min(width, _RING_BLUR)
        doubt = max(blur**2, width**2 - blur**2)
    shift = lines.curvature * blur**2 / 2
    if lines.kind == "disc" and level != 0.5:
        # An iso-level of the edge's own error function.
        shift = shift + width * ndtri(1 - level)
    return shift, lines.curvature * doubt / 2
