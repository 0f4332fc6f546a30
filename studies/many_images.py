"""Do many images of one rig give what is claimed of them?

1. **Frames of one plane.** Is the error of the combined plane that of its covariance, with rigs drawn from theirs? Does
   the spots' part shrink as one over the number of frames, and the rig's not at all? What happens to generalised least
   squares that takes the sensitivities to the rig, as noisy frames give them, for exact?
2. **The check of the rig.** Has the pooled statistic, and each of its parts, its law though the rig's error is common
   to all images? How large a turn of the beam is found, by how many images?
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import scipy.stats
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from planeopt.estimation.drift import LEVEL
from studies.many_images_cells import NOISE_PX, CheckRow, CombineRow, run_checks, run_frames
from studies.statistics import LEVEL as FAMILY
from studies.statistics import binomial_limits
from studies.study import Mode, Result, read_rows, rounded
from studies.style import DARK, FAINT, LIGHT, RED, figure


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer both questions."""
    return result_of(run_frames(mode, executor), run_checks(mode, executor))


def result_of(frames: Sequence[CombineRow], checks: Sequence[CheckRow]) -> Result:
    """Judge, draw and put into words what was measured."""
    frames, checks = rounded(frames), rounded(checks)
    said = _numbers(frames, checks)
    return Result(
        tables={"frames": frames, "checks": checks},
        headline=_headline(said),
        finding=_finding(frames, checks),
        figures={"many_images": _figure(frames, checks)},
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(read_rows(folder / "frames.csv", CombineRow), read_rows(folder / "checks.csv", CheckRow))


def faults(frames: Sequence[CombineRow], checks: Sequence[CheckRow]) -> list[str]:
    """Return what is beyond its limits: two-sided, family-wise 0.001; nothing for right code."""
    right = [row for row in checks if row.turn_mrad == 0]
    means = [("total error", row.frames, row.total, 3 * row.draws) for row in frames]
    means += [("error of the spots' part", row.frames, row.spot, 3 * row.draws) for row in frames]
    means += [("scatter", row.frames, row.scatter, 3 * (row.frames - 1) * row.draws) for row in frames]
    means += [("pooled", row.images, row.pooled, 2 * row.images * row.batches) for row in right]
    means += [("shift", row.images, row.shift, 4 * row.batches) for row in right]
    means += [("trend", row.images, row.trend, 4 * row.batches) for row in right]
    means += [("rest", row.images, row.rest, (2 * row.images - 8) * row.batches) for row in right]
    means = [mean for mean in means if not math.isnan(mean[2])]
    tests = len(means) + len(right)
    found = []
    for name, count, value, dof in means:
        low, high = scipy.stats.chi2.ppf([FAMILY / 2 / tests, 1 - FAMILY / 2 / tests], dof) / dof
        if not low <= value <= high:
            found.append(f"{name} of {count}: {value:.4g}, outside {low:.4g} to {high:.4g}")
    for row in right:
        most = binomial_limits(row.batches, LEVEL, tests)[1]
        if row.degraded * row.batches > most:
            found.append(f"{row.degraded:.4g} of right rigs called degraded by {row.images} images")
    return found


def _numbers(frames: Sequence[CombineRow], checks: Sequence[CheckRow]) -> dict[str, float]:
    """Return the headline's numbers, from `frames.csv` and, of rigs that have not turned, `checks.csv`."""
    first, last = frames[0], frames[-1]
    most = max(row.images for row in checks)
    right = next(row for row in checks if row.images == most and row.turn_mrad == 0)
    return {
        "least_frames": first.frames,
        "most_frames": last.frames,
        "spots_sigma_falls_by": first.sigma_z_spot_mm / last.sigma_z_spot_mm,
        "rig_sigma_changes_by_percent": 100 * abs(1 - last.sigma_z_rig_mm / first.sigma_z_rig_mm),
        "least_squared_error": min(row.total for row in frames),
        "largest_squared_error": max(row.total for row in frames),
        "largest_believing": max(row.believing for row in frames),
        "images_checked": right.images,
        "batches_checked": right.batches,
        "called_degraded_percent": 100 * right.degraded,
        "by_sum_percent": 100 * right.naive,
    }


def _headline(n: Mapping[str, float]) -> str:
    return (
        f"From {n['least_frames']:.0f} to {n['most_frames']:.0f} frames of one plane the spots' part of sigma falls by "
        f"a factor of {n['spots_sigma_falls_by']:.1f}, the rig's changes by {n['rig_sigma_changes_by_percent']:.1f} %; "
        f"the squared error over the covariance is {n['least_squared_error']:.2f} to "
        f"{n['largest_squared_error']:.2f}, by weights that believe noisy sensitivities up to "
        f"{n['largest_believing']:.1f}. {n['images_checked']:.0f} images call a right rig degraded in "
        f"{n['called_degraded_percent']:.1f} % of {n['batches_checked']:.0f} batches; the sum of "
        f"their own chi-squareds would in {n['by_sum_percent']:.0f} %."
    )


def _finding(frames: Sequence[CombineRow], checks: Sequence[CheckRow]) -> str:
    last = frames[-1]
    lines = [
        "# Many images of one rig",
        "",
        f"Points with {NOISE_PX:g} px of noise across the boundary; the example's rig with a calibration's covariance.",
        "",
        "## Frames of one plane",
        "",
        "Mean squared errors over the stated covariance, a component: 1 is right. `believing` is generalised least "
        "squares that takes the measured sensitivities to the rig for exact.",
        "",
        "| frames | draws | combined | spots' part alone | believing | scatter | sigma z_L: spots, rig (mm) |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {row.frames} | {row.draws} | {row.total:.3f} | {row.spot:.3f} | {row.believing:.3f} | "
            f"{_cell(row.scatter)} | {row.sigma_z_spot_mm:.4f}, {row.sigma_z_rig_mm:.4f} |"
            for row in frames
        ),
        "",
        f"The spots' variance times the number of frames is that of one frame to {_inconstancy(frames):.1%}. With "
        f"{last.frames} frames the squared error is {last.believing:.2f} times what is stated where what noisy frames "
        f"say of the rig is believed, {last.total:.2f} times where they are combined.",
        "",
        "## The check of the rig",
        "",
        "Statistics over their degrees of freedom, the share of batches that are called degraded, and the share whose "
        "sum of the images' own chi-squareds has p < 0.001.",
        "",
        "| images | turn (mrad) | batches | pooled | shift | trend | rest | degraded | sum, p < 0.001 |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row.images} | {row.turn_mrad:g} | {row.batches} | {row.pooled:.3f} | {_cell(row.shift)} | "
            f"{_cell(row.trend)} | {_cell(row.rest)} | {row.degraded:.3f} | {row.naive:.3f} |"
            for row in checks
        ),
        "",
        *_faults_in_words(frames, checks),
    ]
    return "\n".join(lines)


