"""`planeopt calibrate`: from a folder of board images to `rig.toml`, or to the reason why not."""

import shlex
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass, fields, replace
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.types import NonNegativeInt, PositiveInt

from planeopt.cli.clock import stated_time
from planeopt.cli.files import may_write, output_folder, spare_inputs
from planeopt.cli.messages import exit_status, remark, stages, tables
from planeopt.cli.tables import text_table
from planeopt.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from planeopt.calibration.detection import Detected
    from planeopt.calibration.record import CalibrationFile
    from planeopt.calibration.routine import Options

Tell = Callable[[str, int, int], object]
_NONE = Parameter(negative="")


@Parameter(name="*")
@dataclass(frozen=True)
class Asked:
    """What is left free.

    Parameters
    ----------
    focal
        One focal length or two; auto takes two where the pixels are shown not to be square.
    distortion
        How far up the ladder of distortions; auto frees all five, kept to what lenses do, and tests each.
    warp
        Whether the board may be bowed: two numbers more.
    beam
        Of free direction; parallel to the optical axis, as the paper has it; none calibrates the camera alone.
    corner_weights
        Whether each corner counts by its own measured sigma, or all equally, as in other programs.
    reject
        Whether outliers are left out, by rule; other programs leave none out.
    expect
        NAME=VALUE,TOLERANCE: what is known otherwise, such as f_mm=12,0.2 or radius=6,0.05 (px, mm); may be given many
        times. Images alone cannot show that the board's squares have another size than stated.
    """

    focal: Literal["auto", "shared", "separate"] | None = None
    distortion: Literal["auto", "none", "k1", "k2", "tangential", "k3"] | None = None
    warp: bool | None = None
    beam: Literal["free", "parallel", "none"] | None = None
    corner_weights: Literal["measured", "equal"] | None = None
    reject: bool | None = None
    expect: Annotated[tuple[str, ...], _NONE] = ()

    def over(self, given: "Options") -> "Options":
        """Return options with what was asked for here in the place of what stands there."""
        asked = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "expect"}
        said: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
        if self.expect:
            said["expect"] = {**given.expect, **dict(_expected(text) for text in self.expect)}
        return replace(given, **said)

    def words(self) -> Iterator[str]:
        """Give what was asked for as it is typed."""
        for name in ("focal", "distortion", "beam", "corner_weights"):
            if getattr(self, name) is not None:
                yield from (f"--{name.replace('_', '-')}", getattr(self, name))
        for name in ("warp", "reject"):
            if getattr(self, name) is not None:
                yield f"--{name}" if getattr(self, name) else f"--no-{name}"
        for text in self.expect:
            yield from ("--expect", text)


def _expected(text: str) -> tuple[str, tuple[float, float]]:
    name, equals, numbers = text.partition("=")
    value, comma, tolerance = numbers.partition(",")
    try:
        found = float(value), float(tolerance)
    except ValueError:
        found = None
    if not (name and equals and comma) or found is None or not (isfinite(found[0]) and 0 < found[1] < inf):
        raise InputError(f"--expect must be NAME=VALUE,TOLERANCE, such as radius=6,0.05, not {text!r}")
    return name.strip(), found


_ASKED = Asked()


