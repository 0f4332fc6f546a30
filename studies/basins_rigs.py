"""Random rigs and planes, and where searches end on their noisy images."""

import math
import zlib
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.conic import geometric_from_conic
from planeopt.estimation import solve_problem
from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, EitherSide, Problem
from planeopt.solution import Solution
from planeopt.solvers import Ipopt, Sqp
from studies.basins_searches import OBVIOUS, PLANE, Search, end_of, end_of_solution, without
from studies.study import Mode

Array = NDArray[np.float64]

RIGS: dict[Mode, int] = {"full": 10_000, "quick": 8}
SOME: dict[Mode, int] = {"full": 300, "quick": 2}
"""The first rigs, on which searches are run that are compared with the main ones only."""

_CHUNK = 50
N_POINTS = 60
FOCAL_MM, RADII_MM = (4.0, 100.0), (0.5, 50.0)
TILT_DEG = 80.0
DISTANCES = (3.0, 1000.0)
"""Of the spot, in radii of the beam."""
OFFSETS = 10.0
"""Largest, in radii of the beam."""
NOISES = (1e-4, 5e-3)
"""Standard deviation of a boundary point over the image ellipse's shorter semi-axis."""

FIELD = 1.5
"""Largest tangent of the angle between a ray to the spot and the optical axis: a lens of 113 degrees."""
_GRAZING = math.sin(math.radians(2))
"""Least sine of the angle between the plane and the ray to the spot's centre; the spot's nearest point is at least this
share of its centre's depth away."""
_NARROW = 0.02
"""Least ratio of the image ellipse's semi-axes."""


class Rig(NamedTuple):
    """A setup and a plane whose spot the camera sees whole and from its lit side."""

    setup: eq.Setup
    pose: eq.PaperVariables


def draw_rig(rng: np.random.Generator) -> Rig:
    """Draw a camera, a beam and a plane.

    Two fifths of the cameras are outside the beam (to `OFFSETS` radii), a fifth within 5 % of its surface (logarithmic
    from 1e-6, both sides), two fifths inside, every fourth of them on its axis. Focal lengths, radii and distances are
    logarithmic, tilts uniform to `TILT_DEG`, directions to all sides.
    """
    while True:
        r, f = _log(rng, *RADII_MM), _log(rng, *FOCAL_MM)
        offset, around = r * _offset(rng), rng.uniform(-np.pi, np.pi)
        alpha, beta = math.radians(rng.uniform(0, TILT_DEG)), rng.uniform(-np.pi, np.pi)
        k = eq.Setup(f, offset * math.cos(around), offset * math.sin(around), r)
        v = eq.PaperVariables(r / math.cos(alpha), r * _log(rng, *DISTANCES), alpha, beta)
        if _is_seen(k, v):
            return Rig(k, v)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _offset(rng: np.random.Generator) -> float:
    kind = rng.integers(10)
    if kind < 4:
        return _log(rng, 1.05, OFFSETS)
    if kind < 6:
        return 1 + float(rng.choice([-1, 1])) * _log(rng, 1e-6, 0.05)
    return 0.0 if kind == 9 else rng.uniform(0, 0.95)


def _is_seen(k: eq.Setup, v: eq.PaperVariables) -> bool:
    x, y, z = eq.spot_point(np, v, k, np.linspace(0, 2 * np.pi, 90))
    if np.min(z) < _GRAZING * v.z_L or np.max(np.hypot(x, y) / z) > FIELD:
        return False
    centre = math.sqrt(k.e_x**2 + k.e_y**2 + v.z_L**2)
    if eq.lit_side(np, v, k) < _GRAZING * centre:
        return False
    minor, major = sorted(_semi_axes(k, v))
    return bool(minor > _NARROW * major)


def _semi_axes(k: eq.Setup, v: eq.PaperVariables) -> Sequence[float]:
    b = np.array(eq.image_conic(np, v, k))
    return np.asarray(geometric_from_conic(b[1:] / b[0]).semi_axes, dtype=float).tolist()


def draw_start(rng: np.random.Generator, r: float, depths: tuple[float, float]) -> tuple[float, float, float, float]:
    """Draw ``(R, z_L, alpha, beta)``: R half to ten radii, the depth (mm) logarithmic, the tilt to `TILT_DEG`."""
    depth = _log(rng, *depths)
    return r * rng.uniform(0.5, 10), depth, math.radians(rng.uniform(0, TILT_DEG)), rng.uniform(-np.pi, np.pi)


