"""What the sets add up to: how often intervals hold the truth, whether ranks are uniform, and the finding in words."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from studies.coverage_checks import LEVELS, RANKS, UNRANKED, Checks, covered
from studies.coverage_draws import QUANTITIES
from studies.coverage_images import ImageRow
from studies.coverage_points import SetRow
from studies.coverage_rig import COUNTED, IGNORED, OFFSET_SIGMA_MM, WrongRigRow
from studies.outline import Array
from studies.statistics import LEVEL, binomial_limits, uniform_p

METHODS = ("Laplace", "posterior")
PER_BIN = 20
"""Ranks expected in a bin, at least."""

Groups = Mapping[str, Sequence[Checks]]


@dataclass(frozen=True)
class CoverageRow:
    """How often an interval held the truth.

    Attributes
    ----------
    group : str
        Of sets.
    method : str
        Laplace: the plane of maximum likelihood with its first-order sigma, where it may be trusted; posterior: all.
    quantity : str
    level : float
        What the interval claims.
    sets, covered : int
    least, most : int
        That right code has, two-sided at a family-wise level of 0.001 over all rows and all rows of the ranks.
    """

    group: str
    method: str
    quantity: str
    level: float
    sets: int
    covered: int
    least: int
    most: int

    @property
    def share(self) -> float:
        return self.covered / self.sets

    @property
    def within(self) -> bool:
        return self.least <= self.covered <= self.most


@dataclass(frozen=True)
class RankRow:
    """Whether the truth's ranks among the posterior's draws are uniform.

    Attributes
    ----------
    group, quantity : str
    sets, bins : int
    p_value : float
        Of chi-squared over the bins.
    least : float
        That right code has, at a family-wise level of 0.001 over all rows and all rows of the coverage.
    """

    group: str
    quantity: str
    sets: int
    bins: int
    p_value: float
    least: float

    @property
    def within(self) -> bool:
        return self.p_value >= self.least


def sigmas_of(rows: Sequence[Checks], quantity: str) -> Array:
    """Return the errors in own sigmas of the rows that have them."""
    values = np.array([getattr(row, f"{quantity}_sigmas") for row in rows], dtype=float)
    return values[np.isfinite(values)]


def ranks_of(rows: Sequence[Checks], quantity: str) -> NDArray[np.intp]:
    """Return the ranks of the rows that have them."""
    values = np.array([getattr(row, f"{quantity}_rank") for row in rows], dtype=np.intp)
    return values[values != UNRANKED]


def held(rows: Sequence[Checks], method: str, quantity: str) -> Callable[[float], NDArray[np.bool_]]:
    """Return a function of the level: whether the interval of each set held the truth."""
    if method == "Laplace":
        errors = np.abs(sigmas_of(rows, quantity))
        return lambda level: errors <= scipy.stats.norm.ppf((1 + level) / 2)
    found = ranks_of(rows, quantity)
    return lambda level: covered(found, level)


def judge(groups: Groups) -> tuple[list[CoverageRow], list[RankRow]]:
    """Count every interval and test all ranks, as one family."""
    cases = [
        (group, method, quantity, level, held(rows, method, quantity)(level))
        for group, rows in groups.items()
        for method in METHODS
        for quantity in QUANTITIES
        for level in LEVELS
    ]
    ranked = [(group, quantity, ranks_of(rows, quantity)) for group, rows in groups.items() for quantity in QUANTITIES]
    cases = [case for case in cases if len(case[-1])]
    ranked = [case for case in ranked if len(case[-1])]
    tests = len(cases) + len(ranked)
    coverage = [
        CoverageRow(
            group, method, quantity, level, len(inside), int(inside.sum()), *binomial_limits(len(inside), level, tests)
        )
        for group, method, quantity, level, inside in cases
    ]
    ranks = []
    for group, quantity, found in ranked:
        bins = bins_for(len(found))
        p_value = uniform_p(found.tolist(), RANKS, bins)
        ranks.append(RankRow(group, quantity, len(found), bins, p_value, LEVEL / tests))
    return coverage, ranks


def bins_for(sets: int) -> int:
    """Return the most bins, up to 20, of equally many ranks with enough sets in each."""
    return max((bins for bins in (2, 4, 5, 10, 20) if sets >= PER_BIN * bins), default=2)


POINTS, IMAGES = "point sets", "images"
WITHOUT, WITH = "rig without covariance", "rig with covariance"
UNCERTAIN, IGNORING = "offset known to 0.04 mm, counted", "offset known to 0.04 mm, ignored"

_SAID = (
    ("posterior_sets", POINTS, "posterior"),
    ("posterior_images", IMAGES, "posterior"),
    ("laplace_sets", POINTS, "Laplace"),
    ("laplace_images", IMAGES, "Laplace"),
    ("posterior_with_covariance", WITH, "posterior"),
    ("laplace_with_covariance", WITH, "Laplace"),
    ("posterior_without_covariance", WITHOUT, "posterior"),
    ("laplace_without_covariance", WITHOUT, "Laplace"),
    ("posterior_ignored", IGNORING, "posterior"),
)
"""What the headline says of which group, by which method."""


def groups_of(points: Sequence[SetRow], images: Sequence[ImageRow], wrong_rig: Sequence[WrongRigRow]) -> Groups:
    """Return every group that is judged: the point sets in parts as well."""
    return {
        POINTS: points,
        "full arc": [row for row in points if row.arc == 1],
        "40 % of the arc": [row for row in points if row.arc < 1],
        WITHOUT: [row for row in points if row.covariance == "none"],
        WITH: [row for row in points if row.covariance == "given"],
        IMAGES: images,
        UNCERTAIN: [row for row in wrong_rig if row.rig == COUNTED],
        IGNORING: [row for row in wrong_rig if row.rig == IGNORED],
    }


def numbers(
    points: Sequence[SetRow], images: Sequence[ImageRow], coverage: Sequence[CoverageRow], ranks: Sequence[RankRow]
) -> dict[str, float]:
    """Return the headline's numbers: shares are of `coverage.csv` at the level 0.95, `covered` over `sets`, in %."""
    right = [row for row in coverage if row.group != IGNORING]
    p_values = [row for row in ranks if row.group != IGNORING]
    found: dict[str, float] = {
        "level_percent": 100 * LEVELS[1],
        "point_sets": len(points),
        "images": sum(row.outcome == "measured" for row in images),
        "proportions": len(right),
        "proportions_within": sum(row.within for row in right),
        "rank_tests": len(p_values),
        "rank_tests_within": sum(row.within for row in p_values),
        "family_wise_level": LEVEL,
        "offset_sigma_mm": OFFSET_SIGMA_MM,
    }
    for name, group, method in _SAID:
        shares = [100 * r.share for r in coverage if (r.group, r.method, r.level) == (group, method, LEVELS[1])]
        found |= {
            f"{name}_least_percent": min(shares, default=np.nan),
            f"{name}_most_percent": max(shares, default=np.nan),
        }
    return found


