"""What slack, L1 and hard rows do to the estimate: bias and RMS error over the Cramér-Rao bound, by draws of noise."""

import itertools
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache
from typing import cast

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.estimation import starts
from planeopt.executors import ordered_map
from planeopt.formulations import Constrained, Elastic, LeastSquares, Problem, Start
from planeopt.formulations.snooping import whitened_by_plane
from planeopt.nlp import Nlp
from planeopt.solvers import Ipopt
from studies.constraints_forms import HardImageRows, Rows
from studies.study import Mode

Array = NDArray[np.float64]

NOISE_MM = 0.3 * 0.005
N_POINTS = 200
DRAWS: dict[Mode, int] = {"full": 300, "quick": 6}
_CHUNK = 20
_SEED = 17
TRIPLES: tuple[Rows, ...] = tuple(itertools.combinations(range(5), 3))
ESTIMATORS = (
    "slack weighted by the covariance",
    "slack over its coefficient",
    "slack without weights",
    "all ten without weights",
    "L1 slack",
    "three hard, largest",
    "three hard, largest in sigmas",
    "three hard, best of ten",
)


@dataclass(frozen=True)
class Scene:
    """A rig and a plane, and how much of the ellipse is seen."""

    name: str
    setup: eq.Setup
    plane: tuple[float, float, float]
    arc: float


def _scene(name: str, offset: tuple[float, float], z_L: float, tilt: float, beta: float, arc: float) -> Scene:
    v = eq.PaperVariables(None, z_L, np.radians(tilt), np.radians(beta))
    p, q = (float(value) for value in eq.slopes(np, v))
    return Scene(name, eq.Setup(paper.SETUP.f, *offset, paper.SETUP.r), (z_L, p, q), arc)


_OFFSET = (paper.SETUP.e_x, paper.SETUP.e_y)
SCENES = (
    _scene("worked example", _OFFSET, 75.0, 60.0, 30.0, 1.0),
    _scene("worked example, 40 % of the arc", _OFFSET, 75.0, 60.0, 30.0, 0.4),
    _scene("250 mm, 30 deg", _OFFSET, 250.0, 30.0, 30.0, 1.0),
    _scene("250 mm, 30 deg, offset 15 mm", (9.0, 12.0), 250.0, 30.0, 30.0, 1.0),
)


@dataclass(frozen=True)
class EstimateRow:
    """An estimator's error over draws of noise of 0.3 px on 200 points.

    Attributes
    ----------
    scene, estimator : str
    draws, lost : int
        All, and those without a minimum as computed again.
    rms_over_bound, bias_over_bound : float
        Of ``(z_L, p, q)``, pooled by the Cramér-Rao bound; 1 is an efficient estimator's RMS.
    bias_by_chance : float
        What an unbiased estimator of this RMS would show in 95 % of such studies, at most.
    z_L_over_bound, p_over_bound, q_over_bound : float
        RMS of each over its own bound.
    """

    scene: str
    estimator: str
    draws: int
    lost: int
    rms_over_bound: float
    bias_over_bound: float
    bias_by_chance: float
    z_L_over_bound: float
    p_over_bound: float
    q_over_bound: float


@dataclass(frozen=True)
class TripleRow:
    """Three of (17)-(21) hard, two left out.

    Attributes
    ----------
    scene, rows : str
    predicted_over_bound : float
        RMS of ``(z_L, p, q)`` over the bound, to first order.
    chosen : str
        By pivoted QR of the rows as they are ("largest"), of the rows over their standard deviations ("largest in
        sigmas"), as the best and the worst of the ten.
    """

    scene: str
    rows: str
    predicted_over_bound: float
    chosen: str


# --- Choices of three rows --------------------------------------------------------------------------------------------


@cache
def exact(scene: Scene) -> Problem:
    """The exact boundary, with the weights of the noise."""
    phi = 2 * np.pi * scene.arc * np.arange(N_POINTS) / N_POINTS
    point = eq.spot_point_in_slopes(np, eq.SlopeVariables(None, *scene.plane), scene.setup, phi)
    points = np.stack(eq.image_point(np, scene.setup, *point), axis=1)
    return Problem.from_points(points, scene.setup, NOISE_MM)


@cache
def information(scene: Scene) -> Array:
    """Root ``W`` (5, 3) of the information ``W'W`` on ``(z_L, p, q)``: that of the boundary, since B is sufficient."""
    return whitened_by_plane(exact(scene), np.array(scene.plane))


@cache
def chosen_rows(scene: Scene) -> dict[str, Rows]:
    """Rows by each way to choose, at the true plane."""
    problem = exact(scene)
    plain = problem.B_factor @ information(scene) * np.array([scene.plane[0], 1.0, 1.0])
    sigma = np.sqrt(np.sum(problem.B_factor**2, axis=1))
    predicted = [predicted_over_bound(scene, rows) for rows in TRIPLES]
    return {
        "largest": _pivots(plain),
        "largest in sigmas": _pivots(plain / sigma[:, None]),
        "best": TRIPLES[int(np.argmin(predicted))],
        "worst": TRIPLES[int(np.argmax(predicted))],
    }


