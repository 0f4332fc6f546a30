"""Follow up the bright places of an image, the most promising first, and judge what comes of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.ellipses import joined, like, unlike
from planeopt.spot.grey import Box
from planeopt.spot.hints import BeamHint
from planeopt.spot.points import NoSpotReason
from planeopt.spot.pyramid import Level, centres
from planeopt.spot.rays import Seeds, all_seeds, ellipses_through, seeds_at
from planeopt.spot.trace import FINE, Traced, together, trace

Array = NDArray[np.floating]

_MIN_SIZE, _MIN_MINOR = 3.6, 2.4  # px: below, background, edge and plateau cannot be told apart
_SEEDS, _CENTRES = 120, 16  # of a level
_COARSE = 2  # levels: half and quarter size come after those
_LEAST_SHARE, _LARGEST = 0.3, 9.0  # of a spot's height in the response of a level; px of the level
_BATCHES = 4, 12, 12, 12, 16, 16  # seeds that are followed up together, and no more: that is what time there is
_WORTH = 0.12  # of the best one's strength: a seed that promises less cannot rival it
WHOLE = 0.85  # of the boundary
_VOTED = 150_000  # pixels: on larger levels edges do not vote, which takes long and finds small things
_AGREE = 0.3  # of the rays
_ALIKE = 0.1  # of the size: ellipses that differ by less are followed once
_SAME = 0.05  # of the size: those that start where others started or ended
_MAX_RATIO = 12.5  # of the semi-axes: a tilt of 85 degrees
_MIN_SUPPORT = 0.55  # of the boundary
_MAX_RUNS = 3  # pieces in which it is seen
_SOFT = 0.5  # sharpness: what is softer and cut off has no outline to complete
_MIN_REST = 0.8  # of the boundary that is on the image, if some of it is not
_MAX_BEYOND = 0.3  # of the boundary, of what is not seen of it: with more light beyond it, it is not a boundary
_MOST_BEYOND, _FITS = 0.4, 2.0  # the same for what fits the beam that well: a misfit
_MOST = 0.8  # of the boundary
_MAX_OUTSIDE = 0.45  # of the boundary
_TOUCHING = 0.05  # of the boundary: with less of it off the image it lies inside


@dataclass(frozen=True, eq=False)
class Judged:
    """K ellipses that were followed up, and what is thought of them.

    Parameters
    ----------
    traced : Traced
    verdicts : list
        Why each is no spot, or None.
    seen : (K,) array
        Share of the boundary that is seen, less the share beyond which it is as bright.
    rank : (K,) array
        Size times the root of the height of the edge, less for what speaks against it; 0 for what is no spot.
    """

    traced: Traced
    verdicts: list[NoSpotReason | None]
    seen: Array
    rank: Array


def search(levels: list[Level], which: range, floor: float, threshold: float, box: Box, beam: BeamHint) -> Judged:
    """Follow up the bright places of an image until what is left cannot rival what was found.

    Parameters
    ----------
    levels : list of Level
        From fine to coarse.
    which : range
        Those that are looked at.
    floor, threshold : float
        By how much a place and an edge have to stand out, in units of the image.
    box : tuple of int
        Where a place has to lie.
    beam : BeamHint
    """
    found = _Search(levels, threshold, beam)
    # The coarse levels cost next to nothing, and what they show need not be looked into on the finer ones.
    coarse = [index for index in which if index >= _COARSE]
    for group in (coarse, *([index] for index in reversed(which) if index < _COARSE)):
        if group:
            found.follow_up(all_seeds([_seeds(index, which.start, floor, box, found) for index in group]))
    everything = found.everything
    return Judged(
        together([judged.traced for judged in everything]),
        [verdict for judged in everything for verdict in judged.verdicts],
        np.concatenate([np.empty(0), *(judged.seen for judged in everything)]),
        np.concatenate([np.empty(0), *(judged.rank for judged in everything)]),
    )


class _Search:
    """What was followed up so far.

    Parameters
    ----------
    levels : list of Level
    threshold : float
        The least height of an edge, in units of the image.
    beam : BeamHint
    """

    def __init__(self, levels: list[Level], threshold: float, beam: BeamHint) -> None:
        self.levels, self.threshold, self.beam = levels, threshold, beam
        self.everything: list[Judged] = []
        self.best = 0.0
        image = levels[min(_COARSE, len(levels) - 1)].image
        self.range = 2 * float(image.max() - image.min())
        self._whole = self._known = joined([])

    def explained(self, places: Array) -> NDArray[np.bool_]:
        """Return which places lie in a spot that is seen nearly whole: they have nothing else to say."""
        if not len(self._whole) or not len(places):
            return np.zeros(len(places), dtype=bool)
        radius = self._whole.radius_of(np.broadcast_to(places, (len(self._whole), *places.shape)))
        return np.any(radius < 1, axis=0)

    def follow_up(self, pending: Seeds) -> None:
        """Follow up seeds, the most promising first."""
        promise = pending.promise
        pending = pending[np.argsort(-promise, kind="stable")]
        for count in _BATCHES:
            pending = pending[pending.promise > max(_WORTH * self.best, 1e-12)]
            if not len(pending):
                break
            batch, pending = pending[:count], pending[count:]
            judged = self._judge(batch)
            self.everything.append(judged)
            self.best = max(self.best, float(judged.rank.max(initial=0.0)))
            whole = judged.traced.ellipses[(judged.rank > 0) & (judged.seen > WHOLE)]
            self._whole = joined([self._whole, whole[unlike(whole, whole.size, _ALIKE)]])
            pending = pending[~self.explained(pending.place)]

    def _judge(self, seeds: Seeds) -> Judged:
        ellipses, share, found_at = ellipses_through(seeds)
        kept = np.flatnonzero((share > _AGREE) & ~like(ellipses, self._known, _SAME))
        kept = kept[unlike(ellipses[kept], share[kept], _ALIKE)]
        traced = trace(self.levels, ellipses[kept], found_at[kept])
        misfit = self.beam.misfit(traced.ellipses)
        verdicts = verdicts_on(traced, misfit, self.threshold, self.beam.known)
        seen = np.maximum(traced.support - traced.beyond, 0)
        seen = np.where(self.beam.known & (misfit < _FITS), np.maximum(seen, traced.support / 2), seen)
        rank = traced.ellipses.size * np.sqrt(traced.height) * (seen * traced.sharpness) ** 2 / (1 + misfit**2)
        good = np.array([verdict is None for verdict in verdicts], dtype=bool)
        self._known = joined([self._known, ellipses[kept], traced.ellipses[good]])
        return Judged(traced, verdicts, seen, np.where(good, rank, 0))


def _seeds(index: int, finest: int, floor: float, box: Box, found: _Search) -> Seeds:
    """Return the places that show at a level and may be in a spot that rivals what was found already."""
    level = found.levels[index]
    # What is so faint that it cannot rival what was found.
    floor = max(floor, _LEAST_SHARE * (_WORTH * found.best / (_LARGEST * level.factor)) ** 2)
    places = level.peaks(floor, _SEEDS) if floor < found.range else np.empty((0, 2))
    if level.image.size < _VOTED:
        places = np.concatenate([places, centres(level, floor, _CENTRES)])
    places = places[_inside(places, box) & found.beam.allows(places) & ~found.explained(places)]
    # One level finer: from a part of an ellipse the rest follows only if the edges are in their places.
    return seeds_at(found.levels, max(index - 1, finest), places)


def _inside(places: Array, box: Box) -> NDArray[np.bool_]:
    x0, y0, x1, y1 = box
    return np.all((places >= [x0 - 0.5, y0 - 0.5]) & (places <= [x1 - 0.5, y1 - 0.5]), axis=1)


def verdicts_on(traced: Traced, misfit: Array, threshold: float, told: bool) -> list[NoSpotReason | None]:
    """Return for each ellipse why it is no spot, or None.

    If a rig has told where it can be, something bright may hide a part of it.
    """
    small = (traced.ellipses.size < _MIN_SIZE) | (traced.ellipses.semi_axes[:, 1] < _MIN_MINOR)
    # Of what is cut off by the border the rest has to be seen: many ellipses fit to a corner.
    inside = traced.outside < _TOUCHING
    whole = (traced.support > _MIN_REST * (1 - traced.outside)) & (traced.sharpness > _SOFT)
    cut = (traced.outside > _MAX_OUTSIDE) & whole
    least = np.where(inside, _MIN_SUPPORT, 1 - _MAX_OUTSIDE - _TOUCHING)
    hidden = told & (misfit < _FITS)
    shapeless = (traced.support < least) | (traced.beyond > np.where(hidden, _MOST_BEYOND, _MAX_BEYOND))
    shapeless |= ~inside & ~whole
    # What hides a part of a spot is seldom as bright as the spot; where edges are everywhere, much is.
    shapeless |= ~hidden & (traced.support < _MOST) & (traced.beyond > _MAX_BEYOND * (1 - traced.support))
    axes = traced.ellipses.semi_axes
    shapeless |= traced.runs > _MAX_RUNS
    shapeless |= axes[:, 0] > _MAX_RATIO * axes[:, 1]
    # Large spots are looked at on coarser levels, which have less noise.
    faint = traced.height < threshold * 0.5 / np.sqrt(np.maximum(traced.ellipses.size / FINE, 1))
    rules = (
        (faint, NoSpotReason.NO_CONTRAST),
        (small, NoSpotReason.TOO_SMALL),
        (cut, NoSpotReason.TOUCHES_BORDER),
        (shapeless, NoSpotReason.NOT_AN_ELLIPSE),
        (np.isinf(misfit), NoSpotReason.OFF_BEAM),
    )
    return [next((reason for rule, reason in rules if rule[index]), None) for index in range(len(traced))]
