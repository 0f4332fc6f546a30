"""From a rough ellipse to the fit of all pixels round it, in rounds.

The first rounds look at some of the pixels, robustly, and with little that is free; each gives a better ellipse, the
law of the noise, and which segments are the spot's. The last one looks at all.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.adjustment import Fitted, fit_model, noise_law
from planeopt.spot.band import Band, band_round
from planeopt.spot.candidates import Candidate
from planeopt.spot.grey import Grey
from planeopt.spot.judgement import GOOD_SEGMENT, GOOD_START, foreign, judged, require_share, unclipped
from planeopt.spot.model import Freedom, Model, Seen, Terms, Widths, see, terms_of
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind, NoSpotReason, SpotNotFound
from planeopt.spot.profiles import Start
from planeopt.spot.scatter import scatter_about_ellipse
from planeopt.spot.segments import Segments, segments_of
from planeopt.spot.surfaces import waves

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIGMA_FLOOR = 1e-3
"""px: finer than that no segment is placed."""

_ROUNDS = 4
_STEPS = 6  # of Gauss-Newton, from a start
_LAST_ROUNDS = 3  # as long as segments that were fitted to turn out not to fit
_FEW_BAD = 0.02  # of them: fewer do no harm
_LAST_STEPS = 3  # from the solution on some of the pixels, with all of them
_ROUGHLY = 4.0  # times further off than in the last round the profile of a curved boundary may be before
_CLEAN = 0.95  # of a rough start's normals showed the boundary: it is whole
_FAR = 0.5  # of the width: from further off a fit with all free may end elsewhere
_SETTLED = 0.1  # of the width: an ellipse that moves less is the same
_SOME = 2500  # pixels: enough for a start
_FEWEST = 60  # pixels that a spot is told by
_MOST = 20_000  # pixels that the shared parameters are fitted to
_WHOLE = 0.85  # of the segments: where fewer are good something hides the others
_MARGIN, _MARGIN_PX = 0.25, 64  # of the spot's size, and px, that are looked at round it
_WAVE = 30.0  # px of the boundary a wave of offset, plateau or background
_SURFACE_WAVES = 6
_LEAST_WAVES, _MOST_WAVES = 2, 4  # of the boundary: what an ellipse can do, at least
_NARROW = 6.0  # widths in half the spot: below, a plateau has hardly a shape
_SEEN_PLATEAU = 0.5  # of its pixels unclipped: else its shape is not known


@dataclass(frozen=True, eq=False)
class View:
    """The part of the image that is looked at, and where its first pixel lies."""

    values: NDArray[np.float32]
    clipped: Mask | None
    black: Mask | None
    kind: Kind
    origin: Array

    @classmethod
    def of(cls, grey: Grey, candidate: Candidate) -> tuple["View", Outline]:
        """Return the part round a candidate, and the candidate's ellipse in it."""
        e = candidate.outline
        centre, half = np.array([e.x, e.y]), np.array(e.extent) + _MARGIN * e.size + _MARGIN_PX
        low = np.maximum(np.floor(centre - half), 0).astype(int)
        high = np.minimum(np.ceil(centre + half) + 1, grey.shape[::-1]).astype(int)
        if np.any(high - low < 4):
            raise SpotNotFound(NoSpotReason.TOUCHES_BORDER)
        box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        view = cls(grey.crop(box), grey.crop_clipped(box), grey.crop_black(box), candidate.kind, low.astype(np.float64))
        return view, e.moved(-view.origin)


