"""Where does each search end: on the plane, on the plane behind it, elsewhere, or nowhere?

The ten equations have two exact solutions; an opaque plane shows only the one whose lit side faces the camera.

1. **The paper's worked example.** From grids of starts over `(alpha, beta)` and `(z_L, alpha)` through the paper's own,
   and from random starts: where does each formulation with each solver end, with and without the inequality `c > 0`?
   What does the mild first stage of `Constrained` do?
2. **Random rigs and planes.** Over ten thousand of them, with noise: does a search with the inequality, from the closed
   form, ever end on the plane behind? How often does one without it, from a random start?
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

from studies.basins_example import EndRow, run_example
from studies.basins_figures import depths_figure, shares_figure, tilts_figure
from studies.basins_finding import finding, headline
from studies.basins_rigs import RigRow, run_rigs
from studies.basins_summary import example_shares, rig_shares
from studies.study import Mode, Result, read_rows, rounded


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer both questions."""
    return result_of(run_example(mode, executor), run_rigs(mode, executor))


def result_of(ends: Sequence[EndRow], rigs: Sequence[RigRow]) -> Result:
    """Count, draw and put into words what was searched."""
    ends, rigs = rounded(ends), rounded(rigs)
    shares, of_rigs = example_shares(ends), rig_shares(rigs)
    said, numbers = headline(ends, shares, of_rigs)
    return Result(
        tables={"ends": ends, "shares": shares, "rigs": rigs, "rig_shares": of_rigs},
        headline=said,
        finding=finding(ends, shares, rigs, of_rigs),
        figures={
            "tilts": tilts_figure(ends),
            "depths": depths_figure(ends),
            "shares": shares_figure(shares, of_rigs),
        },
        numbers=numbers,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_rows(folder / "ends.csv", EndRow), read_rows(folder / "rigs.csv", RigRow))
