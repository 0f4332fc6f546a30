"""The two figures of the image study: boundaries over the grid, and poses."""

from collections.abc import Sequence

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.image_cells import RADII_PX, CellRow
from studies.image_poses import HARD, PoseRow
from studies.style import DARK, FAINT, LIGHT, RED, figure

BIAS_PX, BIAS_SATURATED_PX, NOISE_OVER_BOUND = 0.02, 0.05, 1.5
"""What is asked for."""

_GROUPS = {
    "disc": ("disc", 1.0, DARK, "o"),
    "ring": ("ring", 1.0, LIGHT, "s"),
    "disc, over-exposed twice": ("disc", 2.0, RED, "^"),
    "ring, over-exposed twice": ("ring", 2.0, FAINT, "v"),
}


def boundary_figure(rows: Sequence[CellRow]) -> Figure:
    """Draw bias, noise over the bound and honesty of each cell against the spot's radius."""
    worst = max((abs(row.bias_px) for row in rows if row.over == 1 and np.isfinite(row.bias_px)), default=np.nan)
    heading = f"The measured boundary against the true one: the largest mean bias is {worst:.3f} px"
    with figure(12.0, 4.4, heading) as made:
        bias, noise, own = made.subplots(1, 3)
        _cells(bias, rows, lambda row: row.bias_px, lambda row: row.bias_error_px)
        for limit in (BIAS_PX, BIAS_SATURATED_PX):
            bias.axhspan(-limit, limit, color="0.5", alpha=0.12, lw=0)
        bias.set(
            title="bias; bands: 0.02 px, and 0.05 px if saturated",
            ylabel="mean signed distance, outwards (px)",
            yscale="symlog",
        )
        bias.set_yscale("symlog", linthresh=0.02)
        _cells(noise, rows, lambda row: row.shape_over_bound)
        noise.axhline(1.0, color="black", lw=0.8)
        noise.axhline(NOISE_OVER_BOUND, color="black", lw=0.8, ls=":")
        noise.set(title="noise of centre and axes", ylabel="RMS error over the Cramér-Rao bound")
        noise.set_yscale("log")
        _cells(own, rows, lambda row: row.own, lambda row: row.own_error)
        own.axhline(1.0, color="black", lw=0.8)
        own.set(title="size, centre and axes by the points' own sigma", ylabel="mean squared error over own variance")
        own.set_yscale("log")
        bias.legend(loc="best", fontsize=8)
    return made


def _cells(axes: Axes, rows: Sequence[CellRow], value, error=None) -> None:
    for index, (label, (kind, over, colour, marker)) in enumerate(_GROUPS.items()):
        members = [row for row in rows if row.kind == kind and row.over == over]
        # Cells of one radius side by side, in the order of the table.
        seen: dict[float, int] = {}
        x = []
        for row in members:
            count = seen[row.radius_px] = seen.get(row.radius_px, 0) + 1
            x.append(row.radius_px * (1 + 0.012 * count + 0.22 * (index % 2) + 0.11 * (over > 1)))
        bars = None if error is None else [error(row) for row in members]
        axes.errorbar(
            x,
            [value(row) for row in members],
            bars,
            fmt=marker,
            ms=3.5,
            color=colour,
            mec="black",
            mew=0.3,
            lw=0.8,
            label=label,
        )
    axes.set_xscale("log")
    axes.set_xticks(RADII_PX, [f"{radius:g}" for radius in RADII_PX])
    axes.minorticks_off()
    axes.set_xlabel("radius of the spot in the image (px)")
    axes.grid(axis="y")


def pose_figure(rows: Sequence[PoseRow]) -> Figure:
    """Draw how the hard cases ended, and the normalised errors of the plain ones against the normal distribution."""
    wrong = sum(row.outcome in ("wrong", "degraded", "broken") for row in rows if row.case in HARD)
    heading = f"From image to plane: {wrong} of {sum(row.case in HARD for row in rows)} hard images gave a wrong plane"
    with figure(12.0, 4.4, heading) as made:
        ends, quantiles = made.subplots(1, 2, width_ratios=(1, 1))
        _ends(ends, rows)
        _quantiles(quantiles, rows)
    return made


def _ends(axes: Axes, rows: Sequence[PoseRow]) -> None:
    colours = {"right": DARK, "refused": FAINT, "degraded": LIGHT, "wrong": RED, "broken": "black"}
    names = list(HARD)
    left = np.zeros(len(names))
    for outcome, colour in colours.items():
        of_case = [[row.outcome == outcome for row in rows if row.case == name] for name in names]
        share = np.array([100 * np.mean(found) if found else 0.0 for found in of_case])
        axes.barh(names, share, left=left, color=colour, label=outcome, height=0.65, ec="white", lw=0.4)
        left += share
    axes.invert_yaxis()
    axes.axvline(98, color="black", lw=0.8, ls=":")
    axes.set(xlabel="images (%); dotted: the 98 % asked for", title="right: within 4 own standard deviations")
    axes.legend(loc="lower center", ncols=5, bbox_to_anchor=(0.5, -0.32))


def _quantiles(axes: Axes, rows: Sequence[PoseRow]) -> None:
    plain = [row for row in rows if row.case == "plain" and np.isfinite(row.z_L_sigmas)]
    if not plain:
        return
    expected = scipy.stats.norm.ppf((np.arange(len(plain)) + 0.5) / len(plain))
    for name, colour, marker in (("z_L", DARK, "o"), ("p", LIGHT, "s"), ("q", RED, "^")):
        errors = np.sort([getattr(row, f"{name}_sigmas") for row in plain])
        label = f"{name.replace('z_L', '$z_L$')}: variance {np.mean(errors**2):.2f}"
        axes.plot(expected, errors, marker, ms=3, color=colour, mec="black", mew=0.2, label=label)
    reach = float(np.abs(expected).max())
    axes.plot([-reach, reach], [-reach, reach], color="black", lw=0.8, zorder=0)
    axes.set(
        xlabel="standard normal quantile",
        ylabel="error over own standard deviation",
        title=f"{len(plain)} random images: errors in own sigmas",
    )
    axes.grid()
    axes.legend(loc="upper left")
