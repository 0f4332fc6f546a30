"""Figures of what a calibration's accuracy depends on, and of what it costs a plane."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.calibration_accuracy import (
    BOUNDARY,
    PLANE_TILT_DEG,
    SPOT_PX,
    AccuracyRow,
    median,
    typical_error,
    values_of,
)
from studies.style import DARK, FAINT, LIGHT, RED, figure

_PANELS = {
    "views": "number of views (tilts to 40°, depths 1:2)",
    "tilt": "largest tilt, degrees (15 views, depths 1:2)",
    "depths": "farthest over nearest depth (15 views, tilts to 40°)",
}
_NEAR = 1.2
"""Depth ratios below have no room for a tick of their own but the first."""


def accuracy_figure(rows: Sequence[AccuracyRow]) -> Figure:
    """Draw what the number of views, tilts and depths are worth."""
    (low, high), (near, far) = (_ends(rows, varied) for varied in ("tilt", "depths"))
    f = [100 * median(rows, "tilt", value, "f_relative") for value in (low, high)]
    offset = [median(rows, "depths", value, "offset_mm") for value in (near, far)]
    heading = (
        f"f is known to {f[0]:.2g} % with tilts to {low:g}°, {f[1]:.2g} % to {high:g}°; the offset to {offset[0]:.2g} "
        f"mm with depths at 1:{near:g}, {offset[1]:.2g} mm at 1:{far:g}"
    )
    with figure(13.0, 4.6, heading) as made:
        grid: Any = np.ravel(made.subplots(1, 3, sharey=True))
        for axes, varied in zip(grid, _PANELS, strict=True):
            values = values_of(rows, varied)
            for name, colour, marker, text, scale in (
                ("f_relative", DARK, "o", "focal length $f$ (%)", 100.0),
                ("offset_mm", LIGHT, "s", "offset $e$ (mm)", 1.0),
                ("radius_mm", "black", "D", "radius $r$ (mm)", 1.0),
                ("direction_mrad", RED, "^", "direction (mrad)", 1.0),
            ):
                medians = [scale * median(rows, varied, value, name) for value in values]
                axes.plot(values, medians, "-", marker=marker, ms=4, color=colour, lw=1.3, label=text)
            errors = [100 * typical_error(rows, varied, value) for value in values]
            axes.plot(values, errors, "x", color=DARK, ms=6, label="error of $f$ against the truth (%)")
            _finished(axes, varied, values)
            axes.set_xlabel(_PANELS[varied])
        grid[0].set_ylabel("standard deviation, median over\nsessions (units in the legend)")
        handles, labels = grid[0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return made


def cost_figure(rows: Sequence[AccuracyRow]) -> Figure:
    """Draw what the calibration costs a plane, beside what the noise of the plane's own spot does."""
    few, many = _ends(rows, "views")
    flat, steep = _ends(rows, "tilt")
    depth = [100 * median(rows, "tilt", value, "z_L_relative") for value in (flat, steep)]
    normal = [median(rows, "views", value, "normal_deg") for value in (few, many)]
    heading = (
        f"What the calibration costs a plane: z_L {depth[0]:.2g} % with tilts to {flat:g}°, {depth[1]:.2g} % to "
        f"{steep:g}°; the normal {normal[0]:.2g}° with {few:g} views, {normal[1]:.2g}° with {many:g}"
    )
    quantities = (
        ("z_L_relative", "z_L_spot_relative", 100.0, "sigma of $z_L$ over $z_L$ (%)"),
        ("normal_deg", "normal_spot_deg", 1.0, "sigma of the normal (degrees)"),
    )
    with figure(13.0, 6.6, heading) as made:
        grid: Any = made.subplots(2, 3, sharex="col", sharey="row")
        for line, (name, of_spot, scale, label) in zip(grid, quantities, strict=True):
            for axes, varied in zip(line, _PANELS, strict=True):
                values = values_of(rows, varied)
                own = {value: [row for row in rows if (row.varied, row.value) == (varied, value)] for value in values}
                every = [scale * np.array([getattr(row, name) for row in own[value]]) for value in values]
                for value, found in zip(values, every, strict=True):
                    axes.plot(np.full(len(found), value), found, ".", ms=4, color=FAINT, zorder=1)
                middle = [float(np.nanmedian(found)) for found in every]
                axes.plot(values, middle, "o-", ms=5, color=DARK, lw=1.5, label="from the calibration, median")
                noise = [scale * median(rows, varied, value, of_spot) for value in values]
                text = f"from its own spot's noise ({BOUNDARY} points, {SPOT_PX:g} px)"
                axes.plot(values, noise, "s--", ms=4, mfc="white", color=LIGHT, lw=1.3, label=text)
                _finished(axes, varied, values)
            line[0].set_ylabel(label)
        for axes, varied in zip(grid[1], _PANELS, strict=True):
            axes.set_xlabel(_PANELS[varied])
        handles, labels = grid[0][0].get_legend_handles_labels()
        handles.append(grid[0][0].get_lines()[0])
        labels.append(f"each session (plane tilted by {PLANE_TILT_DEG:g}° at the working distance)")
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return made


def _finished(axes: Axes, varied: str, values: Sequence[float]) -> None:
    axes.set(yscale="log", xscale="linear" if varied == "depths" else "log")
    ticks = [value for value in values if varied != "depths" or value == values[0] or value > _NEAR]
    axes.set_xticks(ticks, [f"{value:g}" for value in ticks])
    axes.minorticks_off()
    axes.grid()


def _ends(rows: Sequence[AccuracyRow], varied: str) -> tuple[float, float]:
    values = values_of(rows, varied)
    return values[0], values[-1]
