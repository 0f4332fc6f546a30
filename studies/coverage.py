"""Do 95 % intervals, of first order (Laplace) and sampled (emcee), hold the truth in 95 % of cases, and 68 % in 68 %?

Planes are drawn from the prior, rigs at random, half of those of the point sets and a quarter of those of the images
known only as well as a calibration's covariance says.

1. **Point sets.** With boundary points on full and on 40 % arcs, with noise of 0.1 to 1 px: how often do the intervals
   of z_L, both slopes, tilt and R hold the truth, those of the posterior everywhere and those of first order where they
   say that they may be trusted? Is the truth's rank among the posterior's draws uniform (simulation-based calibration)?
2. **Images.** The same through the whole chain: render, find the spot, solve, sample.
3. **The calibration's covariance.** With a beam's offset uncertain by 0.04 mm: what do intervals hold that ignore it?

No set is left out for where its plane lies: a posterior's claims hold on average over the prior, and also over any
choice that depends on the data alone. Only spots that are too small, or not found, by what was measured of them are
passed over. The noise moves points across the boundary, as the edge of an image does: noise along it would not be seen,
and noise in both directions makes every boundary longer.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from studies.coverage_checks import Checks
from studies.coverage_figures import coverage_figure, rank_figure, rig_figure
from studies.coverage_images import ImageRow, run_images
from studies.coverage_points import SetRow, run_points
from studies.coverage_rig import WrongRigRow, run_wrong_rig
from studies.coverage_summary import IMAGES, POINTS, finding, groups_of, headline, judge, numbers
from studies.study import Mode, Result, read_rows, rounded


@dataclass(frozen=True)
class _Size:
    """How many rigs, sets of each, of which sampled, images, sets with an uncertain offset, of which sampled."""

    rigs: int
    sets: int
    sampled: int
    images: int
    uncertain: int
    uncertain_sampled: int


_SIZES = {"full": _Size(40, 25, 25, 205, 200, 100), "quick": _Size(2, 30, 1, 2, 60, 1)}


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the three questions."""
    size = _SIZES[mode]
    points = run_points(size.rigs, size.sets, size.sampled, executor)
    images = run_images(range(size.images), executor)
    wrong_rig = run_wrong_rig(size.uncertain, size.uncertain_sampled, executor)
    return result_of(points, images, wrong_rig)


def result_of(points: Sequence[SetRow], images: Sequence[ImageRow], wrong_rig: Sequence[WrongRigRow]) -> Result:
    """Judge, draw and put into words what was simulated."""
    points, images, wrong_rig = rounded(points), rounded(images), rounded(wrong_rig)
    coverage, ranks = judge(groups_of(points, images, wrong_rig))
    main: dict[str, Sequence[Checks]] = {POINTS: points, IMAGES: images}
    tests, said = len(coverage) + len(ranks), numbers(points, images, coverage, ranks)
    return Result(
        tables={"sets": points, "images": images, "wrong_rig": wrong_rig, "coverage": coverage, "ranks": ranks},
        headline=headline(said),
        finding=finding(points, images, coverage, ranks),
        figures={
            "coverage": coverage_figure(main, coverage, tests),
            "ranks": rank_figure(main, ranks, tests),
            "wrong_rig": rig_figure(wrong_rig, coverage),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(
        read_rows(folder / "sets.csv", SetRow),
        read_rows(folder / "images.csv", ImageRow),
        read_rows(folder / "wrong_rig.csv", WrongRigRow),
    )
