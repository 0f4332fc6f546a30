"""Times of one process against the size of its problem."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration import Model
from planeopt.calibration.ladder import adjust_all
from planeopt.closed_form import solve_both
from planeopt.conic import taubin
from planeopt.equations import Setup
from planeopt.estimation import solve, solve_batch
from planeopt.example import example_folder
from planeopt.formulations import Constrained, Problem, Reprojection
from planeopt.plane import SpotPose
from planeopt.posterior import Likelihood, Prior
from planeopt.posterior.target import Target
from planeopt.rig import Rig, load_rig
from planeopt.simulation import long_session
from planeopt.spot import Spot
from studies.outline import pixels_at
from studies.study import Mode

Array = NDArray[np.float64]

NOISE_PX = 0.1
POINTS = 200
"""Of a spot, where their number is not what varies."""

ROUNDS: dict[Mode, int] = {"full": 5, "quick": 1}
_LONG = 2.0  # seconds: not repeated beyond

FRAMES: dict[Mode, tuple[int, ...]] = {"full": (10, 100, 1000, 10_000), "quick": (10, 100)}
ELLIPSES: dict[Mode, tuple[int, ...]] = {"full": (100, 1000, 10_000, 100_000), "quick": (100, 1000)}
POINT_COUNTS: dict[Mode, tuple[int, ...]] = {"full": (25, 50, 100, 200, 400, 800, 1600), "quick": (25, 50)}
VIEWS: dict[Mode, tuple[int, ...]] = {"full": (10, 30, 100, 300), "quick": (4, 8)}
WALKERS: dict[Mode, tuple[int, ...]] = {"full": (10, 30, 100, 300, 1000), "quick": (10, 30)}


@dataclass(frozen=True)
class TimeRow:
    """How long one size took.

    Attributes
    ----------
    axis : str
        What varies: frames, points, views or walkers.
    what : str
        What was done.
    size : int
        How many of the axis.
    seconds : float
        Best of the rounds.
    per_item_us : float
        The same over the size, microseconds.
    """

    axis: str
    what: str
    size: int
    seconds: float
    per_item_us: float


@dataclass(frozen=True)
class GrowthRow:
    """How a time grows: as size^exponent, by least squares in logarithms; and between the two largest sizes alone."""

    axis: str
    what: str
    smallest: int
    largest: int
    exponent: float
    exponent_at_the_end: float


def best(work: Callable[[], object], rounds: int) -> float:
    """Return the least time of some rounds, seconds; what takes long is not repeated."""
    least = np.inf
    for _ in range(rounds):
        begun = time.perf_counter()
        work()
        least = min(least, time.perf_counter() - begun)
        if least > _LONG:
            break
    return float(least)


def spots_of(rig: Rig, pose: SpotPose, count: int, points: int, seed: int = 1) -> list[Spot]:
    """Return one boundary again and again, with noise across it."""
    pixels, normals = pixels_at(rig, pose, 2 * np.pi * np.arange(points) / points)
    noise = NOISE_PX * np.random.default_rng(seed).standard_normal((count, points, 1))
    return [Spot(pixels + one * normals, np.full(points, NOISE_PX)) for one in noise]


def example() -> tuple[Rig, SpotPose]:
    """Return the example's rig, without covariance, and a plane tilted by 40 degrees at 220 mm."""
    rig = load_rig(example_folder() / "truth_rig.toml")
    alpha = np.radians(40.0)
    return rig, SpotPose.canonical(rig.require_beam().radius / np.cos(alpha), 220.0, alpha, np.radians(100.0))


def run_times(mode: Mode) -> list[TimeRow]:
    """Time every axis."""
    rig, pose = example()
    return [*_frames(mode, rig, pose), *_points(mode, rig, pose), *_views(mode), *_walkers(mode, rig, pose)]


def _row(axis: str, what: str, size: int, seconds: float) -> TimeRow:
    return TimeRow(axis, what, size, seconds, 1e6 * seconds / size)


def _frames(mode: Mode, rig: Rig, pose: SpotPose) -> Iterator[TimeRow]:
    setup = Setup(rig.focal_length, *rig.laser_offset, rig.require_beam().radius)
    spots = spots_of(rig, pose, max(FRAMES[mode]), POINTS)
    for size in FRAMES[mode]:
        some = spots[:size]
        yield _row("frames", "solve_batch", size, best(lambda some=some: solve_batch(some, rig), ROUNDS[mode]))
    few = np.stack([rig.to_laser_plane(spot.points)[0] for spot in spots[: min(100, len(spots))]])
    B = taubin(few).B
    for size in ELLIPSES[mode]:
        many = np.resize(B, (size, 5))
        yield _row("frames", "closed form", size, best(lambda many=many: solve_both(many, setup), ROUNDS[mode]))


def _points(mode: Mode, rig: Rig, pose: SpotPose) -> Iterator[TimeRow]:
    for what, formulation in (("Constrained + Ipopt", Constrained()), ("Reprojection + Ipopt", Reprojection())):
        for size in POINT_COUNTS[mode]:
            (spot,) = spots_of(rig, pose, 1, size)

            def work(spot: Spot = spot, formulation: Constrained | Reprojection = formulation) -> object:
                return solve(spot, rig, formulation=formulation)

            work()  # The programme is built, once for a number of points.
            yield _row("points", what, size, best(work, ROUNDS[mode]))
    for size in POINT_COUNTS[mode]:
        spots = spots_of(rig, pose, 100, size)
        seconds = best(lambda spots=spots: solve_batch(spots, rig), ROUNDS[mode])
        yield _row("points", "solve_batch, one of 100", size, seconds / len(spots))


def _views(mode: Mode) -> Iterator[TimeRow]:
    for size in VIEWS[mode]:
        seen = long_session(1, size).observations
        yield _row("views", "joint adjustment", size, best(lambda seen=seen: adjust_all(seen, Model()), 2))


def _walkers(mode: Mode, rig: Rig, pose: SpotPose) -> Iterator[TimeRow]:
    (spot,) = spots_of(rig, pose, 1, POINTS)
    target = Target(Likelihood.of(Problem.from_spot(spot, rig)), Prior())
    centre = np.array([np.log(pose.z_L), *pose.slopes])
    rng = np.random.default_rng(1)
    for size in WALKERS[mode]:
        ensemble = centre + 1e-5 * rng.standard_normal((size, 3))
        seconds = best(lambda ensemble=ensemble: target(ensemble), 4 * ROUNDS[mode])
        yield _row("walkers", "log posterior", size, seconds)


def growth(times: Sequence[TimeRow]) -> list[GrowthRow]:
    """Fit the exponents, a row for each thing done."""
    found = []
    for axis, what in dict.fromkeys((row.axis, row.what) for row in times):
        rows = [row for row in times if (row.axis, row.what) == (axis, what)]
        size, seconds = (np.log([getattr(row, name) for row in rows]) for name in ("size", "seconds"))
        exponent = float(np.polyfit(size, seconds, 1)[0])
        at_the_end = float(np.diff(seconds[-2:])[0] / np.diff(size[-2:])[0])
        found.append(GrowthRow(axis, what, rows[0].size, rows[-1].size, exponent, at_the_end))
    return found
