"""`planeopt check`: whether the rig is still as calibrated."""

from collections.abc import Iterable, Iterator
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.types import PositiveFloat, PositiveInt

from planeopt.cli.check_board import SpotChoice, check_board, is_session
from planeopt.cli.files import may_write
from planeopt.cli.messages import exit_status, report, tables
from planeopt.cli.rigs import load_measuring_rig
from planeopt.cli.tables import table
from planeopt.cli.times import read_times
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.check import CheckRecord, Tested

_IMAGES = [("z_L mm", "z_L_mm", ".4f"), ("chi-squared", "chi2", ".3f"), ("p", "p_value", ".2g")]
_TESTS = [("chi-squared", "chi2", ".3f"), ("degrees of freedom", "dof", "d"), ("p", "p_value", ".2g")]
_CHANGES = [("change", "value", "+.4f"), ("sigma", "sigma", ".4f")]


def check(
    *inputs: Annotated[str, Parameter(required=True)],
    rig: Path,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    board: Path | None = None,
    spot: SpotChoice | None = None,
    bow_mm: PositiveFloat = 0.2,
    times: Path | None = None,
    dark: Path | None = None,
    jobs: PositiveInt = 1,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Test whether the rig is still as calibrated, with images of the spot on any planes: OK or DEGRADED, and why.

    Each image leaves two numbers that no plane explains; more images at different distances test more. With images of a
    board (--board, or a session) the lens, the radius and the scale are tested too.
    Exit status: 0 OK; 2 DEGRADED, or an image is refused; 1 some input cannot be used.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]); or a session (a folder with session.toml).
    rig
        The rig file (rig.toml), with its covariance if it has one.
    output
        File for the record (JSON).
    board
        The board file (board.toml), where the images are of a board.
    spot
        What the laser draws on the board, where that differs from the rig's: disc, ring or none.
    bow_mm
        How far the board's middle may lie off its edges: standard deviation.
    times
        A table image,time_s (.csv): against what a trend is sought. Unless given, the numbers in the images' names, or
        their order.
    dark
        An image of the same view with the laser off, to be subtracted from each image.
    jobs
        Processes to work in.
    force
        Overwrite the output file.
    """
    from planeopt.batch import Search
    from planeopt.check import check as check_rig
    from planeopt.check import measure_for_check
    from planeopt.estimation.sequence import Positions
    from planeopt.executors import processes
    from planeopt.rig import load_rig
    from planeopt.spot import read_image
    from planeopt.whole_files import write_text

    of_board = board is not None or is_session(inputs)
    loaded = load_rig(rig) if of_board else load_measuring_rig(rig)
    if output is not None:
        may_write(output, [*inputs, *(file for file in (rig, board, times, dark) if file is not None)], force=force)
    if of_board:
        if times is not None:
            raise InputError("--times goes with images of planes: views of a board are tested for no trend")
        found, status = check_board(
            inputs, loaded, str(rig), board=board, spot=spot, bow_mm=bow_mm, dark=dark, jobs=jobs
        )
        if output is not None:
            write_text(output, found.to_json())
        return status
    if spot is not None:
        raise InputError("--spot goes with images of a board: give --board board.toml")
    positions = Positions.of_names(inputs) if times is None else read_times(times, inputs)
    search = Search(dark=None if dark is None else read_image(dark))
    tested: list[Tested] = []
    with processes(jobs) as executor:
        images = measure_for_check(inputs, loaded, search=search, executor=executor)
        try:
            status = report(_kept(images, tested), len(inputs), "check")
        except BrokenExecutor as error:
            raise InputError("a worker process died, for lack of memory perhaps: try fewer --jobs") from error
    record = check_rig(tested, loaded, positions, str(rig))
    if output is not None:
        write_text(output, record.to_json())
    _show(record)
    return max(status, exit_status([record.status]), key=(0, 2, 1).index)


def _kept(images: Iterable["Tested"], kept: list["Tested"]) -> Iterator["Tested"]:
    for image in images:
        kept.append(image)
        yield image


def _show(record: "CheckRecord") -> None:
    """Print what was tested, a table each, and the verdict."""
    values = record.to_dict()
    console = tables()
    images: list[dict[str, Any]] = [row | {"image": Path(row["input"]).name} for row in values["images"]]
    console.print(table("each image, 2 degrees of freedom", "image", images, _IMAGES, words=[("status", "status")]))
    if values["tests"]:
        verdicts = [row | {"verdict": "ok" if row["ok"] else "not explained by chance"} for row in values["tests"]]
        console.print(table("all images", "part", verdicts, _TESTS, words=[("verdict", "verdict")]))
    for title, key in (("the beam minus the rig file", "shift"), ("from the first image to the last", "trend")):
        if values[key]:
            console.print(table(title, "name", values[key], _CHANGES, words=[("unit", "unit")]))
    for sentence in (record.message, record.untested):
        console.print(sentence, markup=False, emoji=False, highlight=False, soft_wrap=True)
