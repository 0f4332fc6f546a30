"""Which parameters the observations ask for: the ladder of distortions, and tests of what might be left out.

Each test compares two models that are nested, adjusted to the same observations with the same weights: twice the
difference of their log-likelihoods is chi-squared where the smaller one holds, and F when divided by the noise that was
estimated.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import f as fisher

from planeopt.board import Observations
from planeopt.calibration.adjustment import Adjustment, adjust, refit
from planeopt.calibration.equations import AdjustmentError, Prior
from planeopt.calibration.model import RUNGS, Model, Rung
from planeopt.calibration.packed import Packed
from planeopt.calibration.start import likely_camera
from planeopt.rig import Camera

_log = logging.getLogger(__name__)

LEVEL = 0.01
"""A test that sees nothing where there is nothing says so with a chance of 0.99."""

_LENS = 0.02
"""How far lenses are taken to distort at the image's corner, by each term, as a share of the radius: one sigma."""
_FOCAL = 0.5
"""How well a focal length is taken to be known before anything is seen, as a share of it: one sigma."""
_OFF_CENTRE = 0.1
"""How far the principal point is taken to lie off the image's middle, as a share of the diagonal: one sigma."""


@dataclass(frozen=True, eq=False)
class Tested:
    """A model against a smaller one.

    Parameters
    ----------
    name : str
        Of what the larger model has and the smaller one has not.
    statistic : float
        F: reduction of the weighted squares for each term, over the noise's variance.
    dof : tuple of float
        Number of terms, and degrees of freedom of the noise.
    p_value : float
        Of a statistic as large as this, if the terms were zero.
    used : bool
        Whether the calibration has the terms.
    sentence : str
    smaller, larger : mapping of str to (float, float)
        Values and standard deviations of the free parameters of either model.
    """

    name: str
    statistic: float
    dof: tuple[float, float]
    p_value: float
    used: bool
    sentence: str
    smaller: Mapping[str, tuple[float, float]]
    larger: Mapping[str, tuple[float, float]]


def compare(name: str, smaller: Adjustment, larger: Adjustment, *, used: bool, words: str) -> Tested:
    """Return the F test of two nested models with the same weights.

    Parameters
    ----------
    name : str
    smaller, larger : Adjustment
        From `refit` of one and the same adjustment.
    used : bool
    words : str
        What the terms are, to begin the sentence with.
    """
    terms = len(larger.names) - len(smaller.names)
    freedom = larger.dof_corners
    statistic = max(smaller.cost - larger.cost, 0.0) / terms
    p_value = float(fisher.sf(statistic, terms, max(freedom, 1.0)))
    seen = "the observations show" if p_value < LEVEL else "the observations do not show"
    choice = "free in this calibration" if used else "not free in this calibration"
    sentence = f"{words}: {seen} it (F = {statistic:.3g}, p = {p_value:.2g}); {choice}."
    return Tested(name, statistic, (terms, freedom), p_value, used, sentence, _table(smaller), _table(larger))


def _table(adjustment: Adjustment) -> dict[str, tuple[float, float]]:
    return {name: (adjustment.value(name), adjustment.sigma(name)) for name in adjustment.names}


_RUNG_WORDS: dict[Rung, str] = {
    "none": "no distortion",
    "k1": "radial distortion k1",
    "k2": "radial distortion k2",
    "tangential": "tangential distortion p1, p2",
    "k3": "radial distortion k3",
}


def climb(
    observations: Observations, model: Model, rung: Rung | None, *, reject: bool = True
) -> tuple[Adjustment, tuple[Tested, ...]]:
    """Adjust on a rung of the ladder of distortions, and test each rung against the one below.

    Where no rung is asked for, all terms are free, with a prior that keeps them to what lenses do (`camera_prior`): a
    term that is left out because its test sees nothing stays wrong by up to two of its standard deviations or more, and
    what is correlated with it (the principal point with p1 and p2, k2 with k3) by as many of its own, while the
    intervals become shorter than that. Where the observations tell a term, the prior says nothing beside them; where
    they do not, it keeps the image's corners from folding.

    Parameters
    ----------
    observations : Observations
    model : Model
        Its distortion is replaced.
    rung : Rung or None
        The one asked for; its terms are then free without a prior.
    reject : bool
        Whether outliers are left out.

    Returns
    -------
    Adjustment
        On that rung.
    tuple of Tested
        `k1`, `k2`, `tangential`, `k3`: each rung as a test, all with the weights of the highest.

    Raises
    ------
    AdjustmentError
        If the observations do not determine the rung.
    """
    top = adjust_all(observations, model, reject=reject)
    fits = {name: refit(top, replace(model, distortion=name)) for name in RUNGS[:-1]} | {RUNGS[-1]: top}
    chosen = RUNGS[-1] if rung is None else rung
    tests = tuple(
        compare(
            upper,
            fits[lower],
            fits[upper],
            used=RUNGS.index(upper) <= RUNGS.index(chosen),
            words=_RUNG_WORDS[upper].capitalize(),
        )
        for lower, upper in pairwise(RUNGS)
    )
    if rung is None:
        return top, tests
    asked = replace(model, distortion=rung)
    # Few or frontal views may have several minima: of the one from nothing and the one near all distortions the lower.
    ends = [adjust(observations, asked, start=start, reject=reject) for start in (None, fits[rung].state)]
    return min(ends, key=lambda end: end.chi2_corners + end.chi2_spots), tests


