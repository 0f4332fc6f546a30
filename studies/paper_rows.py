"""The reproduction as tables of numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planeopt import equations as eq
from planeopt import paper
from planeopt.reproduction.results import Reproduction
from planeopt.reproduction.searches import Search
from studies.paper_readings import ConsequenceRow
from studies.paper_repeats import RepeatRow

_DEG = (1.0, 1.0, 180 / np.pi, 180 / np.pi)
_UNKNOWNS = (("R", "mm"), ("z_L", "mm"), ("alpha", "deg"), ("beta", "deg"))


@dataclass(frozen=True)
class PointRow:
    """A point of Table 1, and the same by (3) as printed, mm."""

    theta_deg: float
    x_mm: float
    y_mm: float
    x_as_printed_mm: float
    y_as_printed_mm: float


@dataclass(frozen=True)
class CoefficientRow:
    """An entry of Table 2: printed, by (6) at the stated solution, and fitted to Table 1 with its sigma."""

    coefficient: str
    unit: str
    printed: str
    from_6: str
    printed_minus_6: float
    fitted_to_table_1: str
    sigma: float


@dataclass(frozen=True)
class AnswerRow:
    """One unknown by one method, from Table 1 and the paper's start.

    Attributes
    ----------
    method, unknown, unit : str
    stated, found : str
        To six decimals.
    error : float
        Found minus stated.
    allowed_worst, allowed_sigma : float
        What the rounding of Table 1 may do to this method: the worst, and the standard deviation.
    error_over_worst : float
    iterations, evaluations, derivative_evaluations : int
        Of the whole search.
    """

    method: str
    unknown: str
    unit: str
    stated: str
    found: str
    error: float
    allowed_worst: float
    allowed_sigma: float
    error_over_worst: float
    iterations: int
    evaluations: int
    derivative_evaluations: int


@dataclass(frozen=True)
class SearchRow:
    """Where a search from the paper's start ended; ``misfit`` is the largest of the ten over the size of its data."""

    search: str
    end: str
    R_mm: float
    z_L_mm: float
    alpha_deg: float
    beta_deg: float
    misfit: float
    iterations: int
    evaluations: int
    derivative_evaluations: int


@dataclass(frozen=True)
class RankRow:
    """What the ten equations fix, and what is said where they are handed over as hard constraints."""

    equations: int
    unknowns: int
    laser_rank: int
    image_rank: int
    rank: int
    repeat_the_others: str
    outcome: str


@dataclass(frozen=True)
class MisprintRow:
    """A number that one reading gets right and the other does not.

    Attributes
    ----------
    where, printed, right : str
    quantity, unit : str
    must_be, allowed : float
        The number, and how far rounding may take it from there.
    right_gives, printed_gives : float
    right_over_allowed, printed_over_allowed : float
        Deviations from the number, over what is allowed.
    """

    where: str
    printed: str
    right: str
    quantity: str
    unit: str
    must_be: float
    allowed: float
    right_gives: float
    printed_gives: float
    right_over_allowed: float
    printed_over_allowed: float


@dataclass(frozen=True)
class Tables:
    """All tables of the study."""

    table_1: Sequence[PointRow]
    table_2: Sequence[CoefficientRow]
    answers: Sequence[AnswerRow]
    searches: Sequence[SearchRow]
    repeats: Sequence[RepeatRow]
    ranks: Sequence[RankRow]
    misprints: Sequence[MisprintRow]
    consequences: Sequence[ConsequenceRow]


def table_1_rows() -> list[PointRow]:
    """Table 1 made again, and (5) of (3) as printed at the stated solution."""
    spot = paper.printed_spot_point(np, paper.TRUTH, paper.SETUP, paper.TABLE_1_ANGLES)
    as_printed = np.stack(eq.image_point(np, paper.SETUP, *spot), axis=1)
    columns = np.column_stack([np.degrees(paper.TABLE_1_ANGLES), paper.table_1(), as_printed])
    return [PointRow(*(float(value) for value in row)) for row in columns]


def table_2_rows(found: Reproduction) -> list[CoefficientRow]:
    """Table 2 beside (6) and beside the fit to Table 1."""
    sigma = np.sqrt(np.sum(found.problem.B_factor**2, axis=1))
    columns = zip(paper.TABLE_2, paper.exact_ellipse(), found.problem.B, sigma, strict=True)
    return [
        CoefficientRow(
            f"B_{i}", unit, f"{printed:.4f}", f"{exact:.6f}", float(printed - exact), f"{fit:.6f}", float(one_sigma)
        )
        for i, ((printed, exact, fit, one_sigma), unit) in enumerate(
            zip(columns, ("1", "1", "mm", "mm", "mm^2"), strict=True), start=1
        )
    ]


def answer_rows(found: Reproduction) -> list[AnswerRow]:
    """Each method's answer, its error, and what rounding allows."""
    return [
        AnswerRow(
            answer.name,
            unknown,
            unit,
            f"{paper.TRUTH[i] * scale:.6f}",
            f"{answer.found[i] * scale:.6f}",
            float(answer.error[i] * scale),
            float(answer.allowance.worst[i] * scale),
            float(answer.allowance.sigma[i] * scale),
            float(abs(answer.error[i]) / answer.allowance.worst[i]),
            answer.solution.effort.iterations,
            answer.solution.effort.evaluations,
            answer.solution.effort.derivative_evaluations,
        )
        for answer in found.answers
        for i, ((unknown, unit), scale) in enumerate(zip(_UNKNOWNS, _DEG, strict=True))
    ]


def search_rows(found: Reproduction) -> list[SearchRow]:
    """Where the searches from the paper's start ended."""
    return [_search_row(search) for search in found.searches]


def _search_row(search: Search) -> SearchRow:
    R, z_L, alpha, beta = (float(value) for value in search.poses[-1] * _DEG)
    effort = search.effort
    counts = effort.iterations, effort.evaluations, effort.derivative_evaluations
    return SearchRow(search.name, search.end, R, z_L, alpha, beta, float(search.misfit[-1]), *counts)


def rank_rows(found: Reproduction) -> list[RankRow]:
    """Counts and ranks of the ten, at the start of the refused solve."""
    evidence = found.refusal.identifiability
    if evidence is None:
        raise RuntimeError("the refusal has no counts and ranks")
    return [
        RankRow(
            evidence.n_equations,
            evidence.n_unknowns,
            evidence.laser_rank,
            evidence.image_rank,
            evidence.rank,
            " ".join(evidence.dependent_rows),
            found.refusal.status.name.lower(),
        )
    ]


def misprint_rows() -> list[MisprintRow]:
    """Every number that tells the readings apart."""
    return [
        MisprintRow(
            misprint.where,
            misprint.printed,
            misprint.right,
            evidence.quantity,
            evidence.unit,
            evidence.expected,
            evidence.tolerance,
            evidence.right,
            evidence.printed,
            abs(evidence.right - evidence.expected) / evidence.tolerance,
            abs(evidence.printed - evidence.expected) / evidence.tolerance,
        )
        for misprint in paper.MISPRINTS
        for evidence in misprint.evidence()
    ]
