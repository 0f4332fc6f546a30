"""`planeopt pose`: one record a line."""

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from planeopt.cli.files import names_in, spare_what_is_read
from planeopt.cli.messages import doing, remark, report
from planeopt.cli.record_files import Kept, check_kept, kept_records, may_begin, record_file
from planeopt.cli.rigs import load_measuring_rig
from planeopt.errors import InputError
from planeopt.whole_files import place_of

if TYPE_CHECKING:
    from planeopt.record import PoseRecord


def pose(
    *inputs: str,
    rig: Path,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    inputs_from: Annotated[Path | None, Parameter(allow_leading_hyphen=True)] = None,
    jobs: int = 1,
    dask: str | None = None,
    resume: Annotated[bool, Parameter(negative="")] = False,
    formulation: str | None = None,
    solver: str | None = None,
    dark: Path | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Measure the plane in each input: one JSON record a line, in input order.

    Records are written as they come, and few are held: there may be any number of inputs. Exit status: 0 all ok; 2 some
    degraded or refused; 1 some input cannot be used.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]).
    rig
        The rig file (rig.toml).
    output
        File for the records (JSON lines); standard output unless given.
    inputs_from
        A file that lists inputs, one a line, "-" for standard input: more of them than a command line takes.
    jobs
        Processes to work in; with --dask local, workers of the cluster.
    dask
        Work on a Dask cluster: the address of its scheduler, or "local" for one of this machine.
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
    from planeopt.executors import workers
    from planeopt.methods import method_named
    from planeopt.spot import read_image

    names = [*inputs, *(() if inputs_from is None else names_in(inputs_from))]
    if not names:
        raise InputError("there is nothing to measure: name inputs, or a file that lists them with --inputs-from")
    method = method_named(formulation, solver)
    loaded = load_measuring_rig(rig)
    if output is None and resume:
        raise InputError("--resume needs the output file to continue: -o FILE.jsonl")
    kept = None
    if output is not None:
        spare_what_is_read(output, (*names, rig, *(file for file in (dark, inputs_from) if file is not None)))
        output = place_of(output)
        may_begin(output, resume=resume, force=force)
        kept = kept_records(output, names, method.formulation.name) if resume else None
    search = Search(dark=None if dark is None else read_image(dark))
    with ExitStack() as opened:
        with doing("starting workers"):
            executor = opened.enter_context(workers(jobs, dask))
        measure = partial(
            measure_many,
            rig=loaded,
            formulation=method.formulation,
            solver=method.solver,
            search=search,
            executor=executor,
        )
        if kept is not None:
            with doing("looking whether rig and options are those of the records kept"):
                if not check_kept(kept, measure):
                    remark(f"{kept.source}: its inputs are gone; that rig and options are the same was not checked")
        write = opened.enter_context(_sink(output, kept, force=force))
        before, done = (iter(()), 0) if kept is None else (kept.records(), kept.count)
        new = _written(measure(names[done:]), write)
        try:
            quiet = output is None and sys.stdout.isatty()
            return report(new, len(names), "pose", kept=before, quiet=quiet)
        except BrokenExecutor as error:
            hint = "" if output is None else f"; {output}.part holds the finished records, --resume continues"
            raise InputError(f"{error}{hint}") from error


def _written(records: Iterator["PoseRecord"], write: Callable[["PoseRecord"], None]) -> Iterator["PoseRecord"]:
    for record in records:
        write(record)
        yield record


@contextmanager
def _sink(output: Path | None, kept: Kept | None, *, force: bool) -> Iterator[Callable[["PoseRecord"], None]]:
    if output is not None:
        with record_file(output, kept, force=force) as write:
            yield write
        return

    yield _print


def _print(record: "PoseRecord") -> None:
    sys.stdout.write(f"{record.to_json()}\n")
    sys.stdout.flush()
