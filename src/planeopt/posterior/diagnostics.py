"""Has the chain run long enough? Autocorrelation time, split R-hat, effective sample size."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Stop(Enum):
    """Why sampling ended; the value is the sentence a user reads."""

    CONVERGED = (
        "Sampling ended by itself: over 50 autocorrelation times, their estimate steady to 2 %, split R-hat below "
        "1.05, and as many effective draws as asked for."
    )
    BUDGET = (
        "Sampling ended because its budget of steps was used up, before it was long enough to end by itself: "
        "intervals may be rough."
    )
    INTERRUPTED = "Sampling was interrupted: these are the draws it had by then; intervals may be rough."


@dataclass(frozen=True)
class Diagnostics:
    """How the chain went.

    Attributes
    ----------
    stopped : Stop
    steps, burn_in, thin : int
        Steps of the ensemble, how many of them were left out at the beginning, and each how-many-th was kept.
    walkers : int
    tau : float
        Integrated autocorrelation time of the slowest coordinate, steps.
    ess : float
        How many independent draws those that were kept are worth, for the slowest coordinate.
    r_hat : float
        Split R-hat (Gelman et al. 2013) of the worst coordinate, the halves of each walker's path as chains.
    acceptance : float
        Share of proposals taken.
    """

    stopped: Stop
    steps: int
    burn_in: int
    thin: int
    walkers: int
    tau: float
    ess: float
    r_hat: float
    acceptance: float

    @property
    def converged(self) -> bool:
        return self.stopped is Stop.CONVERGED

    @property
    def sentence(self) -> str:
        return (
            f"{self.stopped.value} {self.walkers} walkers, {self.steps} steps, autocorrelation time {self.tau:.1f} "
            f"steps, {self.ess:.0f} effective draws, split R-hat {self.r_hat:.4f}, acceptance {self.acceptance:.2f}."
        )


_WINDOW = 5.0

R_HAT_LIMIT = 1.05
"""Beyond it the walkers have not mixed. Half a chain of 50 autocorrelation times has sqrt(1 + 1/25) by chance alone."""


def autocorrelation_time(chain: Array) -> float:
    """Integrated autocorrelation time of the slowest coordinate of a chain (steps, walkers, d), at least 1; steps.

    Of the walkers together, about their common mean: about each walker's own, as emcee has it, a short chain's time
    comes out too small, by a tenth at 70 times, and walkers that never leave their places look as if they mixed. The
    sum is cut off at 5 times itself (Sokal 1997). A chain without any motion counts as one draw.
    """
    steps = len(chain)
    centred = chain - np.mean(chain, axis=(0, 1))
    spectrum = np.abs(np.fft.rfft(centred, 2 * steps, axis=0)) ** 2
    covariance = np.fft.irfft(np.sum(spectrum, axis=1), 2 * steps, axis=0)[:steps]
    moving = covariance[:, covariance[0] > 0]
    if steps < 4 or not moving.size:
        return float(steps)
    times = 2 * np.cumsum(moving / moving[0], axis=0) - 1
    enough = np.arange(steps)[:, None] >= _WINDOW * times
    last = np.where(enough.any(axis=0), np.argmax(enough, axis=0), steps - 1)
    return max(1.0, float(np.max(times[last, np.arange(times.shape[1])])))


def split_r_hat(chain: Array) -> float:
    """Split R-hat of the worst coordinate of a chain (steps, walkers, d); infinite for fewer than four steps."""
    half = len(chain) // 2
    if half < 2:
        return float("inf")
    chains = np.concatenate([chain[:half], chain[-half:]], axis=1)
    within = np.mean(np.var(chains, axis=0, ddof=1), axis=0)
    between = np.var(np.mean(chains, axis=0), axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(within > 0, between / within, np.where(between > 0, np.inf, 0.0))
    return float(np.sqrt(np.max((half - 1) / half + ratio)))
