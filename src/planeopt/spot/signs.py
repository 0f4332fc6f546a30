"""Signs in the shape of a disc's edge that the measurement does not hold: of a dirty beam, of a response not linear."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from planeopt.spot.adjustment import solve, whitened
from planeopt.spot.band import Band
from planeopt.spot.model import ELLIPSE_WAVES, Model, Seen, Terms, see, variance
from planeopt.spot.surfaces import waves

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHANCE = 1e-6  # of a sign where there is none
_SHARP = 0.7  # px: a profile narrower than that is not a blurred edge's
_MOST = 3000  # pixels that are looked at


def level_dependence(band: Band, terms: Terms, model: Model, seen: Seen, usable: Mask, good: Mask) -> float:
    """Return by how much the ellipse of the edge's upper half differs from that of its lower half, px; 0 if by chance.

    Both halves of each segment say by themselves where the boundary is. Their difference round the spot, apart from its
    mean, which is a matter of the width: what changes centre and axes.

    Parameters
    ----------
    band, terms, model, seen
    usable : (M,) bool array
        Pixels.
    good : (S,) bool array
        Segments.
    """
    power = usable * seen.position**2 / variance(model, seen)
    pull = usable * seen.position * (terms.values - seen.value) / variance(model, seen)
    upper = seen.level > 0.5
    difference, spread = np.zeros(band.count), np.zeros(band.count)
    known = good.copy()
    for half, sign in ((upper, 1.0), (~upper, -1.0)):
        information = np.bincount(band.segment[half], power[half], band.count)
        known &= information > 0
        safe = np.where(information > 0, information, 1.0)
        difference += sign * np.bincount(band.segment[half], pull[half], band.count) / safe
        spread += 1 / safe
    if known.sum() < 4 * (2 * ELLIPSE_WAVES + 1):
        return 0.0
    theta = 2 * np.pi * (np.arange(band.count) + 0.5) / band.count
    rows = waves(theta, ELLIPSE_WAVES)[:, known] / np.sqrt(spread[known])
    information, right = rows @ rows.T, rows @ (difference[known] / np.sqrt(spread[known]))
    found = solve(information, right)
    # More scatter than the pixels' noise explains makes the difference less sure too.
    residual = difference[known] / np.sqrt(spread[known]) - found @ rows
    scale = max(float(np.mean(residual**2)), 1.0)
    left = information[1:, 1:] - np.outer(information[1:, 0], information[0, 1:]) / information[0, 0]
    if float(found[1:] @ left @ found[1:]) / scale < chi2.isf(_CHANCE, len(left)):
        return 0.0
    return float(np.hypot(found[1::2], found[2::2]).max())


def response(terms: Terms, model: Model) -> float:
    """Return the exponent, less 1, of the light to which the edge's shape takes the grey values; 0 if by chance.

    To first order: ``v^(1+g) = v + g v ln v``. One more column in the fit, whose coefficient is estimated with all
    other parameters free. An edge so sharp that a pixel's square shows in it says nothing: 0.

    Parameters
    ----------
    terms : Terms
        Of the pixels that count.
    model : Model
    """
    if model.widths.mean < _SHARP:
        return 0.0
    every = max(1, len(terms.u) // _MOST)
    terms = terms.part(np.arange(len(terms.u)) % every == 0)
    seen = see(terms, model)
    jacobian, residual = whitened(terms, model, seen)
    light = np.maximum(seen.value, 1e-3)
    column = light * np.log(light) / np.sqrt(variance(model, seen))
    jacobian = jacobian.astype(np.float64)
    information = jacobian @ jacobian.T
    mixed = jacobian @ column
    left = column - solve(information, mixed) @ jacobian
    power = float(left @ left)
    scale = max(float(np.mean(residual**2)), 1.0)
    value = float(left @ residual) / max(power, 1e-300)
    return value if value**2 * power / scale > chi2.isf(_CHANCE, 1) else 0.0
