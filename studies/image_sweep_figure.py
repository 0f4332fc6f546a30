"""The figure of the image study's axes: bias and noise against blur, contrast, over-exposure and speckle."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from studies.image_sweeps import AXES, KINDS, SweepRow
from studies.style import DARK, LIGHT, figure

_LABELS = {
    "blur_px": "optics' blur, standard deviation (px)",
    "contrast": "contrast (grey levels; noise 2)",
    "over": "light over full scale",
    "speckle": "speckle, standard deviation over mean",
}
_LOGARITHMIC = ("blur_px", "contrast", "over")
_LOOKS = {"disc": (DARK, "o", "-"), "ring": (LIGHT, "s", "--")}
_SIDE = {"disc": -0.006, "ring": 0.006}


def sweep_figure(rows: Sequence[SweepRow], heading: str) -> Figure:
    """Draw bias above and noise below, a column an axis."""
    with figure(13.0, 6.6, heading) as made:
        grid = made.subplots(2, len(AXES), sharex="col", sharey="row")
        for (bias, noise), axis in zip(grid.T, AXES, strict=True):
            for kind in KINDS:
                members = [row for row in rows if (row.axis, row.kind) == (axis, kind)]
                _bias(bias, members)
                _noise(noise, members)
            bias.axhline(0.0, color="black", lw=0.8, zorder=0)
            noise.set_yscale("log")
            noise.yaxis.set_major_locator(FixedLocator([0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1]))
            noise.yaxis.set_major_formatter("{x:g}")
            noise.yaxis.set_minor_locator(NullLocator())
            if axis in _LOGARITHMIC:
                noise.set_xscale("log")
            noise.xaxis.set_major_locator(FixedLocator(AXES[axis]))
            noise.xaxis.set_major_formatter("{x:g}")
            noise.xaxis.set_minor_locator(NullLocator())
            noise.set_xlabel(_LABELS[axis])
            for axes in (bias, noise):
                axes.grid(axis="y")
        grid[0, 0].set_ylabel("mean signed distance, outwards (px)")
        grid[1, 0].set_ylabel("RMS distance of points (px)")
        handles, labels = grid[1, 0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=4)
    return made


def _bias(axes: Axes, rows: Sequence[SweepRow]) -> None:
    colour, marker, line = _LOOKS[rows[0].kind]
    bars = [row.bias_error_px for row in rows]
    axes.errorbar(_x(rows), [row.bias_px for row in rows], bars, color=colour, marker=marker, ms=4.5, ls=line, lw=1.2)


def _noise(axes: Axes, rows: Sequence[SweepRow]) -> None:
    colour, marker, line = _LOOKS[rows[0].kind]
    noise = np.array([row.points_px for row in rows])
    kind = rows[0].kind
    axes.plot(_x(rows), noise, color=colour, marker=marker, ms=4.5, ls=line, lw=1.2, label=f"{kind}, measured")
    least = noise / np.array([row.points_over_bound for row in rows])
    bound = "least that the pixels' noise allows"
    axes.plot(_x(rows), least, color=colour, marker="_", ms=9, mew=1.6, ls=":", lw=1.0, label=f"{kind}, {bound}")


def _x(rows: Sequence[SweepRow]) -> np.ndarray:
    values = np.array([row.value for row in rows])
    low, high = AXES[rows[0].axis][0], AXES[rows[0].axis][-1]
    side = _SIDE[rows[0].kind]
    return values * (high / low) ** side if rows[0].axis in _LOGARITHMIC else values + (high - low) * side
