"""The three files of a calibration: the rig, the record, the page."""

from dataclasses import replace
from datetime import datetime
from pathlib import Path

from planeopt.calibration.record import CalibrationFile
from planeopt.calibration.recording import calibration_file, provenance
from planeopt.calibration.routine import Calibration
from planeopt.report.calibration_page import calibration_html
from planeopt.rig import save_rig
from planeopt.whole_files import write_text

RIG, JSON, HTML = FILES = "rig.toml", "calibration.json", "calibration.html"


def write_calibration(
    calibration: Calibration,
    folder: Path,
    *,
    session: str,
    command: str = "",
    when: datetime | None = None,
    forced: bool = False,
) -> CalibrationFile:
    """Write `calibration.json`, `calibration.html` and, where there is a rig to be trusted, `rig.toml`, each whole.

    Parameters
    ----------
    calibration : Calibration
    folder : Path
        That is there.
    session : str
        What was read: a title, and for who wants to know.
    command : str
        That makes the calibration again.
    when : datetime, optional
        Aware of its time zone. Without it no time is noted, so that the same session gives the same bytes.
    forced : bool
        Write the rig of a calibration that was refused too, marked so.

    Returns
    -------
    CalibrationFile
        What `calibration.json` holds; its `has_rig` says whether `rig.toml` was written.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    came = provenance(session, command=command, seed=calibration.seed, when=when)
    file = calibration_file(calibration, came, forced=forced)
    write_text(folder / JSON, file.to_json())
    write_text(folder / HTML, calibration_html(file))
    if file.has_rig:
        rig = calibration.rig
        save_rig(replace(rig, refused=file.message) if file.forced else rig, folder / RIG)
    return file
