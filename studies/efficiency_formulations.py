"""Errors of every formulation over the Cramér-Rao bound, from the same points, the same ellipse and the same start."""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from itertools import groupby

import numpy as np

from planeopt.conic import fit_conic
from planeopt.errors import InputError
from planeopt.estimation import solve_problem
from planeopt.executors import ordered_map
from planeopt.formulations import (
    AsPrinted,
    ClosedForm,
    Constrained,
    Elastic,
    Formulation,
    LeastSquares,
    Penalty,
    Problem,
)
from studies.efficiency_cells import Array
from studies.efficiency_fits import DRAWS as FIT_DRAWS
from studies.efficiency_fits import maximum_likelihood
from studies.efficiency_sweeps import Errors, Sample, Setting, Step, draw, errors_of, held, steps_of
from studies.study import Mode

DRAWS: dict[Mode, int] = {"full": 28, "quick": 1}
_PER_JOB = 7

REPROJECTION = "Reprojection"
"""Solved by `planeopt.estimation.solve_points`, many at once; the NLP finds the same planes."""

PAPER = "the paper: (16) and Penalty"
"""The penalty function on the ellipse of least squares, as published; the others have that of maximum likelihood."""

SEARCHES: tuple[Formulation, ...] = (
    ClosedForm(),
    Constrained(),
    Constrained("paper"),
    Elastic(),
    LeastSquares(),
    Penalty(),
    Penalty("image objective"),
    AsPrinted(),
)

FORMULATIONS = (REPROJECTION, *(each.name for each in SEARCHES if each != AsPrinted()), PAPER)
"""Names of those that can give a plane."""


@dataclass(frozen=True, kw_only=True)
class FormulationRow(Errors):
    """A formulation at one place of an axis.

    Attributes
    ----------
    axis : str
    value : float
    formulation : str
    excess : float
        By what factor the criterion's worst number is over its limit: at most 1 where the bound can be reached.
    draws : int
        The first of those of the conic fits.
    over_ml : float
        RMS error over that of maximum likelihood with the same draws, of those where both have a plane: what chance
        does to both drops out.
    over_bound_paired : float
        `over_ml` times what maximum likelihood is at over the bound with all the draws of the conic fits: `over_bound`
        with less chance in it.
    reasons : str
        Why there was no plane, with counts.
    """

    axis: str
    value: float
    formulation: str
    excess: float
    draws: int
    over_ml: float
    over_bound_paired: float
    reasons: str


@dataclass(frozen=True)
class Part:
    """Some draws of a setting."""

    setting: Setting
    first: int
    end: int


Answer = tuple[Array, str]
"""A plane (3,), or NaN and the reason."""


def run_formulations(mode: Mode, executor: Executor | None) -> list[FormulationRow]:
    """Measure all formulations at all steps; a setting that lies on several axes is measured once."""
    steps, draws = steps_of(mode), DRAWS[mode]
    settings = list(dict.fromkeys(step.setting for step in steps))
    parts = [
        Part(setting, first, min(first + _PER_JOB, draws))
        for setting in settings
        for first in range(0, draws, _PER_JOB)
    ]
    answers = zip(parts, ordered_map(solve_part, parts, executor), strict=True)
    rows = {
        setting: _rows_of(draw(setting, FIT_DRAWS[mode]), draws, [found for _, found in members])
        for setting, members in groupby(answers, key=lambda pair: pair[0].setting)
    }
    return [_row(step, row) for step in steps for row in rows[step.setting]]


def solve_part(part: Part) -> dict[str, list[Answer]]:
    """Return each formulation's answers to the draws of a part."""
    sample = draw(part.setting, part.end)
    found: dict[str, list[Answer]] = {formulation.name: [] for formulation in SEARCHES} | {PAPER: []}
    for points in sample.points[part.first : part.end]:
        for name, answer in _answers(points, sample).items():
            found[name].append(answer)
    return found


def _answers(points: Array, sample: Sample) -> dict[str, Answer]:
    try:
        problem = Problem.from_points(points, sample.truth.setup, sample.sigma)
        fit = fit_conic(points, sample.sigma, "least_squares")
        assert fit.covariance is not None
        algebraic = Problem.from_conic(fit.B, fit.covariance, sample.truth.setup)
    except InputError:
        return dict.fromkeys([*(formulation.name for formulation in SEARCHES), PAPER], _nothing("no_ellipse"))
    answers = {formulation.name: _answer(problem, formulation) for formulation in SEARCHES}
    return answers | {PAPER: _answer(algebraic, Penalty())}


def _answer(problem: Problem, formulation: Formulation) -> Answer:
    solution = solve_problem(problem, formulation=formulation)
    if solution.pose is None or solution.status.record == "refused":
        return _nothing(solution.status.name.lower())
    return np.array([solution.pose.z_L, *solution.pose.slopes]), ""


def _nothing(reason: str) -> Answer:
    return np.full(3, np.nan), reason


@dataclass(frozen=True)
class _Found:
    """What the rows of a setting say, whatever axis they are on."""

    formulation: str
    excess: float
    draws: int
    over_ml: float
    over_bound_paired: float
    reasons: str
    errors: Errors


def _rows_of(sample: Sample, draws: int, parts: Sequence[dict[str, list[Answer]]]) -> list[_Found]:
    best = maximum_likelihood(sample)
    ml = errors_of(best, sample).over_bound
    rows = [_found(REPROJECTION, sample, best[:draws], best[:draws], ml, [])]
    for name in parts[0]:
        answers = [answer for part in parts for answer in part[name]]
        planes = np.stack([plane for plane, _ in answers])
        rows.append(_found(name, sample, planes, best[:draws], ml, [reason for _, reason in answers if reason]))
    return rows


def _found(name: str, sample: Sample, planes: Array, best: Array, ml: float, reasons: Sequence[str]) -> _Found:
    both = (np.isfinite(planes) & np.isfinite(best)).all(axis=1)
    over_ml = np.nan
    if both.any():
        over_ml = held(errors_of(planes[both], sample).over_bound / errors_of(best[both], sample).over_bound)
    counted = " ".join(f"{reason}:{count}" for reason, count in sorted(Counter(reasons).items()))
    return _Found(name, sample.excess, len(planes), over_ml, held(over_ml * ml), counted, errors_of(planes, sample))


def _row(step: Step, found: _Found) -> FormulationRow:
    return FormulationRow(
        **asdict(found.errors),
        axis=step.axis,
        value=step.value,
        formulation=found.formulation,
        excess=found.excess,
        draws=found.draws,
        over_ml=found.over_ml,
        over_bound_paired=found.over_bound_paired,
        reasons=found.reasons,
    )
