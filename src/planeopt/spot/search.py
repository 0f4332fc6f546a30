"""Follow up the bright places of an image, the most promising first, and judge what comes of them."""

from collections.abc import Callable
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
_WORTH = 0.12  # of the best one's strength: a seed that promises less cannot rival it,
_WORTH_SETTLED = 0.2  # nor one that promises less than that, if the best one was looked at closely
_NEARLY = 0.4  # of the response to what fills a box of 5 px: that of a level of half the size, smoothed before
_MANY = 20_000  # places: no quicker to look through than a level
WHOLE = 0.85  # of the boundary
_GLANCED = 20_000  # pixels: smaller levels are looked at first
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

    def and_also(self, others: "Judged") -> "Judged":
        """Return these and others; the indices of these remain."""
        return Judged(
            together([self.traced, others.traced]),
            [*self.verdicts, *others.verdicts],
            np.concatenate([self.seen, others.seen]),
            np.concatenate([self.rank, others.rank]),
        )


def search(
    levels: list[Level],
    which: range,
    floor: float,
    threshold: float,
    box: Box,
    beam: BeamHint,
    settles: Callable[[Judged, int], bool],
) -> Judged:
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
    settles : callable
        Whether the ellipse of an index, looked at more closely, is so clearly a spot that only what is nearly as strong
        can make the choice a guess.
    """
    found = _Search(levels, which.start, floor, threshold, box, beam, settles)
    coarse = [index for index in which if index >= _COARSE and levels[index].image.size < _VOTED] or [which.stop - 1]
    small = [index for index in coarse if levels[index].image.size < _GLANCED] or coarse[-1:]
    # Most spots are the most promising thing on the smallest levels. All that is left then is to look for rivals.
    pending = found.follow_up(found.seeds(small), _BATCHES[:1])
    others = found.seeds([index for index in coarse if index not in small])
    found.follow_up(all_seeds([pending, others]), _BATCHES[1:])
    # The coarse levels cost next to nothing, and what they show need not be looked into on the finer ones.
    for index in range(coarse[0] - 1, which.start - 1, -1):
        if not found.shows_nothing_else(index):
            found.follow_up(found.seeds([index]), _BATCHES)
    return found.judged


class _Search:
    """What was followed up so far.

    Parameters
    ----------
    levels : list of Level
    finest : int
        The first of those that are looked at.
    floor, threshold, box, beam, settles
        See `search`.
    """

    def __init__(
        self,
        levels: list[Level],
        finest: int,
        floor: float,
        threshold: float,
        box: Box,
        beam: BeamHint,
        settles: Callable[[Judged, int], bool],
    ) -> None:
        self._levels, self._finest, self._floor, self._threshold = levels, finest, floor, threshold
        self._box, self._beam, self._settles = box, beam, settles
        self.judged = Judged(together([]), [], np.empty(0), np.empty(0))
        self._least = 0.0  # strength: what has less cannot rival what was found
        self._whole = self._known = joined([])

    def seeds(self, group: list[int]) -> Seeds:
        """Return the places that show at some levels and may be in a spot that rivals what was found already."""
        shown = [self._places(index) for index in group]
        every = np.concatenate([np.empty((0, 2)), *shown])
        at = np.repeat(np.array(group, dtype=np.intp), [len(places) for places in shown])
        kept = np.flatnonzero(_inside(every, self._box))
        kept = kept[self._beam.allows(every[kept]) & ~self._explained(every[kept])]
        # One level finer: from a part of an ellipse the rest follows only if the edges are in their places.
        parts = [(max(index - 1, self._finest), every[kept[at[kept] == index]]) for index in group]
        return all_seeds([seeds_at(self._levels, index, places) for index, places in parts])

    def _places(self, index: int) -> Array:
        level, floor = self._levels[index], self._faintest(index)
        places = level.peaks(floor, _SEEDS)
        return np.concatenate([places, centres(level, floor, _CENTRES)]) if level.image.size < _VOTED else places

    def _faintest(self, index: int) -> float:
        """Return the least response of a level to what can rival what was found."""
        return max(self._floor, _LEAST_SHARE * (self._least / (_LARGEST * self._levels[index].factor)) ** 2)

    def shows_nothing_else(self, index: int) -> bool:
        """Return whether what is bright on a level lies in spots that are seen nearly whole.

        Told from the next level, of a quarter of the pixels; what is bright only nearly as much counts there.
        """
        if not len(self._whole):
            return False
        places = self._levels[index + 1].brighter(_NEARLY * self._faintest(index))
        return len(places) < _MANY and bool(np.all(self._explained(places) | ~_inside(places, self._box)))

    def _explained(self, places: Array) -> NDArray[np.bool_]:
        """Return which places lie in a spot that is seen nearly whole: they have nothing else to say."""
        if not len(self._whole) or not len(places):
            return np.zeros(len(places), dtype=bool)
        radius = self._whole.radius_of(np.broadcast_to(places, (len(self._whole), *places.shape)))
        return np.any(radius < 1, axis=0)

    def follow_up(self, pending: Seeds, batches: tuple[int, ...]) -> Seeds:
        """Follow up seeds, the most promising first; return those that are left."""
        promise = pending.promise
        pending = pending[np.argsort(-promise, kind="stable")]
        for count in batches:
            pending = pending[pending.promise > max(self._least, 1e-12)]
            if not len(pending):
                break
            batch, pending = pending[:count], pending[count:]
            judged = self._judge(batch)
            self.judged = self.judged.and_also(judged)
            self._weigh()
            whole = judged.traced.ellipses[(judged.rank > 0) & (judged.seen > WHOLE)]
            self._whole = joined([self._whole, whole[unlike(whole, whole.size, _ALIKE)]])
            pending = pending[~self._explained(pending.place)]
        return pending

    def _weigh(self) -> None:
        """Raise what a find has to be worth to that of the best one; more, if that is clearly a spot."""
        if not len(self.judged.rank):
            return
        best = int(self.judged.rank.argmax())
        rank = float(self.judged.rank[best])
        self._least = max(self._least, _WORTH * rank)
        if _WORTH_SETTLED * rank > self._least and self._settles(self.judged, best):
            self._least = _WORTH_SETTLED * rank

    def _judge(self, seeds: Seeds) -> Judged:
        ellipses, share, found_at = ellipses_through(seeds)
        kept = np.flatnonzero((share > _AGREE) & ~like(ellipses, self._known, _SAME))
        kept = kept[unlike(ellipses[kept], share[kept], _ALIKE)]
        traced = trace(self._levels, ellipses[kept], found_at[kept])
        misfit = self._beam.misfit(traced.ellipses)
        verdicts = verdicts_on(traced, misfit, self._threshold, self._beam.known)
        seen = np.maximum(traced.support - traced.beyond, 0)
        seen = np.where(self._beam.known & (misfit < _FITS), np.maximum(seen, traced.support / 2), seen)
        rank = traced.ellipses.size * np.sqrt(traced.height) * (seen * traced.sharpness) ** 2 / (1 + misfit**2)
        good = np.array([verdict is None for verdict in verdicts], dtype=bool)
        self._known = joined([self._known, ellipses[kept], traced.ellipses[good]])
        return Judged(traced, verdicts, seen, np.where(good, rank, 0))


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
