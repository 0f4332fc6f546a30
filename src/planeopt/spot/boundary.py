"""From a candidate to sub-pixel boundary points with their noise."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from planeopt.spot.candidates import Candidate
from planeopt.spot.grey import Grey
from planeopt.spot.judgement import require_share
from planeopt.spot.outline import Outline
from planeopt.spot.points import NoSpotReason, SpotNotFound
from planeopt.spot.profiles import rough_boundary
from planeopt.spot.rounds import SIGMA_FLOOR, BandFit, State, View, fit_in_rounds
from planeopt.spot.scatter import inflation_of, scatter_about_ellipse
from planeopt.spot.signs import level_dependence, response
from planeopt.spot.surfaces import waves

Array = NDArray[np.float64]
Straighten = Callable[[Array], tuple[Array, Array]]
"""Raw pixels (N, 2) to pixels without distortion (N, 2) and the local stretch (N,)."""

# Of the ellipse's size: what scatters more is not one, unless all of it is what the noise explains.
_MAX_SCATTER, _MAX_NOISE, _UNEXPECTED = 0.04, 0.15, 2.0
_MAX_SIGMA = 0.02  # of the ellipse's size, for that size: beyond, nothing is measured
_MIN_WIDTHS = 1.5  # of the profile, in half the spot: less never reaches a plateau
_OWN_ERROR = {"disc": 1.5e-4, "ring": 4e-4}  # px: of the model, on noiseless images; common to all points


@dataclass(frozen=True, eq=False)
class Boundary:
    """What was measured; N points.

    Parameters
    ----------
    points : (N, 2) array
        Raw pixels.
    sigma : (N,) array
        px, inflated for correlation.
    rejected : (M, 2) array
        Points that were measured and left out.
    width : float
        Standard deviation of the profile, px.
    height, background : float
        Of the plateau (the ridge) and below it, share of full scale.
    noise : float
        Standard deviation of a pixel of the background, share of full scale.
    outline : Outline
        Fitted to the points.
    share : float
        Of the boundary that could be measured.
    outliers : float
        Share of segments that were there but did not fit.
    excess : float
        Scatter about the ellipse over what the pixels' noise explains.
    inflation : float
        By which `sigma` exceeds what the pixels' noise explains, because of scatter and correlation.
    shared : float
        By which it exceeds that because of what all points share: blur, plateau, background.
    curvature : float
        Largest curvature times `width`.
    ambiguity : float
        What the split of `width` into the beam's own softness and blur leaves open, px: two standard deviations of
        a ring's, all of a disc's.
    level_dependence : float
        Of a disc: by how much its ellipse differs between the lower and the upper half of the edge, px, where that is
        more than chance; else 0.
    response : float
        Of a disc: the power of the light, less 1, that the edge's shape takes the grey values for, where that is more
        than chance; else 0.
    """

    points: Array
    sigma: Array
    rejected: Array
    width: float
    height: float
    background: float
    noise: float
    outline: Outline
    share: float
    outliers: float
    excess: float
    inflation: float
    shared: float
    curvature: float
    ambiguity: float
    level_dependence: float
    response: float


def measure_boundary(
    grey: Grey,
    candidate: Candidate,
    *,
    noise: float = 0.0,
    level: float = 0.5,
    camera_blur: float | None = None,
    straighten: Straighten | None = None,
) -> Boundary:
    """Measure the boundary of a candidate in segments of about one pixel.

    Parameters
    ----------
    grey : Grey
    candidate : Candidate
    noise : float
        Standard deviation of a pixel, as a start.
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
    if camera_blur is not None and candidate.outline.b < _MIN_WIDTHS * camera_blur:
        raise SpotNotFound(
            NoSpotReason.TOO_SMALL, f"It is {2 * candidate.outline.b:.1f} px across, the blur {camera_blur:g} px."
        )
    view, outline = View.of(grey, candidate)
    start = rough_boundary(view.values, outline, candidate.kind, candidate.line_width)
    state = State.at_start(start, view.kind, noise, camera_blur)
    return _result(view, fit_in_rounds(view, state), level, camera_blur, straighten)


