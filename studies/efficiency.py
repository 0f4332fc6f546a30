"""How far from the Cramér-Rao bound are maximum likelihood, each conic fit and each formulation, and where?

1. **Efficiency.** Over planes tilted 0 to 70 degrees, 100 to 1,000 mm away, beams 0 to 40 mm off the camera with radii
   of 10 and 2.5 mm, boundary noise of 0.05 to 1 px on 30 to 100 % of the ellipse (200 points): is the RMS error of
   `(z_L, p, q)`, pooled by the bound, at most 1.03 in every cell within the criterion of
   `planeopt.estimation.efficiency`?
2. **The criterion.** Are the cells where it is larger those that the criterion marks, by the true plane, and by the
   answers themselves?
3. **Conic fits.** Against noise, tilt, depth, arc, number of points and offset, one at a time about a base case: what
   do planes of the closed form lose, by either route, from the ellipses of each conic fit, OpenCV's included?
4. **Formulations.** Along the same axes, with the same points: what does each formulation lose?
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

from studies import efficiency_summary as grid
from studies import efficiency_sweep_summary as sweeps
from studies.efficiency_cells import CellRow, run_cells
from studies.efficiency_examples import ExampleRow, run_examples
from studies.efficiency_figure import efficiency_figure
from studies.efficiency_fits import FitRow, run_fits
from studies.efficiency_formulations import FormulationRow, run_formulations
from studies.efficiency_sweep_figures import fits_figure, formulations_figure
from studies.study import Mode, Result, read_rows, rounded


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the four questions."""
    return result_of(
        run_cells(mode, executor),
        run_fits(mode, executor),
        run_formulations(mode, executor),
        run_examples(mode, executor),
    )


def result_of(
    cells: Sequence[CellRow],
    fits: Sequence[FitRow],
    formulations: Sequence[FormulationRow],
    examples: Sequence[ExampleRow],
) -> Result:
    """Judge, draw and put into words what was measured."""
    cells = rounded(cells)
    fits = rounded(fits)
    formulations = rounded(formulations)
    examples = rounded(examples)
    found, said = grid.verdicts(cells), numbers(cells, fits, formulations)
    return Result(
        tables={
            "cells": cells,
            "verdicts": found,
            "fits": fits,
            "formulations": formulations,
            "examples": examples,
        },
        headline=headline(said),
        finding=finding(cells, fits, formulations, examples),
        figures={
            "efficiency": efficiency_figure(cells, found),
            "fits": fits_figure(fits, sweeps.fits_heading(fits)),
            "formulations": formulations_figure(formulations, sweeps.formulations_heading(formulations)),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(
        read_rows(folder / "cells.csv", CellRow),
        read_rows(folder / "fits.csv", FitRow),
        read_rows(folder / "formulations.csv", FormulationRow),
        read_rows(folder / "examples.csv", ExampleRow),
    )


def numbers(
    cells: Sequence[CellRow], fits: Sequence[FitRow], formulations: Sequence[FormulationRow]
) -> dict[str, float]:
    """Return the headline's numbers."""
    return grid.numbers(grid.verdicts(cells)) | sweeps.numbers(fits, formulations)


def headline(said: Mapping[str, float]) -> str:
    """Say it in three sentences."""
    return f"{grid.headline(said)} {sweeps.headline(said)}"


def finding(
    cells: Sequence[CellRow],
    fits: Sequence[FitRow],
    formulations: Sequence[FormulationRow],
    examples: Sequence[ExampleRow],
) -> str:
    """Say what was found; every number comes from the tables."""
    of_axes = sweeps.finding(fits, formulations)
    return "\n".join(
        [grid.finding(cells, grid.verdicts(cells)), "", *of_axes, "", *sweeps.finding_of_examples(examples)]
    )
