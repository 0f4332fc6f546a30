"""`planeopt pose`: one record a line."""

import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from planeopt.cli.files import record_file, spare_what_is_read
from planeopt.cli.messages import report
from planeopt.cli.rigs import load_measuring_rig
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.record import PoseRecord


def pose(
    *inputs: Annotated[str, Parameter(required=True)],
    rig: Path,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    jobs: int = 1,
    resume: Annotated[bool, Parameter(negative="")] = False,
    formulation: str | None = None,
    solver: str | None = None,
    dark: Path | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Measure the plane in each input: one JSON record a line, in input order.

    Exit status: 0 all ok; 2 some degraded or refused; 1 some input cannot be used.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]).
    rig
        The rig file (rig.toml).
    output
        File for the records (JSON lines); standard output unless given.
    jobs
        Processes to work in.
    resume
        Keep the records that an interrupted run of the same command left, and go on.
    formulation
        Constrained unless given; "planeopt compare" lists them.
    solver
        Ipopt, Sqp or Swift; the formulation's usual one unless given.
    dark
        An image of the same view with the laser off, to be subtracted from each image.
    force
        Overwrite the output file.
    """
    from planeopt.batch import Search, measure_many
    from planeopt.executors import processes
    from planeopt.methods import method_named
    from planeopt.spot import read_image

    if jobs < 1:
        raise InputError(f"--jobs must be at least 1, not {jobs}")
    method = method_named(formulation, solver)
    loaded = load_measuring_rig(rig)
    if output is not None:
        spare_what_is_read(output, (*inputs, rig, *(() if dark is None else (dark,))))
    search = Search(dark=None if dark is None else read_image(dark))
    records = _sink(output, inputs, method.formulation.name, resume=resume, force=force)
    with records as (kept, write), processes(jobs) as executor:
        new = measure_many(
            inputs[len(kept) :],
            loaded,
            formulation=method.formulation,
            solver=method.solver,
            search=search,
            executor=executor,
        )
        try:
            everything = chain(kept, _written(new, write))
            return report(everything, len(inputs), "pose", quiet=output is None and sys.stdout.isatty())
        except BrokenExecutor as error:
            hint = f"; {output}.part holds the finished records, --resume continues" if output is not None else ""
            raise InputError(f"a worker process died, for lack of memory perhaps: try fewer --jobs{hint}") from error


def _written(records: Iterator["PoseRecord"], write: Callable[["PoseRecord"], None]) -> Iterator["PoseRecord"]:
    for record in records:
        write(record)
        yield record


@contextmanager
def _sink(
    output: Path | None, inputs: Sequence[str], formulation: str, *, resume: bool, force: bool
) -> Iterator[tuple[list["PoseRecord"], Callable[["PoseRecord"], None]]]:
    if output is not None:
        with record_file(output, inputs, formulation, resume=resume, force=force) as opened:
            yield opened
        return
    if resume:
        raise InputError("--resume needs the output file to continue: -o FILE.jsonl")

    def write(record: "PoseRecord") -> None:
        sys.stdout.write(f"{record.to_json()}\n")
        sys.stdout.flush()

    yield [], write
