"""Does a rig in use get the verdict, and the update, that it deserves?

1. **New views of a board.** How often is a rig as calibrated called degraded, and have the parts of the test their
   laws, with one view as with four? Are moves worth noticing found, and is what moved named?
2. **Field recalibration.** Are the errors of a rig that images of unknown planes have updated those of its covariance,
   where nothing has moved and where the beam has, by 0.05 mm and 0.5 mrad?
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor

import scipy.stats

from planeopt.estimation.misfits import LEVEL
from studies.rig_checks_cells import CheckRow, UpdateRow, run_checks, run_updates
from studies.statistics import LEVEL as FAMILY
from studies.statistics import binomial_limits
from studies.study import Mode, Result

_PARTS = ("pooled", "shift", "rest", "spots")
_COMPONENTS = (("parameters", 8), ("four", 4), ("plane", 3))


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer both questions."""
    checks, updates = run_checks(mode, executor), run_updates(mode, executor)
    return Result({"checks": checks, "updates": updates}, _headline(checks, updates), _finding(checks, updates))


def faults(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> list[str]:
    """Return what is beyond its limits: two-sided, family-wise 0.001; nothing for right code."""
    right = [row for row in checks if row.moved == "nothing"]
    laws = [(row, part, getattr(row, f"{part}_uniform")) for row in right for part in _PARTS]
    laws = [law for law in laws if not math.isnan(law[2])]
    means = [(row, name, getattr(row, name), dof) for row in updates for name, dof in _COMPONENTS]
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
        count = dof * round(row.updates * (1 - row.refused))
        low, high = scipy.stats.chi2.ppf([FAMILY / 2 / tests, 1 - FAMILY / 2 / tests], count) / count
        if not low <= value <= high:
            found.append(f"{name}, moved: {row.moved}: {value:.4g}, outside {low:.4g} to {high:.4g}")
    found += [
        f"{row.refused:.4g} of updates refused, moved: {row.moved}"
        for row in updates
        if row.refused * row.updates > binomial_limits(row.updates, LEVEL, tests)[1]
    ]
    return found


def _headline(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> str:
    right = [row for row in checks if row.moved == "nothing"]
    moved = [row for row in checks if row.moved != "nothing"]
    fewest, most = min(row.views for row in moved), max(row.views for row in moved)
    count = sum(row.checks for row in right)
    called = sum(round(row.degraded * row.checks) for row in right)
    several, few = ([row for row in moved if row.views == views] for views in (most, fewest))
    return (
        f"Of {count} rigs as calibrated new views of a board call {called} degraded; with {most} views moves worth "
        f"noticing are found in {_share(several, 'degraded')} and named in {_share(several, 'named')} of the checks, "
        f"with {fewest} in {_share(few, 'degraded')} and {_share(few, 'named')}. "
        f"The squared error of updated rigs over their covariance is {min(row.parameters for row in updates):.2f} to "
        f"{max(row.parameters for row in updates):.2f}, of planes measured with them "
        f"{min(row.plane for row in updates):.2f} to {max(row.plane for row in updates):.2f}."
    )


def _share(rows: Sequence[CheckRow], name: str) -> str:
    total = sum(row.checks for row in rows)
    return f"{sum(getattr(row, name) * row.checks for row in rows) / total:.0%}"


def _finding(checks: Sequence[CheckRow], updates: Sequence[UpdateRow]) -> str:
    lines = [
        "# Rigs in use",
        "",
        "## New views of a board",
        "",
        "Random rigs with the covariance of a calibration; what is in their files is drawn from it, the boards' bow "
        "from what is allowed for. The parts over their degrees of freedom; `degraded` and `named` are shares of the "
        "checks, `named` that the group that moved is the first cause or said to do as well. Moves: 0.5 % of the "
        "focal length, 0.3 % of the image's width, 1 % at the image's corner, 2 % and 1 % of the radius (offset, "
        "radius), 1 mrad.",
        "",
        "| moved | views | checks | pooled | shift | rest | spots | degraded | named |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row.moved} | {row.views} | {row.checks} | {_cell(row.pooled)} | {_cell(row.shift)} | "
            f"{_cell(row.rest)} | {_cell(row.spots)} | {row.degraded:.3f} | {_cell(row.named)} |"
            for row in checks
        ),
        "",
        "## Field recalibration",
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
