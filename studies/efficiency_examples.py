"""The paper's example, 40 % of its arc, and a plane farther off: the programmes themselves, solved draw by draw."""

from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from itertools import groupby

import numpy as np

from planeopt.estimation import solve_problem
from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, Formulation, Problem, Reprojection
from studies.efficiency_cells import Array
from studies.efficiency_sweeps import Errors, Setting, draw, errors_of
from studies.study import Mode

DRAWS: dict[Mode, int] = {"full": 1000, "quick": 2}
_PER_JOB = 50

EXAMPLES = {
    "the paper's example": Setting(noise_px=0.3, tilt_deg=60.0, depth_mm=75.0),
    "the paper's example, 40 % of the arc": Setting(noise_px=0.3, tilt_deg=60.0, depth_mm=75.0, arc=0.4),
    "250 mm, 30 degrees": Setting(noise_px=0.3, depth_mm=250.0),
}
SOLVED: tuple[Formulation, ...] = (Constrained(), Reprojection())


@dataclass(frozen=True, kw_only=True)
class ExampleRow(Errors):
    """A formulation, solved by IPOPT, in one example.

    Attributes
    ----------
    example, formulation : str
    excess : float
        By what factor the criterion's worst number is over its limit: at most 1 where the bound can be reached.
    draws : int
    """

    example: str
    formulation: str
    excess: float
    draws: int


@dataclass(frozen=True)
class Part:
    """Some draws of an example."""

    example: str
    first: int
    end: int


def run_examples(mode: Mode, executor: Executor | None) -> list[ExampleRow]:
    """Solve all draws of all examples."""
    firsts = range(0, DRAWS[mode], _PER_JOB)
    parts = [Part(name, first, min(first + _PER_JOB, DRAWS[mode])) for name in EXAMPLES for first in firsts]
    solved = zip(parts, ordered_map(solve_part, parts, executor), strict=True)
    rows = []
    for name, members in groupby(solved, key=lambda pair: pair[0].example):
        planes, sample = np.concatenate([found for _, found in members], axis=1), draw(EXAMPLES[name], 1)
        for formulation, found in zip(SOLVED, planes, strict=True):
            rows.append(
                ExampleRow(
                    **asdict(errors_of(found, sample)),
                    example=name,
                    formulation=formulation.name,
                    excess=sample.excess,
                    draws=len(found),
                )
            )
    return rows


def solve_part(part: Part) -> Array:
    """Return the planes of each formulation, (F, D, 3); NaN where there is none."""
    sample = draw(EXAMPLES[part.example], part.end)
    planes = np.full((len(SOLVED), part.end - part.first, 3), np.nan)
    for i, points in enumerate(sample.points[part.first :]):
        problem = Problem.from_points(points, sample.truth.setup, sample.sigma)
        for plane, formulation in zip(planes, SOLVED, strict=True):
            pose = solve_problem(problem, formulation=formulation).pose
            if pose is not None:
                plane[i] = pose.z_L, *pose.slopes
    return planes
