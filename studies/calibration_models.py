"""What becomes of a calibration whose model lacks something that is there, or that chooses its model by a test."""

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from planeopt.calibration.adjustment import Adjustment, adjust, refit
from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.ladder import LEVEL, compare
from planeopt.calibration.model import Model
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.executors import ordered_map
from planeopt.rig import Rig
from planeopt.simulation import Shooting, SimulatedSession, random_session
from planeopt.spot import Spot
from studies.calibration_fits import NAN, NO_ERRORS, Errors, errors_row, fit_default
from studies.calibration_sessions import working_pose
from studies.outline import pixels_at

BOWED, FLAT, TANGENTIAL, OBLIQUE = "bowed by 0.5 mm", "flat board", "small p1, p2", "beam 5 mrad off"
_VIEWS = 15
_CORNER_PX, _SPOT_PX = 0.1, 0.1
_BOW_MM = (0.5, 0.25)
_TANGENTIAL = 1.5e-4
OBLIQUE_MRAD = 5.0
_BOUNDARY = 90


@dataclass(frozen=True, kw_only=True)
class ModelRow(Errors):
    """One session with something in it, calibrated with or without a place for it.

    Attributes
    ----------
    case : str
        What is there.
    model : str
        What is done about it.
    seed : int
    outcome : str
    f_error, f_relative : float
        Error of f and its standard deviation, over f.
    off_axis_mrad, off_axis_sigma_mrad : float
        Angle between beam and optical axis as found, and its standard deviation along that direction; 0 where the
        beam is taken to be parallel.
    z_L_error, normal_error_deg : float
        Error of a plane within the session's depths measured with the rig from an exact boundary: of z_L, over z_L, and
        the angle between the normals.
    """

    case: str
    model: str
    seed: int
    outcome: str
    f_error: float
    f_relative: float
    off_axis_mrad: float
    off_axis_sigma_mrad: float
    z_L_error: float
    normal_error_deg: float


def _tangential(model: str) -> Callable[[SimulatedSession], Adjustment]:
    def fit(session: SimulatedSession) -> Adjustment:
        kept = adjust(session.observations, Model(distortion="tangential"))
        if model == "kept":
            return kept
        dropped = refit(kept, Model(distortion="k2"))
        if model == "dropped":
            return dropped
        test = compare("tangential", dropped, kept, used=True, words="p1, p2")
        return kept if test.p_value < LEVEL else dropped

    return fit


def _plain(model: Model) -> Callable[[SimulatedSession], Adjustment]:
    return lambda session: adjust(session.observations, model)


_CAMERA = "tangential"
KINDS: dict[tuple[str, str], Callable[[SimulatedSession], Adjustment]] = {
    (BOWED, "bow free"): _plain(Model(distortion=_CAMERA)),
    (BOWED, "taken as flat"): _plain(Model(distortion=_CAMERA, warp=False)),
    (FLAT, "bow free"): _plain(Model(distortion=_CAMERA)),
    (FLAT, "taken as flat"): _plain(Model(distortion=_CAMERA, warp=False)),
    (TANGENTIAL, "dropped"): _tangential("dropped"),
    (TANGENTIAL, "chosen by its test"): _tangential("chosen"),
    (TANGENTIAL, "kept"): _tangential("kept"),
    (TANGENTIAL, "default"): lambda session: fit_default(session.observations),
    (OBLIQUE, "direction free"): _plain(Model(distortion=_CAMERA)),
    (OBLIQUE, "taken as parallel"): _plain(Model(distortion=_CAMERA, beam="parallel")),
}


def run_models(seeds: int, executor: Executor | None) -> list[ModelRow]:
    """Calibrate so many sessions of each case with each of its models."""
    jobs = [(case, seed) for case in dict.fromkeys(case for case, _ in KINDS) for seed in range(seeds)]
    return [row for rows in ordered_map(_case, jobs, executor) for row in rows]


def session_of(case: str, seed: int) -> SimulatedSession:
    """Return a session with what the case has."""
    warp = _BOW_MM if case == BOWED else (0.0, 0.0)
    session = random_session(
        900 + seed, shooting=Shooting(_VIEWS), warp=warp, corner_sigma=_CORNER_PX, spot_sigma=_SPOT_PX
    )
    rng = np.random.default_rng((77, seed))
    camera, beam = session.rig.camera, session.rig.require_beam()
    k1, k2 = camera.distortion[:2]
    p1, p2 = (_TANGENTIAL * rng.standard_normal(2)).tolist()
    camera = replace(camera, distortion=(k1, k2, p1, p2, 0.0))
    if case == OBLIQUE:
        x, y = (1e-3 * OBLIQUE_MRAD * np.array([math.cos(at := rng.uniform(0, math.tau)), math.sin(at)])).tolist()
        beam = replace(beam, direction=(x, y, math.sqrt(1 - x * x - y * y)))
    return replace(session, rig=Rig(camera, beam)).again(seed)


def _case(job: tuple[str, int]) -> list[ModelRow]:
    case, seed = job
    session = session_of(case, seed)
    return [_row(case, model, seed, session, fit) for (of, model), fit in KINDS.items() if of == case]


def _row(
    case: str, model: str, seed: int, session: SimulatedSession, fit: Callable[[SimulatedSession], Adjustment]
) -> ModelRow:
    try:
        found = fit(session)
        errors = errors_row(found, session)
        z_L_error, normal = _plane_error(found.rig, session, seed)
    except (AdjustmentError, InputError) as error:
        nothing = dict.fromkeys(
            ("f_error", "f_relative", "off_axis_mrad", "off_axis_sigma_mrad", "z_L_error", "normal_error_deg"), NAN
        )
        outcome = " ".join(str(error).split())
        return ModelRow(**vars(NO_ERRORS), case=case, model=model, seed=seed, outcome=outcome, **nothing)
    f = session.rig.camera.fx
    angle, sigma = off_axis(found)
    return ModelRow(
        **vars(errors),
        case=case,
        model=model,
        seed=seed,
        outcome="calibrated",
        f_error=(found.value("f") - f) / f,
        f_relative=found.sigma("f") / f,
        off_axis_mrad=1e3 * angle,
        off_axis_sigma_mrad=1e3 * sigma,
        z_L_error=z_L_error,
        normal_error_deg=normal,
    )


def off_axis(fit: Adjustment) -> tuple[float, float]:
    """Return the sine of the angle between beam and optical axis, and its standard deviation."""
    names = ("direction_x", "direction_y")
    across = np.array([fit.value(name) for name in names])
    length = float(np.linalg.norm(across))
    if names[0] not in fit.names:
        return length, 0.0
    rows = [fit.names.index(name) for name in names]
    return length, float(np.sqrt(across @ fit.covariance[np.ix_(rows, rows)] @ across)) / length


def _plane_error(rig: Rig, session: SimulatedSession, seed: int) -> tuple[float, float]:
    """Return the relative error of z_L and the angle between the normals, degrees."""
    pose = working_pose(session, seed)
    theta = 2 * np.pi * np.arange(_BOUNDARY) / _BOUNDARY
    spot = Spot(pixels_at(session.rig, pose, theta)[0], np.full(_BOUNDARY, 0.1), arc_fraction=1.0)
    found = solve(spot, replace(rig, covariance=None))
    if found.pose is None:
        return NAN, NAN
    true, measured = session.rig.plane_from_pose(pose).normal, rig.plane_from_pose(found.pose).normal
    angle = math.degrees(math.atan2(float(np.linalg.norm(np.cross(true, measured))), float(true @ measured)))
    return (found.pose.z_L - pose.z_L) / pose.z_L, angle
