"""`planeopt compare`: every formulation with every solver."""

import sys
from collections.abc import Sequence
from contextlib import nullcontext
from math import isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from planeopt.cli.files import output_folder, spare_inputs, write_csv
from planeopt.cli.messages import complain, exit_status, tables
from planeopt.cli.rigs import load_measuring_rig
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.accuracy import Truth
    from planeopt.comparison import Case
    from planeopt.record import RecordStatus
    from planeopt.rig import Rig
    from planeopt.spot import Spot

FILES = ("comparison.json", "comparison.csv", "summary.csv", "comparison.png")
NOISE_PX, POINTS, SEED = 0.3, 200, 1


def compare(
    *inputs: str,
    rig: Path | None = None,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    method: Annotated[list[str] | None, Parameter(negative="")] = None,
    start: str = "closed-form",
    repeats: int = 1,
    jobs: int = 1,
    dask: str | None = None,
    simulate: int | None = None,
    noise_px: float | None = None,
    points: int | None = None,
    seed: int | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Solve each input by every formulation with every solver, from the same start, and show what each finds and costs.

    With the truth beside an image (same name, .json) errors are shown too, also over the Cramer-Rao bound. Failures
    stay in the tables with their reason. One input: its tables; several: a summary of each method over all. Exit status
    as for pose with its defaults.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]); with --simulate a scene, or nothing.
    rig
        The rig file (rig.toml); with --simulate the scene's own.
    output
        Folder for comparison.json, comparison.csv (a row an input and method), summary.csv, comparison.png.
    method
        Only these: a pair ("LeastSquares + Sqp"), or a formulation with all solvers that suit it; several times.
    start
        Where all searches begin: "closed-form" of each input, the "paper"'s (10, 250, 20, 20), or R,z_L,alpha,beta in
        mm and degrees.
    repeats
        How often each is solved, for the shortest times.
    jobs
        Processes to work in, which disturb each other's times; with --dask local, workers of the cluster.
    dask
        Work on a Dask cluster: the address of its scheduler, or "local" for one of this machine.
    simulate
        In place of files, so many sets of boundary points with known noise, of the planes of a scene (scene.toml), or,
        without one, of the paper's example with pixels of 5 um.
    noise_px
        Standard deviation of simulated points in x and in y; 0.3 unless given.
    points
        Number of simulated points round the spot; 200 unless given.
    seed
        Of the simulated noise; 1 unless given.
    force
        Write into an existing folder.
    """
    from planeopt.executors import workers
    from planeopt.methods import EVERY, methods_named

    if repeats < 1:
        raise InputError(f"--repeats must be at least 1, not {repeats}")
    options: dict[str, Any] = {
        "start": _start(start),
        "methods": EVERY if method is None else methods_named(method),
        "repeats": repeats,
    }
    settings: dict[str, str | int | float | None] = {"start": start, "repeats": repeats}
    if simulate is None:
        given = {"--noise-px": noise_px, "--points": points, "--seed": seed}
        surplus = [name for name, value in given.items() if value is not None]
        if surplus:
            raise InputError(f"{surplus[0]} goes with --simulate N")
        if not inputs:
            raise InputError("there is nothing to compare on: name images or .csv files, or give --simulate N")
        if rig is None:
            raise InputError("images and points need the rig that saw them: --rig RIG")
    elif rig is not None:
        raise InputError("--rig goes with files; --simulate takes the scene's rig, or the paper's")
    if output is not None:
        spare_inputs([output / name for name in FILES], [*inputs, *([] if rig is None else [rig])])
    folder = nullcontext() if output is None else output_folder(output, force=force)
    with folder as place, workers(jobs, dask) as executor:
        options["executor"] = executor
        if simulate is None:
            assert rig is not None  # refused above
            entries = _of_files(inputs, load_measuring_rig(rig), options)
        else:
            kept = POINTS if points is None else points, NOISE_PX if noise_px is None else noise_px
            settings |= {"simulate": simulate, "points": kept[0], "noise_px": kept[1]}
            settings["seed"] = seed = SEED if seed is None else seed
            entries = _of_simulated(inputs, simulate, *kept, seed, options)
        if place is not None:
            _write(place, entries, settings, _name(inputs, simulate))
    return _show(entries)


Entry = tuple["Case", "RecordStatus", str]
"""A case with the status and the message of its input."""


def _start(text: str) -> tuple[float, ...] | None:
    """Return the start that is meant, mm and rad; None for the closed form."""
    from planeopt import paper

    if text == "closed-form":
        return None
    if text == "paper":
        return tuple(paper.START)
    try:
        R, z_L, alpha, beta = (float(part) for part in text.split(","))
    except ValueError as error:
        wanted = "closed-form, paper, or R,z_L,alpha,beta (mm and degrees)"
        raise InputError(f"--start must be {wanted}, not {text!r}") from error
    if not all(map(isfinite, (R, z_L, alpha, beta))) or R <= 0 or z_L <= 0 or abs(alpha) >= 90:
        raise InputError(f"--start needs R and z_L above 0 mm, and alpha below 90 degrees, not {text!r}")
    return R, z_L, radians(alpha), radians(beta)


def _of_files(inputs: Sequence[str], rig: "Rig", options: dict[str, Any]) -> list[Entry]:
    from rich.console import Console
    from rich.progress import track

    from planeopt.comparison import Case, compare_files

    results = compare_files(inputs, rig, **options)
    if len(inputs) > 1 and sys.stderr.isatty():
        results = track(results, "compare", len(inputs), console=Console(stderr=True), transient=True)
    entries: list[Entry] = []
    for result in results:
        record = result.record
        if result.comparison is None:
            case = Case(record.input, message=record.message)
        else:
            (case,) = result.comparison.cases
        entries.append((case, record.status, record.message))
    return entries


def _of_simulated(
    inputs: Sequence[str], count: int, points: int, noise_px: float, seed: int, options: dict[str, Any]
) -> list[Entry]:
    from planeopt.comparison import compare
    from planeopt.comparison.simulated import simulated_spot

    if len(inputs) > 1:
        raise InputError(f"--simulate takes one scene, not {len(inputs)}")
    if count < 1:
        raise InputError(f"--simulate must be at least 1, not {count}")
    if seed < 0:
        raise InputError(f"--seed must not be negative, but is {seed}")
    rig, truths = _simulated_planes(inputs, count)
    spots: list[Spot] = [
        simulated_spot(rig, truth.pose, n=points, noise_px=noise_px, seed=(seed, i)) for i, truth in enumerate(truths)
    ]
    names = [f"simulated {i + 1}" for i in range(count)]
    compared = compare(spots, rig, truth=truths, names=names, **options)
    return [
        (case, "ok", "") if case.message is None else (case, "error", f"{case.name}: {case.message}")
        for case in compared.cases
    ]


def _simulated_planes(inputs: Sequence[str], count: int) -> tuple["Rig", list["Truth"]]:
    """Return the rig and the planes of a scene, drawn from its sweep where it has one; or the paper's."""
    from planeopt.accuracy import Truth
    from planeopt.comparison.simulated import worked_example
    from planeopt.simulation import frame, load_scene

    if not inputs:
        rig, pose = worked_example()
        return rig, [Truth(pose, rig.plane_from_pose(pose))] * count
    scene = load_scene(inputs[0])
    try:
        scenes = [frame(scene, i) for i in range(count)]
    except InputError as error:
        raise InputError(f"{inputs[0]}: {error}") from error
    return scene.rig, [Truth(single.pose, single.true_plane) for single in scenes]