def _faults_in_words(frames: Sequence[CombineRow], checks: Sequence[CheckRow]) -> list[str]:
    found = faults(frames, checks)
    if not found:
        return [f"All of this is within its limits (two-sided, family-wise {FAMILY:g})."]
    return ["Beyond its limits:", "", *(f"- {fault}" for fault in found)]


def _inconstancy(frames: Sequence[CombineRow]) -> float:
    one = frames[0].sigma_z_spot_mm
    return max(abs(row.frames * (row.sigma_z_spot_mm / one) ** 2 - 1) for row in frames)


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3f}"


def _figure(frames: Sequence[CombineRow], checks: Sequence[CheckRow]) -> Figure:
    said = _numbers(frames, checks)
    heading = (
        f"{said['most_frames']:.0f} frames: the spots' part falls by a factor of {said['spots_sigma_falls_by']:.1f}, "
        f"the rig's changes by {said['rig_sigma_changes_by_percent']:.1f} %; squared errors are "
        f"{said['least_squared_error']:.2f} to {said['largest_squared_error']:.2f} times the stated"
    )
    count = [row.frames for row in frames]
    with figure(11, 3.8, heading) as made:
        sigma, error, power = made.subplots(1, 3)
        sigma.loglog(count, [row.sigma_z_spot_mm for row in frames], "o-", color=DARK, label="spots' part")
        sigma.loglog(count, [row.sigma_z_rig_mm for row in frames], "s-", color=LIGHT, label="rig's part")
        ideal = [frames[0].sigma_z_spot_mm / n**0.5 for n in count]
        sigma.loglog(count, ideal, ":", color="black", lw=0.8, label="one over the root of frames")
        sigma.set(title="sigma of z_L", xlabel="frames of one plane", ylabel="standard deviation (mm)")
        error.semilogx(count, [row.believing for row in frames], "^--", color=RED, label="believing the sensitivities")
        error.semilogx(count, [row.total for row in frames], "o-", color=DARK, label="combined")
        error.semilogx(count, [row.spot for row in frames], "s", color=FAINT, label="right rig, spots' part")
        error.axhline(1, color="black", lw=0.8)
        error.set(
            title="squared error over the covariance", xlabel="frames of one plane", ylabel="per component; 1 is right"
        )
        looks = (("^:", FAINT), ("s--", LIGHT), ("o-", DARK))
        for n, (line, color) in zip(sorted({row.images for row in checks}), looks, strict=False):
            rows = [row for row in checks if row.images == n]
            label = f"{n} image{'s' if n > 1 else ''}"
            power.plot([r.turn_mrad for r in rows], [r.degraded for r in rows], line, color=color, label=label)
        for axes in (sigma, error):
            axes.set_xticks(count, [str(n) for n in count])
            axes.xaxis.set_minor_locator(NullLocator())
        sigma.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        sigma.yaxis.set_major_formatter("{x:g}")
        sigma.yaxis.set_minor_locator(NullLocator())
        power.set(title="share of rigs called degraded", xlabel="turn of the beam since calibration (mrad)")
        power.set_ylabel("share of batches")
        for axes in (sigma, error, power):
            axes.grid(visible=True)
            axes.legend()
    return made
