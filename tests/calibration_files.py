"""A calibration of a simulated session as its file holds it, with a hand-made verdict: for tests of file and page."""

from functools import cache
from typing import Literal

import msgspec

from planeopt.calibration.adjusted import adjustment_record
from planeopt.calibration.adjustment import adjust
from planeopt.calibration.model import Model
from planeopt.calibration.observed import observations_record
from planeopt.calibration.pose_cost import pose_cost, working_planes
from planeopt.calibration.record import (
    CalibrationFile,
    FoldRecord,
    GateRecord,
    HeldOutRecord,
    ImageRecord,
    NextViewRecord,
    OptionsRecord,
    TestRecord,
)
from planeopt.calibration.recording import cost_record, provenance
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
            _gate("views", "ok", 30.0, (10.0, 3.0)),
            _gate("condition", "warn", found.condition, (500.0, 1e4)),
            _gate("twins", "ok", None, (None, None)),
        ),
        next_view=NextViewRecord(
            sentence="Tilt the board by 40 deg about its vertical axis, 400 mm away.",
            rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            translation_mm=(0.0, 0.0, 400.0),
            gain=0.04,
        ),
        options=OptionsRecord(expect={"radius": (14.2, 0.1)}),
        images=(
            _image("a.png", "", 88),
            _image("<b>.png", "No marker was found.", 0),
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
                    views=("a.png", "b.png"),
                    error_px=0.09,
                    expected_px=0.091,
                    spot_error_px=0.1,
                    spot_expected_px=None,
                    largest_shift=1.2,
                    parameter="cx",
                ),
            ),
        ),
        cost=tuple(cost_record(one) for one in planes),
        observations=observations_record(observations),
    )


def _image(name: str, reason: str, corners: int) -> ImageRecord:
    return ImageRecord(
        name=name,
        status="refused" if reason else "ok",
        reason=reason,
        n_corners=corners,
        spot_status="none" if reason else "ok",
        spot_reason="",
        spot_flags=(),
        blur_px=0.8,
        marker_share=None if reason else 0.74,
    )


def _gate(
    name: str, state: Literal["ok", "warn", "refuse"], value: float | None, limits: tuple[float | None, float | None]
) -> GateRecord:
    return GateRecord(name=name, state=state, value=value, limits=limits, sentence=f"So <so>: {name}.", symptom=False)
