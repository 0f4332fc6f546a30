"""Random sessions as points, each calibrated and compared with its truth; and a plane measured with each rig."""

import math
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.model import Model
from planeopt.errors import InputError
from planeopt.executors import ordered_map
from planeopt.plane import SpotPose
from planeopt.simulation import SimulatedSession, random_session
from studies.calibration_fits import NAN, NO_ERRORS, Errors, PoseErrors, errors_row, fit_default, pose_errors

DEFAULT, KNOWN = "default", "as simulated"
MODELS = (DEFAULT, KNOWN)
"""What is free: every term, as unless told otherwise; or the terms that the session was simulated with."""


@dataclass(frozen=True, kw_only=True)
class SessionRow(Errors):
    """One session, calibrated with one model.

    Attributes
    ----------
    seed : int
    model : str
    outcome : str
        "calibrated", or why not.
    views : int
    corner_sigma_px : float
        The corners' noise.
    f_relative : float
        Standard deviation of f over f.
    z_L_sigmas, p_sigmas, q_sigmas : float
        Errors of a plane at the working distance, whose boundary is exact, in its own standard deviations; by default
        models alone.
    z_L_apart, p_apart, q_apart : float
        The same with camera and beam taken as independent.
    z_L_sigma_mm, z_L_apart_mm : float
        Standard deviation of z_L by either.
    """

    seed: int
    model: str
    outcome: str
    views: int
    corner_sigma_px: float
    f_relative: float
    z_L_sigmas: float
    p_sigmas: float
    q_sigmas: float
    z_L_apart: float
    p_apart: float
    q_apart: float
    z_L_sigma_mm: float
    z_L_apart_mm: float


def run_sessions(count: int, executor: Executor | None) -> list[SessionRow]:
    """Calibrate so many sessions with each model."""
    work = partial(calibrated, models=MODELS)
    return [row for rows in ordered_map(work, range(count), executor) for row in rows]


def calibrated(seed: int, models: tuple[str, ...]) -> list[SessionRow]:
    """Return a session's rows."""
    session = random_session(seed)
    return [_row(seed, session, model) for model in models]


def fitted(session: SimulatedSession, model: str) -> Adjustment:
    """Return a session's calibration with a model of `MODELS`."""
    if model == DEFAULT:
        return fit_default(session.observations)
    rung = "k3" if session.rig.camera.distortion[4] else "tangential"
    return adjust(session.observations, Model(distortion=rung))


def _row(seed: int, session: SimulatedSession, model: str) -> SessionRow:
    outcome, errors, relative, poses = "calibrated", NO_ERRORS, NAN, None
    try:
        adjustment = fitted(session, model)
        errors = errors_row(adjustment, session)
        relative = adjustment.sigma("f") / adjustment.value("f")
        if model == DEFAULT:
            poses = pose_errors(adjustment.rig, session.rig, working_pose(session, seed))
    except (AdjustmentError, InputError) as error:
        outcome = " ".join(str(error).split())
    joint, apart = _over(poses)
    return SessionRow(
        **vars(errors),
        seed=seed,
        model=model,
        outcome=outcome,
        views=len(session.poses),
        corner_sigma_px=session.corner_sigma,
        f_relative=relative,
        z_L_sigmas=joint[0],
        p_sigmas=joint[1],
        q_sigmas=joint[2],
        z_L_apart=apart[0],
        p_apart=apart[1],
        q_apart=apart[2],
        z_L_sigma_mm=NAN if poses is None else float(poses.joint[0]),
        z_L_apart_mm=NAN if poses is None else float(poses.apart[0]),
    )


def _over(poses: PoseErrors | None) -> tuple[list[float], list[float]]:
    if poses is None:
        return [NAN] * 3, [NAN] * 3
    return (poses.errors / poses.joint).tolist(), (poses.errors / poses.apart).tolist()


def working_pose(session: SimulatedSession, seed: int) -> SpotPose:
    """Return a plane within the session's depths, tilted by up to 50 degrees in any direction, that the rig sees."""
    rng = np.random.default_rng((76, seed))
    views = [view for view in session.views() if view.spot_state() == "seen"]
    theta = np.linspace(0, math.tau, 24, endpoint=False)
    depths = [(view.spot_on_board(theta) @ view.rotation.T + view.translation)[:, 2].mean() for view in views]
    z_L = float(rng.uniform(min(depths), max(depths)))
    alpha, beta = math.radians(rng.uniform(5, 50)), rng.uniform(-math.pi, math.pi)
    radius = session.rig.require_beam().radius
    return SpotPose.canonical(radius / math.cos(alpha), z_L, alpha, beta)
