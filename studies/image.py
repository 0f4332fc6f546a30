"""Is the boundary measured in an image unbiased, at the bound of the pixels' noise, and honest about itself?

1. **Bias and noise.** On simulated discs and rings of 8 to 300 px radius, blurred by 0.7 to 2 px, 20 to 230 grey levels
   high, tilted to 65 degrees, seen through a distorting lens, in 8 bits: is the mean signed distance of the boundary's
   points from the true boundary below 0.02 px (0.05 px where over-exposed twice), and their noise, and that of the
   ellipse's size, centre and axes, within 1.5 times what the noise of the pixels allows (`planeopt.spot.bound`)?
2. **One axis at a time.** How do bias and noise grow with blur, with contrast, with over-exposure to four times full
   scale, and with speckle to half the mean?
3. **Hard cases.** With speckle, occlusion, distractors, hardly any contrast, saturation, few pixels: is the plane right
   within 4 of its own standard deviations, and refused where it is not?
4. **Honesty.** Over random images: have the errors of z_L and of both slopes, over their own sigmas, unit variance?
5. **Flags.** Are they raised where something is wrong with an image, and not where nothing is?
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

from studies.image_cells import CellRow, cells_of, run_cells
from studies.image_figures import boundary_figure, pose_figure
from studies.image_flags import FlagRow, run_flags
from studies.image_poses import HARD, Job, PoseRow, run_poses
from studies.image_summary import cases_of, finding, headline, honesty_of, numbers
from studies.image_sweep_figure import sweep_figure
from studies.image_sweeps import SweepRow, run_sweeps
from studies.study import Mode, Result, read_rows, rounded

_IMAGES = {"full": (400, 200, 60), "quick": (6, 1, 1)}
"""Plain ones, of each hard case, and with each fault."""


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the five questions."""
    plain, hard, faulty = _IMAGES[mode]
    cells, sweeps = run_cells(cells_of(mode), executor), run_sweeps(mode, executor)
    jobs = [Job("plain", seed) for seed in range(plain)]
    jobs += [Job(case, seed) for case in HARD for seed in range(hard)]
    return result_of(cells, sweeps, run_poses(jobs, executor), run_flags(faulty, executor))


def result_of(
    cells: Sequence[CellRow], sweeps: Sequence[SweepRow], poses: Sequence[PoseRow], flags: Sequence[FlagRow]
) -> Result:
    """Judge, draw and put into words what was measured."""
    cells = rounded(cells)
    sweeps = rounded(sweeps)
    poses = rounded(poses)
    flags = rounded(flags)
    cases, honesty = cases_of(poses), honesty_of(poses)
    said = numbers(cells, cases, honesty, sweeps)
    clear = max(row.points_over_bound for row in sweeps if row.axis != "speckle")
    heading = (
        f"Bias at most {said['largest_bias_sweeps_px']:.3f} px, with speckle {said['largest_bias_speckle_px']:.3f} px; "
        f"noise without speckle at most {clear:.2f} times its bound, which knows nothing of speckle"
    )
    return Result(
        tables={
            "cells": cells,
            "sweeps": sweeps,
            "poses": poses,
            "cases": cases,
            "honesty": honesty,
            "flags": flags,
        },
        headline=headline(said),
        finding=finding(cells, cases, honesty, flags, sweeps),
        figures={
            "boundary": boundary_figure(cells),
            "sweeps": sweep_figure(sweeps, heading),
            "poses": pose_figure(poses),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(
        read_rows(folder / "cells.csv", CellRow),
        read_rows(folder / "sweeps.csv", SweepRow),
        read_rows(folder / "poses.csv", PoseRow),
        read_rows(folder / "flags.csv", FlagRow),
    )
