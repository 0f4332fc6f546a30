"""What the study of SWIFT says, made from its tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.swift_paths import PathRow, ValleyRow, WorkRow
from studies.swift_runs import AT_MINIMISER, DEFAULT, READINGS, STARTS, RunRow
from studies.swift_weights import ToleranceRow, WeightRow

IN_WORDS = {"printed": "J = 0", "image objective": "J = image block"}
"""The readings of (29)."""


@dataclass(frozen=True)
class EndRow:
    """Where the searches of a schedule end.

    Attributes
    ----------
    start, reading, method, schedule : str
    searches, minimiser, local, none : int
        All, and those that end at the minimiser, at another point that fulfils the conditions of a minimum, elsewhere.
    median_evaluations : float
        Of values, over all searches.
    median_calls : float
        Of values and derivatives.
    """

    start: str
    reading: str
    method: str
    schedule: str
    searches: int
    minimiser: int
    local: int
    none: int
    median_evaluations: float
    median_calls: float


@dataclass(frozen=True)
class ReachedRow:
    """Calls after which a search stays within `AT_MINIMISER` of the minimiser; nothing where it never does."""

    problem: str
    start: str
    method: str
    calls: float
    minimiser_to_truth: float


@dataclass(frozen=True)
class Tables:
    """All tables of the study."""

    runs: Sequence[RunRow]
    ends: Sequence[EndRow]
    weights: Sequence[WeightRow]
    tolerances: Sequence[ToleranceRow]
    work: Sequence[WorkRow]
    reached: Sequence[ReachedRow]
    paths: Sequence[PathRow]
    valley: Sequence[ValleyRow]


def ends_of(runs: Sequence[RunRow]) -> list[EndRow]:
    """Count where the searches end, by start, reading, method and schedule."""
    keys = dict.fromkeys((run.start, run.reading, run.method, run.schedule) for run in runs)
    return [
        _end_row([run for run in runs if (run.start, run.reading, run.method, run.schedule) == key]) for key in keys
    ]


def _end_row(runs: Sequence[RunRow]) -> EndRow:
    first, ended = runs[0], [run.end for run in runs]
    calls = [run.evaluations + run.first_derivatives + run.second_derivatives for run in runs]
    return EndRow(
        first.start,
        first.reading,
        first.method,
        first.schedule,
        len(runs),
        ended.count("minimiser"),
        ended.count("local"),
        ended.count("none"),
        float(np.median([run.evaluations for run in runs])),
        float(np.median(calls)),
    )


def reached(work: Sequence[WorkRow]) -> list[ReachedRow]:
    """The least work after which a search stays near the minimiser."""
    rows = []
    for key in dict.fromkeys((row.problem, row.start, row.method) for row in work):
        own = [row for row in work if (row.problem, row.start, row.method) == key]
        far = [i for i, row in enumerate(own) if not row.to_minimiser <= AT_MINIMISER]
        first = far[-1] + 1 if far else 0
        calls = float(own[first].calls) if first < len(own) else np.nan
        nearest = min(own, key=lambda row: row.to_minimiser)
        rows.append(ReachedRow(*key, calls, nearest.to_truth))
    return rows


def ends(rows: Sequence[EndRow], start: str, reading: str, method: str, schedule: str | None = None) -> EndRow:
    """The row of these."""
    return next(
        row
        for row in rows
        if (row.start, row.reading, row.method) == (start, reading, method) and schedule in (None, row.schedule)
    )


def slope_of_violation(rows: Sequence[WeightRow]) -> float:
    """Exponent of the weight with which the laser's violation falls, image block as objective.

    Where the violation is between a thousandth of that without the beam's equations and rounding: by least squares over
    all problems, each with a level of its own.
    """
    x, y = [], []
    for problem in dict.fromkeys(row.problem for row in rows):
        own = [row for row in rows if row.problem == problem and row.reading == "image objective"]
        most = max(row.laser_violation for row in own)
        used = [row for row in own if 1e-13 < row.laser_violation < 1e-2 * most]
        weight, violation = (np.log10([getattr(row, name) for row in used]) for name in ("weight", "laser_violation"))
        x.append(weight - np.mean(weight))
        y.append(violation - np.mean(violation))
    u, v = np.concatenate(x), np.concatenate(y)
    return float(u @ v / (u @ u))


def slope_of_tolerance(rows: Sequence[ToleranceRow]) -> float:
    """Exponent of the weight with which the distance falls at which a simplex of equal values ends."""
    x, y = [], []
    for problem in dict.fromkeys(row.problem for row in rows):
        own = [row for row in rows if row.problem == problem and row.to_minimiser > 0]
        weight, off = (np.log10([getattr(row, name) for row in own]) for name in ("weight", "to_minimiser"))
        x.append(weight - np.mean(weight))
        y.append(off - np.mean(off))
    u, v = np.concatenate(x), np.concatenate(y)
    return float(u @ v / (u @ u))


def numbers(tables: Tables) -> dict[str, float]:
    """Return every number of the headline, by name."""
    idle = [row for row in tables.weights if row.reading == "printed"]
    printed, blocks = (ends(tables.ends, "paper's", reading, "Swift", DEFAULT) for reading in READINGS)
    heavy = ends(tables.ends, "paper's", "image objective", "Swift", "1e5")
    at_once = ends(tables.ends, "paper's", "image objective", "Ipopt")
    ipopt = ends(tables.ends, "paper's", "printed", "Ipopt")
    found: dict[str, float] = {
        "weights_decades": round(np.log10(max(row.weight for row in idle) / min(row.weight for row in idle))),
        "J_0_minimiser_moves_at_most": max(row.most_from_weight_1 for row in idle),
        "image_objective_violation_falls_with_weight_to_the_power": slope_of_violation(tables.weights),
        "searches_from_paper_start": printed.searches,
        "J_0_schedule_at_minimiser": printed.minimiser,
        "image_objective_schedule_at_minimiser": blocks.minimiser,
        "image_objective_weight_1e5_alone_at_minimiser": heavy.minimiser,
        "ipopt_J_0_at_minimiser": ipopt.minimiser,
        "ipopt_image_objective_weight_1e5_at_minimiser": at_once.minimiser,
        "heavy_weight": 1e5,
    }
    for name, row in (("swift", printed), ("ipopt", ipopt)):
        if row.minimiser:
            found[f"{name}_J_0_median_calls"] = median_calls(tables.runs, row)
    return found


def median_calls(runs: Sequence[RunRow], of: EndRow) -> float:
    """Return the median of the calls of values and derivatives, over the searches that end at the minimiser."""
    key = (of.start, of.reading, of.method, of.schedule)
    own = [run for run in runs if (run.start, run.reading, run.method, run.schedule) == key and run.end == "minimiser"]
    return float(np.median([run.evaluations + run.first_derivatives + run.second_derivatives for run in own]))


def headline(said: Mapping[str, float]) -> str:
    """Say it in a sentence."""
    return (
        f"With J = 0 the minimiser of (29) moves by at most {said['J_0_minimiser_moves_at_most']:.0e} of itself over "
        f"{said['weights_decades']:.0f} decades of the weight. With the image block as the objective the beam's "
        f"violation goes as the weight to the power "
        f"{said['image_objective_violation_falls_with_weight_to_the_power']:.2f}, and from the paper's start SWIFT "
        f"finds the minimiser in {said['image_objective_schedule_at_minimiser']} of "
        f"{said['searches_from_paper_start']} problems by a rising weight, in "
        f"{said['image_objective_weight_1e5_alone_at_minimiser']} by the weight {said['heavy_weight']:.0e} at once "
        f"(IPOPT: {said['ipopt_image_objective_weight_1e5_at_minimiser']}); with J = 0 SWIFT finds it in "
        f"{said['J_0_schedule_at_minimiser']}{_by_calls(said, 'swift')}, IPOPT in "
        f"{said['ipopt_J_0_at_minimiser']}{_by_calls(said, 'ipopt')}."
    )


def _by_calls(said: Mapping[str, float], name: str) -> str:
    """Say with how much work, unless nothing was found."""
    calls = said.get(f"{name}_J_0_median_calls")
    return "" if calls is None else f", there by {calls:.0f} calls in the median"


def finding(tables: Tables, said: Mapping[str, float]) -> str:
    """Say what was found; every number comes from the tables."""
    lightest, heaviest = min(row.weight for row in tables.weights), max(row.weight for row in tables.weights)
    lines = [
        "# The rising weight of SWIFT",
        "",
        f"**In short.** {headline(said)}",
        "",
        "**The weight with J = 0.** (29) is then the weight times one sum of squares, whose minimiser no factor "
        "moves; the residuals of ten equations with noise do not vanish there either. What changes is what a "
        "difference of values means: a simplex that ends where its values differ by less than a fixed amount ends at "
        f"distances that fall as the weight to the power {slope_of_tolerance(tables.tolerances):.2f} "
        "(`tolerances.csv`; a quadratic valley has -0.5).",
        "",
        f"**What the weight does** (`weights.csv`, weights {lightest:g} to {heaviest:g}, noise of 0.3 px).",
        "",
        "| problem | (29) | moved from weight 1, at most | laser violation, lightest | heaviest | RMS error over "
        "Constrained's, lightest | heaviest |",
        "|---|---|---|---|---|---|---|",
        *_weights(tables.weights),
        "",
        f"At the weight {heaviest:g} the RMS errors of the two readings' minimisers differ by at most "
        f"{_readings_apart(tables.weights, heaviest):.1e} of themselves (`rms_error`); `Constrained` weighs the image "
        "equations by their covariance.",
        "",
        "**Schedules** (`ends.csv`, from `runs.csv`; at the minimiser within 1e-6).",
        "",
        "| start | (29) | search | weights | at the minimiser | at another minimum | elsewhere | median evaluations | "
        "median calls with derivatives |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row.start} | {IN_WORDS[row.reading]} | {row.method} | {row.schedule} | {row.minimiser} of "
            f"{row.searches} | {row.local} | {row.none} | {row.median_evaluations:.0f} | {row.median_calls:.0f} |"
            for start in STARTS
            for row in tables.ends
            if row.start == start
        ),
        "",
        "**Work to the minimiser, J = 0** (`reached.csv`, from `work.csv`: calls after which the search stays within "
        "1e-6 of it). What is left to the truth is the noise's.",
        "",
        "| problem | start | minimiser to truth | " + " | ".join(_methods(tables.reached)) + " |",
        "|---|---|---|" + "---|" * len(_methods(tables.reached)),
        *_reached(tables.reached),
    ]
    return "\n".join(lines)


def _methods(rows: Sequence[ReachedRow]) -> list[str]:
    return list(dict.fromkeys(row.method for row in rows))


def _reached(rows: Sequence[ReachedRow]) -> list[str]:
    lines = []
    for problem, start in dict.fromkeys((row.problem, row.start) for row in rows):
        own = {row.method: row for row in rows if (row.problem, row.start) == (problem, start)}
        error = min(row.minimiser_to_truth for row in own.values())
        cells = ("never" if np.isnan(own[name].calls) else f"{own[name].calls:.0f}" for name in _methods(rows))
        lines.append(f"| {problem} | {start} | {error:.1e} | {' | '.join(cells)} |")
    return lines


def _readings_apart(rows: Sequence[WeightRow], weight: float) -> float:
    """Return the largest relative difference of the two readings' errors at a weight, over the problems."""
    first, second = (
        {row.problem: row.rms_error for row in rows if (row.reading, row.weight) == (reading, weight)}
        for reading in READINGS
    )
    return max(abs(first[problem] / second[problem] - 1) for problem in first)


def _weights(rows: Sequence[WeightRow]) -> list[str]:
    lines = []
    for problem, reading in dict.fromkeys((row.problem, row.reading) for row in rows):
        own = [row for row in rows if (row.problem, row.reading) == (problem, reading)]
        first, last = own[0], own[-1]
        moved = max(row.most_from_weight_1 for row in own)
        lines.append(
            f"| {problem} | {IN_WORDS[reading]} | {moved:.0e} | {first.laser_violation:.0e} | "
            f"{last.laser_violation:.0e} | {first.over_constrained:.2f} | {last.over_constrained:.2f} |"
        )
    return lines
