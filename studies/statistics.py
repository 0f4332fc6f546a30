"""Limits that right code keeps, for a family of tests that are judged together."""

from collections.abc import Sequence

import numpy as np
import scipy.stats

LEVEL = 0.001
"""Family-wise: how rarely right code may fail any of a family's two-sided tests."""


def binomial_limits(trials: int, probability: float, tests: int) -> tuple[int, int]:
    """Return the fewest and the most successes of so many trials that right code has, in a family of so many tests."""
    tail = LEVEL / 2 / tests
    fewest, most = scipy.stats.binom.ppf([tail, 1 - tail], trials, probability)
    return int(fewest), int(most)


def uniform_p(ranks: Sequence[int], values: int, bins: int) -> float:
    """Return the p-value of chi-squared over bins for ranks 0, 1, ... `values` - 1 that should be equally frequent.

    Parameters
    ----------
    ranks : sequence of int
    values : int
        How many ranks there are; a multiple of `bins`.
    bins : int
        With equally many ranks each.
    """
    if values % bins:
        raise ValueError(f"{values} ranks do not fill {bins} bins evenly")
    counts = np.bincount(np.asarray(ranks, dtype=int) // (values // bins), minlength=bins)
    return float(scipy.stats.chisquare(counts).pvalue)
