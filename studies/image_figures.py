"""The two figures of the image study: boundaries over the grid, and poses."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from studies.image_cells import RADII_PX, CellRow
from studies.image_poses import HARD, PoseRow
from studies.image_summary import KNOWN_PX
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
    known = [abs(row.bias_px) for row in rows if row.over == 1 and row.bias_error_px < KNOWN_PX]
    heading = (
        f"The boundary's mean bias is at most {max(known, default=np.nan):.3f} px where it is known to {KNOWN_PX} px"
    )
    with figure(12.0, 8.0, heading) as made:
        (bias, points), (shape, own) = made.subplots(2, 2)
        for limit in (BIAS_PX, BIAS_SATURATED_PX):
            bias.axhspan(-limit, limit, color="0.5", alpha=0.12, lw=0)
        _cells(bias, rows, lambda row: row.bias_px, lambda row: row.bias_error_px)
        bias.set(
            title=f"bias; bands: {BIAS_PX} px, and {BIAS_SATURATED_PX} px if over-exposed",
            ylabel="mean signed distance, outwards (px)",
        )
        _cells(points, rows, lambda row: row.points_over_bound)
        points.set(title="noise of the points; dotted: what is asked", ylabel="RMS over the Cramér-Rao bound")
        _cells(shape, rows, lambda row: row.shape_over_bound)
        shape.set(title="noise of the ellipse's centre and axes", ylabel="RMS over the Cramér-Rao bound")
        _cells(own, rows, lambda row: row.own, lambda row: row.own_error)
        own.set(title="size, centre and axes against the points' own sigma", ylabel="squared error over own variance")
        for axes in (points, shape, own):
            axes.axhline(1.0, color="black", lw=0.8, zorder=0)
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 1.2, 1.5, 2, 3, 5, 10, 20, 50]))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_locator(NullLocator())
        for axes in (points, shape):
            axes.axhline(NOISE_OVER_BOUND, color="black", lw=0.8, ls=":", zorder=0)
        handles, labels = bias.get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return made


def _cells(
    axes: Axes,
    rows: Sequence[CellRow],
    value: Callable[[CellRow], float],
    error: Callable[[CellRow], float] | None = None,
) -> None:
    for index, (label, (kind, over, colour, marker)) in enumerate(_GROUPS.items()):
        members = [row for row in rows if row.kind == kind and row.over == over]
        # Cells of one radius side by side, in the order of the table; a group beside the other.
        seen: Counter[float] = Counter()
        x = []
        for row in members:
            x.append(row.radius_px * (0.86 + 0.012 * seen[row.radius_px] + 0.17 * (index % 2) + 0.34 * (over > 1)))
            seen[row.radius_px] += 1
        bars = None if error is None else [error(row) for row in members]
        style = {"fmt": marker, "ms": 3.5, "color": colour, "mec": "black", "mew": 0.3, "lw": 0.8}
        axes.errorbar(x, [value(row) for row in members], bars, label=label, **style)
    axes.set_xscale("log")
    axes.set_xticks(RADII_PX, [f"{radius:g}" for radius in RADII_PX])
    axes.xaxis.set_minor_locator(NullLocator())
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
    looks = {
        "right": (DARK, ""),
        "refused": (FAINT, ""),
        "degraded": (LIGHT, "//"),
        "wrong": (RED, "xx"),
        "broken": ("black", ".."),
    }
    names = list(HARD)
    left = np.zeros(len(names))
    for outcome, (colour, hatch) in looks.items():
        of_case = [[row.outcome == outcome for row in rows if row.case == name] for name in names]
        share = np.array([100 * np.mean(found) if found else 0.0 for found in of_case])
        axes.barh(names, share, left=left, color=colour, label=outcome, height=0.65, ec="white", lw=0.4, hatch=hatch)
        left += share
    axes.invert_yaxis()
    axes.axvline(98, color="black", lw=0.8, ls=":")
    axes.set(xlabel="images (%); dotted: the 98 % asked for", title="right: within 4 own standard deviations")
    axes.legend(loc="lower center", ncols=5, bbox_to_anchor=(0.5, -0.3))


def _quantiles(axes: Axes, rows: Sequence[PoseRow]) -> None:
    plain = [row for row in rows if row.case == "plain" and np.isfinite(row.z_L_sigmas)]
    if not plain:
        return
    expected = scipy.stats.norm.ppf((np.arange(len(plain)) + 0.5) / len(plain))
    for name, colour, marker in (("z_L", DARK, "o"), ("p", LIGHT, "s"), ("q", RED, "^")):
        errors = np.sort([getattr(row, f"{name}_sigmas") for row in plain])
        label = f"${name}$: variance {np.mean(errors**2):.2f}"
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
