"""Can the paper's worked example be reproduced, and what of it is a misprint?

1. **Reproduction.** Do Table 1 and the paper's start give the stated solution, by each method, to within what the
   rounding of Table 1 allows? Where do searches without the visibility inequality end?
2. **Chance.** From other tables that round to the same accuracy, does each method end on the same plane?
3. **Misprints.** For each: which number does the corrected reading give, and which the printed one, where one of them
   must come out?
4. **Consequences.** Which plane comes out where a misprint is left in the ten equations?
"""

from concurrent.futures import Executor
from pathlib import Path

from planeopt.reproduction.results import compute
from studies import paper_rows as rows
from studies.paper_figures import misprints_figure, repeats_figure, reproduction_figure
from studies.paper_readings import read_all
from studies.paper_repeats import repeat
from studies.paper_rows import Tables
from studies.paper_summary import finding, headline, numbers
from studies.study import Mode, Result, named, read_tables, rounded_tables


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the four questions; the modes differ in the second only."""
    found = compute()
    return result_of(
        Tables(
            rows.table_1_rows(),
            rows.table_2_rows(found),
            rows.answer_rows(found),
            rows.search_rows(found),
            repeat(mode, executor),
            rows.rank_rows(found),
            rows.misprint_rows(),
            read_all(executor),
        )
    )


def result_of(tables: Tables) -> Result:
    """Draw and put into words what was found."""
    tables = rounded_tables(tables)
    said = numbers(tables)
    return Result(
        tables=named(tables),
        headline=headline(said),
        finding=finding(tables, said),
        figures={
            "reproduction": reproduction_figure(tables, said),
            "repeats": repeats_figure(tables, said),
            "misprints": misprints_figure(tables, said),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_tables(folder, Tables))
