"""Find the one thing in an image that looks like a spot: bright, elliptic, with an edge round most of it."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.rig import Rig
from planeopt.spot.grey import Box, Grey
from planeopt.spot.hints import BeamHint, box_of_previous, region_box
from planeopt.spot.lines import Look, look_at
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind, NoSpotReason, Spot, SpotNotFound
from planeopt.spot.pyramid import Level, pyramid
from planeopt.spot.search import WHOLE, Judged, search, verdicts_on
from planeopt.spot.trace import Traced, confirmed

Array = NDArray[np.floating]

_log = logging.getLogger(__name__)

_MIN_SIDE = 16  # px
_LARGE = 4_000_000  # pixels: in larger images the smallest spots are looked for only if nothing else is there
_NOISE_FACTOR = 3.0  # an edge has to be that many standard deviations of a pixel's noise
_DARK = 0.02  # of full scale
_MIN_CONTRAST = 0.004  # of full scale: one grey value of 8 bits
_LEAST_STEPS = 4  # grey values
_OVERLAP = 0.4  # of the size, and of the boundary: ellipses whose centres are closer, or that share more, are one thing
_AROUND = 48  # points
_RIVAL = 0.3  # a second find with that share of the best one's strength makes the choice a guess
_RIVAL_OF_PART = 0.1  # the same, where the best one is only partly seen
_PARTIAL = 0.75  # of the boundary
_CHANCES = 4  # rounds of confirming
_SUPPORT = 0.6  # of the boundary, where no rig says that it can be a spot,
_UNEVEN = 0.7  # of the height,
_LOW = 0.4  # of its edges: what is not brighter than its surroundings by more is a pattern
_JUDGED = 12  # the best, whose kind and contrast are measured


@dataclass(frozen=True, slots=True)
class Candidate:
    """Something that looks like a spot.

    Parameters
    ----------
    outline : Outline
        The ellipse (of a ring: the middle of its line), good to a pixel or two.
    kind : {"disc", "ring"}
        By the brightness of its inside.
    contrast : float
        Height of its edge, share of full scale.
    line_width : float
        Of a ring: the width of its line at half its height, px.
    touches_border : bool
        Whether a part of it lies off the image.
    support : float
        Share of its boundary that is seen, less the share beyond which it is as bright.
    strength : float
        What it is ranked by: its size times the root of its contrast, less for what speaks against it.
    """

    outline: Outline
    kind: Kind
    contrast: float
    line_width: float
    touches_border: bool
    support: float = 1.0
    strength: float = 1.0


@dataclass(frozen=True, slots=True)
class _Rejected:
    """The most striking thing that is not a spot, and why not."""

    reason: NoSpotReason | None = None
    place: tuple[float, float] = (0.0, 0.0)


def find_candidate(
    grey: Grey,
    noise: float,
    kind: Kind | None = None,
    *,
    rig: Rig | None = None,
    region: Sequence[float] | None = None,
    previous: Spot | ArrayLike | None = None,
) -> Candidate:
    """Return the one thing in the image that looks like a spot.

    Parameters
    ----------
    grey : Grey
    noise : float
        Standard deviation of a pixel, share of full scale.
    kind : {"disc", "ring"}, optional
        What it has to be.
    rig : Rig, optional
        Its beam says where the spot can lie.
    region : sequence of float, optional
        ``(x0, y0, x1, y1)``, px: where the spot's centre is looked for.
    previous : Spot or array_like, optional
        The spot of the frame before, its centre, or points of its boundary: it is looked for there first.

    Raises
    ------
    SpotNotFound
        If there is none, or no telling which of several it is.
    InputError
        If the region or the previous spot is none.
    """
    if min(grey.shape) < _MIN_SIDE:
        raise SpotNotFound(NoSpotReason.IMAGE_TOO_SMALL, f"It has {grey.shape[1]} x {grey.shape[0]} pixels.")
    box = region_box(region, grey.shape)
    beam = BeamHint(rig)
    near = box_of_previous(previous, box)
    if near is not None:
        try:
            return _find_in(grey, near, noise, kind, beam)
        except SpotNotFound as nothing:
            _log.debug("not where it was before: %s", nothing)
    return _find_in(grey, box, noise, kind, beam)


def _find_in(grey: Grey, box: Box, noise: float, kind: Kind | None, beam: BeamHint) -> Candidate:
    found, rejected = _search(grey, box, noise, kind, beam)
    right = [candidate for candidate in found if kind in (None, candidate.kind)]
    best = max(right or found, key=lambda candidate: candidate.strength, default=None)
    if best is None:
        raise _explain(grey, rejected)
    if not right:
        raise SpotNotFound(NoSpotReason.WRONG_KIND, f"A {best.kind} was found at {_places([best])}, not a {kind}.")
    rivals = [other for other in right if other is not best and _rivals(other, best)]
    if rivals:
        raise SpotNotFound(NoSpotReason.SEVERAL, f"{len(rivals) + 1} were found, at {_places([best, *rivals])}.")
    return best


def _rivals(other: Candidate, best: Candidate) -> bool:
    """Whether a second find makes the choice a guess: about as strong, and about as much of it is seen.

    Where many edges are, parts of ellipses are everywhere. One of them is believed only if it is alone.
    """
    share = _RIVAL if best.support > _PARTIAL else _RIVAL_OF_PART
    return other.strength > share * best.strength and other.support > _PARTIAL * best.support


def _places(candidates: list[Candidate]) -> str:
    return ", ".join(f"({found.outline.x:.0f}, {found.outline.y:.0f})" for found in candidates)


def _explain(grey: Grey, rejected: _Rejected) -> SpotNotFound:
    if grey.clipped is not None and grey.clipped.mean() > 0.5:
        return SpotNotFound(NoSpotReason.TOO_BRIGHT)
    if rejected.reason not in (None, NoSpotReason.NO_CONTRAST):
        return SpotNotFound(rejected.reason, f"It is near ({rejected.place[0]:.0f}, {rejected.place[1]:.0f}).")
    if np.quantile(grey.values, 0.999) < _DARK:
        return SpotNotFound(NoSpotReason.TOO_DARK)
    return SpotNotFound(NoSpotReason.NO_CONTRAST)


def _search(grey: Grey, box: Box, noise: float, kind: Kind | None, beam: BeamHint) -> tuple[list[Candidate], _Rejected]:
    """Return what looks like a spot, one of each, and why the most striking other thing does not."""
    x0, y0, x1, y1 = _padded(beam.box(box), grey.shape)
    if min(x1 - x0, y1 - y0) < _MIN_SIDE:
        return [], _Rejected()
    levels = pyramid(grey.search[y0:y1, x0:x1], (x0, y0), noise * grey.search_scale)
    first = 1 if (x1 - x0) * (y1 - y0) > _LARGE else 0
    found, rejected = _compete(grey, levels, range(first, len(levels)), box, noise, kind, beam)
    if not found and first > 0:
        found, rejected = _compete(grey, levels, range(first), box, noise, kind, beam)
    return found, rejected


def _padded(box: Box, shape: tuple[int, int]) -> Box:
    """Return a box with half of its size added on each side: the region holds the spot's centre, not all of it."""
    x0, y0, x1, y1 = box
    if x1 <= x0 or y1 <= y0:
        return box
    dx, dy = (x1 - x0) // 2, (y1 - y0) // 2
    return max(x0 - dx, 0), max(y0 - dy, 0), min(x1 + dx, shape[1]), min(y1 + dy, shape[0])