def adjust_all(observations: Observations, model: Model, *, reject: bool = True) -> Adjustment:
    """Adjust with all distortions free, and the prior of all cameras: what `climb` gives where no rung is asked for.

    Parameters
    ----------
    observations : Observations
    model : Model
        Its distortion is replaced.
    reject : bool
        Whether outliers are left out.

    Raises
    ------
    AdjustmentError
        If the observations do not determine the free parameters.
    """
    near = likely_camera(Packed.of(observations))
    full = replace(model, distortion=RUNGS[-1])
    return adjust(observations, full, prior=camera_prior(near), start=near, reject=reject)


def camera_prior(camera: Camera) -> Prior:
    """Return what all cameras have in common, far less exactly than any session that is worth its name tells it.

    Each term of distortion moves the image's corner by 2 % of its radius, as one sigma: 0.02 / r^2 for k1, 0.02 / r^4
    for k2, with r the normalised radius of the corner. The principal point is in the image's middle, give or take a
    tenth of the diagonal, and the focal length is known to half of itself: where views are all frontal it is not told,
    and would drift without end. A lens beyond that is seen so well that the prior does not count.

    Parameters
    ----------
    camera : Camera
        Near the true one.
    """
    width, height = camera.image_size
    radius = float(np.hypot(width / camera.fx, height / camera.fy)) / 2
    middle = _OFF_CENTRE * float(np.hypot(width, height))
    # A tangential term moves the corner by up to 3 p r^2.
    lens = _LENS / np.array([radius**2, radius**4, 3 * radius, 3 * radius, radius**6])
    focal = np.array([camera.fx, camera.fx, camera.fy])
    values = np.array([*focal, (width - 1) / 2, (height - 1) / 2, *np.zeros(5)])
    sigmas = np.array([*(_FOCAL * focal), middle, middle, *lens])
    return Prior(("f", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), values, np.diag(sigmas**-2))


TERMS = ("warp", "aspect", "parallel", "divergence")
"""What can be tested beside the distortions."""


def compare_terms(adjustment: Adjustment, only: tuple[str, ...] = TERMS) -> dict[str, Tested]:
    """Test the bow of the board, the pixels' squareness, the beam's parallelism and its divergence.

    Parameters
    ----------
    adjustment : Adjustment
        Of the model that was chosen.
    only : tuple of str
        Which of `TERMS`.

    Returns
    -------
    dict of str to Tested
        By `warp`, `aspect`, `parallel`, `divergence`; what cannot be tested is not there.
    """
    model = adjustment.model
    pairs: dict[str, tuple[Model, Model, bool, str]] = {
        "warp": (replace(model, warp=False), replace(model, warp=True), model.warp, "A bow of the board"),
        "aspect": (
            replace(model, focal="shared"),
            replace(model, focal="separate"),
            model.focal == "separate",
            "A difference between fx and fy",
        ),
        "parallel": (
            replace(model, beam="none" if model.beam == "none" else "parallel"),
            replace(model, beam="none" if model.beam == "none" else "free"),
            model.beam == "free",
            "An angle between beam and optical axis",
        ),
        "divergence": (
            replace(model, divergence=False),
            replace(model, divergence=model.beam != "none"),
            model.divergence,
            "A divergence of the beam",
        ),
    }
    found: dict[str, Tested] = {}
    for name in only:
        if model.beam == "none" and name in ("parallel", "divergence"):
            continue
        smaller, larger, used, words = pairs[name]
        try:
            fits = [adjustment if each == model else refit(adjustment, each) for each in (smaller, larger)]
        except AdjustmentError as error:
            _log.debug("%s cannot be tested: %s", name, error)
            continue
        found[name] = compare(name, fits[0], fits[1], used=used, words=words)
    return found


def parallelism(adjustment: Adjustment) -> tuple[float, float]:
    """Return the angle between beam and optical axis and its standard deviation, rad.

    The standard deviation is that of the direction's component along the angle; where the angle is not significant the
    angle itself is not normal, and the test of `parallel` says what can be said.
    """
    names = ("direction_x", "direction_y")
    x, y = (adjustment.value(name) for name in names)
    angle = float(np.arcsin(np.hypot(x, y)))
    if names[0] not in adjustment.names:
        return angle, 0.0
    rows = [adjustment.names.index(name) for name in names]
    block = adjustment.covariance[np.ix_(rows, rows)]
    along = np.array([x, y]) / np.hypot(x, y) if angle > 0 else np.array([1.0, 0.0])
    return angle, float(np.sqrt(along @ block @ along) / np.cos(angle))
