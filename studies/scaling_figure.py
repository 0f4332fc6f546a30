"""Times against sizes, and speed against workers."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from studies.scaling_runs import GrowthRow, TimeRow
from studies.scaling_workers import WorkerRow
from studies.style import DARK, FAINT, LIGHT, RED, figure

_LOOKS = ((DARK, "o", "-"), (LIGHT, "s", "--"), (RED, "^", ":"))
_MOST_TICKS = 6
_UNITS = {
    "frames": "frames (spots, ellipses)",
    "points": "points of a spot",
    "views": "views of a board",
    "walkers": "walkers in a call",
}


def scaling_figure(times: Sequence[TimeRow], grown: Sequence[GrowthRow], workers: Sequence[WorkerRow]) -> Figure:
    """Draw four panels of times and one of workers."""
    steepest = max(grown, key=lambda row: row.exponent_at_the_end)
    heading = (
        f"No time grows faster than the power {steepest.exponent_at_the_end:.2f} of the size "
        f"({steepest.what}, {steepest.axis})"
    )
    with figure(11.5, 6.6, heading) as made:
        panels = made.subplots(2, 3).ravel()
        for axes, axis in zip(panels, _UNITS, strict=False):
            _times(axes, axis, [row for row in times if row.axis == axis])
        _workers(panels[4], [row for row in workers if np.isfinite(row.images_per_second)])
        _starts(panels[5], [row for row in workers if np.isfinite(row.start_seconds)])
    return made


def _times(axes: Axes, axis: str, rows: Sequence[TimeRow]) -> None:
    for what, (colour, marker, line) in zip(dict.fromkeys(row.what for row in rows), _LOOKS, strict=False):
        some = [row for row in rows if row.what == what]
        size, seconds = np.array([row.size for row in some]), np.array([1e3 * row.seconds for row in some])
        axes.plot(size, seconds, color=colour, marker=marker, ls=line, label=what)
        axes.plot(size, seconds[-1] * size / size[-1], color=FAINT, lw=0.9, zorder=0)
    axes.plot([], [], color=FAINT, lw=0.9, label="linear, through the last")
    axes.set(xscale="log", yscale="log", xlabel=_UNITS[axis], ylabel="time, ms", title=f"against {axis}")
    sizes = sorted({row.size for row in rows})
    axes.xaxis.set_major_locator(FixedLocator(sizes[:: -(-len(sizes) // _MOST_TICKS)]))
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)) if _decades(rows) < 2 else LogLocator())
    for side in (axes.xaxis, axes.yaxis):
        side.set_major_formatter("{x:g}")
        side.set_minor_locator(NullLocator())
    axes.grid(True, which="major")
    axes.legend()


def _decades(rows: Sequence[TimeRow]) -> float:
    seconds = [row.seconds for row in rows]
    return math.log10(max(seconds) / min(seconds))


def _workers(axes: Axes, rows: Sequence[WorkerRow]) -> None:
    names = [_name(row) for row in rows]
    bars = axes.bar(names, [row.images_per_second for row in rows], color=DARK, width=0.6)
    axes.bar_label(bars, [f"{row.speed_up:.2f} x" for row in rows], padding=2)
    axes.set(ylabel="images a second", title="poses of images, after the start")
    axes.margins(y=0.15)
    axes.grid(True, axis="y")


def _starts(axes: Axes, rows: Sequence[WorkerRow]) -> None:
    axes.bar([_name(row) for row in rows], [row.start_seconds for row in rows], color=LIGHT, width=0.6, hatch="//")
    axes.set(ylabel="seconds", title="until every worker has done its first image")
    axes.grid(True, axis="y")


def _name(row: WorkerRow) -> str:
    return row.place if row.workers == 1 else f"{row.workers}\n{row.place}"
