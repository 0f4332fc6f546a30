"""Is the boundary measured in an image unbiased, at the bound of the pixels' noise, and honest about itself?

1. **Bias and noise.** On simulated discs and rings of 8 to 300 px radius, blurred by 0.7 to 2 px, 20 to 230 grey levels
   high, tilted to 65 degrees, seen through a distorting lens, in 8 bits: is the mean signed distance of the boundary's
   points from the true boundary below 0.02 px (0.05 px where over-exposed twice), and their noise, and that of the
   ellipse's size, centre and axes, within 1.5 times what the noise of the pixels allows (`planeopt.spot.bound`)?
2. **Hard cases.** With speckle, occlusion, distractors, hardly any contrast, saturation, few pixels: is the plane right
   within 4 of its own standard deviations, and refused where it is not?
3. **Honesty.** Over random images: have the errors of z_L and of both slopes, over their own sigmas, unit variance?
4. **Flags.** Are they raised where something is wrong with an image, and not where nothing is?
"""

from concurrent.futures import Executor

from studies.image_cells import cells_of, run_cells
from studies.image_figures import boundary_figure, pose_figure
from studies.image_flags import run_flags
from studies.image_poses import HARD, Job, run_poses
from studies.image_summary import cases_of, finding, headline, honesty_of
from studies.study import Mode, Result

_IMAGES = {"full": (400, 200, 100), "quick": (50, 8, 4)}
"""Plain ones, of each hard case, and with each fault."""


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the four questions."""
    plain, hard, faulty = _IMAGES[mode]
    cells = run_cells(cells_of(mode), executor)
    jobs = [Job("plain", seed) for seed in range(plain)]
    jobs += [Job(case, seed) for case in HARD for seed in range(hard)]
    poses = run_poses(jobs, executor)
    cases, honesty, flags = cases_of(poses), honesty_of(poses), run_flags(faulty, executor)
    return Result(
        tables={"cells": cells, "poses": poses, "cases": cases, "honesty": honesty, "flags": flags},
        headline=headline(cells, cases, honesty),
        finding=finding(cells, cases, honesty, flags),
        figures={"boundary": boundary_figure(cells), "poses": pose_figure(poses)},
    )