def _skew(fit: BandFit) -> Array:
    """Return by how much (S,) the symmetric profile is fitted outside the ridge of a line that leans, px.

    Where the beam's scale ``h`` leans by ``L``, its line is wider outside than inside: ``u = h (t + L t^2 / 2)`` for
    ``t`` of the beam's radius. To first order that adds ``L u^3 / 2 h l^2`` times the line, of variance ``l^2``, to it;
    blurred, and projected on the derivative of the profile of variance ``w^2`` by its place, this is a shift by
    ``(3 l^2 - 3/2 l^4 / w^2) L / 2h``.
    """
    widths, outline, theta = fit.fitted.model.widths, fit.band.outline, fit.segments.theta
    stretch = 1 / (np.hypot(np.cos(theta) / outline.a, np.sin(theta) / outline.b) * outline.size)
    lean = np.array(widths.lean) @ waves(theta, 1)[1:]
    line = widths.line * (stretch * (1 + lean)) ** 2
    return (3 * line - 1.5 * line**2 / (widths.blur + line)) * lean / (2 * outline.size * stretch)


def _levels(fit: BandFit) -> tuple[float, float]:
    """Return the height of the plateau (of the ridge) and the background, as they are at the good segments.

    Raises
    ------
    SpotNotFound
        If it is not brighter than the background.
    """
    seen = fit.seen.part(fit.good[fit.band.segment])
    height = float(np.median(seen.plateau))
    if fit.fitted.model.kind == "ring":
        # The light of a line: its peak is lower the wider it is.
        height /= fit.fitted.model.widths.mean
    if height <= 0:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, "It is not brighter than its surroundings.")
    return height, float(np.median(seen.value - seen.height))


def _result(
    view: View, fit: BandFit, level: float, camera_blur: float | None, straighten: Straighten | None
) -> Boundary:
    kind = view.kind
    model, segments = fit.fitted.model, fit.segments
    width = model.widths.mean
    _, normals, curvature = fit.band.outline.at(segments.theta)
    points = fit.points + view.origin
    if kind == "ring":
        points = points - normals * _skew(fit)[:, None]
    elif level != 0.5:
        # An iso-level of the edge's own error function.
        points = points + normals * (width * ndtri(1 - level))
    expected = np.maximum(np.sqrt(np.where(fit.good, segments.variance, 1.0)), SIGMA_FLOOR)
    raw = scatter_about_ellipse(points, expected, fit.good, fit.band.outline.moved(view.origin))
    straight = raw
    if straighten is not None:
        flat, stretch = straighten(
            np.where(fit.good[:, None], points, fit.band.outline.at(segments.theta)[0] + view.origin)
        )
        straight = scatter_about_ellipse(flat, expected * stretch, fit.good)
    if raw is None or straight is None:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    keep = straight.keep
    require_share(keep)
    scatter = straight.factor * float(np.median(expected[keep])) / raw.outline.size
    if scatter > (_MAX_SCATTER if straight.factor > _UNEXPECTED else _MAX_NOISE):
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    if raw.outline.b < _MIN_WIDTHS * width:
        raise SpotNotFound(NoSpotReason.TOO_SMALL, f"It is {2 * raw.outline.b:.1f} px across.")
    inflation = inflation_of(straight)
    height, background = _levels(fit)
    shared = fit.fitted.shared_inflation(float(fit.good.sum() / max((fit.good & fit.some).sum(), 1)))
    if kind == "ring" or camera_blur is not None:
        ambiguity = float(curvature[keep].max()) * fit.fitted.blur_sigma
    else:
        ambiguity = float(curvature[keep].max()) * width**2 / 2
    sigma = np.hypot(expected[keep] * inflation * shared, _OWN_ERROR[kind] * np.sqrt(keep.sum()))
    if float(np.median(sigma)) > _MAX_SIGMA * np.sqrt(keep.sum()) * raw.outline.size:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, "Where it is, is hardly known.")
    return Boundary(
        points=points[keep],
        sigma=sigma,
        rejected=points[fit.there & ~keep],
        width=width,
        height=height,
        background=background,
        noise=float(np.sqrt(model.noise[0])),
        outline=raw.outline,
        share=float(keep.mean()),
        outliers=float(1 - keep.sum() / max(fit.there.sum(), 1)),
        excess=straight.factor,
        inflation=inflation,
        shared=shared,
        curvature=float(curvature[keep].max() * width),
        ambiguity=ambiguity,
        level_dependence=level_dependence(fit.band, fit.terms, model, fit.seen, fit.usable, fit.good)
        if kind == "disc"
        else 0.0,
        response=response(fit.terms.part(fit.usable & fit.good[fit.band.segment]), model) if kind == "disc" else 0.0,
    )
