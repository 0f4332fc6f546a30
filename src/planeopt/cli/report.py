"""`planeopt report`: poses with their posteriors, as a page, on paper and as JSON."""

import math
import shlex
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.types import NonNegativeInt, PositiveFloat, PositiveInt

from planeopt.cli.clock import now
from planeopt.cli.files import output_folder, spare_inputs
from planeopt.cli.messages import doing, tables
from planeopt.cli.messages import report as go_through
from planeopt.cli.rigs import load_measuring_rig
from planeopt.cli.tables import table
from planeopt.cli.times import read_times
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.report.examine import Examined
    from planeopt.report.record import ReportFile

_Switch = Annotated[bool, Parameter(negative="")]


def report(
    *inputs: Annotated[str, Parameter(required=True)],
    rig: Path,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    seed: NonNegativeInt = 0,
    draws: PositiveInt = 2000,
    posterior: bool = True,
    condition_on_rig: _Switch = False,
    robust: PositiveFloat | None = None,
    both_sides: _Switch = False,
    combine: _Switch = False,
    sequence: _Switch = False,
    times: Path | None = None,
    dark: Path | None = None,
    jobs: PositiveInt = 1,
    dask: str | None = None,
    force: _Switch = False,
) -> int:
    """Measure the plane in each input and report on it: DIR/report.html, DIR/report.pdf, DIR/poses.json.

    The page holds, for each input, the boundary on the image, the plane in space, the posterior with its intervals, and
    all formulations side by side; before them, for several inputs, what they say together. The time it notes is that of
    SOURCE_DATE_EPOCH where this is set. Exit status: 0 all ok; 2 some degraded or refused; 1 some input cannot be used.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]).
    rig
        The rig file (rig.toml).
    output
        Folder for the three files.
    seed
        Of the sampler.
    draws
        Effective draws of each posterior.
    posterior
        Whether to sample posteriors; without them all uncertainties are of first order.
    condition_on_rig
        Take the rig's numbers as exact, whatever covariance its file has.
    robust
        Degrees of freedom of Student's t for the points, 4 for example: gross errors then sway the posterior little.
    both_sides
        The plane may be seen from behind, as a translucent screen can be.
    combine
        All inputs show one plane, camera and plane still: combine them.
    sequence
        The inputs, in the order given, are a sequence: look for trends along the numbers in their names.
    times
        A table of when they were taken, with the header image,time_s: for trends along time instead.
    dark
        An image of the same view with the laser off, to be subtracted from each image.
    jobs
        Processes to work in; with --dask local, workers of the cluster.
    dask
        Work on a Dask cluster: the address of its scheduler, or "local" for one of this machine.
    force
        Write into an existing folder.
    """
    from planeopt.batch import Search
    from planeopt.estimation.sequence import Positions
    from planeopt.executors import workers
    from planeopt.report.build import FILES, assemble
    from planeopt.report.examine import Options, examine_many
    from planeopt.report.provenance import provenance
    from planeopt.spot import read_image

    if robust is not None and not math.isfinite(robust):
        raise InputError(f"--robust must be a finite number of degrees of freedom, not {robust}")
    when = now()
    loaded = load_measuring_rig(rig)
    read = [*inputs, rig, *(file for file in (dark, times) if file is not None)]
    spare_inputs((output / name for name in FILES), read)
    positions = Positions.of_names(inputs) if sequence else None
    if times is not None:
        positions = read_times(times, inputs)
    options = Options(
        seed=seed,
        draws=draws if posterior else None,
        robust=robust,
        condition_on_rig=condition_on_rig,
        both_sides=both_sides,
        search=Search(dark=None if dark is None else read_image(dark)),
    )
    flags = {
        "--no-posterior": not posterior,
        "--condition-on-rig": condition_on_rig,
        "--both-sides": both_sides,
        "--combine": combine,
        "--sequence": sequence,
    }
    values = {
        "--seed": seed,
        "--draws": draws if posterior else None,
        "--robust": robust,
        "--times": times,
        "--dark": dark,
    }
    command = _command(inputs, {"--rig": rig, "-o": output, **values}, flags)
    came = provenance(rig, command=command, seed=seed, when=when)
    with output_folder(output, force=force) as folder:
        examined: list[Examined] = []
        with ExitStack() as opened:
            with doing("starting workers"):
                executor = opened.enter_context(workers(jobs, dask))
            found = kept_as_they_come(examine_many(inputs, loaded, options, executor=executor), examined)
            status = go_through(found, len(inputs), "report")
        made = assemble(examined, loaded, came, options, combined=combine, positions=positions)
        made.write(folder)
    _show(made.file, output)
    return status


def _show(file: "ReportFile", output: Path) -> None:
    """Print a row an input, and where the report is."""
    from planeopt.report.build import FILES

    rows = [_row(record) for record in file.to_dict()["records"]]
    columns = [(title, key, style) for title, key, style in _COLUMNS if any(row[key] is not None for row in rows)]
    console = tables()
    console.print(table("poses", "input", rows, columns, words=[("status", "status")]))
    written = ", ".join(str(output / name) for name in FILES)
    console.print(f"written: {written}", soft_wrap=True, highlight=False, markup=False)


_COLUMNS = [
    ("z_L mm", "z_L_mm", ".4f"),
    ("sigma", "sigma_z_L_mm", ".4f"),
    ("alpha deg", "alpha_deg", ".3f"),
    ("sigma", "sigma_alpha_deg", ".3f"),
    ("beta deg", "beta_deg", ".3f"),
    ("sigma", "sigma_beta_deg", ".3f"),
    ("chi2", "chi2", ".2f"),
    ("p", "p_value", ".3f"),
]


def _row(record: dict[str, Any]) -> dict[str, Any]:
    """Return what the table shows of a record: the posterior's median and half its 68 % interval, where it has one."""
    row = {**record, "input": Path(record["input"]).name}
    for name in ("z_L_mm", "alpha_deg", "beta_deg"):
        interval = None if record["posterior"] is None else record["posterior"][name]
        row[f"sigma_{name}"] = record["sigma"][name]
        if interval is not None:
            width = interval["high68"] - interval["low68"]
            row[name] = interval["median"]
            # A direction's low end is the larger number across 180 deg.
            row[f"sigma_{name}"] = (width if width >= 0 else width + 360) / 2
    return row


def _command(inputs: Sequence[str], values: dict[str, object], flags: dict[str, bool]) -> str:
    """Return the command that gives the same report again; what changes nothing in it is left out."""
    words = ["planeopt", "report", *inputs]
    for name, value in values.items():
        if value is not None:
            words += [name, str(value)]
    return shlex.join([*words, *(name for name, given in flags.items() if given)])


def kept_as_they_come(found: Iterator["Examined"], kept: list["Examined"]) -> Iterator["Examined"]:
    """Pass on what was examined and keep it; an interrupt of the sampler ends the command."""
    for one in found:
        posterior = one.record.posterior
        if posterior is not None and posterior.diagnostics.stopped == "interrupted":
            # The sampler returns what it has; the user wanted the command to end.
            raise KeyboardInterrupt
        kept.append(one)
        yield one
