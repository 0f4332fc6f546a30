"""How much of the answer is the prior's."""

import math

import numpy as np
from numpy.typing import NDArray

from planeopt.posterior.result import PriorEffect
from planeopt.posterior.target import Target

Array = NDArray[np.float64]

MOVED = 0.25
"""Share of half a 68 % interval by which a median may move when the prior is taken away."""

CUT = 0.025
"""Share of what the points alone allow that the prior's bounds may cut off."""

_FEW = 0.1
"""Share of the draws that must count when the prior is taken away; with fewer it cannot be."""


def prior_effect(target: Target, draws: Array, log_candidates: Array, outside: NDArray[np.bool_]) -> PriorEffect:
    """Compare the posterior with what a prior flat in ``(log z_L, p, q)`` would have given.

    Parameters
    ----------
    target : Target
    draws : (S, d)
        Of the posterior.
    log_candidates : (M,)
        Log weights that make draws of the likelihood alone out of another sample.
    outside : (M,) of bool
        Which of that sample the prior leaves out.
    """
    weights = np.exp(log_candidates - np.max(log_candidates))
    cut = float(np.sum(weights[outside]) / np.sum(weights))
    if cut > CUT:
        return PriorEffect(
            True, f"Prior-dominated: {100 * cut:.0f} % of what the points alone allow is beyond the prior's bounds."
        )
    log_prior = target.log_prior(draws)
    without = np.exp(np.min(log_prior) - log_prior)
    if np.sum(without) ** 2 < _FEW * len(draws) * np.sum(without**2):
        return PriorEffect(True, "Prior-dominated: the points say too little for the prior to be taken away.")
    tilt = np.arctan(np.hypot(draws[:, 1], draws[:, 2]))
    shifts = {
        name: _shift(values, without)
        for name, values in (("z_L", draws[:, 0]), ("p", draws[:, 1]), ("q", draws[:, 2]), ("alpha", tilt))
    }
    name = max(shifts, key=lambda key: shifts[key])
    size = f"{math.ceil(100 * shifts[name] + 1e-9)} % of half its 68 % interval"
    if shifts[name] > MOVED:
        return PriorEffect(True, f"Prior-dominated: the prior moves the median of {name} by {size}.")
    return PriorEffect(False, f"The points decide: the prior moves no median by more than {size}.")


def _shift(values: Array, weights: Array) -> float:
    """By how much weights move the median, in halves of the 68 % interval."""
    order = np.argsort(values)
    ahead = np.cumsum(weights[order])
    middle = float(values[order[int(np.searchsorted(ahead, ahead[-1] / 2))]])
    low, median, high = np.quantile(values, [0.16, 0.5, 0.84]).tolist()
    return abs(middle - median) / max((high - low) / 2, math.ulp(median))
