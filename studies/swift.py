"""What does the rising weight of SWIFT do, in both readings of its penalty function (29)?

1. **The weight.** With J = 0 and all ten equations penalised, as printed: does it move the minimiser? With the image
   block as the objective and the laser block penalised: how fast does the beam's equation come to hold, and what does
   it do to the error?
2. **Schedules.** A constant weight, a fast, a geometric and a slow one, from light and heavy beginnings: where do they
   end, after how many evaluations, beside IPOPT and SQP on the same programme from the same start?
3. **Accuracy.** How do the distances to the minimiser and to the truth fall with the work?

All searches of a problem have the same start, bounds, sizes of unknowns and compiled functions.
"""

from concurrent.futures import Executor
from pathlib import Path

from studies.study import Mode, Result, named, read_tables, rounded, rounded_tables
from studies.swift_figures import paths_figure, schedules_figure, weights_figure, work_figure
from studies.swift_paths import accuracies, paths, valley
from studies.swift_runs import run_all
from studies.swift_summary import Tables, ends_of, finding, headline, numbers, reached
from studies.swift_weights import tolerances, weigh


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the three questions."""
    runs, work = rounded(run_all(mode, executor)), rounded(accuracies(mode, executor))
    weights, ended = weigh(mode, executor), tolerances(mode, executor)
    return result_of(Tables(runs, ends_of(runs), weights, ended, work, reached(work), paths(), valley(mode)))


def result_of(tables: Tables) -> Result:
    """Draw and put into words what was found."""
    tables = rounded_tables(tables)
    said = numbers(tables)
    return Result(
        tables=named(tables),
        headline=headline(said),
        finding=finding(tables, said),
        figures={
            "weights": weights_figure(tables, said),
            "schedules": schedules_figure(tables, said),
            "work": work_figure(tables, said),
            "paths": paths_figure(tables, said),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_tables(folder, Tables))
