"""Where the truth lies within what is reported of a plane: in standard deviations, and by rank among draws."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from planeopt.plane import SpotPose
from planeopt.posterior import Posterior
from planeopt.solution import Flag, Sigmas
from studies.coverage_draws import QUANTITIES
from studies.outline import Array

DRAWS = 199
RANKS = DRAWS + 1
"""Of the truth among so many draws of the posterior: 0 to 199, all equally likely if the posterior is right.

That holds exactly for any number of independent draws, and 200 ranks can be cut at 68 % and at 95 % exactly: the
finite number of draws needs no allowance.
"""

LEVELS = (0.68, 0.95)
UNRANKED = -1
NAN = float("nan")


@dataclass(frozen=True, kw_only=True)
class Checks:
    """Of one plane, for each of z_L, both slopes, tilt and R.

    Attributes
    ----------
    z_L_sigmas, p_sigmas, q_sigmas, alpha_sigmas, R_sigmas : float
        Error of the maximum-likelihood plane in its own first-order standard deviations; NaN where it is said not to
        be trusted (out of the bound's reach; for tilt and R also where the angles are not linear).
    z_L_rank, p_rank, q_rank, alpha_rank, R_rank : int
        How many of 199 draws of the posterior lie below the truth; -1 where there is no posterior.
    """

    z_L_sigmas: float
    p_sigmas: float
    q_sigmas: float
    alpha_sigmas: float
    R_sigmas: float
    z_L_rank: int
    p_rank: int
    q_rank: int
    alpha_rank: int
    R_rank: int


class Estimate(Protocol):
    """What is needed of a solution."""

    @property
    def pose(self) -> SpotPose | None: ...

    @property
    def covariance(self) -> Array | None: ...

    @property
    def sigma(self) -> Sigmas | None: ...

    @property
    def flags(self) -> Sequence[object]: ...


def check(estimate: Estimate | None, posterior: Posterior | None, truth: Mapping[str, float], seed: int) -> Checks:
    """Return where the truth lies within a solution and within a posterior; without either, nothing.

    Parameters
    ----------
    estimate : Estimate or None
    posterior : Posterior or None
    truth : mapping of str to float
        By `QUANTITIES`; mm and rad.
    seed : int
        Of the choice among the posterior's draws.
    """
    errors = dict.fromkeys(QUANTITIES, NAN) | ({} if estimate is None else _own_sigmas(estimate, truth))
    ranks = dict.fromkeys(QUANTITIES, UNRANKED) | ({} if posterior is None else _ranks(posterior, truth, seed))
    fields: dict[str, Any] = {f"{name}_sigmas": error for name, error in errors.items()}
    return Checks(**fields, **{f"{name}_rank": rank for name, rank in ranks.items()})


def _own_sigmas(estimate: Estimate, truth: Mapping[str, float]) -> dict[str, float]:
    pose, covariance, sigma = estimate.pose, estimate.covariance, estimate.sigma
    if pose is None or covariance is None or sigma is None or _any(estimate, (Flag.BOUND_OUT_OF_REACH, Flag.WEAK)):
        return {}
    p, q = pose.slopes
    spread = np.sqrt(np.diag(covariance)).tolist()
    found = {
        name: (value - truth[name]) / own
        for name, value, own in zip(QUANTITIES[:3], (pose.z_L, p, q), spread, strict=True)
    }
    if sigma.alpha is not None and sigma.R is not None and not _any(estimate, (Flag.ANGLES_NONLINEAR,)):
        found["alpha"] = (pose.alpha - truth["alpha"]) / sigma.alpha
        found["R"] = (pose.R - truth["R"]) / sigma.R
    return found


def _any(estimate: Estimate, flags: Sequence[Flag]) -> bool:
    return any(flag in estimate.flags for flag in flags)


def _ranks(posterior: Posterior, truth: Mapping[str, float], seed: int) -> dict[str, int]:
    if len(posterior.samples) < DRAWS:
        return {}
    # Few of many, anywhere in the chain: what is left of its correlation does not show.
    chosen = np.random.default_rng(seed).choice(len(posterior.samples), DRAWS, replace=False)
    return {name: int(np.sum(posterior.quantities[name][chosen] < truth[name])) for name in QUANTITIES}


def covered(rank: NDArray[np.integer], level: float) -> NDArray[np.bool_]:
    """Whether ranks lie in the middle share of the ranks that is nearest to a level: exact for `LEVELS`."""
    tail = round(RANKS * (1 - level) / 2)
    return (rank >= tail) & (rank < RANKS - tail)