def headline(n: Mapping[str, float]) -> str:
    """Say it in a sentence."""

    def span(name: str) -> str:
        low, high = f"{n[f'{name}_least_percent']:.1f}", f"{n[f'{name}_most_percent']:.1f}"
        return low if low == high else f"{low} to {high}"

    return (
        f"Over {n['point_sets']:.0f} point sets and {n['images']:.0f} images {n['level_percent']:.0f} % intervals hold "
        f"the truth in {span('posterior_sets')} % and {span('posterior_images')} % (posterior, sampled by emcee; over "
        f"the five quantities), {span('laplace_sets')} % and {span('laplace_images')} % (Laplace, of first order, "
        f"where it may be trusted); with a rig known only as well as its covariance says in "
        f"{span('posterior_with_covariance')} % and {span('laplace_with_covariance')} % of the sets, with a rig known "
        f"exactly in {span('posterior_without_covariance')} % and {span('laplace_without_covariance')} %; "
        f"{n['proportions_within']:.0f} of {n['proportions']:.0f} proportions and {n['rank_tests_within']:.0f} of "
        f"{n['rank_tests']:.0f} tests of the ranks are within their limits at a family-wise "
        f"{n['family_wise_level']:g}. Ignoring that an offset is uncertain by {n['offset_sigma_mm']:g} mm leaves "
        f"{span('posterior_ignored')} %."
    )


