"""One problem or many, all methods: rows, and for many a summary."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

from planeopt.accuracy import Truth
from planeopt.batch import UNFORESEEN
from planeopt.comparison.problem import Case, broken_down, compare_problem
from planeopt.comparison.rows import Row
from planeopt.comparison.summary import Summary, summarise
from planeopt.errors import InputError
from planeopt.estimation.starts import StartLike
from planeopt.executors import ordered_map
from planeopt.formulations import Problem
from planeopt.methods import EVERY, Method
from planeopt.rig import Rig
from planeopt.spot import Spot


@dataclass(frozen=True, eq=False)
class Comparison:
    """Methods on the same problems.

    Attributes
    ----------
    cases : tuple of Case
        In the order of the problems.
    """

    cases: tuple[Case, ...]

    @property
    def rows(self) -> tuple[Row, ...]:
        """All rows, problem by problem, in the order of the methods, failures included."""
        return tuple(row for case in self.cases for row in case.rows)

    @property
    def summary(self) -> tuple[Summary, ...]:
        """What each method did over all problems, in the order of the methods."""
        return summarise(self.cases)

    def to_dicts(self) -> list[dict[str, Any]]:
        """Return the rows as plain JSON values; with several problems each with its ``input``."""
        if len(self.cases) == 1:
            return [row.to_dict() for row in self.rows]
        return [{"input": case.name, **row.to_dict()} for case in self.cases for row in case.rows]


def compare(
    problems: Spot | Problem | Sequence[Spot | Problem],
    rig: Rig | None = None,
    *,
    truth: Truth | Sequence[Truth | None] | None = None,
    start: StartLike | None = None,
    methods: Sequence[Method] = EVERY,
    repeats: int = 1,
    executor: Executor | None = None,
    names: Sequence[str] | None = None,
) -> Comparison:
    """Solve one problem or many by every formulation with every solver, from the same start, without second attempts.

    Parameters
    ----------
    problems : Spot or Problem, or a sequence of them
    rig : Rig, optional
        With a beam; needed for spots.
    truth : Truth, or a sequence of them, optional
        Known planes, for the error of each answer; of a sequence one for each problem, None where it is not known.
    start : SpotPose or (R, z_L, alpha, beta), optional
        mm and rad, for all problems; each one's closed form unless given. A start far off shows which searches find
        their way.
    methods : sequence of Method, optional
        `planeopt.methods.EVERY` unless given; `planeopt.methods.METHODS` are those that suit each other.
    repeats : int
        How often each is solved, for the shortest times.
    executor : Executor, optional
        Where the problems are worked on; in this process unless given. All but the times is the same.
    names : sequence of str, optional
        Of the problems; their places, from 1, unless given.

    Returns
    -------
    Comparison
        Of several problems one that cannot be used is a case without rows that says why.

    Raises
    ------
    InputError
        If the rig, the start or the only problem cannot be used, or lengths differ.
    """
    alone = isinstance(problems, Spot | Problem)
    several = [problems] if isinstance(problems, Spot | Problem) else list(problems)
    truths = [truth] * len(several) if truth is None or isinstance(truth, Truth) else list(truth)
    labels = [str(i + 1) for i in range(len(several))] if names is None else list(names)
    if not several:
        raise InputError("there is nothing to compare: the list of problems is empty")
    if not methods:
        raise InputError("there is nothing to compare: the list of methods is empty")
    if not len(several) == len(truths) == len(labels):
        raise InputError(f"{len(several)} problems, {len(truths)} truths and {len(labels)} names do not go together")
    if repeats < 1:
        raise InputError(f"repeats must be at least 1, not {repeats}")
    work = partial(_case, rig=rig, start=start, methods=tuple(methods), repeats=repeats)
    cases = tuple(ordered_map(work, list(zip(several, truths, labels, strict=True)), executor))
    if alone and cases[0].message is not None:
        raise InputError(cases[0].message)
    return Comparison(cases)


def _case(
    item: tuple[Spot | Problem, Truth | None, str],
    *,
    rig: Rig | None,
    start: StartLike | None,
    methods: tuple[Method, ...],
    repeats: int,
) -> Case:
    given, truth, name = item
    try:
        problem = problem_of(given, rig)
        return compare_problem(problem, methods, name=name, truth=truth, start=start, repeats=repeats)
    except InputError as error:
        return Case(name, message=str(error))
    except UNFORESEEN as error:
        return Case(name, message=broken_down(error))


def problem_of(given: Spot | Problem, rig: Rig | None) -> Problem:
    """Return the problem of a spot; a problem as it is.

    Raises
    ------
    InputError
        If the spot or the rig cannot be used.
    """
    if isinstance(given, Problem):
        return given
    if rig is None:
        raise InputError("spots need the rig that saw them")
    return Problem.from_spot(given, rig)