def _name(inputs: Sequence[str], simulate: int | None) -> str:
    """Return what the figure says it is of."""
    several = len(inputs) > 1
    if simulate is None:
        return f"{len(inputs)} inputs" if several else Path(inputs[0]).name
    spots = f"{simulate} simulated spot{'s' if simulate > 1 else ''}"
    return f"{spots} of {Path(inputs[0]).name}" if inputs else f"{spots} of the paper's example"


def _write(folder: Path, entries: Sequence[Entry], settings: dict[str, str | int | float | None], name: str) -> None:
    import msgspec

    from planeopt import __version__
    from planeopt.comparison import Comparison
    from planeopt.comparison.record import comparison_file, flat_rows, flat_summary

    made = comparison_file(entries, __version__, settings)
    (folder / FILES[0]).write_bytes(msgspec.json.format(msgspec.json.encode(made), indent=1) + b"\n")
    write_csv(folder / FILES[1], flat_rows(made))
    write_csv(folder / FILES[2], flat_summary(made))
    cases = tuple(case for case, _, _ in entries)
    if any(case.rows for case in cases):
        from planeopt.report.comparison_figure import comparison_figure

        comparison_figure(Comparison(cases), name).savefig(folder / FILES[3], metadata={"Software": None})


def _show(entries: Sequence[Entry]) -> int:
    from planeopt.cli.comparison_tables import print_case, print_summary
    from planeopt.comparison import summarise

    for case, status, message in entries:
        if not case.rows:
            complain(message if status == "error" else f"{case.name}: {status}: {message}")
    cases = [case for case, _, _ in entries if case.rows]
    console = tables()
    if len(cases) == 1:
        print_case(console, cases[0])
    elif cases:
        print_summary(console, summarise(cases), len(cases))
    return exit_status(status for _, status, _ in entries)
