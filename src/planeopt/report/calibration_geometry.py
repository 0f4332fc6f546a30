"""Figures of what was calibrated: the beam against depth, the board's bow."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.calibration.adjusted import WITHIN
from planeopt.calibration.record import AdjustmentRecord, BoardRecord, CalibrationFile, SectionRecord
from planeopt.look import DARK
from planeopt.report.content import Picture
from planeopt.report.style import BAND, ELLIPSE, PAGE_WIDTH, REJECTED, mark_size, page_figure, picture

Array = NDArray[np.float64]

_MICROMETRES = 1e3
_PALE = 20.0  # µm: a bow below this does not take the full range of colours
_LEVELS = 10  # lines of equal depth at most
_ZERO = 1e-9


def beam(adjustment: AdjustmentRecord) -> Picture | None:
    """Draw the beam's sections in the views against depth; None where there are none."""
    found = [(view.section, view.spot_used) for view in adjustment.views if view.section is not None]
    if not found:
        return None
    sections = [section for section, _ in found]
    used = np.array([kept for _, kept in found])
    along = np.array([section.along_mm for section in sections])
    reach = np.linspace(0.93 * along.min(), 1.05 * along.max(), 60)
    with page_figure(PAGE_WIDTH, 4.9) as figure:
        panels = figure.subplots(2, 3, sharex=True)
        for column, (name, kind) in enumerate((("x", 0), ("y", 1), ("radius", 2))):
            measured, fitted, sigma = _column(sections, kind, adjustment)
            above, below = panels[0, column], panels[1, column]
            line = np.polyfit(along, fitted, 1) if len(set(along)) > 1 else np.array([0.0, fitted[0]])
            above.plot(reach, np.polyval(line, reach), color=ELLIPSE, lw=1.5, label="fitted beam")
            _points(above, along, measured, used)
            above.set_title(f"{'radius' if kind == 2 else f'{name} of the middle'} (mm)", loc="left")
            above.ticklabel_format(useOffset=False)
            width = _band(below, adjustment, kind, reach)
            bars = _MICROMETRES * WITHIN * sigma
            away = _MICROMETRES * (measured - fitted)
            size = mark_size(1.0, len(along), 60)
            below.errorbar(along, away, bars, fmt="none", ecolor=DARK, elinewidth=size, capsize=2 * size)
            _points(below, along, away, used)
            below.axhline(0, color=ELLIPSE, lw=1.2)
            below.set_title(f"less the fit (µm), band ±{width:.2g}", loc="left")
            room = 1.25 * float(np.max(np.abs(away) + bars))
            below.set(xlabel="distance along the beam (mm)", ylim=(-room, room))
        panels[0, 0].legend(loc="best", frameon=False)
        return picture(figure, "Middle and radius of the beam in each view against depth, and what is left of them")


def _points(axes: Axes, along: Array, values: Array, used: NDArray[np.bool_]) -> None:
    axes.plot(
        along[used], values[used], "o", color=DARK, ms=mark_size(4.5, len(along), 60), label="spots on their boards"
    )
    if not np.all(used):
        axes.plot(along[~used], values[~used], "x", color=REJECTED, ms=6, mew=1.6, label="left out by rule")


def _column(sections: list[SectionRecord], kind: int, adjustment: AdjustmentRecord) -> tuple[Array, Array, Array]:
    """Return what was measured in each view, what the fitted beam has there, and the measurement's sigma."""
    if kind < _RADIUS:
        measured = np.array([section.centre_mm[kind] for section in sections])
        fitted = np.array([section.axis_mm[kind] for section in sections])
        return measured, fitted, np.array([(section.sigma_x_mm, section.sigma_y_mm)[kind] for section in sections])
    values = {parameter.name: parameter.value for parameter in adjustment.parameters}
    along = np.array([section.along_mm for section in sections])
    return (
        np.array([section.radius_mm for section in sections]),
        values["radius"] + values.get("divergence", 0.0) * along,
        np.array([section.sigma_radius_mm for section in sections]),
    )


_RADIUS = 2


def _band(axes: Axes, adjustment: AdjustmentRecord, kind: int, reach: Array) -> float:
    """Draw the interval of 95 % of the fitted beam, as much as the axes show of it; return its largest half width."""
    names = adjustment.covariance.parameters
    at_zero, slope = (("e_x", "direction_x"), ("e_y", "direction_y"), ("radius", "divergence"))[kind]
    gradient = np.zeros((len(reach), len(names)))
    gradient[:, names.index(at_zero)] = 1.0
    if slope in names:
        gradient[:, names.index(slope)] = reach
    spread = np.sqrt(np.sum(gradient @ np.array(adjustment.covariance.matrix) * gradient, axis=1))
    width = _MICROMETRES * WITHIN * spread
    axes.fill_between(reach, -width, width, color=BAND[0], lw=0)
    return float(width.max())


def warp(file: CalibrationFile, adjustment: AdjustmentRecord) -> Picture | None:
    """Draw the board's bow as a map; None where the board was taken as flat."""
    values = {parameter.name: parameter.value for parameter in adjustment.parameters}
    if "warp_x" not in values:
        return None
    record = file.observations.board
    board = Board(**{name: getattr(record, name) for name in BoardRecord.__struct_fields__})
    width, height = board.size_mm
    x, y = np.meshgrid(np.linspace(0, width, 91), np.linspace(0, height, 71))
    bow = board.bow(np.stack([x, y], axis=-1)) @ [values["warp_x"], values["warp_y"]]
    bow = _MICROMETRES * bow
    limit = max(float(np.max(np.abs(bow))), _PALE)
    with page_figure(6.6, 0.7 + 5.0 * height / width) as figure:
        axes = figure.subplots()
        # Paler is nearer, all of it pale enough to read on; the lines' labels tell a hill from a hollow.
        levels = np.asarray(MaxNLocator(_LEVELS, symmetric=True).tick_values(-limit, limit))
        drawn = axes.contourf(x, y, bow, levels=levels.tolist(), cmap="Blues", vmax=float(3 * levels[-1]))
        widths = np.where(np.abs(levels) < _ZERO * limit, 1.6, 0.7)
        lines = axes.contour(x, y, bow, levels=levels.tolist(), colors="black", linewidths=widths.tolist())
        axes.clabel(lines, fmt=lambda value: f"{value:+g}" if abs(value) > _ZERO * limit else "0", fontsize=8)
        axes.plot(*board.corners[board.printed].T, ".", ms=3, color="black")
        if board.window_mm is not None:
            left, top, across, down = board.window_mm
            axes.add_patch(Rectangle((left, top), across, down, fill=False, color="black", lw=1.0, ls="--"))
        axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
        axes.set_title("depth of the board behind its plane (µm)", loc="left")
        figure.colorbar(drawn, ax=axes, shrink=0.85, format="%+.3g")
        return picture(figure, "Map of the board's bow, with its corners and its window")
