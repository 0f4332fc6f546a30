"""What a calibration's accuracy, and what it costs a plane, depend on: the views' number, their tilts, their depths."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
import scipy.stats

from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.pose_cost import pose_cost
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.executors import ordered_map
from planeopt.plane import SpotPose
from planeopt.rig import Rig
from planeopt.simulation import Shooting, random_session
from planeopt.spot import Spot
from studies.calibration_fits import NAN, fit_default, truth_of
from studies.outline import pixels_at

VIEWS = (3, 4, 6, 8, 10, 15, 20, 30, 40)
TILTS_DEG = (4.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0)
RATIOS = (1.02, 1.1, 1.25, 1.5, 2.0, 2.5)
CORNER_PX, SPOT_PX = 0.2, 0.1
_VIEWS, _TILT_DEG, _RATIO = 15, 40.0, 2.0
_SIZE = (1280, 960)
PLANE_TILT_DEG = 30.0
BOUNDARY = 100
"""Points of the boundary of a plane's spot, each known to `SPOT_PX`."""
_DIRECTION = 0.5


@dataclass(frozen=True)
class AccuracyRow:
    """One session.

    Attributes
    ----------
    varied : str
        "views", "tilt" or "depths".
    value : float
        Views; largest tilt, degrees; farthest depth over nearest.
    seed : int
    outcome : str
    f_relative, f_error : float
        Standard deviation of f over f, and its error over the true one.
    offset_mm, radius_mm, direction_mrad : float
        Standard deviations: of (e_x, e_y) and of the direction, root of the sum of squares, and of the radius.
    z_L_relative, normal_deg : float
        What the calibration alone costs a plane tilted by 30 degrees at the working distance: standard deviation of z_L
        over z_L, and of the normal.
    z_L_spot_relative, normal_spot_deg : float
        What the noise of that plane's own spot costs it: 100 points of the boundary, each known to 0.1 px.
    """

    varied: str
    value: float
    seed: int
    outcome: str
    f_relative: float
    f_error: float
    offset_mm: float
    radius_mm: float
    direction_mrad: float
    z_L_relative: float
    normal_deg: float
    z_L_spot_relative: float
    normal_spot_deg: float


@dataclass(frozen=True)
class _Job:
    varied: str
    value: float
    seed: int

    @property
    def shooting(self) -> Shooting:
        views = int(self.value) if self.varied == "views" else _VIEWS
        tilt = self.value if self.varied == "tilt" else _TILT_DEG
        return Shooting(views, (0.0, tilt), self.value if self.varied == "depths" else _RATIO)


def run_accuracy(seeds: int, executor: Executor | None, *, every: int = 1) -> list[AccuracyRow]:
    """Calibrate so many sessions of each kind; of the kinds only every so many-th."""
    kinds = [("views", float(count)) for count in VIEWS[::every]]
    kinds += [("tilt", tilt) for tilt in TILTS_DEG[::every]] + [("depths", ratio) for ratio in RATIOS[::every]]
    jobs = [_Job(varied, value, seed) for varied, value in kinds for seed in range(seeds)]
    return list(ordered_map(_measured, jobs, executor))


def _measured(job: _Job) -> AccuracyRow:
    session = random_session(
        700 + job.seed,
        shooting=job.shooting,
        image_size=_SIZE,
        corner_sigma=CORNER_PX,
        spot_sigma=SPOT_PX,
    )
    try:
        fit = fit_default(session.observations)
        depth = float(np.median(session.poses.translations[:, 2]))
        (cost,) = pose_cost(fit.rig, np.array([[depth, np.radians(PLANE_TILT_DEG), _DIRECTION]]))
        z_L_spot, normal_spot = _of_the_spot(fit.rig, depth)
    except (AdjustmentError, InputError) as error:
        return AccuracyRow(job.varied, job.value, job.seed, " ".join(str(error).split()), *[NAN] * 9)
    f, true = fit.value("f"), truth_of(session)["f"]
    offset, direction = (np.hypot(fit.sigma(f"{a}_x"), fit.sigma(f"{a}_y")) for a in ("e", "direction"))
    return AccuracyRow(
        job.varied,
        job.value,
        job.seed,
        "calibrated",
        fit.sigma("f") / f,
        (f - true) / true,
        float(offset),
        fit.sigma("radius"),
        float(1e3 * direction),
        cost.sigma_z_L / depth,
        float(np.degrees(cost.sigma_normal)),
        z_L_spot / depth,
        float(np.degrees(normal_spot)),
    )


def _of_the_spot(rig: Rig, depth: float) -> tuple[float, float]:
    """Return what a spot's own noise costs the plane: the standard deviations of z_L (mm) and of the normal (rad)."""
    tilt = np.radians(PLANE_TILT_DEG)
    pose = SpotPose.canonical(rig.require_beam().radius / np.cos(tilt), depth, tilt, _DIRECTION)
    theta = 2 * np.pi * np.arange(BOUNDARY) / BOUNDARY
    spot = Spot(pixels_at(rig, pose, theta)[0], np.full(BOUNDARY, SPOT_PX), arc_fraction=1.0)
    found = solve(spot, rig).uncertainty
    if found is None:
        return NAN, NAN
    return float(np.sqrt(found.spot[0, 0])), float(np.sqrt(np.trace(found.normal_spot)))


def median(rows: Sequence[AccuracyRow], varied: str, value: float, name: str) -> float:
    """Return the median of a field over the sessions of a kind."""
    own = [getattr(row, name) for row in rows if (row.varied, row.value) == (varied, value)]
    return float(np.nanmedian(own))


def values_of(rows: Sequence[AccuracyRow], varied: str) -> list[float]:
    """Return what was tried of views, tilts or depths, rising."""
    return sorted({row.value for row in rows if row.varied == varied})


def typical_error(rows: Sequence[AccuracyRow], varied: str, value: float) -> float:
    """Return the standard deviation of f's error, over f, as the median of its size tells it."""
    errors = [row.f_error for row in rows if (row.varied, row.value) == (varied, value)]
    return float(np.nanmedian(np.abs(errors)) / scipy.stats.norm.ppf(0.75))


def worst_in_sigmas(rows: Sequence[AccuracyRow], varied: str, value: float) -> float:
    """Return the largest error of f in its own standard deviations."""
    own = [row for row in rows if (row.varied, row.value) == (varied, value)]
    return float(np.nanmax([abs(row.f_error) / (1 + row.f_error) / row.f_relative for row in own]))
