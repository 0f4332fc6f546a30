"""Figures of how well a rig is known: correlations, and what they cost a plane."""

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from planeopt.calibration.record import AdjustmentRecord, CostRecord
from planeopt.look import DARK, LIGHT
from planeopt.report.calibration_words import SYMBOLS
from planeopt.report.content import Picture
from planeopt.report.style import ELLIPSE, PAGE_WIDTH, page_figure, picture

Array = NDArray[np.float64]


def correlation_matrix(adjustment: AdjustmentRecord) -> Array:
    """Return the correlations (g, g) of an adjustment's parameters."""
    matrix = np.array(adjustment.covariance.matrix)
    sigma = np.sqrt(np.diagonal(matrix))
    return matrix / np.outer(sigma, sigma)


def correlations(adjustment: AdjustmentRecord) -> Picture:
    """Draw the correlations of all parameters, with their numbers."""
    found = correlation_matrix(adjustment)
    names = [SYMBOLS.get(name, name) for name in adjustment.covariance.parameters]
    n = len(names)
    with page_figure(min(PAGE_WIDTH, 1.2 + 0.52 * n), 0.75 + 0.4 * n) as figure:
        axes = figure.subplots()
        shown = axes.imshow(found, cmap="RdBu", vmin=-1, vmax=1, aspect="auto")
        for row in range(n):
            for column in range(n):
                value = found[row, column]
                if row != column:
                    text = f"{value:+.2f}".replace("0.", ".", 1) if abs(value) < _ALL_BUT_ONE else f"{value:+.3f}"
                    colour = "white" if abs(value) > _DARK else "black"
                    drawn = axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
                    drawn.set_in_layout(False)  # it lies within the axes: the layout need not measure each
        axes.set_xticks(range(n), names)
        axes.set_yticks(range(n), names)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        figure.colorbar(shown, ax=axes, shrink=0.8, pad=0.02)
        return picture(figure, "Matrix of the correlations between all parameters")


_ALL_BUT_ONE, _DARK = 0.995, 0.6


def cost(costs: tuple[CostRecord, ...]) -> Picture:
    """Draw what the calibration costs planes: from the joint covariance, and as if its parts were independent."""
    labels = [_plane(one) for one in costs]
    rows = np.arange(len(costs))[::-1]
    kinds = (("offset", "x", LIGHT), ("independent", "o", ELLIPSE), ("sigma", "o", DARK))
    with page_figure(PAGE_WIDTH, 1.0 + 0.24 * len(costs)) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, quantity, title in (
            (panels[0], "z_L_mm", r"sigma of $z_L$ (mm)"),
            (panels[1], "normal_deg", "sigma of the normal (deg)"),
        ):
            values = {kind: np.array([getattr(one, f"{kind}_{quantity}") for one in costs]) for kind, _, _ in kinds}
            axes.hlines(rows, values["sigma"], values["independent"], color="0.75", lw=1)
            for kind, marker, colour in kinds:
                fill = colour if kind == "sigma" else "none"
                axes.plot(values[kind], rows, marker, color=colour, mfc=fill, ms=6, mew=1.4)
            axes.set(xscale="log", xlabel=title)
            axes.grid(True, axis="x")
        panels[0].set_yticks(rows, labels)
        handles = [
            Line2D([], [], color=DARK, marker="o", lw=0, label="joint covariance: what a plane is given"),
            Line2D([], [], color=ELLIPSE, marker="o", mfc="none", lw=0, label="camera and beam as if independent"),
            Line2D([], [], color=LIGHT, marker="x", lw=0, label="e_x and e_y alone"),
        ]
        figure.legend(handles=handles, loc="outside upper right", ncols=3, frameon=False)
        return picture(figure, "Standard deviations of planes from the calibration alone, joint and as if independent")


def _plane(one: CostRecord) -> str:
    if one.beta_deg is None:
        return rf"{one.z_L_mm:.0f} mm, face on"
    return rf"{one.z_L_mm:.0f} mm, {one.alpha_deg:.0f}° towards {one.beta_deg:.0f}°"
