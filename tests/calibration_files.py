"""A calibration of a simulated session as its file holds it, with a hand-made verdict: for tests of file and page."""

from functools import cache

import msgspec
import numpy as np

from planeopt.calibration.adjustment import adjust
from planeopt.calibration.model import Model
from planeopt.calibration.observed import observations_record
from planeopt.calibration.pose_cost import pose_cost, working_planes
from planeopt.calibration.record import (
    CalibrationFile,
    CostRecord,
    FoldRecord,
    GateRecord,
    HeldOutRecord,
    ImageRecord,
    NextViewRecord,
    OptionsRecord,
    TestRecord,
)
from planeopt.calibration.recording import adjustment_record, provenance
from planeopt.simulation.board_random import random_session
from planeopt.simulation.board_sessions import SimulatedSession


def session() -> SimulatedSession:
    return random_session(3)


@cache
def calibration_file() -> CalibrationFile:
    """Return the file of a session of 30 views with one corner that is 3 px off."""
    observations = session().observations
    views = list(observations.views)
    moved = views[4].corners.copy()
    moved[3] += [3.0, -2.0]
    views[4] = type(views[4])(views[4].name, views[4].ids, moved, views[4].sigma, views[4].spot)
    observations = type(observations)(
        observations.board, observations.image_size, tuple(views), observations.spot, observations.pixel_pitch_mm
    )
    found = adjust(observations, Model())
    planes = pose_cost(found.rig, working_planes([300.0, 500.0]))
    flat = TestRecord(
        name="warp",
        statistic=65.2,
        dof=(2.0, 1498.4),
        p_value=3.1e-27,
        used=True,
        sentence="The board is bowed by 0.046 mm; that was compensated.",
        smaller={"f": (3462.0, 0.55)},
        larger={"f": (3459.9, 0.6)},
    )
    return CalibrationFile(
        planeopt="0.1.0",
        provenance=provenance("session", command="planeopt calibrate session", seed=0, when=None),
        verdict="degraded",
        message="The board is bowed.",
        forced=False,
        gates=(
            GateRecord(name="views", state="ok", value=30.0, limits=(10.0, 3.0), sentence="30 views are enough."),
            GateRecord(name="condition", state="warn", value=found.condition, limits=(500.0, 1e4), sentence="So <so>."),
            GateRecord(name="twins", state="ok", value=None, limits=(None, None), sentence="Nothing to judge."),
        ),
        next_view=NextViewRecord(
            sentence="Tilt the board by 40 deg about its vertical axis, 400 mm away.",
            rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            translation_mm=(0.0, 0.0, 400.0),
            gain=0.04,
        ),
        options=OptionsRecord(expect={"radius": (14.2, 0.1)}),
        images=(
            ImageRecord(name="a.png", status="ok", reason="", n_corners=88, spot="ok", spot_reason=""),
            ImageRecord(
                name="<b>.png",
                status="refused",
                reason="No marker was found.",
                n_corners=0,
                spot="none",
                spot_reason="",
            ),
        ),
        adjustment=adjustment_record(found),
        ladder=(flat, msgspec.structs.replace(flat, name="k3", p_value=0.4, used=False)),
        tests={"warp": flat, "parallel": msgspec.structs.replace(flat, name="parallel", sentence="Not parallel.")},
        held_out=HeldOutRecord(
            ok=True,
            sentence="What had no say is predicted as well as expected.",
            error_px=0.092,
            expected_px=0.091,
            folds=(
                FoldRecord(
                    views=("a.png", "b.png"), error_px=0.09, expected_px=0.091, largest_shift=1.2, parameter="cx"
                ),
            ),
        ),
        cost=tuple(
            CostRecord(
                z_L_mm=one.z_L,
                alpha_deg=float(np.degrees(one.alpha)),
                beta_deg=None if one.beta is None else float(np.degrees(one.beta)),
                sigma_z_L_mm=one.sigma_z_L,
                sigma_normal_deg=float(np.degrees(one.sigma_normal)),
                independent_z_L_mm=one.independent_z_L,
                independent_normal_deg=float(np.degrees(one.independent_normal)),
                offset_z_L_mm=one.offset_z_L,
                offset_normal_deg=float(np.degrees(one.offset_normal)),
            )
            for one in planes
        ),
        observations=observations_record(observations),
    )
