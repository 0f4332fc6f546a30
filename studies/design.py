"""What rig to build: how well are z_L and tilt measured, over offset, radius, focal length, distance and tilt?

1. **Charts.** What standard deviations of z_L and of the normal does the Cramér-Rao bound of `planeopt.design` predict
   for a usual image, one number of the rig or the plane changed at a time?
2. **Laws.** With which powers of offset, radius, focal length and distance do they go, and what is an offset worth
   against none?
3. **Checks.** Do the errors of maximum likelihood on drawn boundary points scatter as predicted, and what do
   `find_spot` and `solve` make of rendered images, by their own sigma and by their errors?
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

from studies.design_cells import DrawRow, ImageRow, SweepRow, run_draws, run_images, sweeps
from studies.design_figures import checks_figure, offsets_figure, sweeps_figure
from studies.design_laws import HumpRow, LawRow, OffsetRow, humps, laws, offsets
from studies.design_summary import checks, finding, headline, numbers
from studies.study import Mode, Result, read_rows, rounded


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the three questions; the charts and laws are the same in both modes."""
    return result_of(sweeps(), laws(), humps(), offsets(), run_draws(mode, executor), run_images(mode, executor))


def result_of(
    swept: Sequence[SweepRow],
    powers: Sequence[LawRow],
    tops: Sequence[HumpRow],
    compared: Sequence[OffsetRow],
    draws: Sequence[DrawRow],
    images: Sequence[ImageRow],
) -> Result:
    """Judge, draw and put into words what was predicted and checked."""
    swept = rounded(swept)
    powers = rounded(powers)
    tops = rounded(tops)
    compared = rounded(compared)
    draws = rounded(draws)
    images = rounded(images)
    found = checks(draws, images)
    said, top = numbers(swept, powers, tops, found), tops[0]
    of_sweeps = (
        f"At {said['distance_mm']:.0f} mm and {said['tilt_deg']:.0f} degrees: {said['sigma_z_L_um']:.1f} um and "
        f"{said['sigma_normal_deg']:.3f} degrees; twice the distance costs a factor of "
        f"{2 ** said['z_L_distance_power_least']:.1f} to {2 ** said['z_L_distance_power_most']:.1f}"
    )
    of_offsets = (
        f"An offset below {top.even_offset_over_radius:.1f} radii measures z_L worse than none, "
        f"at {top.worst_offset_over_radius:.2f} radii {top.worst_over_coaxial:.2f} times"
    )
    of_checks = (
        f"Errors are as predicted in {found[0].planes - found[0].outside} of {found[0].planes} planes drawn; images "
        f"claim {found[1].own_least:.2f} to {found[1].own_most:.2f} times the bound"
    )
    return Result(
        tables={
            "sweeps": swept,
            "laws": powers,
            "humps": tops,
            "offsets": compared,
            "draws": draws,
            "images": images,
            "checks": found,
        },
        headline=headline(said),
        finding=finding(said, powers, tops, found),
        figures={
            "sweeps": sweeps_figure(swept, draws, images, of_sweeps),
            "offsets": offsets_figure(compared, tops, of_offsets),
            "checks": checks_figure(draws, images, of_checks),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(
        read_rows(folder / "sweeps.csv", SweepRow),
        read_rows(folder / "laws.csv", LawRow),
        read_rows(folder / "humps.csv", HumpRow),
        read_rows(folder / "offsets.csv", OffsetRow),
        read_rows(folder / "draws.csv", DrawRow),
        read_rows(folder / "images.csv", ImageRow),
    )
