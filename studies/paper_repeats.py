"""The worked example again from tables that round to Table 1's accuracy: is where a search ends a matter of chance?"""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from planeopt import paper
from planeopt.estimation import starts
from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, Formulation, LeastSquares, Penalty, Problem
from planeopt.nlp import Nlp
from planeopt.reproduction.searches import second_pose, stated_plane
from planeopt.solvers import Ipopt, Solver, Swift
from studies.study import Mode

DRAWS: dict[Mode, int] = {"full": 60, "quick": 2}
_SEED = 1
_NEAR = 1e-3
"""Of depth, and in slopes: rounding does less, the planes differ by more."""

METHODS: tuple[tuple[Formulation, Solver], ...] = (
    (Constrained(), Ipopt()),
    (LeastSquares(), Ipopt()),
    (Penalty(), Swift()),
    (Penalty("image objective"), Swift()),
)


@dataclass(frozen=True)
class RepeatRow:
    """A method from the paper's start, over tables of points each off by up to 0.00005 mm.

    Attributes
    ----------
    method : str
    tables, on_the_plane, on_the_second_plane, on_neither : int
    median_evaluations : float
    """

    method: str
    tables: int
    on_the_plane: int
    on_the_second_plane: int
    on_neither: int
    median_evaluations: float


def repeat(mode: Mode, executor: Executor | None) -> list[RepeatRow]:
    """Search from every table by every method."""
    found = list(ordered_map(_search, range(DRAWS[mode]), executor))
    rows = []
    for i, (formulation, solver) in enumerate(METHODS):
        ends = [ends[i] for ends, _ in found]
        plane, second, neither = (ends.count(end) for end in ("plane", "second plane", "neither"))
        evaluations = float(np.median([spent[i] for _, spent in found]))
        name = f"{formulation.name} + {solver.name}"
        rows.append(RepeatRow(name, len(ends), plane, second, neither, evaluations))
    return rows


def _search(number: int) -> tuple[list[str], list[int]]:
    """Where each method ends, and its evaluations, from one table."""
    rng = np.random.default_rng([_SEED, number])
    exact = paper.exact_points()
    points = exact + rng.uniform(-paper.ROUNDING, paper.ROUNDING, exact.shape)
    problem = Problem.from_points(points, paper.SETUP, paper.ROUNDING / np.sqrt(3))
    start = starts.given(tuple(paper.START), problem)
    second = second_pose()
    planes = {"plane": stated_plane(), "second plane": np.array([second.z_L, *second.slopes])}
    ends, spent = [], []
    for formulation, solver in METHODS:
        nlp = formulation.build(problem, start)
        if not isinstance(nlp, Nlp):
            raise TypeError(f"{formulation.name} is not searched")
        found = solver.solve(nlp)
        spent.append(found.effort.evaluations)
        off = found.nlp.plane(found.x)
        near = [name for name, plane in planes.items() if np.allclose(off, plane, rtol=_NEAR, atol=_NEAR)]
        ends.append(near[0] if near else "neither")
    return ends, spent
