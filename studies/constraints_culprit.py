"""One image coefficient in error: which equation the largest slack accuses, and what is left of the plane."""

import itertools
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, Elastic, Formulation, LeastSquares, Problem
from studies.constraints_estimates import SCENES, Scene, draw, information
from studies.study import Mode

Array = NDArray[np.float64]

PIXEL_MM = 0.005
SIZES_PX: dict[Mode, tuple[float, ...]] = {"full": (1.5, 15.0), "quick": (15.0,)}
DRAWS: dict[Mode, int] = {"full": 6, "quick": 1}
FORMULATIONS: tuple[Formulation, ...] = (Elastic(), Constrained(), LeastSquares())
_SIGNS = (1.0, -1.0)


@dataclass(frozen=True)
class CulpritRow:
    """Draws with an error in one coefficient of B, by so much that the boundary moves by ``outlier_px`` RMS.

    Attributes
    ----------
    scene, formulation, at_fault : str
    outlier_px : float
    draws, named : int
        Half of the draws with either sign; those whose largest slack, in standard deviations, is that equation's.
    rms_over_bound : float
        Of the plane found, over the Cramér-Rao bound of the clean points.
    """

    scene: str
    formulation: str
    at_fault: str
    outlier_px: float
    draws: int
    named: int
    rms_over_bound: float


@dataclass(frozen=True)
class _Job:
    scene: Scene
    outlier: float
    index: int
    draws: int


def culprit_rows(mode: Mode, executor: Executor | None) -> list[CulpritRow]:
    """Put the error into each coefficient in turn."""
    scenes = SCENES[:3] if mode == "full" else SCENES[:1]
    jobs = [_Job(scene, size, i, DRAWS[mode]) for scene, size, i in itertools.product(scenes, SIZES_PX[mode], range(5))]
    return list(itertools.chain.from_iterable(ordered_map(_accused, jobs, executor)))


def _accused(job: _Job) -> list[CulpritRow]:
    culprit = f"({eq.IMAGE_BLOCK[job.index].number})"
    root = information(job.scene)
    draws = list(itertools.product(range(job.draws), _SIGNS))
    rows = []
    for formulation in FORMULATIONS:
        named, squares = 0, []
        for number, sign in draws:
            problem = spoilt(draw(job.scene, number), job.index, sign * job.outlier * PIXEL_MM)
            found = solve_problem(problem, formulation=formulation)
            named += found.worst is not None and found.worst.equation == culprit
            if found.pose is not None:
                error = np.array([found.pose.z_L, *found.pose.slopes]) - np.array(job.scene.plane)
                squares.append(float(np.sum((root @ error) ** 2)) / 3)
        rms = float(np.sqrt(np.mean(squares))) if squares else np.nan
        rows.append(CulpritRow(job.scene.name, formulation.name, culprit, job.outlier, len(draws), named, rms))
    return rows


def spoilt(problem: Problem, i: int, size: float) -> Problem:
    """The problem with ``B_(i+1)`` changed so that the boundary moves by ``size`` mm RMS along its normal."""
    if problem.points is None:
        raise ValueError("the size of an error is that of the boundary's shift: points are needed")
    x, y = problem.points.T
    B = problem.B.copy()
    monomial = np.stack([x * y, y * y, x, y, np.ones_like(x)])[i]
    gradient = np.hypot(2 * x + B[0] * y + B[2], B[0] * x + 2 * B[1] * y + B[3])
    B[i] += size / np.sqrt(np.mean((monomial / gradient) ** 2))
    return replace(problem, B=B)
