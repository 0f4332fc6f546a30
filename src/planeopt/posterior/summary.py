"""Medians and intervals; of angles as what they are, directions on a circle."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNTILTED = 0.99
"""Where the untilted plane lies in this region of the slopes' posterior, every direction of tilt is possible."""

_LEVELS = np.array([0.5, 0.16, 0.84, 0.025, 0.975])


@dataclass(frozen=True)
class Interval:
    """Median and equal-tailed intervals of 68 and 95 % of a posterior; mm, rad or 1.

    An angle's ends are in (-pi, pi]; where an interval crosses pi its low end is the larger number.
    """

    median: float
    low68: float
    high68: float
    low95: float
    high95: float


def interval(draws: Array) -> Interval:
    """Of a number on a line."""
    return Interval(*np.quantile(draws, _LEVELS).tolist())


def circular_interval(angles: Array) -> Interval:
    """Of a direction, rad: as on a line that is cut opposite to the mean direction."""
    mean = math.atan2(float(np.mean(np.sin(angles))), float(np.mean(np.cos(angles))))
    around = interval(np.remainder(angles - mean + math.pi, math.tau) - math.pi)
    ends = (around.median, around.low68, around.high68, around.low95, around.high95)
    return Interval(*(_half_open(mean + end) for end in ends))


def may_be_untilted(slopes: Array) -> bool:
    """Whether slopes (S, 2) = 0 lies in the region, an ellipse about their mean, that holds 99 % of them.

    The direction of tilt is then undefined: its posterior goes all the way round.
    """
    centre = np.mean(slopes, axis=0)
    root = np.linalg.cholesky(np.cov(slopes, rowvar=False) + np.finfo(float).tiny * np.eye(2))
    far = np.linalg.norm(np.linalg.solve(root, (slopes - centre).T), axis=0)
    return bool(np.linalg.norm(np.linalg.solve(root, centre)) <= np.quantile(far, UNTILTED))


def intercept_interval(draws: Array) -> Interval | None:
    """Of an intercept, mm; None where the 95 % interval passes through infinity, the plane parallel to the axis.

    Its reciprocal has no such place: its quantiles are taken.
    """
    reciprocal = interval(1 / draws)
    if reciprocal.low95 <= 0 <= reciprocal.high95:
        return None
    ends = (reciprocal.median, reciprocal.high68, reciprocal.low68, reciprocal.high95, reciprocal.low95)
    return Interval(*(1 / end for end in ends))


def _half_open(angle: float) -> float:
    turned = math.remainder(angle, math.tau)
    return math.pi if turned <= -math.pi else turned + 0.0


@dataclass(frozen=True)
class Cone:
    """Where the normal points: its mean direction, and the angles about it that hold 68 and 95 % of the posterior.

    Attributes
    ----------
    axis : (float, float, float)
        Unit, camera frame.
    radius68, radius95 : float
        rad.
    """

    axis: tuple[float, float, float]
    radius68: float
    radius95: float


def cone(normals: Array) -> Cone:
    """Of unit normals (S, 3)."""
    total = np.sum(normals, axis=0)
    axis = total / np.linalg.norm(total)
    # By the half chord, which is accurate where the cosine is not.
    angles = 2 * np.arcsin(np.clip(np.linalg.norm(normals - axis, axis=1) / 2, 0, 1))
    radius68, radius95 = np.quantile(angles, [0.68, 0.95]).tolist()
    x, y, z = axis.tolist()
    return Cone((x, y, z), radius68, radius95)


@dataclass(frozen=True)
class Split:
    """A variance in two: what the spot's points leave open where the rig is known, and what the rig adds.

    Attributes
    ----------
    spot, calibration : float
        Standard deviations; their squares add up to the whole variance.
    """

    spot: float
    calibration: float

    @property
    def share(self) -> float:
        """Of the calibration in the variance."""
        total = self.spot**2 + self.calibration**2
        return self.calibration**2 / total if total > 0 else 0.0


def variance_split(draws: Array, rig: Array) -> Split:
    """Split the variance of draws (S,) or (S, m), summed over m, by the part that the rig's draws (S, k) explain.

    The law of total variance with a linear regression on the rig's parameters, corrected for the regression's own
    degrees of freedom. To first order it is exact.
    """
    values = draws.reshape(len(draws), -1)
    values = values - np.mean(values, axis=0)
    total = float(np.sum(values**2)) / max(len(values) - 1, 1)
    k = rig.shape[1]
    if k == 0 or len(values) <= 2 * (k + 1):
        return Split(math.sqrt(total), 0.0)
    regressors = rig - np.mean(rig, axis=0)
    regressors = regressors / np.where(np.ptp(rig, axis=0) > 0, np.std(rig, axis=0), 1.0)
    fitted = regressors @ np.linalg.lstsq(regressors, values, rcond=None)[0]
    spot = float(np.sum((values - fitted) ** 2)) / (len(values) - 1 - k)
    return Split(math.sqrt(min(spot, total)), math.sqrt(max(total - spot, 0.0)))
