"""The cells of the study of rigs in use: checks by new views of a board, and field recalibrations."""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.stats

from planeopt.calibration.adjustment import adjust
from planeopt.calibration.board_check import check_board
from planeopt.calibration.board_verdict import BoardPart, BoardState
from planeopt.calibration.recalibration import Moves, recalibrate
from planeopt.estimation import solve_batch
from planeopt.estimation.misfits import seen, seen_by
from planeopt.executors import ordered_map
from planeopt.rig import Rig
from planeopt.simulation.board_random import Setting, Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession, simulated_session
from studies.many_images_cells import drawn, planes_of, spots_of, squared, true_plane, uncertain_rig
from studies.study import Mode

BOW_MM = 0.2
"""Standard deviation of the boards' bow, as the check allows for."""

RIGS = {"full": (1, 2, 3, 4), "quick": (2,)}
"""Random rigs, each with the covariance of a calibration."""
VIEWS = {"full": (1, 2, 4), "quick": (2,)}
CHECKS = {"full": (45, 4), "quick": (6, 1)}
"""Of a rig drawn from its covariance alone, and of one of which a part has moved besides."""
UPDATES = {"full": (250, 250), "quick": (6, 6)}
"""Field recalibrations, of a beam that has not moved and of one that has."""

RIGHT = "nothing"
"""What has moved of a rig that is as calibrated."""

COMPONENTS = {"parameters": 8, "four": 4, "plane": 3}
"""Of which an update's squared error is known, and how many numbers they are."""

MOVES = (
    ("the focal length", {"f": 0.005}),
    ("the principal point", {"cx": 0.003}),
    ("the lens's distortion", {"k1": 0.01}),
    ("the beam's offset", {"e_x": 0.02}),
    ("the beam's radius", {"radius": 0.01}),
    ("the beam's direction", {"direction_x": 0.001}),
)
"""What moves, and how far: of the focal length, of the image's width, at the image's corner, of the radius, rad."""


@dataclass(frozen=True)
class CheckRow:
    """Checks by new views of a board; the parts over their degrees of freedom, and the p-values' tests of uniformity.

    `named` is the share of the checks in which the group that moved is the first cause, or said to do as well. NaN
    stands where there is nothing.
    """

    moved: str
    views: int
    checks: int
    pooled: float
    shift: float
    rest: float
    spots: float
    pooled_uniform: float
    shift_uniform: float
    rest_uniform: float
    spots_uniform: float
    degraded: float
    named: float


@dataclass(frozen=True)
class UpdateRow:
    """Field recalibrations: squared errors over the stated covariance, a component (1 is right).

    Of all parameters, of the four numbers that images see, and of the plane in a new image.
    """

    moved: str
    images: int
    updates: int
    refused: float
    parameters: float
    four: float
    plane: float


def run_checks(mode: Mode, executor: Executor | None) -> list[CheckRow]:
    """Check rigs as calibrated, and such of which one group of parameters has moved."""
    kinds = [(group, views) for group in ("", *dict(MOVES)) for views in VIEWS[mode]]
    jobs = [_Job(mode, group, views, rig) for group, views in kinds for rig in RIGS[mode]]
    found: dict[tuple[str, int], list[_Check]] = {kind: [] for kind in kinds}
    for job, some in zip(jobs, ordered_map(_checks, jobs, executor), strict=True):
        found[job.group, job.views] += some
    return [_check_row(group, views, checks) for (group, views), checks in found.items()]


@dataclass(frozen=True)
class _Job:
    mode: Mode
    group: str
    views: int
    rig: int


@dataclass(frozen=True)
class _Check:
    chi2: dict[str, tuple[float, float, float]]
    degraded: bool
    named: bool


def _check_row(group: str, views: int, checks: Sequence[_Check]) -> CheckRow:
    numbers: dict[str, float] = {}
    for part in BoardPart:
        name = part.name.lower()
        found = [check.chi2[part.name] for check in checks if part.name in check.chi2]
        numbers[name] = float(np.mean([chi2 / dof for chi2, dof, _ in found])) if found else math.nan
        law = found and not group
        p_values = [p_value for *_, p_value in found]
        numbers[f"{name}_uniform"] = float(scipy.stats.kstest(p_values, "uniform").pvalue) if law else math.nan
    return CheckRow(
        moved=group or RIGHT,
        views=views,
        checks=len(checks),
        degraded=float(np.mean([check.degraded for check in checks])),
        named=float(np.mean([check.named for check in checks])) if group else math.nan,
        **numbers,
    )


