"""Starts on grids and at random for the paper's worked example, and where searches from them end."""

import math
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import chain, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.executors import ordered_map
from planeopt.formulations import Problem
from studies.basins_rigs import draw_start
from studies.basins_searches import AT_ONCE, FAST, OBVIOUS, SLOW, Search, end_of, without
from studies.study import Mode

Array = NDArray[np.float64]

SIGMA_MM = 0.0015
"""What the points' noise is taken to be for the weights: 0.3 px of 5 um. The points themselves are exact, so that every
formulation has the same two best planes."""

DEPTHS_MM = (20.0, 2000.0)
"""Of random starts."""

TILTS, DEPTHS, RANDOM = "alpha, beta", "z_L, alpha", "random"
"""Sets of starts: two maps through the paper's start, and random ones."""


class Grid(NamedTuple):
    """How fine the maps are, and how many random starts there are."""

    alphas_deg: Sequence[float]
    betas_deg: Sequence[float]
    depths_mm: Sequence[float]
    random: int


def _depths(step: float, below: int, above: int) -> list[float]:
    """Depths through the paper's, by steps of so many octaves."""
    return [250.0 * 2 ** (step * i) for i in range(-below, above + 1)]


_PAPER_ONLY = Grid([20.0], [20.0], [250.0], 1)
FINE: dict[Mode, Grid] = {
    "full": Grid(np.arange(0, 85, 5).tolist(), np.arange(-160, 200, 20).tolist(), _depths(0.5, 8, 8), 300),
    "quick": Grid([20.0, 65.0], [20.0], [62.5, 250.0], 1),
}
COARSE: dict[Mode, Grid] = {
    "full": Grid(np.arange(5, 85, 15).tolist(), np.arange(-140, 220, 40).tolist(), _depths(1.0, 4, 4), 40),
    "quick": _PAPER_ONLY,
}
"""For the searches that take long. Both grids hold the paper's start."""

_CHUNK = 20


@dataclass(frozen=True)
class EndRow:
    """A start, a search, and where it ended.

    Attributes
    ----------
    starts : {"alpha, beta", "z_L, alpha", "random"}
        The set that the start is of; on the maps the unknowns that are not named are the paper's.
    method : str
        Formulation and solver.
    inequality : {"with", "without"}
        Whether ``c > 0`` is among the rows.
    start_R_mm, start_z_L_mm, start_alpha_deg, start_beta_deg : float
    end : str
        One of `basins_searches.ENDS`.
    """

    starts: str
    method: str
    inequality: str
    start_R_mm: float
    start_z_L_mm: float
    start_alpha_deg: float
    start_beta_deg: float
    end: str


class Start(NamedTuple):
    """The paper's unknowns, mm and degrees, and the set they are of."""

    starts: str
    R: float
    z_L: float
    alpha_deg: float
    beta_deg: float


class Job(NamedTuple):
    """Some starts for one search."""

    search: Search
    starts: tuple[Start, ...]


def run_example(mode: Mode, executor: Executor | None) -> list[EndRow]:
    """Search from every start; a row each."""
    return list(chain.from_iterable(ordered_map(work, jobs(mode), executor)))


def jobs(mode: Mode) -> Iterator[Job]:
    """Yield the work: the same starts for every search of a grid, first without the inequality, then with it."""
    yield from _jobs(OBVIOUS, FINE[mode])
    for search in FAST:
        yield from chain(_jobs(without(search), FINE[mode]), _jobs(search, FINE[mode]))
    for search in SLOW if mode == "full" else SLOW[::2]:
        yield from chain(_jobs(without(search), COARSE[mode]), _jobs(search, COARSE[mode]))
    for search in AT_ONCE:
        yield from _jobs(search, FINE[mode], maps=False)


def _jobs(search: Search, grid: Grid, *, maps: bool = True) -> Iterator[Job]:
    starts = starts_of(grid, maps=maps)
    for first in range(0, len(starts), _CHUNK):
        yield Job(search, starts[first : first + _CHUNK])


def starts_of(grid: Grid, *, maps: bool) -> tuple[Start, ...]:
    """Return the starts of both maps, and the random ones."""
    R, z_L, _, beta = paper.START
    found = []
    if maps:
        by_tilt = product(grid.alphas_deg, grid.betas_deg)
        found += [Start(TILTS, R, z_L, tilt, azimuth) for tilt, azimuth in by_tilt]
        by_depth = product(grid.depths_mm, grid.alphas_deg)
        found += [Start(DEPTHS, R, depth, tilt, math.degrees(beta)) for depth, tilt in by_depth]
    rng = np.random.default_rng(zlib.crc32(b"basins: the worked example"))
    for _ in range(grid.random):
        R, z_L, alpha, beta = draw_start(rng, paper.SETUP.r, DEPTHS_MM)
        found.append(Start(RANDOM, R, z_L, math.degrees(alpha), math.degrees(beta)))
    return tuple(found)


def example() -> tuple[Problem, Array]:
    """Return the worked example from the points that Table 1 rounds, and its plane ``(z_L, p, q)``."""
    problem = Problem.from_points(paper.exact_points(), paper.SETUP, SIGMA_MM)
    return problem, np.array([paper.TRUTH.z_L, *eq.slopes(np, paper.TRUTH)])


def work(job: Job) -> list[EndRow]:
    """Search from some starts; the paper's, which is on both maps, once."""
    problem, truth = example()
    ends = {
        start: end_of(job.search, problem, (start[0], start[1], *map(math.radians, start[2:])), truth)
        for start in dict.fromkeys(start[1:] for start in job.starts)
    }
    return [
        EndRow(start.starts, job.search.method, job.search.inequality, *start[1:], end=ends[start[1:]])
        for start in job.starts
    ]
