"""How does the time grow with frames, points, views, walkers and workers?

1. **Frames.** Maximum-likelihood planes of many spots at once, and closed forms of many ellipses, a piece each.
2. **Points.** One plane from 25 to 1,600 boundary points, by three routes.
3. **Views.** The joint adjustment of camera, poses, bow and beam.
4. **Walkers.** The log posterior of an ensemble in one call.
5. **Workers.** Poses of images, by processes and by a Dask cluster on this machine, with and without their start.

Times are the best of some rounds, one after the other in this process, wherever other studies are worked on: numbers
that are read off a clock, here alone, and so they differ from run to run.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

from studies.scaling_figure import scaling_figure
from studies.scaling_runs import GrowthRow, TimeRow, growth, run_times
from studies.scaling_summary import finding, headline, numbers
from studies.scaling_workers import WorkerRow, run_workers
from studies.study import Mode, Result, read_rows, rounded


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Time everything here: what the executor does would only disturb."""
    del executor
    return result_of(run_times(mode), run_workers(mode))


def result_of(times: Sequence[TimeRow], workers: Sequence[WorkerRow]) -> Result:
    """Return the tables, the figure and the words of what was timed."""
    times, workers = rounded(times), rounded(workers)
    grown: list[GrowthRow] = growth(times)
    said = numbers(times, grown, workers)
    return Result(
        tables={"times": times, "growth": grown, "workers": workers},
        headline=headline(said),
        finding=finding(times, grown, workers),
        figures={"scaling": scaling_figure(times, grown, workers)},
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_rows(folder / "times.csv", TimeRow), read_rows(folder / "workers.csv", WorkerRow))