def calibrate(
    session: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    asked: Asked = _ASKED,
    detections: Path | None = None,
    save_detections: Path | None = None,
    seed: NonNegativeInt | None = None,
    jobs: PositiveInt = 1,
    force: Annotated[bool, _NONE] = False,
) -> int:
    """Calibrate camera and beam from images of a ChArUco board with the spot on it.

    Writes DIR/rig.toml, DIR/calibration.json and DIR/calibration.html. The page says how far the rig can be trusted and
    what to shoot next. A calibration that is refused has no rig.toml, unless it is forced. The same session gives the
    same bytes; a time is noted only where SOURCE_DATE_EPOCH says one.
    Exit status: 0 ok; 2 degraded or refused; 1 the session cannot be used.

    Parameters
    ----------
    session
        A folder with session.toml, or that file; or a calibration.json, which is calculated again without images.
    output
        Folder for the three files.
    asked
        What is left free.
    detections
        Corners that another detector found (.csv: image,id,x_px,y_px,sigma_px), instead of those of the images.
    save_detections
        Write the corners that were found into such a file.
    seed
        Of the held-out check; 0 unless given.
    jobs
        Processes to work in.
    force
        Write into an existing folder, and the rig.toml of a calibration that is refused; the file then says so.
    """
    from planeopt.calibration.detections_file import save_detections as save
    from planeopt.calibration.observed import detected_from_record
    from planeopt.calibration.record import load_record
    from planeopt.calibration.recording import options_from_record
    from planeopt.calibration.routine import Options
    from planeopt.calibration.routine import calibrate as calibrated
    from planeopt.executors import processes
    from planeopt.report.calibration_files import FILES, RIG, write_calibration

    when = stated_time()
    written = [output / name for name in FILES]
    read = [file for file in (session, detections) if file is not None]
    spare_inputs(written if save_detections is None else [*written, save_detections], read)
    if save_detections is not None:
        may_write(save_detections, read, force=force)
    again = load_record(session) if session.suffix.lower() == ".json" and not session.is_dir() else None
    if again is not None and detections is not None:
        raise InputError(f"{session}: holds its corners already; --detections goes with a session")
    options = asked.over(Options() if again is None else options_from_record(again))
    seed = seed if seed is not None else 0 if again is None else again.provenance.seed
    with output_folder(output, force=force) as folder, processes(jobs) as executor, stages() as tell:
        seen = _detected(session, detections, executor, tell) if again is None else detected_from_record(again)
        if save_detections is not None:
            save(seen.observations.views, save_detections)
        found = calibrated(seen, options, seed=seed, progress=tell)
        tell("writing", 0, 1)
        command = _command(session, asked, detections, seed)
        file = write_calibration(found, folder, session=str(session), command=command, when=when, forced=force)
        tell("writing", 1, 1)
    if not file.has_rig and (output / RIG).exists():
        remark(f"{output / RIG}: is of an earlier run and was left as it is; this run gave no rig")
    _show(tables(), file, [output / name for name in FILES if name != RIG or file.has_rig])
    return exit_status([found.verdict])


def _detected(session: Path, detections: Path | None, executor: Executor | None, tell: Tell) -> "Detected":
    from planeopt.calibration.detection import detect
    from planeopt.calibration.session import load_session

    loaded = load_session(session)
    if detections is not None:
        loaded = replace(loaded, detections=detections)
    try:
        return detect(loaded, executor=executor, progress=lambda done, total: tell("detecting", done, total))
    except BrokenExecutor as error:
        raise InputError("a worker process died, for lack of memory perhaps: try fewer --jobs") from error


def _command(session: Path, asked: Asked, detections: Path | None, seed: int) -> str:
    """Return the command that gives the same numbers again; where they go changes nothing in them."""
    words = ["planeopt", "calibrate", str(session), *asked.words()]
    if detections is not None:
        words += ["--detections", str(detections)]
    if seed:
        words += ["--seed", str(seed)]
    return shlex.join(words)


def _show(console: "Console", file: "CalibrationFile", written: list[Path]) -> None:
    """Print what became of the images, the parameters, what was tested, the verdict."""
    from planeopt.report.calibration_terminal import conditions, images, parameters, tests
    from planeopt.report.calibration_words import FORCED

    if file.images:
        console.print(text_table(*images(file)))
    if file.adjustment is not None:
        console.print(text_table(*parameters(file.adjustment)))
        console.print(text_table(*tests(file)))
    if any(gate.state != "ok" for gate in file.gates):
        console.print(text_table(*conditions(file)))
    lines = [f"{file.verdict.upper()}: {file.message}"]
    if file.next_view is not None:
        lines.append(file.next_view.sentence)
    if file.forced:
        lines.append(FORCED)
    lines.append(f"written: {', '.join(map(str, written))}")
    for line in lines:
        console.print(line, soft_wrap=True, highlight=False, markup=False)