def _compete(
    grey: Grey, levels: list[Level], which: range, box: Box, noise: float, kind: Kind | None, beam: BeamHint
) -> tuple[list[Candidate], _Rejected]:
    scale = grey.search_scale
    # Of a camera with fewer bits than its file, full scale says little.
    least = min(_MIN_CONTRAST, _LEAST_STEPS * grey.quantum) if grey.quantum else _MIN_CONTRAST
    floor, threshold = least * scale, max(_NOISE_FACTOR * noise, least) * scale
    closely = _Closely(levels, grey, threshold, kind, beam.known)
    judged = search(levels, which, floor, threshold, box, beam, closely.settles)
    traced, verdicts = judged.traced, judged.verdicts
    candidates: list[Candidate] = []
    clutter = 0.0
    # What does not hold makes room for what it had kept out.
    for _ in range(_CHANCES):
        distinct = _distinct(judged)[:_JUDGED]
        looks = [closely.look(judged, index) for index in distinct]
        candidates = [look for look in looks if look is not None]
        failed = [index for index, look in zip(distinct, looks, strict=True) if look is None]
        if not failed:
            break
        clutter = max(clutter, float(judged.rank[failed].max()))
        judged.rank[failed] = 0
    # Among stronger things that turned out to be none, a part of an ellipse is one more of them.
    candidates = [c for c in candidates if c.support > _PARTIAL or c.strength > _RIVAL * clutter]
    _log.debug(
        "%d ellipses followed, %d of them no spots (%d off the beam), %d distinct",
        len(traced),
        sum(verdict is not None for verdict in verdicts),
        sum(verdict is NoSpotReason.OFF_BEAM for verdict in verdicts),
        len(candidates),
    )
    weight = traced.height * traced.ellipses.size * traced.support
    striking = [(weight[i], i) for i, bad in enumerate(verdicts) if bad is not None]
    if not striking:
        return candidates, _Rejected(NoSpotReason.NOT_AN_ELLIPSE if clutter > 0 else None)
    worst = max(striking)[1]
    x, y = traced.ellipses.centre[worst].tolist()
    return candidates, _Rejected(verdicts[worst], (x, y))


