"""What do the ten equations fix, and what becomes of the plane when they are made slack, elastic or hard?

1. **Rank.** Over rigs and planes: the rank of the laser block (11)-(15), of the image block (17)-(21) and of all ten,
   their conditioning, and where rank is lost: at planes through the camera, with numbers of the rig unknown.
2. **Hard rows.** Of all 31 choices of (11)-(15), and of their independent form: which does IPOPT accept, which fix that
   the spot lies on the beam, and where do searches with them end?
3. **The estimate.** Bias and error over the Cramér-Rao bound of slack with and without weights, L1 slack, and three
   hard image rows by several choices.
4. **A gross error.** With one image coefficient wrong, does the largest slack name its equation?
"""

from concurrent.futures import Executor
from pathlib import Path

from studies.constraints_culprit import culprit_rows
from studies.constraints_estimates import estimate_rows, triple_rows
from studies.constraints_figures import culprits_figure, estimates_figure, ranks_figure, subsets_figure
from studies.constraints_ranks import edge_rows, free_rows, rank_rows
from studies.constraints_subsets import subset_rows
from studies.constraints_summary import Tables, finding, headline, numbers
from studies.study import Mode, Result, named, read_tables, rounded_tables


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the four questions."""
    return result_of(
        Tables(
            rank_rows(mode, executor),
            edge_rows(),
            free_rows(),
            subset_rows(mode, executor),
            estimate_rows(mode, executor),
            triple_rows(mode),
            culprit_rows(mode, executor),
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
            "ranks": ranks_figure(tables, said),
            "subsets": subsets_figure(tables, said),
            "estimates": estimates_figure(tables, said),
            "culprits": culprits_figure(tables, said),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_tables(folder, Tables))
