"""`planeopt check --board`: the rig against new views of a board."""

from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from planeopt.cli.messages import complain, exit_status, tables
from planeopt.cli.tables import table
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.calibration.board_record import BoardCheckRecord
    from planeopt.calibration.session import Session
    from planeopt.rig import Rig

SpotChoice = Literal["disc", "ring", "none"]

_VIEWS = [
    ("corners", "corners", "d"),
    ("rms px", "rms_px", ".3f"),
    ("chi-squared", "chi2", ".2f"),
    ("dof", "dof", "d"),
    ("p", "p_value", ".2g"),
    ("spot: chi-squared", "spot_chi2", ".2f"),
    ("p", "spot_p_value", ".2g"),
]
_TESTS = [("chi-squared", "chi2", ".3f"), ("degrees of freedom", "dof", ".1f"), ("p", "p_value", ".2g")]
_PARAMETERS = [
    ("before", "before", ".7g"),
    ("sigma", "sigma_before", ".2g"),
    ("updated", "after", ".7g"),
    ("sigma", "sigma_after", ".2g"),
    ("sigmas", "sigmas", "+.1f"),
    ("found from", "found_from", ".2g"),
]


def is_session(inputs: Sequence[str]) -> bool:
    """Return whether the only input is a session: a folder with `session.toml`, or that file."""
    return len(inputs) == 1 and (Path(inputs[0]).is_dir() or Path(inputs[0]).name == "session.toml")


def check_board(
    inputs: Sequence[str],
    rig: "Rig",
    rig_name: str,
    *,
    board: Path | None,
    spot: SpotChoice | None,
    bow_mm: float,
    dark: Path | None,
    jobs: int,
) -> tuple["BoardCheckRecord", int]:
    """Detect, test, print, and return the record with the exit status.

    Raises
    ------
    InputError
        If an input cannot be used.
    """
    from planeopt.calibration.board_record import check_detected
    from planeopt.calibration.detection import detect
    from planeopt.executors import processes

    session = _session(inputs, rig, board=board, spot=spot, dark=dark)
    try:
        with processes(jobs) as executor:
            detected = detect(session, executor=executor)
    except BrokenExecutor as error:
        raise InputError("a worker process died, for lack of memory perhaps: try fewer --jobs") from error
    record = check_detected(detected, rig, rig_name, bow_mm=bow_mm)
    for image in detected.images:
        if image.status == "refused":
            complain(f"{image.name}: {image.reason}")
    _show(record)
    return record, exit_status([record.status, *(image.status for image in detected.images)])


def _session(
    inputs: Sequence[str], rig: "Rig", *, board: Path | None, spot: SpotChoice | None, dark: Path | None
) -> "Session":
    from planeopt.board import load_board
    from planeopt.calibration.session import Session, load_session

    if is_session(inputs):
        if board is not None or dark is not None or spot is not None:
            raise InputError(f"{inputs[0]}: a session says itself what --board, --spot and --dark would")
        return load_session(inputs[0])
    if board is None:
        raise InputError("images of a board need --board board.toml")
    images = tuple(Path(name) for name in inputs)
    kind: SpotChoice = "none" if rig.beam is None else "disc"
    if rig.beam is not None and rig.spot is not None and rig.spot.kind == "ring":
        kind = "ring"
    dark_images = () if dark is None else (dark,) * len(images)
    return Session(
        folder=Path(),
        board=load_board(board),
        images=images,
        spot=kind if spot is None else spot,
        pixel_pitch_mm=rig.camera.pixel_pitch_mm,
        dark_images=dark_images,
    )


def _show(record: "BoardCheckRecord") -> None:
    values = record.to_dict()
    console = tables()
    views: list[dict[str, Any]] = [row | {"image": Path(row["input"]).name} for row in values["images"]]
    words = [("status", "status"), ("spot", "spot")]
    console.print(table("each view", "image", views, _VIEWS, words=words))
    if values["tests"]:
        verdicts = [row | {"verdict": "ok" if row["ok"] else "not explained by chance"} for row in values["tests"]]
        console.print(table("all views", "part", verdicts, _TESTS, words=[("verdict", "verdict")]))
    if values["parameters"]:
        title = "the rig file, updated by these views with its covariance as prior"
        console.print(table(title, "name", values["parameters"], _PARAMETERS, words=[("unit", "unit")]))
    for sentence in (record.message, record.untested):
        console.print(sentence, markup=False, emoji=False, highlight=False, soft_wrap=True)
