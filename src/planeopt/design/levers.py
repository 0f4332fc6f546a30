"""What would make the predicted standard deviations smaller: by how much, and how far it has to go."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.optimize
from numpy.typing import ArrayLike, NDArray

from planeopt.design.prediction import Prediction, predict
from planeopt.design.quality import Pixels, Quality
from planeopt.design.rigs import Rigs
from planeopt.errors import InputError
from planeopt.rig import Rig

Array = NDArray[np.float64]

RIG_LEVERS = ("offset", "radius", "f", "distance")
"""What is built: the beam's offset, its radius, the focal length; and how far away the plane is."""

Built = Literal["offset", "radius", "f"]
"""What `smallest` can look for."""

_STEP = 1e-3  # of a logarithm: a central difference is off by its square
_FACTORS = np.geomspace(1 / 20, 20, 121)
"""What is tried of a rig's number."""


def quality_levers(quality: Quality) -> tuple[str, ...]:
    """Return the names of what the image can be better in."""
    return ("noise", "contrast", "blur_px") if isinstance(quality, Pixels) else ("sigma_px",)


def with_factors(
    rig: Rig, planes: Array, quality: Quality, lever: str, factors: ArrayLike, *, criterion: bool = True
) -> Prediction:
    """Predict with one of `RIG_LEVERS` multiplied.

    Parameters
    ----------
    rig : Rig
    planes : (M, 3)
    quality : Pixels or Points
    lever : str
    factors : (...)
    criterion : bool
        As of `predict`.

    Returns
    -------
    Prediction
        Of shape (..., M).
    """
    factor, rigs = np.asarray(factors, dtype=float)[..., None], Rigs.of(rig)
    if lever == "distance":
        far = np.broadcast_to(planes, (*factor.shape[:-1], *planes.shape)).copy()
        far[..., 0] *= factor
        return predict(rigs, far, quality, criterion=criterion)
    return predict(rigs.scaled(lever, factor), planes, quality, criterion=criterion)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Logarithmic derivatives of the standard deviations by a lever: at -1 a tenth more of it is a tenth less sigma.

    Attributes
    ----------
    lever : str
    z_L, normal : (M,)
        Of the standard deviation of z_L, and of the RMS angle of the normal, boundary and calibration together.
    """

    lever: str
    z_L: Array
    normal: Array


def sensitivities(rig: Rig, planes: ArrayLike, quality: Quality) -> tuple[Sensitivity, ...]:
    """Differentiate what `predict` says by offset, radius, focal length, distance, and by what the image is like.

    The calibration's covariance stays as it is; tilts and their directions against the offset do too.

    Parameters
    ----------
    rig : Rig
    planes : (M, 3)
    quality : Pixels or Points
    """
    wanted, step = np.asarray(planes, dtype=float), np.exp([_STEP, -_STEP])
    made = []
    for lever in (*RIG_LEVERS, *quality_levers(quality)):
        if lever in RIG_LEVERS:
            both = with_factors(rig, wanted, quality, lever, step, criterion=False)
            sigmas = [(both.z_L_mm[i], both.normal_deg[i]) for i in range(2)]
        else:
            ends = [predict(rig, wanted, quality.scaled(lever, factor), criterion=False) for factor in step]
            sigmas = [(end.z_L_mm, end.normal_deg) for end in ends]
        rates = [np.log(more / less) / (2 * _STEP) for more, less in zip(*sigmas, strict=True)]
        made.append(Sensitivity(lever, *rates))
    return tuple(made)


@dataclass(frozen=True)
class Smallest:
    """The smallest number of a rig with which all planes are measured as well as is wanted.

    Attributes
    ----------
    lever : str
    factor : float or None
        By what the rig's own is multiplied; None where nothing that was tried will do.
    best : float
        Worst standard deviation of all planes over what is wanted, at `factor`; without one, the least of those tried
        where all planes can be measured: NaN where there is none.
    best_factor : float or None
        Where that is.
    reason : str
        Why there is none, or the smaller ones would not do.
    """

    lever: Built
    factor: float | None
    best: float
    best_factor: float | None
    reason: str


def smallest(
    rig: Rig,
    planes: ArrayLike,
    quality: Quality,
    lever: Built,
    *,
    depth_mm: float = np.inf,
    normal_deg: float = np.inf,
) -> Smallest:
    """Find the smallest offset, radius or focal length with which all planes are measured as well as is wanted.

    The factors from 1/20 to 20 are tried on a grid, since sigma need not fall with the offset all the way (next to a
    beam as wide as the offset it rises), and a larger number may take the spot out of the image; then Brent's method
    finds where the worst standard deviation is what is wanted.

    Parameters
    ----------
    rig : Rig
    planes : (M, 3)
    quality : Pixels or Points
    lever : {"offset", "radius", "f"}
    depth_mm, normal_deg : float
        Largest standard deviations wanted of z_L and of the normal.

    Raises
    ------
    InputError
        If nothing is wanted, or what is wanted is not positive.
    """
    if not (depth_mm > 0 and normal_deg > 0):
        raise InputError("what is wanted of z_L and of the normal must be positive standard deviations")
    if np.isinf(depth_mm) and np.isinf(normal_deg):
        raise InputError("say what is wanted of z_L or of the normal")
    wanted = np.asarray(planes, dtype=float)

    def worst(factor: ArrayLike) -> tuple[Array, NDArray[np.bool_], Prediction]:
        found = with_factors(rig, wanted, quality, lever, factor, criterion=False)
        over = np.maximum(found.z_L_mm / depth_mm, found.normal_deg / normal_deg)
        return np.max(over, axis=-1), np.all(found.visible, axis=-1), found

    over, visible, found = worst(_FACTORS)
    good = np.flatnonzero(visible & (over <= 1))
    if not len(good):
        usable = np.where(visible, over, np.inf)
        best = int(np.argmin(usable))
        if not visible[best]:
            return Smallest(lever, None, np.nan, None, "with none that was tried can all planes be measured")
        reason = "of all that were tried, 1/20 to 20 times the present one, this is the best"
        if best + 1 < len(_FACTORS) and not visible[best + 1]:
            reason = f"larger ones cannot be used: {_why_not(found, best + 1)}"
        return Smallest(lever, None, float(over[best]), float(_FACTORS[best]), reason)
    first = int(good[0])
    if first == 0:
        return Smallest(lever, float(_FACTORS[0]), float(over[0]), float(_FACTORS[0]), "the smallest that was tried")
    if not visible[first - 1]:
        factor = float(_FACTORS[first])
        reason = f"smaller ones cannot be used: {_why_not(found, first - 1)}"
        return Smallest(lever, factor, float(over[first]), factor, reason)
    below, above = np.log(_FACTORS[first - 1 : first + 1]).tolist()
    found_at: Any = scipy.optimize.brentq(lambda x: float(np.log(worst(np.exp(x))[0])), below, above, xtol=1e-9)
    factor = float(np.exp(found_at))
    return Smallest(lever, factor, float(worst(factor)[0]), factor, "what is wanted is just reached")


def _why_not(found: Prediction, which: int) -> str:
    return str(found.views[which][~found.visible[which]][0])
