"""Whether calibrations' claims hold: intervals, joint chi-squareds, scatter over repeats; all one family of tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from studies.calibration_fits import POSE, QUANTITIES, Errors, of
from studies.calibration_images import ImageRow
from studies.calibration_repeats import ALL, DrawRow, RepeatRow, spreads
from studies.calibration_sessions import DEFAULT, KNOWN, SessionRow
from studies.statistics import LEVEL, binomial_limits

LEVELS = (0.68, 0.95)
POINTS, AS_SIMULATED, IMAGES, PLANES = "points", "points, model known", "images", "a plane by each rig"

Groups = Mapping[str, Sequence[Errors]]


@dataclass(frozen=True)
class CoverageRow:
    """How often an interval held the truth.

    Attributes
    ----------
    group, quantity : str
    level : float
        What the interval claims.
    sessions, covered : int
    least, most : int
        That right code has, two-sided at a family-wise level of 0.001 over all tests of the study.
    """

    group: str
    quantity: str
    level: float
    sessions: int
    covered: int
    least: int
    most: int

    @property
    def share(self) -> float:
        return self.covered / self.sessions

    @property
    def within(self) -> bool:
        return self.least <= self.covered <= self.most


@dataclass(frozen=True)
class JointRow:
    """Whether the joint covariance is right in all directions at once.

    Attributes
    ----------
    group : str
        Of sessions; or the number of one that was measured again and again.
    sessions : int
        Or draws.
    over_dof : float
        Sum of chi-squared over the sum of its degrees of freedom.
    low, high : float
        That right code has, two-sided, family-wise.
    ks_p : float
        Kolmogorov-Smirnov test of the p-values' uniformity.
    least_p : float
        That right code has, family-wise.
    """

    group: str
    sessions: int
    over_dof: float
    low: float
    high: float
    ks_p: float
    least_p: float

    @property
    def within(self) -> bool:
        return self.low <= self.over_dof <= self.high and self.ks_p >= self.least_p


@dataclass(frozen=True)
class Judged:
    """Every test of the family."""

    coverage: list[CoverageRow]
    joint: list[JointRow]
    repeats: list[RepeatRow]

    @property
    def tests(self) -> int:
        """How many there are; a joint row is two."""
        return len(self.coverage) + 2 * len(self.joint) + len(self.repeats)

    @property
    def kept(self) -> int:
        """How many hold."""
        good = sum(row.within for row in (*self.coverage, *self.repeats))
        return good + sum((row.low <= row.over_dof <= row.high) + (row.ks_p >= row.least_p) for row in self.joint)


def groups_of(sessions: Sequence[SessionRow], images: Sequence[ImageRow]) -> Groups:
    """Return the groups of calibrations that are judged."""
    points = {
        name: [row for row in sessions if row.model == model]
        for name, model in ((POINTS, DEFAULT), (AS_SIMULATED, KNOWN))
    }
    return {**points, IMAGES: images}


def judge(sessions: Sequence[SessionRow], images: Sequence[ImageRow], draws: Sequence[DrawRow]) -> Judged:
    """Count every interval and test every chi-squared and every scatter."""
    groups = groups_of(sessions, images)
    cases = [(group, name, of(rows, f"{name}_sigmas")) for group, rows in groups.items() for name in QUANTITIES]
    cases += [(PLANES, name, of(groups[POINTS], f"{name}_sigmas")) for name in POSE]
    squares = {group: (of(rows, "chi2"), _dof(rows)) for group, rows in groups.items()}
    for number in sorted({row.session for row in draws}):
        own = [row for row in draws if row.session == number]
        squares[f"session {number}"] = of(own, "chi2"), np.array([row.dof for row in own])
    scatter = spreads(list(draws))
    tests = len(LEVELS) * len(cases) + 2 * len(squares) + len(scatter)
    return Judged(
        [_covered(group, name, level, errors, tests) for group, name, errors in cases for level in LEVELS],
        [_joint(group, found, dof, tests) for group, (found, dof) in squares.items()],
        [_repeat(*row, tests) for row in scatter],
    )


def _dof(rows: Sequence[Errors]) -> np.ndarray:
    return np.array([row.dof for row in rows if row.dof])


def _covered(group: str, quantity: str, level: float, errors: np.ndarray, tests: int) -> CoverageRow:
    inside = int(np.sum(np.abs(errors) <= scipy.stats.norm.ppf((1 + level) / 2)))
    return CoverageRow(group, quantity, level, len(errors), inside, *binomial_limits(len(errors), level, tests))


def _joint(group: str, squares: np.ndarray, dof: np.ndarray, tests: int) -> JointRow:
    total = float(dof.sum())
    tail = LEVEL / 2 / tests
    low, high = (scipy.stats.chi2.ppf([tail, 1 - tail], total) / total).tolist()
    ks = float(scipy.stats.kstest(scipy.stats.chi2.sf(squares, dof), "uniform").pvalue)
    return JointRow(group, len(squares), float(squares.sum()) / total, low, high, ks, LEVEL / tests)


def _repeat(session: str, quantity: str, draws: int, spread: float, reported: float, tests: int) -> RepeatRow:
    tail, freedom = LEVEL / 2 / tests, draws - 1
    least, most = np.sqrt(freedom / scipy.stats.chi2.ppf([1 - tail, tail], freedom)).tolist()
    return RepeatRow(session, quantity, draws, spread, reported, reported / spread, least, most)


def pooled(judged: Judged) -> dict[str, RepeatRow]:
    """Return each quantity's scatter over all repeated sessions."""
    return {row.quantity: row for row in judged.repeats if row.session == ALL}
