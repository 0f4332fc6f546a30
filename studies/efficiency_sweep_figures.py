"""Two figures of six panels: errors over the bound along each axis, by conic fit and by formulation."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from studies.efficiency_cells import Array
from studies.efficiency_fits import FITS, POSE, FitRow
from studies.efficiency_formulations import FORMULATIONS, FormulationRow
from studies.efficiency_sweeps import BASE
from studies.style import DARK, LIGHT, RED, figure

_LABELS = {
    "noise_px": "noise across the boundary (px)",
    "tilt_deg": "tilt of the plane (deg)",
    "depth_mm": "distance of the plane (mm)",
    "arc": "share of the ellipse with points",
    "points": "points",
    "offset_mm": "offset of the beam (mm); 10 mm is its radius",
}
_LOGARITHMIC = ("noise_px", "depth_mm", "points")
_MARKERS = "osv^DPX*<"
_SIDE = 0.012
"""Steps sideways, of a panel's width, so that markers of equal values stand side by side."""


class _Row(Protocol):
    @property
    def axis(self) -> str: ...

    @property
    def value(self) -> float: ...

    @property
    def failed(self) -> int: ...

    @property
    def draws(self) -> int: ...


Row = TypeVar("Row", bound=_Row)


@dataclass(frozen=True)
class _Look:
    """How a line is drawn; `place` puts its markers beside those of others."""

    label: str
    colour: str
    marker: str
    line: str
    place: float


def fits_figure(rows: Sequence[FitRow], heading: str) -> Figure:
    """Draw every conic fit by both routes of the closed form, and maximum likelihood of the plane."""
    middle = (len(FITS) - 1) / 2
    lines: dict[tuple[str, str], _Look] = {}
    for place, (fit, marker) in enumerate(zip(FITS, _MARKERS, strict=False)):
        # A label that begins with an underscore stays out of the legend.
        dual = "dual route, the same markers" if place == 0 else f"_{fit}"
        lines[fit, "dual"] = _Look(dual, LIGHT, marker, ":", place - middle)
        lines[fit, "primal"] = _Look(f"{fit}, primal route", DARK, marker, "-", place - middle)
    lines[POSE, "-"] = _Look("maximum likelihood of the plane", "black", "", "--", 0.0)
    return _panels(rows, lines, lambda row: (row.fit, row.route), lambda row: row.over_bound, heading)


def formulations_figure(rows: Sequence[FormulationRow], heading: str) -> Figure:
    """Draw every formulation."""
    middle = (len(FORMULATIONS) - 1) / 2
    colours = {"Reprojection": ("black", "--"), "Elastic": (RED, "-."), "ClosedForm": ("0.55", ":")}
    lines: dict[tuple[str, str], _Look] = {}
    for place, (name, marker) in enumerate(zip(FORMULATIONS, _MARKERS, strict=True)):
        colour, line = colours.get(name, (DARK if name.startswith("Constrained") else LIGHT, "-"))
        lines[name, ""] = _Look(name, colour, marker, line, place - middle)
    return _panels(rows, lines, lambda row: (row.formulation, ""), lambda row: row.over_bound_paired, heading)


def _panels(
    rows: Sequence[Row],
    lines: Mapping[tuple[str, str], _Look],
    key: Callable[[Row], tuple[str, str]],
    over_bound: Callable[[Row], float],
    heading: str,
) -> Figure:
    with figure(12.5, 8.8, heading) as made:
        grid = made.subplots(2, 3)
        for axes, axis in zip(np.ravel(grid), _LABELS, strict=True):
            members = [row for row in rows if row.axis == axis]
            values = sorted({row.value for row in members})
            top = 1.6 * max(over_bound(row) for row in members if np.isfinite(over_bound(row)))
            if any(not np.isfinite(over_bound(row)) for row in members):
                top *= 1.6
            for line, look in lines.items():
                of_line = [row for row in members if key(row) == line]
                _line(axes, of_line, np.array([over_bound(row) for row in of_line]), values, look, top)
            axes.axhline(1.0, color="black", lw=0.8, zorder=0)
            axes.axvline(getattr(BASE, axis), color="0.6", lw=0.8, ls=(0, (1, 3)), zorder=0)
            _scale(axes, axis, values, top)
        for axes in grid[:, 0]:
            axes.set_ylabel("RMS error over the Cramér-Rao bound")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        missing: list[tuple[dict[str, Any], str]] = []
        if any(0.01 * row.draws < row.failed < row.draws for row in rows):
            missing.append(({"marker": "o", "mfc": "none", "ms": 9}, "ring: some draws have no plane"))
        if any(not np.isfinite(over_bound(row)) for row in rows):
            missing.append(({"marker": "x", "ms": 6, "mew": 1.4}, "cross, at the top: no draw has a plane"))
        handles += [Line2D([], [], ls="", color="black", **look) for look, _ in missing]
        labels += [label for _, label in missing]
        made.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8.5)
    return made


def _line(axes: Axes, rows: Sequence[_Row], y: Array, values: Sequence[float], look: _Look, top: float) -> None:
    x, share = np.array([row.value for row in rows], dtype=float), look.place * _SIDE
    logarithmic = rows[0].axis in _LOGARITHMIC
    x = x * (values[-1] / values[0]) ** share if logarithmic else x + (values[-1] - values[0]) * share
    face, found = look.colour, np.isfinite(y)
    axes.plot(x, y, look.line, color=face, lw=1.0, marker=look.marker, ms=4.5, mec="black", mew=0.3, label=look.label)
    # Where planes are missing the marker has a ring; where all are, a cross at the top says so.
    lost = np.array([row.failed > 0.01 * row.draws for row in rows])
    axes.plot(x[lost & found], y[lost & found], "o", ms=9, mfc="none", mec=face, mew=1.2)
    axes.plot(x[~found], np.full(int(np.sum(~found)), 0.8 * top), "x", ms=6, mec=face, mew=1.4)


def _scale(axes: Axes, axis: str, values: Sequence[float], top: float) -> None:
    axes.set_yscale("log")
    axes.set_ylim(0.8, top)
    finer = (1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 7.0) if top < 10 else (1.0, 2.0, 5.0) if top < 1000 else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=finer))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    if axis in _LOGARITHMIC:
        axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(values))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel(_LABELS[axis])
    axes.grid(axis="y")