def _pivots(rows: Array) -> Rows:
    order = cast("tuple[Array, NDArray[np.intp]]", scipy.linalg.qr(rows.T, mode="r", pivoting=True))[1]
    first, second, third = sorted(int(i) for i in order[:3])
    return first, second, third


def predicted_over_bound(scene: Scene, rows: Rows) -> float:
    """RMS error over the bound, to first order, of the plane that makes three image equations hold."""
    factor, root = exact(scene).B_factor, information(scene)
    kept = list(rows)
    # d plane = J^-1 dB of the kept rows, in units of the bound.
    by_noise = root @ np.linalg.solve((factor @ root)[kept], factor[kept])
    return float(np.linalg.norm(by_noise) / np.sqrt(3))


def triple_rows(mode: Mode) -> list[TripleRow]:
    """Predict every triple of every scene."""
    rows = []
    for scene in _scenes(mode):
        ways = chosen_rows(scene)
        for triple in TRIPLES:
            chosen = ", ".join(way for way, picked in ways.items() if picked == triple)
            rows.append(TripleRow(scene.name, HardImageRows(triple).name, predicted_over_bound(scene, triple), chosen))
    return rows


def _scenes(mode: Mode) -> tuple[Scene, ...]:
    return SCENES if mode == "full" else SCENES[:1]


# --- Draws ------------------------------------------------------------------------------------------------------------


def draw(scene: Scene, number: int) -> Problem:
    """The scene's points with noise."""
    points = exact(scene).points
    if points is None:
        raise ValueError("a scene has points")
    rng = np.random.default_rng([_SEED, SCENES.index(scene), number])
    return Problem.from_points(points + NOISE_MM * rng.standard_normal(points.shape), scene.setup, NOISE_MM)


def programmes(scene: Scene, problem: Problem, start: Start) -> list[Nlp]:
    """The programmes of `ESTIMATORS`, in order."""
    ways = chosen_rows(scene)
    # The slack's factor is all that `Constrained` takes from the covariance.
    weighted = {
        "slack over its coefficient": replace(problem, B_factor=np.diag(np.abs(problem.B))),
        "slack without weights": replace(problem, B_factor=np.eye(5)),
    }
    return [
        Constrained().build(problem, start),
        *(Constrained().build(changed, start) for changed in weighted.values()),
        LeastSquares().build(problem, start),
        Elastic().build(problem, start),
        *(HardImageRows(ways[way]).build(problem, start) for way in ("largest", "largest in sigmas", "best")),
    ]


def estimate_rows(mode: Mode, executor: Executor | None) -> list[EstimateRow]:
    """Draw and solve every scene by every estimator."""
    draws, scenes = DRAWS[mode], _scenes(mode)
    begins = range(0, draws, _CHUNK)
    work = [(scene, range(i, min(i + _CHUNK, draws))) for scene in scenes for i in begins]
    found = ordered_map(_solve, work, executor)
    rows = []
    for scene in scenes:
        planes = np.concatenate(list(itertools.islice(found, len(begins))))
        rows += [_summed(scene, name, planes[:, i]) for i, name in enumerate(ESTIMATORS)]
    return rows


def _solve(work: tuple[Scene, range]) -> Array:
    """Planes (draws, estimators, 3); NaN where there is no minimum."""
    scene, numbers = work
    return np.array([_planes(scene, draw(scene, number)) for number in numbers])


def _planes(scene: Scene, problem: Problem) -> list[Array]:
    planes = []
    for nlp in programmes(scene, problem, starts.from_closed_form(problem)):
        found = Ipopt().solve(nlp)
        planes.append(found.nlp.plane(found.x) if found.kkt.ok else np.full(3, np.nan))
    return planes


def _summed(scene: Scene, name: str, planes: Array) -> EstimateRow:
    solved = np.isfinite(planes).all(axis=1)
    error = (planes - np.array(scene.plane))[solved]
    if not len(error):
        return EstimateRow(scene.name, name, len(planes), len(planes), *(np.nan,) * 6)
    root = information(scene)
    in_bounds = error @ root.T
    rms = float(np.sqrt(np.mean(np.sum(in_bounds**2, axis=1)) / 3))
    bias = float(np.linalg.norm(np.mean(in_bounds, axis=0)) / np.sqrt(3))
    own = np.sqrt(np.diag(np.linalg.inv(root.T @ root)))
    z_L, p, q = (float(value) for value in np.sqrt(np.mean(error**2, axis=0)) / own)
    # The mean's squared length has expectation rms^2 / N; were it all in one direction, its root is |N(0, 1)| of that.
    chance = float(rms * np.sqrt(1 / len(error)) * _TWO_SIGMA)
    return EstimateRow(scene.name, name, len(planes), int(np.sum(~solved)), rms, bias, chance, z_L, p, q)


_TWO_SIGMA = 1.96