class _Closely:
    """A closer look at single ellipses, once at each.

    Parameters
    ----------
    levels : list of Level
    grey : Grey
    threshold : float
        The least height of an edge, in units of the levels.
    kind : {"disc", "ring"} or None
        What it has to be.
    told : bool
        Whether a rig says where it can be.
    """

    def __init__(self, levels: list[Level], grey: Grey, threshold: float, kind: Kind | None, told: bool) -> None:
        self._levels, self._grey, self._threshold, self._told = levels, grey, threshold, told
        self._kind: Kind | None = kind
        self._looks: dict[int, Candidate | None] = {}

    def look(self, judged: Judged, index: int) -> Candidate | None:
        """Return one ellipse as a candidate, or ``None`` if it does not hold."""
        if index not in self._looks:
            traced = confirmed(self._levels, judged.traced[np.array([index])])
            look = look_at(self._levels, traced.ellipses, self._kind)
            holds = verdicts_on(traced, np.zeros(1), self._threshold, self._told)[0] is None
            holds = holds and (self._told or _stands_alone(look, traced))
            strength = float(judged.rank[index])
            self._looks[index] = _candidate(look, traced, strength, self._grey) if holds else None
        return self._looks[index]

    def settles(self, judged: Judged, index: int) -> bool:
        """Return whether one ellipse is a spot of the right kind, and nearly all of it is seen."""
        found = self.look(judged, index)
        return found is not None and found.support > _PARTIAL and self._kind in (None, found.kind)


def _stands_alone(look: Look, traced: Traced) -> bool:
    """Return whether it is a spot by its looks alone: in patterns are edges enough for many ellipses."""
    height = look.high - look.low
    is_one = height > _LOW * traced.height[0] and look.uneven < _UNEVEN
    return bool(is_one and traced.support[0] - traced.beyond[0] > _SUPPORT)


def _distinct(judged: Judged) -> list[int]:
    """Return the best of each heap of ellipses that lie within one another, best first.

    Two that overlap are two things only if the lesser one is seen nearly whole, for the most part outside of the
    other: through what is left of one spot many ellipses can be drawn.
    """
    kept: list[int] = []
    ellipses, rank = judged.traced.ellipses, judged.rank
    major, size, centre = ellipses.semi_axes[:, 0], ellipses.size, ellipses.centre
    points, _, share = ellipses.at(_AROUND)
    for index in np.argsort(-rank, kind="stable").tolist():
        if rank[index] <= 0:
            break
        near = [other for other in kept if np.hypot(*(centre[other] - centre[index])) < max(major[other], major[index])]
        better = ellipses[np.array(near, dtype=np.intp)]
        out = better.radius_of(np.broadcast_to(points[index], (len(near), _AROUND, 2))) > 1.05
        apart = np.linalg.norm(better.centre - centre[index], axis=1) > _OVERLAP * np.maximum(size[near], size[index])
        if np.all(apart & (judged.seen[index] > WHOLE) & (out @ share[index] > _OVERLAP)):
            kept.append(index)
    return kept


def _candidate(look: Look, traced: Traced, strength: float, grey: Grey) -> Candidate:
    light = np.maximum(np.array([look.high, look.low]) / grey.search_scale, 0)
    if grey.image.dtype.kind == "u" and grey.dark is None:
        light = light**grey.gamma
    return Candidate(
        outline=look.outline,
        kind=look.kind,
        contrast=float(light[0] - light[1]),
        line_width=look.line_width,
        touches_border=bool(traced.outside[0] > 0),
        support=float(traced.support[0] - traced.beyond[0]),
        strength=strength,
    )
