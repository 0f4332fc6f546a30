"""From a calibration to `calibration.json`."""

import importlib.metadata
import math
import platform
from datetime import UTC, datetime

import cv2

from planeopt import __version__
from planeopt.calibration.adjusted import adjustment_record, triple, triples
from planeopt.calibration.gate import Gate
from planeopt.calibration.held_out import HeldOut
from planeopt.calibration.ladder import Tested
from planeopt.calibration.next_view import NextView
from planeopt.calibration.observed import image_record, observations_record
from planeopt.calibration.pose_cost import PoseCost
from planeopt.calibration.record import (
    CalibrationFile,
    CostRecord,
    FoldRecord,
    GateRecord,
    HeldOutRecord,
    NextViewRecord,
    OptionsRecord,
    Provenance,
    TestRecord,
)
from planeopt.calibration.routine import Calibration, Options


def versions() -> dict[str, str]:
    """Return the versions of what the numbers depend on."""
    packages = {name: importlib.metadata.version(name) for name in ("numpy", "scipy")}
    # OpenCV comes in several packages, of which any will do.
    return {"planeopt": __version__, "python": platform.python_version(), **packages, "opencv": cv2.__version__}


def provenance(session: str, *, command: str, seed: int, when: datetime | None) -> Provenance:
    """Return where a calibration comes from.

    Parameters
    ----------
    session : str
        What was read.
    command : str
        That makes it again.
    seed : int
    when : datetime, optional
        Aware of its time zone; left out, no time is noted, so that two runs give the same bytes.
    """
    time = None if when is None else when.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return Provenance(versions=versions(), session=session, command=command, seed=seed, time=time)


def calibration_file(calibration: Calibration, came: Provenance, *, forced: bool = False) -> CalibrationFile:
    """Return a calibration as its file holds it.

    Parameters
    ----------
    calibration : Calibration
    came : Provenance
    forced : bool
        Whether a refused rig is used all the same.
    """
    found = calibration.adjustment
    return CalibrationFile(
        planeopt=__version__,
        provenance=came,
        verdict=calibration.verdict,
        message=calibration.message,
        forced=forced and calibration.verdict == "refused" and found is not None,
        gates=tuple(_gate(gate) for gate in calibration.gates),
        next_view=None if calibration.next_view is None else _next_view(calibration.next_view),
        options=_options(calibration.options),
        images=tuple(image_record(image) for image in calibration.images),
        adjustment=None if found is None else adjustment_record(found),
        ladder=tuple(_test(test) for test in calibration.ladder),
        tests={name: _test(test) for name, test in calibration.tests.items()},
        held_out=None if calibration.held_out is None else _held_out(calibration.held_out),
        cost=tuple(cost_record(cost) for cost in calibration.cost),
        observations=observations_record(calibration.observations),
    )


def options_from_record(record: CalibrationFile) -> Options:
    """Return what was asked of a calibration."""
    asked = record.options
    return Options(**{name: getattr(asked, name) for name in OptionsRecord.__struct_fields__})


def _options(options: Options) -> OptionsRecord:
    expect = {name: (float(value), float(room)) for name, (value, room) in options.expect.items()}
    return OptionsRecord(
        focal=options.focal,
        distortion=options.distortion,
        warp=options.warp,
        beam=options.beam,
        corner_weights=options.corner_weights,
        reject=options.reject,
        expect=expect,
    )


def _gate(gate: Gate) -> GateRecord:
    warn, refuse = (_number(limit) for limit in gate.limits)
    return GateRecord(
        name=gate.name,
        state=gate.state,
        value=_number(gate.value),
        limits=(warn, refuse),
        sentence=gate.sentence,
        symptom=gate.symptom,
    )


def _next_view(view: NextView) -> NextViewRecord:
    return NextViewRecord(
        sentence=view.sentence, rotation=triples(view.R), translation_mm=triple(view.t), gain=float(view.gain)
    )


def _test(test: Tested) -> TestRecord:
    terms, freedom = test.dof
    return TestRecord(
        name=test.name,
        statistic=float(test.statistic),
        dof=(float(terms), float(freedom)),
        p_value=float(test.p_value),
        used=bool(test.used),
        sentence=test.sentence,
        smaller={name: (float(value), float(sigma)) for name, (value, sigma) in test.smaller.items()},
        larger={name: (float(value), float(sigma)) for name, (value, sigma) in test.larger.items()},
    )


def _held_out(found: HeldOut) -> HeldOutRecord:
    return HeldOutRecord(
        ok=bool(found.ok),
        sentence=found.sentence,
        error_px=_number(found.error_px),
        expected_px=_number(found.expected_px),
        folds=tuple(
            FoldRecord(
                views=tuple(fold.views),
                error_px=_number(fold.error_px),
                expected_px=_number(fold.expected_px),
                spot_error_px=_number(fold.spots.error_px),
                spot_expected_px=_number(fold.spots.expected_px),
                largest_shift=_number(fold.largest_shift),
                parameter=fold.parameter,
            )
            for fold in found.folds
        ),
    )


def cost_record(cost: PoseCost) -> CostRecord:
    """Return what the calibration costs a plane as it stands in the file: degrees."""
    return CostRecord(
        z_L_mm=float(cost.z_L),
        alpha_deg=math.degrees(cost.alpha),
        beta_deg=None if cost.beta is None else math.degrees(cost.beta),
        sigma_z_L_mm=float(cost.sigma_z_L),
        sigma_normal_deg=math.degrees(cost.sigma_normal),
        independent_z_L_mm=float(cost.independent_z_L),
        independent_normal_deg=math.degrees(cost.independent_normal),
        offset_z_L_mm=float(cost.offset_z_L),
        offset_normal_deg=math.degrees(cost.offset_normal),
    )


def _number(value: float | None) -> float | None:
    """Return a float; None for what is not finite, which JSON has no number for."""
    return None if value is None or not math.isfinite(value) else float(value)
