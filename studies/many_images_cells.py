"""The cells of the study of many images: frames of one plane combined, and rigs checked by images of many planes."""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.stats

from planeopt.estimation import combine, solve_batch
from planeopt.estimation.drift import LEVEL, Part, drift
from planeopt.example import example_folder
from planeopt.executors import ordered_map
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig, RigCovariance, load_rig
from planeopt.solution import Solution
from planeopt.spot import Spot
from studies.outline import Array, pixels_at
from studies.study import Mode

N_POINTS = 60
NOISE_PX = 0.1
"""Across the boundary, of each of the points round it."""

NAMES = ("f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
_SIGMAS = np.array([1.0, 0.5, 0.5, 0.04, 0.04, 0.005, 2e-4, 2e-4])
_CORRELATIONS = (("e_x", "cx", -0.9), ("e_y", "cy", -0.9), ("f", "radius", 0.5))

FRAMES = {"full": ((1, 400), (4, 400), (16, 400), (64, 200), (256, 60)), "quick": ((1, 40), (8, 20))}
"""Frames of a plane, and how often."""

IMAGES = {"full": (1, 5, 20), "quick": (1, 4)}
TURNS_MRAD = {"full": (0.0, 0.25, 0.5, 1.0, 2.0), "quick": (0.0, 4.0)}
BATCHES = {"full": (1000, 200), "quick": (40, 10)}
"""Of a rig drawn from its covariance alone, and of one whose beam has turned besides."""


@dataclass(frozen=True)
class CombineRow:
    """Frames of one plane: mean squared errors over the stated covariance, a component (1 is right).

    `total` is with rigs drawn from the covariance, `spot` with the right rig over the spots' part, `believing` as
    `total` by generalised least squares with the sensitivities as they are measured. `scatter` is over its degrees of
    freedom, NaN for one frame. Sigmas are of z_L in mm and, RMS of p and q, of the slopes.
    """

    frames: int
    draws: int
    total: float
    spot: float
    believing: float
    scatter: float
    sigma_z_spot_mm: float
    sigma_z_rig_mm: float
    sigma_slope_spot: float
    sigma_slope_rig: float


@dataclass(frozen=True)
class CheckRow:
    """Batches of images of planes all different, by a rig drawn from its covariance whose beam has turned besides.

    The parts are means over their degrees of freedom (1 is right for a rig that has not turned; NaN where there is no
    such part); `degraded` is the share of batches with that verdict, `naive` the share whose sum of the images' own
    chi-squareds has p < `LEVEL`.
    """

    images: int
    turn_mrad: float
    batches: int
    pooled: float
    shift: float
    trend: float
    rest: float
    degraded: float
    naive: float


def uncertain_rig() -> Rig:
    """The example's rig, known as a calibration might know it."""
    correlation = np.eye(len(NAMES))
    for one, other, value in _CORRELATIONS:
        i, j = NAMES.index(one), NAMES.index(other)
        correlation[i, j] = correlation[j, i] = value
    rig = load_rig(example_folder() / "truth_rig.toml")
    return replace(rig, covariance=RigCovariance(NAMES, correlation * np.outer(_SIGMAS, _SIGMAS)))


def run_frames(mode: Mode, executor: Executor | None) -> list[CombineRow]:
    """Return a row for each number of frames."""
    return list(ordered_map(_frames_row, FRAMES[mode], executor))


def run_checks(mode: Mode, executor: Executor | None) -> list[CheckRow]:
    """Return a row for each number of images and turn of the beam."""
    cells = [(images, turn) for images in IMAGES[mode] for turn in TURNS_MRAD[mode]]
    return list(ordered_map(partial(_check_row, mode=mode), cells, executor))


def _frames_row(cell: tuple[int, int]) -> CombineRow:
    n, draws = cell
    rng = np.random.default_rng([1, n])
    rig = uncertain_rig()
    plane = rig.plane_from_pose(SpotPose.canonical(rig.require_beam().radius / np.cos(0.5), 240.0, 0.5, 0.8))
    trues = [drawn(rig, rng) for _ in range(draws)]
    taken = _groups(solve_batch([spot for true in trues for spot in spots_of(true, [plane] * n, rng)], rig), n)
    right = _groups(solve_batch(spots_of(rig, [plane] * (n * draws), rng), rig), n)
    total, spot, believing, scatter, sigmas = [], [], [], [], []
    for true, solutions, of_right_rig in zip(trues, taken, right, strict=True):
        truth, result = true_plane(true, plane), combine(solutions, rig)
        total.append(squared(_plane(result.pose) - truth, result.covariance))
        believing.append(squared(*_believing(solutions, rig, truth)))
        scatter.append(result.chi2)
        alone = combine(of_right_rig, rig)
        spot.append(squared(_plane(alone.pose) - true_plane(rig, plane), alone.uncertainty.spot))
        sigmas.append([np.diagonal(part) for part in (alone.uncertainty.spot, alone.uncertainty.rig)])
    (z_spot, *slopes_spot), (z_rig, *slopes_rig) = np.mean(sigmas, axis=0)
    return CombineRow(
        frames=n,
        draws=draws,
        total=float(np.mean(total)) / 3,
        spot=float(np.mean(spot)) / 3,
        believing=float(np.mean(believing)) / 3,
        scatter=float(np.mean(scatter)) / (3 * (n - 1)) if n > 1 else math.nan,
        sigma_z_spot_mm=float(np.sqrt(z_spot)),
        sigma_z_rig_mm=float(np.sqrt(z_rig)),
        sigma_slope_spot=float(np.sqrt(np.mean(slopes_spot))),
        sigma_slope_rig=float(np.sqrt(np.mean(slopes_rig))),
    )


def _check_row(cell: tuple[int, float], *, mode: Mode) -> CheckRow:
    n, turn = cell
    batches = BATCHES[mode][turn > 0]
    rng = np.random.default_rng([2, n, round(1000 * turn)])
    rig = uncertain_rig()
    spots = []
    for _ in range(batches):
        true = drawn(rig, rng)
        turned = true.with_parameters({"direction_x": true.parameter("direction_x") + 1e-3 * turn})
        spots += spots_of(turned, planes_of(rig, n, rng), rng)
    taken = _groups(solve_batch(spots, rig), n)
    found = [drift(solutions, rig) for solutions in taken]
    summed = [sum(solution.chi2 or 0.0 for solution in solutions) for solutions in taken]
    naive = int(np.sum(scipy.stats.chi2.sf(summed, 2 * n) < LEVEL))
    parts = {test.part for result in found for test in result.tests}

    def mean(part: Part) -> float:
        tests = [test for result in found for test in result.tests if test.part is part]
        return sum(test.chi2 for test in tests) / sum(test.dof for test in tests) if part in parts else math.nan

    return CheckRow(
        images=n,
        turn_mrad=turn,
        batches=batches,
        pooled=mean(Part.POOLED),
        shift=mean(Part.SHIFT),
        trend=mean(Part.TREND),
        rest=mean(Part.REST),
        degraded=sum(not result.ok for result in found) / batches,
        naive=naive / batches,
    )


def drawn(rig: Rig, rng: np.random.Generator) -> Rig:
    """A rig drawn from the covariance of this one."""
    names = () if rig.covariance is None else rig.covariance.parameters
    values = np.array([rig.parameter(name) for name in names]) + _root(rig) @ rng.normal(size=len(names))
    return replace(rig, covariance=None).with_parameters(dict(zip(names, values.tolist(), strict=True)))


def _root(rig: Rig) -> Array:
    matrix = np.zeros((0, 0)) if rig.covariance is None else rig.covariance.matrix
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


def planes_of(rig: Rig, n: int, rng: np.random.Generator) -> list[Plane]:
    """Planes 160 to 320 mm away, tilted 3 to 57 deg in all directions."""
    radius = rig.require_beam().radius
    drawn = ((rng.uniform(160, 320), rng.uniform(0.05, 1.0), rng.uniform(-3.1, 3.1)) for _ in range(n))
    return [
        rig.plane_from_pose(SpotPose.canonical(radius / np.cos(alpha), z_L, alpha, beta)) for z_L, alpha, beta in drawn
    ]


def spots_of(true: Rig, planes: Sequence[Plane], rng: np.random.Generator) -> list[Spot]:
    """What the true rig's camera sees, with noise across the boundary."""
    angle = np.linspace(0, 2 * np.pi, N_POINTS, endpoint=False)
    outlines: dict[Plane, tuple[Array, Array]] = {}
    spots = []
    for plane in planes:
        if plane not in outlines:
            outlines[plane] = pixels_at(true, true.pose_from_plane(plane), angle)
        pixels, normals = outlines[plane]
        noise = NOISE_PX * rng.normal(size=(N_POINTS, 1))
        spots.append(Spot(pixels + noise * normals, np.full(N_POINTS, NOISE_PX)))
    return spots


def _groups(solutions: Iterable[Solution], n: int) -> list[list[Solution]]:
    """The solutions, `n` at a time."""
    listed = list(solutions)
    return [listed[i : i + n] for i in range(0, len(listed), n)]


def true_plane(rig: Rig, plane: Plane) -> Array:
    """``(z_L, p, q)`` of a plane."""
    return _plane(rig.pose_from_plane(plane))


def _plane(pose: SpotPose) -> Array:
    return np.array([pose.z_L, *pose.slopes])


def squared(error: Array, covariance: Array) -> float:
    """Squared length of an error in its covariance."""
    return float(error @ np.linalg.solve(covariance, error))


def _believing(solutions: Sequence[Solution], rig: Rig, truth: Array) -> tuple[Array, Array]:
    """Error and covariance of generalised least squares whose weights take the measured sensitivities for exact."""
    parts = [solution.uncertainty for solution in solutions if solution.uncertainty is not None]
    planes = np.concatenate([_plane(solution.pose) for solution in solutions if solution.pose is not None])
    moved = np.concatenate([part.plane_by_rig for part in parts if part.plane_by_rig is not None]) @ _root(rig)
    joint = moved @ moved.T
    for i, part in enumerate(parts):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += part.spot
    size = np.sqrt(np.diagonal(joint))
    design = np.tile(np.eye(3), (len(parts), 1)) / size[:, None]
    weighted = np.linalg.solve(joint / np.outer(size, size), design)
    covariance = np.asarray(np.linalg.inv(design.T @ weighted), dtype=np.float64)
    return covariance @ (weighted.T @ (planes / size)) - truth, covariance