@cache
def _calibrated(seed: int) -> tuple[SimulatedSession, Rig]:
    session = random_session(seed)
    return session, replace(session.rig, covariance=adjust(session.observations).rig.covariance)


def _checks(job: _Job) -> list[_Check]:
    group, views, number = job.group, job.views, job.rig
    session, rig = _calibrated(number)
    depth = float(np.median(session.poses.translations[:, 2]))
    setting = Setting(session.rig, session.board, depth=depth)
    ratio = 1.6 if views > 1 else 1.0
    later = random_session(1000 + number, setting=setting, shooting=Shooting(views, depth_ratio=ratio))
    true = _moved(rig, group)
    places = [name for name, _ in MOVES].index(group) + 1 if group else 0
    rng = np.random.default_rng((number, views, places))
    found = []
    for draw in range(CHECKS[job.mode][bool(group)]):
        bow = tuple((BOW_MM * rng.normal(size=2)).tolist())
        observations = simulated_session(
            true,
            session.board,
            later.poses,
            corner_sigma=later.corner_sigma,
            spot_sigma=later.spot_sigma,
            warp=bow,
            seed=10_000 * number + 1000 * places + draw,
        )
        result = check_board(observations, replace(drawn(rig, rng), covariance=rig.covariance), bow_mm=BOW_MM)
        first = (result.causes[0].group, *result.instead) if result.causes else ()
        chi2 = {test.part.name: (test.chi2, test.dof, test.p_value) for test in result.tests}
        found.append(_Check(chi2, result.state is BoardState.DEGRADED, group in first))
    return found


def _moved(rig: Rig, group: str) -> Rig:
    """The rig with one group moved, by an amount that fits its size."""
    camera, radius = rig.camera, rig.require_beam().radius
    width = camera.image_size[0]
    corner = math.hypot(*camera.image_size) / 2 / camera.fx
    size = {"f": camera.fx, "cx": width, "k1": 1 / corner**2, "e_x": radius, "radius": radius, "direction_x": 1.0}
    changes = dict(MOVES).get(group, {})
    return rig.with_parameters({name: rig.parameter(name) + share * size[name] for name, share in changes.items()})


_IMAGES = 10
_AT_ONCE = 20


def run_updates(mode: Mode, executor: Executor | None) -> list[UpdateRow]:
    """Update rigs drawn from a covariance by images of planes, where nothing has moved and where the beam has."""
    rows = []
    for place, (moved, updates) in enumerate(zip((RIGHT, "the beam"), UPDATES[mode], strict=True)):
        jobs = [(place, begin, min(_AT_ONCE, updates - begin)) for begin in range(0, updates, _AT_ONCE)]
        found = [row for part in ordered_map(_updates, jobs, executor) for row in part]
        kept = np.array([row for row in found if row is not None])
        means = (kept.mean(axis=0) if len(kept) else np.full(3, math.nan)).tolist()
        rows.append(UpdateRow(moved, _IMAGES, updates, 1 - len(kept) / updates, *means))
    return rows


def _updates(job: tuple[int, int, int]) -> list[tuple[float, float, float] | None]:
    """Squared distances of some updates, a component; None where the update was refused."""
    place, begin, count = job
    rng = np.random.default_rng((place, begin))
    rig = uncertain_rig()
    names = () if rig.covariance is None else rig.covariance.parameters
    found: list[tuple[float, float, float] | None] = []
    for _ in range(count):
        true = drawn(rig, rng)
        if place:
            way, lean = np.exp(1j * rng.uniform(-np.pi, np.pi, 2))
            change = {"e_x": 0.05 * way.real, "e_y": 0.05 * way.imag}
            change |= {"direction_x": 5e-4 * lean.real, "direction_y": 5e-4 * lean.imag}
            true = true.with_parameters({name: true.parameter(name) + float(size) for name, size in change.items()})
        planes = planes_of(rig, _IMAGES + 1, rng)
        result = recalibrate(spots_of(true, planes[:-1], rng), rig, moves=None if place else Moves(0.0, 0.0))
        if not result.ok:
            found.append(None)
            continue
        off = np.array([result.rig.parameter(name) - true.parameter(name) for name in names])
        covariance = result.rig.covariance_matrix
        by_free = seen_by(result.rig, names)
        image = solve_batch(spots_of(true, planes[-1:], rng), result.rig)
        found.append(
            (
                squared(off, covariance) / len(off),
                squared(seen(result.rig) - seen(true), by_free @ covariance @ by_free.T) / 4,
                squared(image.planes[0] - true_plane(true, planes[-1]), image.covariance[0]) / 3,
            )
        )
    return found
