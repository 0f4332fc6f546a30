"""Does a rig in use get the verdict, and the update, that it deserves?

1. **New views of a board.** How often is a rig as calibrated called degraded, and have the parts of the test their
   laws, with one view as with four? Are moves worth noticing found, and is what moved named?
2. **Field recalibration.** Are the errors of a rig that images of unknown planes have updated those of its covariance,
   where nothing has moved and where the beam has, by 0.05 mm and 0.5 mrad?
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import scipy.stats

from planeopt.estimation.misfits import LEVEL
from studies.rig_checks_cells import COMPONENTS, RIGHT, CheckRow, UpdateRow, run_checks, run_updates
from studies.rig_checks_figure import Limits, rig_checks_figure
from studies.statistics import LEVEL as FAMILY
from studies.statistics import binomial_limits
from studies.study import Mode, Result, read_rows, rounded

_PARTS = ("pooled", "shift", "rest", "spots")


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer both questions."""
    return result_of(run_checks(mode, executor), run_updates(mode, executor))


def result_of(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> Result:
    """Return the tables, the figure and the words of what was simulated."""
    checks, updates = rounded(checks), rounded(updates)
    said, limits = numbers(checks, updates), _limits(checks, updates)
    return Result(
        tables={"checks": checks, "updates": updates},
        headline=headline(said),
        finding=_finding(checks, updates),
        figures={"rig_checks": rig_checks_figure(checks, updates, limits)},
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_rows(folder / "checks.csv", CheckRow), read_rows(folder / "updates.csv", UpdateRow))


def faults(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> list[str]:
    """Return what is beyond its limits: two-sided, family-wise 0.001; nothing for right code."""
    right, laws, means = _judged(checks, updates)
    tests = len(laws) + len(right) + len(means) + len(updates)
    found = [
        f"{part} of {row.views} views: p-values are not uniform (p = {p_value:.2g})"
        for row, part, p_value in laws
        if p_value < FAMILY / tests
    ]
    found += [
        f"{row.degraded:.4g} of right rigs called degraded by {row.views} views"
        for row in right
        if row.degraded * row.checks > binomial_limits(row.checks, LEVEL, tests)[1]
    ]
    for row, name, value, dof in means:
        low, high = _mean_limits(row, dof, tests)
        if not low <= value <= high:
            found.append(f"{name}, moved: {row.moved}: {value:.4g}, outside {low:.4g} to {high:.4g}")
    found += [
        f"{row.refused:.4g} of updates refused, moved: {row.moved}"
        for row in updates
        if row.refused * row.updates > binomial_limits(row.updates, LEVEL, tests)[1]
    ]
    return found


def _judged(
    checks: Sequence[CheckRow], updates: Sequence[UpdateRow]
) -> tuple[list[CheckRow], list[tuple[CheckRow, str, float]], list[tuple[UpdateRow, str, float, int]]]:
    """Return the rows of right rigs, the p-values of their laws, and the updates' mean squared errors."""
    right = [row for row in checks if row.moved == RIGHT]
    laws = [(row, part, getattr(row, f"{part}_uniform")) for row in right for part in _PARTS]
    means = [(row, name, getattr(row, name), dof) for row in updates for name, dof in COMPONENTS.items()]
    return right, [law for law in laws if not math.isnan(law[2])], means


def _mean_limits(row: UpdateRow, dof: int, tests: int) -> tuple[float, float]:
    """Return the least and the largest mean of squared errors, a component, that right code has."""
    count = dof * round(row.updates * (1 - row.refused))
    low, high = (scipy.stats.chi2.ppf([FAMILY / 2 / tests, 1 - FAMILY / 2 / tests], count) / count).tolist()
    return low, high


def _limits(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> Limits:
    """Return the limits of every mean, by what moved and the component."""
    right, laws, means = _judged(checks, updates)
    tests = len(laws) + len(right) + len(means) + len(updates)
    return {(row.moved, name): _mean_limits(row, dof, tests) for row, name, _, dof in means}


def numbers(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> dict[str, float]:
    """Return the headline's numbers, of which `finding` says whence they come."""
    right = [row for row in checks if row.moved == RIGHT]
    moved = [row for row in checks if row.moved != RIGHT]
    fewest, most = min(row.views for row in moved), max(row.views for row in moved)
    several, few = ([row for row in moved if row.views == views] for views in (most, fewest))
    return {
        "right_rigs": sum(row.checks for row in right),
        "right_rigs_degraded": sum(round(row.degraded * row.checks) for row in right),
        "most_views": most,
        "found_percent_most_views": _share(several, "degraded"),
        "named_percent_most_views": _share(several, "named"),
        "fewest_views": fewest,
        "found_percent_fewest_views": _share(few, "degraded"),
        "named_percent_fewest_views": _share(few, "named"),
        "least_parameters": min(row.parameters for row in updates),
        "largest_parameters": max(row.parameters for row in updates),
        "least_plane": min(row.plane for row in updates),
        "largest_plane": max(row.plane for row in updates),
    }


def headline(n: Mapping[str, float]) -> str:
    """Say it in two sentences."""
    return (
        f"Of {n['right_rigs']:.0f} rigs as calibrated new views of a board call {n['right_rigs_degraded']:.0f} "
        f"degraded; with {n['most_views']:.0f} views moves worth noticing are found in "
        f"{n['found_percent_most_views']:.0f} % and named in {n['named_percent_most_views']:.0f} % of the checks, with "
        f"{n['fewest_views']:.0f} in {n['found_percent_fewest_views']:.0f} % and "
        f"{n['named_percent_fewest_views']:.0f} %. The squared error of updated rigs over their covariance is "
        f"{n['least_parameters']:.2f} to {n['largest_parameters']:.2f}, of planes measured with them "
        f"{n['least_plane']:.2f} to {n['largest_plane']:.2f}."
    )


def _share(rows: Sequence[CheckRow], name: str) -> float:
    """Return the share of all checks, percent."""
    total = sum(row.checks for row in rows)
    return 100 * sum(getattr(row, name) * row.checks for row in rows) / total


def _finding(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> str:
    lines = [
        "# Rigs in use",
        "",
        "## New views of a board (`checks.csv`)",
        "",
        "Random rigs with the covariance of a calibration; what is in their files is drawn from it, the boards' bow "
        "from what is allowed for. The parts over their degrees of freedom; `degraded` and `named` are shares of the "
        "checks, `named` that the group that moved is the first cause or said to do as well. Moves: 0.5 % of the "
        "focal length, 0.3 % of the image's width, 1 % at the image's corner, 2 % and 1 % of the radius (offset, "
        "radius), 1 mrad. The headline's shares are those of all checks with so many views.",
        "",
        "| moved | views | checks | pooled | shift | rest | spots | degraded | named |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row.moved} | {row.views} | {row.checks} | {_cell(row.pooled)} | {_cell(row.shift)} | "
            f"{_cell(row.rest)} | {_cell(row.spots)} | {row.degraded:.3f} | {_cell(row.named)} |"
            for row in checks
        ),
        "",
        "## Field recalibration (`updates.csv`)",
        "",
        "Squared errors over the stated covariance, a component (1 is right): of all parameters, of the four numbers "
        "that images of planes see, of the plane in a new image.",
        "",
        "| moved | images | updates | refused | parameters | four numbers | plane |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {row.moved} | {row.images} | {row.updates} | {row.refused:.3f} | {row.parameters:.3f} | "
            f"{row.four:.3f} | {row.plane:.3f} |"
            for row in updates
        ),
        "",
    ]
    found = faults(checks, updates)
    if not found:
        return "\n".join([*lines, f"All of this is within its limits (two-sided, family-wise {FAMILY:g})."])
    return "\n".join([*lines, "Beyond its limits:", "", *(f"- {fault}" for fault in found)])


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3f}"
