"""From a candidate to sub-pixel boundary points with their noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from planeopt.spot.adjustment import Fitted, fit_model, noise_law
from planeopt.spot.band import Band, band_round
from planeopt.spot.candidates import Candidate
from planeopt.spot.grey import Grey
from planeopt.spot.model import Freedom, Model, Seen, Terms, Widths, see, terms_of, variance
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind, NoSpotReason, SpotNotFound
from planeopt.spot.profiles import Start, rough_boundary
from planeopt.spot.scatter import inflation_of, scatter_about_ellipse
from planeopt.spot.segments import Segments, segments_of
from planeopt.spot.signs import level_dependence, response
from planeopt.spot.surfaces import waves

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Straighten = Callable[[Array], tuple[Array, Array]]
"""Raw pixels (N, 2) to pixels without distortion (N, 2) and the local stretch (N,)."""

_ROUNDS = 4
_STEPS = 6  # of Gauss-Newton, from a start
_LAST_ROUNDS = 3  # as long as a segment that was fitted to turns out not to fit
_LAST_STEPS = 3  # from the solution on some of the pixels, with all of them
_SETTLED = 0.05  # of the width: an ellipse that moves less is the same
_SOME = 2500  # pixels: enough for a start
_MOST = 20_000  # pixels that the shared parameters are fitted to
_FOREIGN, _NEIGHBOURS = 6.0, 2  # usual residuals, and px round it, from which a pixel is no plateau or background
_AWAY = 2.5  # widths from the edge, where there is nothing but these
_MEDIAN_OF_NORMAL = 0.6745  # of a standard normal variable's size
_WHOLE = 0.85  # of the segments: where fewer are good something hides the others
_BAD_SEGMENT = 6.0  # standard deviations of the segments' misfit
_QUANTILES = (0.05, 0.3)  # from which these are told
_GOOD_SEGMENT = 0.02  # of the plateau: a misfit that is good enough, however small the noise
_GOOD_START = 0.1  # the same at first, when the surfaces cannot follow an uneven plateau yet
_MIN_SHARE = 0.35  # of the boundary: a shorter arc hardly holds an ellipse
# Of the ellipse's size: what scatters more is not one, unless all of it is what the noise explains.
_MAX_SCATTER, _MAX_NOISE, _UNEXPECTED = 0.04, 0.15, 2.0
_MIN_WIDTHS = 1.5  # of the profile, in half the spot: less never reaches a plateau
_SIGMA_FLOOR = 1e-3  # px: finer than that no segment is placed
_OWN_ERROR = {"disc": 1.5e-4, "ring": 4e-4}  # px: of the model, on noiseless images; common to all points
_CLIP = 1.5  # standard deviations below full scale: from there on the mean is lower by more than 3 % of one
_MARGIN, _MARGIN_PX = 0.25, 64  # of the spot's size, and px, that are looked at round it
_WAVE = 30.0  # px of the boundary a wave of offset, plateau or background
_SURFACE_WAVES = 6
_LEAST_WAVES, _MOST_WAVES = 2, 4  # of the boundary: what an ellipse can do, at least
_NARROW = 6.0  # widths in half the spot: below, a plateau has hardly a shape
_MIN_INFORMATION = 10.0  # times the usual variance: beyond, a segment shows no edge
_SEEN_PLATEAU = 0.5  # of its pixels unclipped: else its shape is not known


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
    view, outline = _View.of(grey, candidate)
    start = rough_boundary(view.values, outline, candidate.kind, candidate.line_width)
    state = _State.at_start(start, view.kind, noise, camera_blur)
    settled, turn = False, 0
    while not settled and turn < _ROUNDS:
        before = state.outline
        state = _improved(view, state)
        settled = turn > 0 and _distance(before, state.outline) < _SETTLED * state.model.widths.mean
        turn += 1
    return _result(view, _fit(view, state, last=True), level, camera_blur, straighten)


@dataclass(frozen=True, eq=False)
class _View:
    """The part of the image that is looked at, and where its first pixel lies."""

    values: NDArray[np.float32]
    clipped: Mask | None
    kind: Kind
    origin: Array

    @classmethod
    def of(cls, grey: Grey, candidate: Candidate) -> tuple["_View", Outline]:
        """Return the part round a candidate, and the candidate's ellipse in it."""
        e = candidate.outline
        centre, half = np.array([e.x, e.y]), np.array(e.extent) + _MARGIN * e.size + _MARGIN_PX
        low = np.maximum(np.floor(centre - half), 0).astype(int)
        high = np.minimum(np.ceil(centre + half) + 1, grey.shape[::-1]).astype(int)
        if np.any(high - low < 4):
            raise SpotNotFound(NoSpotReason.TOUCHES_BORDER)
        box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        view = cls(grey.crop(box), grey.crop_clipped(box), candidate.kind, low.astype(np.float64))
        return view, e.moved(-view.origin)