def finding(
    points: Sequence[SetRow], images: Sequence[ImageRow], coverage: Sequence[CoverageRow], ranks: Sequence[RankRow]
) -> str:
    """Say what was found; every number comes from the tables."""
    limits = next(row for row in coverage if (row.group, row.method, row.level) == (POINTS, "posterior", 0.95))
    refused = Counter(row.outcome for row in images if row.outcome != "measured")
    lines = [
        "# Coverage",
        "",
        f"**Sets.** {len(points)} point sets of {len({row.rig for row in points})} rigs; "
        f"{sum(row.passed_over for row in points)} more were passed over for what was measured of them (too small, "
        f"or no ellipse). {sum(row.covariance == 'given' for row in points)} have a rig that was drawn from its "
        f"calibration's covariance, {sum(row.arc < 1 for row in points)} cover 40 % of the arc, "
        f"{sum(row.prior_dominated for row in points)} are dominated by the prior, by their own account. Intervals of "
        f"first order may be trusted, by theirs, in {len(sigmas_of(points, 'z_L'))} (tilt and R in "
        f"{len(sigmas_of(points, 'alpha'))}). The posterior's chains have {_least_draws(points)} effective draws.",
        "",
        f"**Images.** {len(images)} images; refused by the image alone: "
        f"{', '.join(f'{count} {reason}' for reason, count in sorted(refused.items())) or 'none'}.",
        "",
        f"**Coverage.** Every proportion has two-sided limits at a family-wise level of {LEVEL}, over all "
        f"{len(coverage)} proportions and {len(ranks)} tests of ranks together; for 95 % of {limits.sets} sets they "
        f"are {100 * limits.least / limits.sets:.1f} to {100 * limits.most / limits.sets:.1f} %. "
        f"{_outside([row for row in coverage if row.group != IGNORING])}",
        "",
        f"| sets | intervals | level | {' | '.join(_NAMES.values())} |",
        f"|---|---|---|{'---|' * len(QUANTITIES)}",
        *_table(coverage),
        "",
        f"**Ranks** of the truth among {RANKS - 1} draws of the posterior, p-values of chi-squared over bins (right "
        f"code: above {ranks[0].least:.1g} in all of them together, in 999 of 1,000 runs):",
        "",
        f"| sets | bins | {' | '.join(_NAMES.values())} |",
        f"|---|---|{'---|' * len(QUANTITIES)}",
        *_rank_table(ranks),
        "",
        "**The calibration's covariance.** With an offset known to 0.04 mm and a calibration whose covariance says so, "
        f"95 % intervals hold the truth in {_shares(coverage, (UNCERTAIN,), 'posterior', 0.95)} % of "
        f"{_sets(coverage, UNCERTAIN)} sets (first order: {_shares(coverage, (UNCERTAIN,), 'Laplace', 0.95)} %); those "
        f"that take the offset as exact in {_shares(coverage, (IGNORING,), 'posterior', 0.95)} % (first order: "
        f"{_shares(coverage, (IGNORING,), 'Laplace', 0.95)} %).",
    ]
    return "\n".join(lines)


_NAMES = {"z_L": "z_L", "p": "p", "q": "q", "alpha": "tilt", "R": "R"}


def _least_draws(points: Sequence[SetRow]) -> str:
    draws = np.array([row.effective_draws for row in points])
    return f"{np.nanmin(draws):.0f} to {np.nanmax(draws):.0f}"


def _shares(coverage: Sequence[CoverageRow], groups: Sequence[str], method: str, level: float) -> str:
    found = [100 * r.share for r in coverage if r.group in groups and (r.method, r.level) == (method, level)]
    if not found:
        return "none"
    low, high = f"{min(found):.1f}", f"{max(found):.1f}"
    return low if low == high else f"{low} to {high}"


def _sets(coverage: Sequence[CoverageRow], group: str) -> int:
    return max((row.sets for row in coverage if row.group == group), default=0)


def _outside(coverage: Sequence[CoverageRow]) -> str:
    outside = [row for row in coverage if not row.within]
    if not outside:
        return f"All {len(coverage)} that should be are within them (in %):"
    named = (f"{row.group}, {row.method}, {_NAMES[row.quantity]}, {100 * row.level:.0f} %" for row in outside)
    return f"Outside are {len(outside)} of {len(coverage)}: {'; '.join(named)} (in %):"


def _table(coverage: Sequence[CoverageRow]) -> Iterator[str]:
    shares = {(row.group, row.method, row.level, row.quantity): row for row in coverage}
    for group, method, level in dict.fromkeys((row.group, row.method, row.level) for row in coverage):
        rows = [shares.get((group, method, level, quantity)) for quantity in QUANTITIES]
        cells = ("-" if row is None else f"{100 * row.share:.1f}" for row in rows)
        yield f"| {group} | {method} | {100 * level:.0f} | {' | '.join(cells)} |"


def _rank_table(ranks: Sequence[RankRow]) -> Iterator[str]:
    p_values = {(row.group, row.quantity): f"{row.p_value:.2g}" for row in ranks}
    for group, bins in dict.fromkeys((row.group, row.bins) for row in ranks):
        yield f"| {group} | {bins} | {' | '.join(p_values.get((group, name), '-') for name in QUANTITIES)} |"
