"""The first-order answer beside the samples: the likeliest plane and the normal law of the curvature there."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.posterior.summary import Interval, interval

Array = NDArray[np.float64]

PARAMETERS = ("z_L", "p", "q")

CENTRE_TOLERANCE = 0.25
"""Largest difference of a median from the normal law's centre, in its standard deviations, that counts as agreement."""

WIDTH_TOLERANCE = 0.2
"""Largest difference of half the 95 % interval from the normal law's, as a share of that."""

_NORMAL95 = 1.959964


@dataclass(frozen=True, eq=False)
class Laplace:
    """A normal law of ``(z_L, p, q)``, z_L along the beam.

    Attributes
    ----------
    plane : (3,)
        The likeliest plane: the prior is not in it.
    covariance : (3, 3)
        Inverse of the log likelihood's curvature there, the rig's uncertainty included where it is in the posterior.
    spot : (3, 3)
        The part of it that is left where the rig is known.
    """

    plane: Array
    covariance: Array
    spot: Array

    @property
    def rig(self) -> Array:
        """The part (3, 3) that the rig's uncertainty adds."""
        return self.covariance - self.spot


@dataclass(frozen=True)
class Agreement:
    """Whether the normal law describes the posterior, and in words where not."""

    agrees: bool
    sentence: str


def compare(laplace: Laplace | None, samples: Array, ess: float) -> Agreement:
    """Compare the normal law with draws (S, 3) of ``(z_L, p, q)``.

    They differ where a median is off by more than a quarter of a standard deviation, or half a 95 % interval by more
    than a fifth, beyond three standard errors of the draws themselves.
    """
    if laplace is None:
        return Agreement(False, "There is no first-order law to compare with: the likelihood has no peak inside.")
    # Standard errors for a normal law: of a median sqrt(pi/2/n) sigma, of half the distance of the 2.5 % quantiles 1.9.
    centre_limit = CENTRE_TOLERANCE + 3 * math.sqrt(math.pi / 2 / ess)
    width_limit = WIDTH_TOLERANCE + 3 * 1.9 / _NORMAL95 / math.sqrt(ess)
    found = []
    for i, name in enumerate(PARAMETERS):
        sigma, of = math.sqrt(laplace.covariance[i, i]), interval(samples[:, i])
        off, ratio = (of.median - laplace.plane[i]) / sigma, _half_width(of) / (_NORMAL95 * sigma)
        if abs(off) > centre_limit:
            found.append(f"the median of {name} is {abs(off):.2f} sigma {'above' if off > 0 else 'below'}")
        if abs(ratio - 1) > width_limit:
            found.append(f"the 95 % interval of {name} is {ratio:.2f} times as wide")
    if not found:
        return Agreement(True, "The first-order intervals and the sampled ones agree.")
    return Agreement(False, f"The samples differ from the first-order law: {'; '.join(found)}. Trust the samples.")


def _half_width(of: Interval) -> float:
    return (of.high95 - of.low95) / 2
