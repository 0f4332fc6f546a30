"""What each short segment of a boundary says by itself about its place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.band import Band
from planeopt.spot.model import Model, Seen, Terms, variance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Segments:
    """What each segment of the boundary says by itself; S segments.

    Parameters
    ----------
    offset : (S,) array
        Of the boundary from the model's, px outwards: one weighted least-squares step.
    variance : (S,) array
        Of `offset`, px^2; infinite where nothing is known.
    misfit : (S,) array
        Mean squared residual over the expected variance.
    theta : (S,) array
        Eccentric angle of what was seen, weighted by what it says about the place.
    """

    offset: Array
    variance: Array
    misfit: Array
    theta: Array


def segments_of(band: Band, terms: Terms, model: Model, seen: Seen, keep: Mask) -> Segments:
    """Return what the kept pixels (M,) of each segment say about the boundary's place, all else being the model's."""
    weight = keep / variance(model, seen)
    residual = terms.values - seen.value
    power, n = weight * seen.position**2, band.count
    information = np.bincount(band.segment, power, n)
    known = information > 0
    safe = np.where(known, information, 1.0)
    pixels = np.maximum(np.bincount(band.segment, keep.astype(np.float64), n), 1.0)
    # The first segment begins at angle 0: none holds the jump from 2 pi to it.
    theta = np.bincount(band.segment, power * band.theta, n) / safe
    return Segments(
        offset=np.bincount(band.segment, weight * seen.position * residual, n) / safe,
        variance=np.where(known, 1 / safe, np.inf),
        misfit=np.bincount(band.segment, weight * residual**2, n) / pixels,
        theta=theta,
    )
