"""Does maximum likelihood reach the Cramér-Rao bound, wherever the criterion says that it can be reached?

1. **Efficiency.** Over planes tilted 0 to 70 degrees, 100 to 1,000 mm away, beams 0 to 40 mm off the camera with radii
   of 10 and 2.5 mm, boundary noise of 0.05 to 1 px on 30 to 100 % of the ellipse (200 points): is the RMS error of
   `(z_L, p, q)`, pooled by the bound, at most 1.03 in every cell within the criterion of
   `planeopt.estimation.efficiency`?
2. **The criterion.** Are the cells where it is larger those that the criterion marks, by the true plane, and by the
   answers themselves?
"""

from concurrent.futures import Executor

from studies.efficiency_cells import run_cells
from studies.efficiency_figure import efficiency_figure
from studies.efficiency_summary import finding, headline, verdicts
from studies.study import Mode, Result


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer both questions."""
    cells = run_cells(mode, executor)
    found = verdicts(cells)
    return Result(
        tables={"cells": cells, "verdicts": found},
        headline=headline(found),
        finding=finding(cells, found),
        figures={"efficiency": efficiency_figure(cells, found)},
    )
