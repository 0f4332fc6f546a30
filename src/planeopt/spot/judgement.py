"""Which pixels and which segments of a band are the spot's: the others are clipped, hidden, or something else."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from planeopt.spot.band import Band
from planeopt.spot.model import Model, Seen, Terms, variance
from planeopt.spot.points import NoSpotReason, SpotNotFound
from planeopt.spot.robust import deviation
from planeopt.spot.segments import Segments

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GOOD_SEGMENT = 0.02
"""Of the plateau: a misfit that is good enough, however small the noise."""

GOOD_START = 0.1
"""The same at first, when the surfaces cannot follow an uneven plateau yet."""

_FOREIGN = 6.0  # usual residuals, from which a pixel is no plateau or background
_SKIRT = 2.0  # widths round it, in which the blurred border of what is there still tells
_AWAY = 2.5  # widths from the edge, where there is nothing but these
_BAD_SEGMENT = 6.0  # standard deviations of the segments' misfit
_QUANTILES = (0.05, 0.3)  # from which these are told
_MIN_INFORMATION = 10.0  # times the usual variance: beyond, a segment shows no edge
_MIN_SHARE = 0.35  # of the boundary: a shorter arc hardly holds an ellipse
_CLIP = 1.5  # standard deviations from full scale or black: nearer, clipping moves the mean by more than 3 % of one
_MOST_BLACK = 0.15  # of the plateau's height: more of the edge is not given away


def unclipped(band: Band, value: Array, model: Model, *, measured: bool) -> Mask:
    """Return which pixels (M,) clipping leaves alone, where `value` (M,) is what they should be.

    At full scale where any is there, and at black where many are; not at black where `value` is what was `measured`:
    of a background that noise alone lifts from it, what is lifted most would be left.
    """
    alone = np.ones(len(value), dtype=np.bool_)
    read, shot, speckle = model.noise.tolist()
    if band.clipped.any():
        top = read + shot * model.scale + speckle * model.scale**2
        alone &= value < 1.0 - _CLIP * np.sqrt(top)
    if band.black.any() and not measured:
        # Of the noise at black half is cut off: that half-way up tells it.
        half = model.scale / 2
        noise = np.sqrt(read + shot * half + speckle * half**2)
        alone &= value > min(_CLIP * float(noise), _MOST_BLACK * model.scale)
    return alone


def foreign(band: Band, terms: Terms, model: Model, seen: Seen, good: Mask) -> Mask:
    """Return which pixels (M,) away from the edge see something else than plateau or background: an obstacle, a lamp.

    Those that are off by more than so many usual residuals, those of the good segments (S,), and their neighbours. A
    segment of which they are left out still says where its edge is.
    """
    away = np.abs(terms.u - model.offset @ terms.boundary) > _AWAY * model.widths.mean
    off = np.abs(terms.values - seen.value) / np.sqrt(variance(model, seen))
    # Of all pixels, more than half may see something else: their median says nothing of the noise.
    among = good[band.segment]
    if not among.any():
        return away
    usual = deviation(off[among])
    far = away & (off > _FOREIGN * usual) & (np.abs(terms.values - seen.value) > GOOD_SEGMENT * model.scale)
    return away & band.widened(far, int(np.ceil(_SKIRT * model.widths.mean))) if far.any() else far


def judged(segments: Segments, model: Model, chosen: Mask, enough: float) -> tuple[Mask, Mask]:
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
    require_share(good[chosen])
    return there, good


def require_share(use: Mask) -> None:
    """Raise `SpotNotFound` if too few of the segments (S,) are of use."""
    if use.mean() < _MIN_SHARE:
        raise SpotNotFound(NoSpotReason.NO_BOUNDARY, f"{100 * use.mean():.0f} % of it could be.")