@dataclass(frozen=True, eq=False)
class _State:
    """What is known so far: an ellipse, a model, and which of S segments of the boundary are the spot's."""

    outline: Outline
    model: Model
    good: Mask

    @property
    def is_first(self) -> bool:
        """Whether nothing has been fitted yet."""
        return len(self.model.surface) == 1

    @classmethod
    def at_start(cls, start: Start, kind: Kind, noise: float, camera_blur: float | None) -> "_State":
        total = start.width**2
        split = kind == "ring" or camera_blur is not None
        free = Freedom(0, 0, 0, 0, 0, False, False, camera_blur is None, split, False)
        if camera_blur is not None:
            widths = Widths(camera_blur**2, max(total - camera_blur**2, 0.01))
        else:
            widths = Widths(total / 2, total / 2) if kind == "ring" else Widths(total)
        law = np.array([max(noise, 1e-4) ** 2, 0.0, 0.0])
        return cls(start.outline, Model(kind, free, widths, np.zeros(1), np.zeros(1), law, start.height), start.seen)

    def good_of(self, count: int) -> Mask:
        """Return which of so many segments are good: those at the same share of the perimeter."""
        return self.good[(np.arange(count) * len(self.good)) // count]


@dataclass(frozen=True, eq=False)
class _Fit:
    """A model fitted to a band, and what each of S segments says: its point, and whether it is there and good."""

    band: Band
    fitted: Fitted
    terms: Terms
    usable: Mask
    segments: Segments
    points: Array
    there: Mask
    good: Mask
    some: Mask


def _improved(view: _View, state: _State) -> _State:
    """Fit to some of the pixels, and return the ellipse of all the segments."""
    fit = _fit(view, state, last=False)
    sigma = np.sqrt(np.where(np.isfinite(fit.segments.variance), fit.segments.variance, 1.0))
    found = scatter_about_ellipse(fit.points, np.maximum(sigma, _SIGMA_FLOOR), fit.good, fit.band.outline)
    if found is None:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    # The law of the noise is that of the good segments: what is not the spot's is no noise.
    inside = fit.usable & fit.good[fit.band.segment]
    terms = fit.terms.part(inside)
    seen = see(terms, fit.fitted.model)
    law = noise_law(seen, terms.values - seen.value)
    model = replace(fit.fitted.model, noise=law)
    # A segment that was not looked at is as good as the nearest that was.
    looked = np.flatnonzero(fit.band.chosen)
    middle = (looked[1:] + looked[:-1] + 1) // 2
    nearest = looked[np.searchsorted(middle, np.arange(fit.band.count), side="right")]
    return _State(found.outline, model, fit.good[nearest])


def _fit(view: _View, state: _State, *, last: bool) -> _Fit:
    outer = 4 * state.model.widths.mean + 3
    # The plateau's slope needs a longer lever inside than the background does outside.
    inner = outer + 2 if view.kind == "disc" else outer
    band = band_round(view.values, view.clipped, state.outline, inner, outer, most=None if last else _SOME)
    good = state.good_of(band.count)
    _require_share(good)
    free = _freedom(state, band, good)
    # The waves start anew: the ellipse has taken up what it could of them.
    model = replace(state.model, freedom=free, offset=np.zeros(2 * free.waves + 1))
    terms = terms_of(band, view.kind, free, model.widths).single()
    fit = _attempt(band, terms, model, good, last=last)
    for _ in range(_LAST_ROUNDS - 1 if last else 0):
        if not np.any(fit.some & ~fit.good):
            break
        fit = _attempt(band, terms, model, fit.good, last=last)
    return fit


def _attempt(band: Band, terms: Terms, model: Model, good: Mask, *, last: bool) -> _Fit:
    """Fit to the good segments (S,), and judge all of them by the result."""
    first, steps = len(model.surface) == 1, _LAST_STEPS if last else _STEPS
    some = _spread(band, good)
    usable = ~band.clipped & _unclipped(band.values, model.noise[0]) if band.clipped.any() else ~band.clipped
    robust = not last or good.mean() < _WHOLE
    fitted = fit_model(terms.part(usable & some[band.segment]), model, steps=steps, robust=robust)
    value = see(terms, fitted.model)
    # What is left out by what was measured is left out too often where the noise went up.
    alone = _unclipped(value.value, fitted.model.noise.sum()) & ~_foreign(band, terms, fitted.model, value)
    if np.any(alone != usable):
        usable = alone
        fitted = fit_model(terms.part(usable & some[band.segment]), fitted.model, steps=steps, robust=robust)
    if last:
        fitted = fitted.pruned()
    segments = segments_of(band, terms, fitted.model, usable)
    there, good = _judged(segments, fitted.model, band.chosen, _GOOD_START if first else _GOOD_SEGMENT)
    offset = fitted.model.offset @ waves(segments.theta, fitted.model.freedom.waves) + segments.offset
    feet, normals, _ = band.outline.at(segments.theta)
    return _Fit(band, fitted, terms, usable, segments, feet + normals * offset[:, None], there, good, some)


def _freedom(state: _State, band: Band, good: Mask) -> Freedom:
    """Return what can be told from so much of a spot of that size."""
    was, wide = state.model.freedom, band.outline.b / state.model.widths.mean
    room = int(band.outline.perimeter * good.mean() / _WAVE)
    # At first, and where a part is hidden, as little as may be: surfaces that are free to follow what hides it would.
    little = wide < _NARROW or state.is_first or good.mean() < _WHOLE
    degree, slopes = (1, False) if little else (2, True)
    surface_waves = max(degree, min(room, _SURFACE_WAVES) if slopes else 0)
    plateau, plateau_waves, plateau_slopes = degree, surface_waves, slopes
    if state.model.kind == "ring":
        # A slope of its brightness cannot be told from another place of the ridge.
        plateau, plateau_slopes = 0, False
    elif _share(band.clipped, band.u < -state.model.widths.mean) > 1 - _SEEN_PLATEAU:
        plateau, plateau_waves, plateau_slopes = 0, 0, False
    return Freedom(
        waves=int(np.clip(room, _LEAST_WAVES, _MOST_WAVES)),
        plateau=plateau,
        plateau_waves=plateau_waves,
        plateau_slopes=plateau_slopes,
        background=degree,
        background_waves=surface_waves,
        background_slopes=slopes,
        blur=was.blur,
        line=was.line,
        lean=was.line and not state.is_first,
    )


def _share(what: Mask, of: Mask) -> float:
    return float((what & of).sum()) / max(int(of.sum()), 1)


def _spread(band: Band, good: Mask) -> Mask:
    """Return which of the good segments (S,) the shared parameters are fitted to: all, or enough of them."""
    every = max(1, len(band.u) // _MOST)
    return good & (np.arange(band.count) % every == 0)


def _unclipped(value: Array, noise: float) -> Mask:
    """Return which pixels (M,) clipping leaves alone, where `value` (M,) is what they should be."""
    return value < 1.0 - _CLIP * np.sqrt(noise)


def _foreign(band: Band, terms: Terms, model: Model, seen: Seen) -> Mask:
    """Return which pixels (M,) away from the edge see something else than plateau or background: an obstacle, a lamp.

    Those that are off by more than so many usual residuals, and their neighbours. A segment of which they are left out
    still says where its edge is.
    """
    away = np.abs(terms.u - model.offset @ terms.boundary) > _AWAY * model.widths.mean
    off = np.abs(terms.values - seen.value) / np.sqrt(variance(model, seen))
    usual = float(np.median(off)) / _MEDIAN_OF_NORMAL
    far = away & (off > _FOREIGN * usual) & (np.abs(terms.values - seen.value) > _GOOD_SEGMENT * model.scale)
    return away & band.widened(far, _NEIGHBOURS) if far.any() else far


def _judged(segments: Segments, model: Model, chosen: Mask, enough: float) -> tuple[Mask, Mask]:
    """Return which segments show the boundary at all, and which of them fit the model as well as the others.

    Of those that were `chosen` (S,) to be looked at; a misfit of `enough` of the plateau is no reason against one.

    A bad segment's neighbours within the profile's width see what it sees.
    """
    there = np.isfinite(segments.variance)
    if not there.any():
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY)
    there &= segments.variance < _MIN_INFORMATION * np.median(segments.variance[there])
    misfit = segments.misfit
    # From the better ones: nearly half of all may be something else's.
    best, usual = np.quantile(misfit[there], _QUANTILES)
    spread = (usual - best) / float(ndtri(_QUANTILES[1]) - ndtri(_QUANTILES[0]))
    limit = usual + (_BAD_SEGMENT - float(ndtri(_QUANTILES[1]))) * spread
    least = (enough * model.scale) ** 2 / float(model.noise[0])
    bad = (chosen & ~there) | (misfit > max(limit, least))
    reach = int(np.ceil(model.widths.mean))
    near = np.convolve(np.concatenate([bad[-reach:], bad, bad[:reach]]), np.ones(2 * reach + 1), "valid") > 0
    good = chosen & ~near
    _require_share(good[chosen])
    return there, good


def _require_share(use: Mask) -> None:
    if use.mean() < _MIN_SHARE:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, f"{100 * use.mean():.0f} % of it could be.")


