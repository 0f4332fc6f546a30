"""`planeopt recalibrate`: the rig updated in the field, from images of unknown planes."""

from collections.abc import Iterable, Iterator
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.types import NonNegativeFloat, PositiveInt

from planeopt.cli.files import may_write
from planeopt.cli.messages import exit_status, report, tables
from planeopt.cli.rigs import load_measuring_rig
from planeopt.cli.tables import table
from planeopt.cli.times import read_times
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.batch import Measurement
    from planeopt.calibration.recalibration_record import RecalibrationRecord

_UPDATED = [
    ("before", "before", ".7g"),
    ("sigma", "sigma_before", ".2g"),
    ("after", "after", ".7g"),
    ("sigma", "sigma_after", ".2g"),
    ("change", "change", "+.3g"),
    ("sigmas", "sigmas", ".1f"),
]
_TESTS = [("chi-squared", "chi2", ".3f"), ("degrees of freedom", "dof", "d"), ("p", "p_value", ".2g")]


def recalibrate(
    *inputs: Annotated[str, Parameter(required=True)],
    rig: Path,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    record: Path | None = None,
    moved_mm: NonNegativeFloat = 1.0,
    turned_mrad: NonNegativeFloat = 10.0,
    sigma: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    times: Path | None = None,
    dark: Path | None = None,
    jobs: PositiveInt = 1,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Update the beam's direction and its offset over its radius by images of the spot on any planes.

    The old calibration is the prior; what no image of a plane can tell (focal length, scale, ...) stays as it was.
    Nothing is written where the beam moved while the images were taken, or too few can be used.
    Exit status: 0 updated; 2 refused, or an image is refused; 1 some input cannot be used.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]), 5 or more, at different distances and tilts.
    rig
        The rig file (rig.toml), with its covariance.
    output
        The new rig file.
    record
        File for the record (JSON).
    moved_mm
        How far the beam's offset may have moved since the calibration: standard deviation of each component.
    turned_mrad
        How far its direction may have turned, likewise. With 0 for both the images only add to the calibration.
    sigma
        NAME=VALUE, for a rig file without a covariance: a standard deviation (px, mm, 1) of f, cx, cy, radius, ...; may
        be given many times.
    times
        A table image,time_s (.csv): against what a trend is sought. Unless given, the numbers in the images' names, or
        their order.
    dark
        An image of the same view with the laser off, to be subtracted from each image.
    jobs
        Processes to work in.
    force
        Overwrite the output files.
    """
    from planeopt.batch import Search, measure
    from planeopt.calibration.recalibration import Moves, with_stated_sigmas
    from planeopt.calibration.recalibration_record import recalibrate_measured
    from planeopt.estimation.sequence import Positions
    from planeopt.executors import ordered_map, processes
    from planeopt.rig import save_rig
    from planeopt.spot import read_image
    from planeopt.whole_files import write_text

    loaded = load_measuring_rig(rig)
    stated = _stated(sigma)
    if stated:
        loaded = with_stated_sigmas(loaded, stated)
    if loaded.covariance is None:
        raise InputError(
            f"{rig}: has no [covariance]: an update has to know how well camera and radius are known. Calibrate with a "
            "board, or state it: --sigma f=2 --sigma cx=1 --sigma cy=1 --sigma radius=0.01"
        )
    written = [output] if record is None else [output, record]
    for number, path in enumerate(written):
        read = (file for file in (rig, times, dark) if file is not None)
        may_write(path, [*inputs, *read, *written[:number]], force=force)
    positions = Positions.of_names(inputs) if times is None else read_times(times, inputs)
    search = Search(dark=None if dark is None else read_image(dark))
    measured: list[Measurement] = []
    with processes(jobs) as executor:
        images = ordered_map(partial(measure, rig=loaded, search=search), inputs, executor)
        try:
            status = report(_kept(images, measured), len(inputs), "recalibrate")
        except BrokenExecutor as error:
            raise InputError("a worker process died, for lack of memory perhaps: try fewer --jobs") from error
    moves = Moves(moved_mm, 1e-3 * turned_mrad)
    found, result = recalibrate_measured(measured, loaded, positions, str(rig), moves)
    if record is not None:
        write_text(record, found.to_json())
    if result.ok:
        save_rig(result.rig, output)
    _show(found)
    return max(status, exit_status([found.status]), key=(0, 2, 1).index)


def _stated(texts: tuple[str, ...]) -> dict[str, float]:
    stated: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            stated[name.strip()] = float(value)
        except ValueError:
            raise InputError(f"--sigma {text}: give NAME=VALUE, cx=1 for example") from None
    return stated


@dataclass(frozen=True)
class _Line:
    """What the progress and the messages need of a measurement."""

    input: str
    status: str
    message: str


def _kept(images: Iterable["Measurement"], kept: list["Measurement"]) -> Iterator[_Line]:
    for image in images:
        kept.append(image)
        status = image.record.status
        # That an image contradicts the old rig is what an update is for.
        yield _Line(image.record.input, "ok" if status == "degraded" else status, image.record.message)


def _show(record: "RecalibrationRecord") -> None:
    """Print what was tested, what changed, and the verdict."""
    values = record.to_dict()
    console = tables()
    if values["tests"]:
        verdicts = [row | {"verdict": "ok" if row["ok"] else "not explained by chance"} for row in values["tests"]]
        console.print(table("the images at the new rig", "part", verdicts, _TESTS, words=[("verdict", "verdict")]))
    for title, key in (("what images see", "seen"), ("the rig", "parameters")):
        if values[key]:
            console.print(table(title, "name", values[key], _UPDATED, words=[("unit", "unit")]))
    if record.chi2_before is not None and record.chi2_after is not None:
        console.print(
            f"chi-squared of {record.dof} misfits: {record.chi2_before:.4g} with the old rig and its covariance, "
            f"{record.chi2_after:.4g} with the new rig as it stands.",
            highlight=False,
            soft_wrap=True,
        )
    for sentence in (record.message, record.kept):
        console.print(sentence, markup=False, emoji=False, highlight=False, soft_wrap=True)
