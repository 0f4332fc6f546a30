"""What each method did over many problems."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats

from planeopt.comparison.problem import Case
from planeopt.comparison.rows import EFFORT, InBound, Root, Row


@dataclass(frozen=True)
class Pooled:
    """Differences over the bound, pooled over problems and over ``(z_L, p, q)``.

    Attributes
    ----------
    count : int
        How many problems have one.
    rms : float
        Root of the mean square: 1 at the bound.
    monte_carlo : float or None
        Standard deviation of ``rms`` from the number of problems, by the scatter of the squares; None for one problem.
    median : float
        Of the same, scaled to be 1 for normal errors at the bound; a few wild answers do not move it.
    z_L, p, q : float
        Root mean square of each component over the bound's standard deviation.
    """

    count: int
    rms: float
    monte_carlo: float | None
    median: float
    z_L: float
    p: float
    q: float

    @classmethod
    def of(cls, differences: Sequence[InBound]) -> "Pooled | None":
        """Return what they come to; None of none."""
        if not differences:
            return None
        squares = np.array([d.mahalanobis**2 for d in differences])
        rms = math.sqrt(float(np.mean(squares)) / 3)
        scatter = None
        if len(squares) > 1 and rms > 0:
            # d rms = d(mean of squares / 3) / (2 rms)
            scatter = float(np.std(squares / 3, ddof=1)) / math.sqrt(len(squares)) / (2 * rms)
        median = math.sqrt(float(np.median(squares)) / float(scipy.stats.chi2.median(3)))
        parts = (_rms([getattr(d, name) for d in differences]) for name in ("z_L", "p", "q"))
        return cls(len(squares), rms, scatter, median, *parts)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain JSON values."""
        return {
            "count": self.count,
            "rms": self.rms,
            "monte_carlo": self.monte_carlo,
            "median": self.median,
            "z_L": self.z_L,
            "p": self.p,
            "q": self.q,
        }


@dataclass(frozen=True)
class Summary:
    """One method over all problems that could be set up.

    Attributes
    ----------
    method, formulation, solver : str
    problems : int
    statuses : mapping of str to int
        How many are ok, degraded, refused.
    outcomes : mapping of str to int
        How many ended how: names of `planeopt.solution.Status`, in lower case.
    roots : mapping of str to int
        How many searches ended near the visible plane, the second, neither, whether or not they were refused.
    reason : str or None
        The message of the first failure.
    error : Pooled or None
        Against the truth, over the bound, of all answers (ok and degraded).
    from_closed_form : Pooled or None
        Against the closed form, likewise.
    iterations, evaluations, first_derivatives, second_derivatives : float or None
        Medians over the searches; None where every problem was refused before one began.
    build_ms, solve_ms, total_ms : float or None
        Likewise.
    residuals : mapping of str to float
        Root mean square of each of the ten equations, by number and unit, where the searches ended.
    """

    method: str
    formulation: str
    solver: str
    problems: int
    statuses: Mapping[str, int]
    outcomes: Mapping[str, int]
    roots: Mapping[str, int]
    reason: str | None
    error: Pooled | None
    from_closed_form: Pooled | None
    iterations: float | None
    evaluations: float | None
    first_derivatives: float | None
    second_derivatives: float | None
    build_ms: float | None
    solve_ms: float | None
    total_ms: float | None
    residuals: Mapping[str, float]

    @property
    def answered(self) -> int:
        """How many problems have an answer, with or without a reservation."""
        return self.statuses["ok"] + self.statuses["degraded"]

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as plain JSON values."""
        return {
            "method": self.method,
            "formulation": self.formulation,
            "solver": self.solver,
            "problems": self.problems,
            "statuses": dict(self.statuses),
            "outcomes": dict(self.outcomes),
            "roots": dict(self.roots),
            "reason": self.reason,
            "error_over_bound": None if self.error is None else self.error.to_dict(),
            "closed_form_over_bound": None if self.from_closed_form is None else self.from_closed_form.to_dict(),
            "iterations": self.iterations,
            "evaluations": self.evaluations,
            "first_derivatives": self.first_derivatives,
            "second_derivatives": self.second_derivatives,
            "build_ms": self.build_ms,
            "solve_ms": self.solve_ms,
            "total_ms": self.total_ms,
            "residuals": dict(self.residuals),
        }


def summarise(cases: Sequence[Case]) -> tuple[Summary, ...]:
    """Return a summary for each method, in the order of the first problem that has rows."""
    by_method: dict[str, list[Row]] = {}
    for case in cases:
        for row in case.rows:
            by_method.setdefault(row.method, []).append(row)
    return tuple(_summary(name, rows) for name, rows in by_method.items())


def _summary(name: str, rows: Sequence[Row]) -> Summary:
    statuses = Counter(row.solution.status.record for row in rows)
    roots = Counter(row.root for row in rows)
    failed = next((row for row in rows if row.solution.status.record == "refused"), None)
    took = [row.took for row in rows if row.took is not None]
    iterations, evaluations, first, second, build, solve, total = (
        _median([row[key] for row in took]) for key in EFFORT
    )
    equations = dict.fromkeys(f"{r.equation} {r.unit}" for row in rows for r in row.residuals)
    values = {
        equation: [r.value for row in rows for r in row.residuals if f"{r.equation} {r.unit}" == equation]
        for equation in equations
    }
    return Summary(
        name,
        rows[0].formulation,
        rows[0].solver,
        len(rows),
        {status: statuses[status] for status in ("ok", "degraded", "refused")},
        dict(Counter(row.solution.status.name.lower() for row in rows)),
        {root.name.lower(): roots[root] for root in Root},
        None if failed is None else failed.solution.message,
        Pooled.of([row.error_in_bound for row in rows if row.error_in_bound is not None]),
        Pooled.of([row.from_closed_form_in_bound for row in rows if row.from_closed_form_in_bound is not None]),
        iterations,
        evaluations,
        first,
        second,
        build,
        solve,
        total,
        {equation: _rms([value for value in those if math.isfinite(value)]) for equation, those in values.items()},
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else 0.0


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