def _distance(before: Outline, after: Outline) -> float:
    return max(abs(getattr(before, name) - getattr(after, name)) for name in ("x", "y", "a", "b"))


def _skew(fit: _Fit) -> Array:
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


def _levels(fit: _Fit) -> tuple[float, float]:
    """Return the height of the plateau (of the ridge) and the background, as they are at the good segments.

    Raises
    ------
    SpotNotFound
        If it is not brighter than the background.
    """
    terms = fit.terms.part(fit.good[fit.band.segment])
    seen = see(terms, fit.fitted.model)
    height = float(np.median(seen.plateau))
    if fit.fitted.model.kind == "ring":
        # The light of a line: its peak is lower the wider it is.
        height /= fit.fitted.model.widths.mean
    if height <= 0:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, "It is not brighter than its surroundings.")
    return height, float(np.median(seen.value - seen.height))


def _result(view: _View, fit: _Fit, level: float, camera_blur: float | None, straighten: Straighten | None) -> Boundary:
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
    expected = np.maximum(np.sqrt(np.where(fit.good, segments.variance, 1.0)), _SIGMA_FLOOR)
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
    _require_share(keep)
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
    return Boundary(
        points=points[keep],
        sigma=np.hypot(expected[keep] * inflation * shared, _OWN_ERROR[kind] * np.sqrt(keep.sum())),
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
        level_dependence=level_dependence(fit.band, fit.terms, model, fit.usable, fit.good) if kind == "disc" else 0.0,
        response=response(fit.terms.part(fit.usable & fit.good[fit.band.segment]), model) if kind == "disc" else 0.0,
    )
