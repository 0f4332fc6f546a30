"""`planeopt pose`: one record a line."""

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from planeopt.cli.files import record_file, spare_what_is_read
from planeopt.cli.messages import exit_status, one_line
from planeopt.cli.rigs import load_measuring_rig
from planeopt.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from planeopt.record import PoseRecord


def pose(
    *inputs: Annotated[str, Parameter(required=True)],
    rig: Path,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    jobs: int = 1,
    resume: Annotated[bool, Parameter(negative="")] = False,
    formulation: str | None = None,
    solver: str | None = None,
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
    force
        Overwrite the output file.
    """
    from planeopt.batch import measure_many
    from planeopt.executors import processes
    from planeopt.methods import method_named

    if jobs < 1:
        raise InputError(f"--jobs must be at least 1, not {jobs}")
    method = method_named(formulation, solver)
    loaded = load_measuring_rig(rig)
    if output is not None:
        spare_what_is_read(output, (*inputs, rig))
    records = _sink(output, inputs, method.formulation.name, resume=resume, force=force)
    with records as (kept, write), processes(jobs) as executor:
        new = measure_many(
            inputs[len(kept) :], loaded, formulation=method.formulation, solver=method.solver, executor=executor
        )
        try:
            return _report(chain(kept, _written(new, write)), len(inputs), quiet=output is None and sys.stdout.isatty())
        except BrokenExecutor as error:
            hint = f"; {output}.part holds the finished records, --resume continues" if output is not None else ""
            raise InputError(f"a worker process died, for lack of memory perhaps: try fewer --jobs{hint}") from error


def _written(records: Iterator["PoseRecord"], write: Callable[["PoseRecord"], None]) -> Iterator["PoseRecord"]:
    for record in records:
        write(record)
        yield record


def _report(records: Iterator["PoseRecord"], total: int, *, quiet: bool) -> int:
    """Show progress where someone watches, say what is wrong with which input, and return the exit status."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    counts: Counter[str] = Counter()
    last = None
    # Standard output is the records': rich would send it through the console of standard error.
    with Progress(
        console=console,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
        disable=quiet or not console.is_terminal,
    ) as progress:
        task = progress.add_task("pose", total=total)
        for last in records:
            counts[last.status] += 1
            if last.status == "error":
                _say(console, last.message)
            progress.advance(task)
    if last is not None and (counts["degraded"] or counts["refused"]):
        tally = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
        alone = f"{last.input}: {last.status}: {last.message}"
        _say(console, alone if total == 1 else f"{total} inputs: {tally}; each record's message says why")
    return exit_status(counts)


def _say(console: "Console", message: str) -> None:
    console.print(one_line(message), markup=False, emoji=False, highlight=False, soft_wrap=True)


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