@dataclass(frozen=True)
class RigRow:
    """A random rig and plane, a random start, and where the searches ended.

    Attributes
    ----------
    rig : int
        Number of the draw.
    offset_over_r : float
        |e|/r: the camera is outside the beam above 1.
    f_mm, r_mm, e_x_mm, e_y_mm, z_L_mm, alpha_deg, beta_deg : float
    noise : float
        Standard deviation of a point over the image ellipse's shorter semi-axis.
    start_R_mm, start_z_L_mm, start_alpha_deg, start_beta_deg : float
        The random start.
    status : str
        Of `planeopt.solve` as it is called without options.
    error_sigmas : float
        Its distance from the truth in its own standard deviations; NaN without a covariance.
    solve, closed_sqp ... random_obvious : str
        Where `planeopt.solve` and the searches of `RUNS` ended, one of `basins_searches.ENDS`; empty where one was not
        run.
    reasons : str
        What `planeopt.solve` says of each search from the closed form that did not end at the plane.
    """

    rig: int
    offset_over_r: float
    f_mm: float
    r_mm: float
    e_x_mm: float
    e_y_mm: float
    z_L_mm: float
    alpha_deg: float
    beta_deg: float
    noise: float
    start_R_mm: float
    start_z_L_mm: float
    start_alpha_deg: float
    start_beta_deg: float
    status: str
    error_sigmas: float
    solve: str
    closed_sqp: str
    closed_paper_ipopt: str
    closed_paper_sqp: str
    closed_ipopt_without: str
    random_ipopt: str
    random_ipopt_without: str
    random_paper_ipopt: str
    random_paper_ipopt_without: str
    random_obvious: str
    reasons: str


class Run(NamedTuple):
    """A column of `RigRow`: a search, from the closed form or a random start, on all rigs or only on some."""

    search: Search
    closed: bool
    on_all: bool


_SLOPES, _PAPER = Search(Constrained(), Ipopt()), Search(Constrained("paper"), Ipopt())
DEFAULT = "solve"
"""The column of `planeopt.solve` as it is called without options: `Constrained`, Ipopt, from the closed form."""

RUNS = {
    "closed_sqp": Run(Search(Constrained(), Sqp()), True, True),
    "closed_paper_ipopt": Run(_PAPER, True, True),
    "closed_paper_sqp": Run(Search(Constrained("paper"), Sqp()), True, True),
    "closed_ipopt_without": Run(without(_SLOPES), True, False),
    "random_ipopt": Run(_SLOPES, False, False),
    "random_ipopt_without": Run(without(_SLOPES), False, True),
    "random_paper_ipopt": Run(_PAPER, False, False),
    "random_paper_ipopt_without": Run(without(_PAPER), False, False),
    "random_obvious": Run(OBVIOUS, False, False),
}
"""The other searches on random rigs, by the name of their column."""


class Job(NamedTuple):
    """Some rigs, by number, and how many of all get every search."""

    numbers: range
    some: int


def run_rigs(mode: Mode, executor: Executor | None) -> list[RigRow]:
    """Draw the rigs and search; a row each."""
    total = RIGS[mode]
    jobs = (Job(range(first, min(first + _CHUNK, total)), SOME[mode]) for first in range(0, total, _CHUNK))
    return list(chain.from_iterable(ordered_map(work, jobs, executor)))


def work(job: Job) -> list[RigRow]:
    """Search on some rigs."""
    return [one_rig(number, every=number < job.some) for number in job.numbers]


def one_rig(number: int, *, every: bool) -> RigRow:
    """Draw the rig, plane, points and start of this number, and search: by the main searches, or by every one."""
    rng = np.random.default_rng((zlib.crc32(b"basins: rigs"), number))
    (k, v), share = draw_rig(rng), _log(rng, *NOISES)
    sigma = share * min(_semi_axes(k, v))
    theta = 2 * np.pi * (np.arange(N_POINTS) + rng.uniform()) / N_POINTS
    points = np.stack(eq.image_point(np, k, *eq.spot_point(np, v, k, theta)), axis=1)
    problem = Problem.from_points(points + sigma * rng.standard_normal(points.shape), k, sigma)
    start = draw_start(rng, k.r, (DISTANCES[0] * k.r, 2 * DISTANCES[1] * k.r))
    truth = np.array([v.z_L, *eq.slopes(np, v)])
    solution = solve_problem(problem)
    ends = {
        name: end_of(run.search, problem, None if run.closed else start, truth) if run.on_all or every else ""
        for name, run in RUNS.items()
    }
    ends = {DEFAULT: end_of_solution(solution, problem, truth), **ends}
    lost = [name for name, end in ends.items() if end not in (PLANE, "") and (name == DEFAULT or RUNS[name].closed)]
    reasons = [solution.message if name == DEFAULT else _reason(RUNS[name].search, problem) for name in lost]
    return RigRow(
        number,
        math.hypot(k.e_x, k.e_y) / k.r,
        k.f,
        k.r,
        k.e_x,
        k.e_y,
        v.z_L,
        math.degrees(v.alpha),
        math.degrees(v.beta),
        share,
        start[0],
        start[1],
        math.degrees(start[2]),
        math.degrees(start[3]),
        solution.status.name.lower(),
        _error(solution, truth),
        **ends,
        reasons="; ".join(f"{name}: {reason}" for name, reason in zip(lost, reasons, strict=True)),
    )


def _error(solution: Solution, truth: Array) -> float:
    if solution.pose is None or solution.covariance is None:
        return math.nan
    off = np.array([solution.pose.z_L, *solution.pose.slopes]) - truth
    return float(np.sqrt(off @ scipy.linalg.solve(solution.covariance, off)))


def _reason(search: Search, problem: Problem) -> str:
    formulation = search.formulation if search.seen else EitherSide(search.formulation)
    return solve_problem(problem, formulation=formulation, solver=search.solver).message