@dataclass(frozen=True, eq=False)
class State:
    """What is known so far: an ellipse, a model, and which of S segments of the ellipse's boundary are the spot's."""

    outline: Outline
    model: Model
    good: Mask
    rough: bool
    """Whether this is a start of which some is not to be trusted, with which as little as may be is free."""

    @classmethod
    def at_start(cls, start: Start, kind: Kind, noise: float, camera_blur: float | None) -> "State":
        total = start.width**2
        split = kind == "ring" or camera_blur is not None
        free = Freedom(0, 0, 0, 0, 0, False, False, camera_blur is None, split, False, False)
        if camera_blur is not None:
            widths = Widths(camera_blur**2, max(total - camera_blur**2, 0.01))
        else:
            widths = Widths(total / 2, total / 2) if kind == "ring" else Widths(total)
        law = np.array([max(noise, 1e-4) ** 2, 0.0, 0.0])
        model = Model(kind, free, widths, np.zeros(1), np.zeros(1), law, start.height)
        return cls(start.outline, model, start.seen, rough=bool(start.seen.mean() < _CLEAN))

    def good_of(self, count: int) -> Mask:
        """Return which of so many segments are good: those at the same share of the perimeter."""
        return self.good[(np.arange(count) * len(self.good)) // count]


@dataclass(frozen=True, eq=False)
class BandFit:
    """A model fitted to a band, and what each of S segments says: its point, and whether it is there and good."""

    band: Band
    fitted: Fitted
    terms: Terms
    seen: Seen
    usable: Mask
    segments: Segments
    points: Array
    there: Mask
    good: Mask
    some: Mask


def fit_in_rounds(view: View, state: State) -> BandFit:
    """Return the fit of all segments, from a start.

    Raises
    ------
    SpotNotFound
        If too little of the boundary can be seen, or it is not an ellipse.
    """
    settled, turn = False, 0
    while not settled and turn < _ROUNDS:
        before = state
        state = _improved(view, state)
        moved = before.outline.distance_to(state.outline) / state.model.widths.mean
        settled = not before.rough and moved < _SETTLED
        if turn == 0 and not before.rough and moved > _FAR:
            # A start that was not what it seemed (of a clipped plateau it is not): again, with little free.
            state = replace(before, rough=True)
        turn += 1
    return _fit(view, state, last=True)


def _improved(view: View, state: State) -> State:
    """Fit to some of the pixels, and return the ellipse of all the segments."""
    fit = _fit(view, state, last=False)
    sigma = np.sqrt(np.where(np.isfinite(fit.segments.variance), fit.segments.variance, 1.0))
    found = scatter_about_ellipse(fit.points, np.maximum(sigma, SIGMA_FLOOR), fit.good, fit.band.outline)
    if found is None:
        raise SpotNotFound(NoSpotReason.NOT_AN_ELLIPSE)
    # The law of the noise is that of the good segments: what is not the spot's is no noise.
    inside = fit.usable & fit.good[fit.band.segment]
    _require_pixels(inside)
    seen = fit.seen.part(inside)
    law = noise_law(seen, fit.terms.values[inside] - seen.value)
    turn = found.outline.angle - fit.band.outline.angle
    model = replace(fit.fitted.model, noise=law, widths=fit.fitted.model.widths.turned(turn))
    # A segment that was not looked at is as good as the nearest that was.
    looked = np.flatnonzero(fit.band.chosen)
    middle = (looked[1:] + looked[:-1] + 1) // 2
    nearest = looked[np.searchsorted(middle, np.arange(fit.band.count), side="right")]
    good = fit.band.outline.carried(fit.good[nearest], found.outline)
    return State(found.outline, model, good, rough=False)


def _fit(view: View, state: State, *, last: bool) -> BandFit:
    outer = 4 * state.model.widths.mean + 3
    # The plateau's slope needs a longer lever inside than the background does outside.
    inner = outer + 2 if view.kind == "disc" else outer
    band = band_round(view.values, view.clipped, view.black, state.outline, inner, outer, most=None if last else _SOME)
    good = state.good_of(band.count)
    require_share(good)
    free = _freedom(state, band, good)
    # The waves start anew: the ellipse has taken up what it could of them.
    model = replace(state.model, freedom=free, offset=np.zeros(2 * free.waves + 1))
    terms = terms_of(band, view.kind, free, model.widths, np.float32, 1.0 if last else _ROUGHLY)
    enough = GOOD_START if state.rough else GOOD_SEGMENT
    fit = _attempt(band, terms, model, good, enough, last=last)
    for _ in range(_LAST_ROUNDS - 1 if last else 0):
        if _share(~fit.good, fit.some) < _FEW_BAD:
            break
        fit = _attempt(band, terms, model, fit.good, enough, last=last)
    return fit


def _attempt(band: Band, terms: Terms, model: Model, good: Mask, enough: float, *, last: bool) -> BandFit:
    """Fit to the good segments (S,), and judge all of them by the result."""
    steps = _LAST_STEPS if last else _STEPS
    some = _spread(band, good)
    usable = ~band.clipped & unclipped(band, band.values, model, measured=True)
    robust = not last or good.mean() < _WHOLE

    def fitted_to(use: Mask, start: Model) -> Fitted:
        among = use & some[band.segment]
        _require_pixels(among)
        return fit_model(terms.part(among), start, steps=steps, robust=robust)

    fitted = fitted_to(usable, model)
    seen = see(terms, fitted.model)
    # What is left out by what was measured is left out too often where the noise went up.
    alone = unclipped(band, seen.value, fitted.model, measured=False)
    alone &= ~foreign(band, terms, fitted.model, seen, good)
    # Less the light without the laser, full scale is lower: there the pixel itself says so.
    alone &= ~(band.clipped & (seen.value > band.values))
    if np.any(alone != usable):
        usable = alone
        fitted = fitted_to(usable, fitted.model)
        seen = see(terms, fitted.model)
    if last:
        fitted = fitted.pruned()
        seen = see(terms, fitted.model)
    segments = segments_of(band, terms, fitted.model, seen, usable)
    there, good = judged(segments, fitted.model, band.chosen, enough)
    offset = fitted.model.offset @ waves(segments.theta, fitted.model.freedom.waves) + segments.offset
    feet, normals, _ = band.outline.at(segments.theta)
    return BandFit(band, fitted, terms, seen, usable, segments, feet + normals * offset[:, None], there, good, some)


def _require_pixels(use: Mask) -> None:
    if use.sum() < _FEWEST:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, "Too few pixels show it alone.")


def _freedom(state: State, band: Band, good: Mask) -> Freedom:
    """Return what can be told from so much of a spot of that size."""
    was, wide = state.model.freedom, band.outline.b / state.model.widths.mean
    room = int(band.outline.perimeter * good.mean() / _WAVE)
    # At first, and where a part is hidden, as little as may be: surfaces that are free to follow what hides it would.
    little = wide < _NARROW or state.rough or good.mean() < _WHOLE
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
        lean=was.line and not state.rough,
        # A ring's own line varies in nearly the same way.
        oval=was.blur and not was.line and wide >= _NARROW and not state.rough,
    )


def _share(what: Mask, of: Mask) -> float:
    return float((what & of).sum()) / max(int(of.sum()), 1)


def _spread(band: Band, good: Mask) -> Mask:
    """Return which of the good segments (S,) the shared parameters are fitted to: all, or enough of them."""
    every = max(1, len(band.u) // _MOST)
    return good & (np.arange(band.count) % every == 0)
