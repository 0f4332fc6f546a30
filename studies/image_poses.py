"""From image to plane: the hard cases, the honesty of the reported sigma, and the flags."""

import zlib
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
import scipy.stats

from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.executors import ordered_map
from planeopt.simulation import Clutter, Occlusion, Scene, Surface, render
from planeopt.solution import Solution
from planeopt.spot import SpotNotFound, find_spot
from planeopt.spot.points import Kind
from studies.boundaries import least_pose_covariance
from studies.draws import Lit, Look, Range, View, draw_scene

Outcome = Literal["right", "refused", "degraded", "wrong", "broken"]
"""Within 4 sigma; no plane; a plane beyond that with a status that warns of it; and without; the computation broke."""

SIGMAS = 4.0
MAHALANOBIS = float(np.sqrt(scipy.stats.chi2.isf(2 * scipy.stats.norm.sf(SIGMAS), 3)))
"""The distance in three dimensions that is as rare as 4 standard deviations in one."""

IMAGE_SIZE = (640, 480)


@dataclass(frozen=True)
class PoseRow:
    """One image.

    Attributes
    ----------
    case : str
    seed : int
    outcome : Outcome
        By each of z_L and both slopes.
    z_L_sigmas, p_sigmas, q_sigmas : float
        Errors in own standard deviations; NaN where there is no plane.
    mahalanobis : float
        Of the three together, by the own covariance.
    over_bound : float
        The same by the least covariance that the pixels' noise allows, over sqrt(3); NaN where something other than
        that noise is in the image.
    reason : str
        Why there is no plane, or what the status is.
    flags : str
        Of the spot.
    """

    case: str
    seed: int
    outcome: Outcome
    z_L_sigmas: float
    p_sigmas: float
    q_sigmas: float
    mahalanobis: float
    over_bound: float
    reason: str
    flags: str


def kind_of(seed: int) -> Kind:
    """Every third spot is a ring."""
    return "ring" if seed % 3 == 2 else "disc"


BRIGHT = Look(Range(100, 220), Range(1, 2), full_well_electrons=10_000.0)
ANY = Look(Range(20, 230), Range(1, 4))


def _lit(seed: int, name: str, look: Look, radius: Range) -> tuple[Lit, np.random.Generator]:
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    return draw_scene(View(radius, kind=kind_of(seed), image_size=IMAGE_SIZE), look, rng), rng


SIZES = Range(25.0, 100.0)


def _plain(seed: int) -> Lit:
    return _lit(seed, "plain", ANY, SIZES)[0]


def _speckle(seed: int) -> Lit:
    # Dim enough for its bright grains.
    look = Look(Range(60, 150), Range(1, 2), full_well_electrons=10_000.0)
    lit, _ = _lit(seed, "speckle", look, SIZES)
    noise = msgspec.structs.replace(lit.scene.noise, speckle=0.35, speckle_grain_px=1.2)
    return lit.changed(noise=noise)


def _occlusion(seed: int) -> Lit:
    lit, rng = _lit(seed, "occlusion", BRIGHT, SIZES)
    shapes: tuple[Literal["half_plane", "bar", "disc"], ...] = ("half_plane", "bar", "disc")
    # Black, as bright as the surface, or brighter than it.
    brightness = (0.0, lit.scene.surface.background, 0.3)[seed // 3 % 3]
    hidden = Occlusion(shape=shapes[int(rng.integers(3))], share=0.35, brightness=brightness)
    return lit.changed(occlusions=(hidden,))


def _distractors(seed: int) -> Lit:
    lit, _ = _lit(seed, "distractors", BRIGHT, SIZES)
    return lit.changed(clutter=Clutter(count=12, height_range=(0.3, 1.2), size_range_px=(2.0, 25.0)))


def _faint(seed: int) -> Lit:
    look = Look(Range.at(22.0), Range(1, 2), background=Range(60, 100))
    lit, rng = _lit(seed, "faint", look, SIZES)
    slope = rng.uniform(-0.25, 0.25, 2).tolist()
    surface = Surface(background=lit.scene.surface.background, gradient=(slope[0], slope[1]))
    return lit.changed(surface=surface)


def _saturated(seed: int) -> Lit:
    return _lit(seed, "saturated", Look(Range.at(0.0), Range(1, 2), over=2.0), SIZES)[0]


def _small(seed: int) -> Lit:
    return _lit(seed, "small", BRIGHT, Range.at(14.0))[0]


CASES: dict[str, Callable[[int], Lit]] = {
    "plain": _plain,
    "speckle": _speckle,
    "occlusion": _occlusion,
    "distractors": _distractors,
    "faint": _faint,
    "saturated": _saturated,
    "small": _small,
}
HARD = tuple(name for name in CASES if name != "plain")
_PIXELS_ALONE = ("plain", "saturated")
"""Cases where nothing but white noise of known size is in the image."""


@dataclass(frozen=True)
class Job:
    """One image of a case."""

    case: str
    seed: int


def run_poses(jobs: Iterable[Job], executor: Executor | None) -> list[PoseRow]:
    """Measure the planes of all images."""
    return list(ordered_map(measure_pose, jobs, executor))


def measure_pose(job: Job) -> PoseRow:
    """Render an image, find the spot with the true rig, solve, and compare with the truth."""
    lit = CASES[job.case](job.seed)
    scene = lit.scene
    try:
        spot = find_spot(render(scene).image, scene.rig, camera_blur=lit.known_blur)
        solution = solve(spot, scene.rig)
    except SpotNotFound as refusal:
        return _row(job, "refused", reason=refusal.reason.name.lower())
    except (InputError, ArithmeticError, ValueError, RuntimeError) as broken:
        return _row(job, "broken", reason=f"{type(broken).__name__}: {' '.join(str(broken).split())}")
    flags = " ".join(flag.name.lower() for flag in spot.flags)
    if solution.pose is None or solution.covariance is None or solution.status.record == "refused":
        return _row(job, "refused", reason=solution.status.name.lower(), flags=flags)
    error = _error(solution, scene)
    own = error / np.sqrt(np.diag(solution.covariance))
    over_bound = np.nan
    if job.case in _PIXELS_ALONE:
        least = least_pose_covariance(lit)
        over_bound = float(np.sqrt(error @ np.linalg.solve(least, error) / 3))
    beyond: Outcome = "degraded" if solution.status.record == "degraded" else "wrong"
    return PoseRow(
        job.case,
        job.seed,
        "right" if np.all(np.abs(own) <= SIGMAS) else beyond,
        *own.tolist(),
        mahalanobis=float(np.sqrt(error @ np.linalg.solve(solution.covariance, error))),
        over_bound=over_bound,
        reason=solution.status.name.lower(),
        flags=flags,
    )


def _error(solution: Solution, scene: Scene) -> np.ndarray:
    assert solution.pose is not None
    truth = scene.pose
    return np.array([solution.pose.z_L, *solution.pose.slopes]) - [truth.z_L, *truth.slopes]


def _row(job: Job, outcome: Outcome, *, reason: str, flags: str = "") -> PoseRow:
    nan = float("nan")
    return PoseRow(job.case, job.seed, outcome, nan, nan, nan, nan, nan, reason, flags)
