"""What a calibration says at a terminal: its tables as texts."""

from collections.abc import Sequence
from typing import Literal

from planeopt.calibration.ladder import LEVEL
from planeopt.calibration.record import AdjustmentRecord, CalibrationFile, ParameterRecord, TestRecord
from planeopt.report.calibration_words import NAMES, TERMS
from planeopt.report.words import number, p_text

Columns = Sequence[tuple[str, Literal["left", "right"]]]
TextTable = tuple[str, Columns, Sequence[Sequence[str]]]


def images(file: CalibrationFile) -> TextTable:
    """Return what became of each image: title, columns, rows."""
    fits = {} if file.adjustment is None else {view.name: view for view in file.adjustment.views}
    rows = []
    for image in file.images:
        fit = fits.get(image.name)
        left = "-" if fit is None or fit.corner_rms_px is None else f"{fit.corner_rms_px:.3f}"
        spot = "left out" if fit is not None and fit.section is not None and not fit.spot_used else image.spot_status
        # Of a board that was not found nobody asks for the spot.
        reasons = image.reason or image.spot_reason
        rows.append((image.name, image.status, spot.replace("none", "-"), str(image.n_corners), left, reasons or "-"))
    columns: Columns = (
        ("image", "left"),
        ("board", "left"),
        ("spot", "left"),
        ("corners", "right"),
        ("RMS px", "right"),
        ("why not", "left"),
    )
    return "images", columns, rows


def parameters(found: AdjustmentRecord) -> TextTable:
    """Return the parameters with their intervals."""
    columns: Columns = (("", "left"), ("value", "right"), ("sigma", "right"), ("95 % interval", "right"))
    return "parameters", columns, [_parameter(one) for one in (*found.parameters, *found.derived)]


def _parameter(one: ParameterRecord) -> tuple[str, str, str, str]:
    value, sigma = number(one.value, one.sigma), "-" if one.sigma is None else number(one.sigma, one.sigma)
    known = one.low95 is not None and one.high95 is not None
    ends = [number(end, one.sigma) for end in (one.low95, one.high95) if end is not None]
    return NAMES.get(one.name, one.name), value, sigma, " to ".join(ends) if known else "-"


def tests(file: CalibrationFile) -> TextTable:
    """Return the tests of the model."""
    columns: Columns = (("term", "left"), ("seen", "left"), ("free", "left"), ("F", "right"), ("p", "right"))
    return "tests", columns, [_test(test) for test in (*file.ladder, *file.tests.values())]


def _test(test: TestRecord) -> tuple[str, str, str, str, str]:
    seen = "yes" if test.p_value < LEVEL else "no"
    chance = p_text(test.p_value)
    return TERMS.get(test.name, test.name), seen, "yes" if test.used else "no", f"{test.statistic:.3g}", chance


def conditions(file: CalibrationFile) -> TextTable:
    """Return the conditions that are not met."""
    columns: Columns = (("condition", "left"), ("state", "left"), ("", "left"))
    return "conditions", columns, [(one.name, one.state, one.sentence) for one in file.gates if one.state != "ok"]
