"""Figures of one pose: the boundary on the image, and the residuals round it."""

from typing import Any

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from numpy.typing import NDArray

from planeopt.look import DARK
from planeopt.report.boundary_panels import MARGIN, bounds, draw_hairs, draw_points, draw_spot
from planeopt.report.content import Picture
from planeopt.report.pixels import Window, show
from planeopt.report.pose_fit import PoseFit
from planeopt.report.spot_judged import Judged
from planeopt.report.style import BAND, ELLIPSE, PAGE_WIDTH, drawable, page_figure, picture
from planeopt.spot import Spot

_BINS = 36  # of the angle, for the running mean
_PER_BIN = 4  # points at least, else there is no mean worth drawing


def overlay(
    image: NDArray[Any] | None, spot: Spot, judged: Judged | None, name: str, *, posed: bool, channel: str = "gray"
) -> Picture:
    """Draw the boundary points and the ellipse on the image, and the residuals magnified.

    Parameters
    ----------
    image : (H, W) or (H, W, C) array, optional
        None where there are boundary points alone.
    spot : Spot
    judged : Judged or None
        The points beside the ellipse of the plane, or of a fit; None where they are on none.
    name : str
        Of the input.
    posed : bool
        Whether the ellipse is the plane's; else it is fitted to the points.
    channel : {"gray", "red", "green", "blue"}
    """
    window = bounds(np.vstack([spot.points, *([] if judged is None else [judged.curve])])).around(MARGIN)
    ellipse = "expected from the plane" if posed else "fitted ellipse"
    with page_figure(PAGE_WIDTH, 3.6) as figure:
        if image is None:
            near, hairs = figure.subplots(1, 2)
            draw_points(near, spot, judged, 1, size=3.0, edge=0.4, ellipse=ellipse)
            _frame(near, window)
            near.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
        else:
            whole, near, hairs = figure.subplots(1, 3, width_ratios=(1.05, 1.2, 1.2))
            show(whole, image)
            whole.plot(*_outline(window).T, color=ELLIPSE, lw=1.4)
            whole.set(title=f"the image, {image.shape[1]} x {image.shape[0]} px", xlabel="x (px)", ylabel="y (px)")
            draw_spot(near, image, spot, judged, window, channel, ellipse=ellipse)
        if judged is None:
            hairs.set_axis_off()
            hairs.text(0.5, 0.5, "The points lie on no ellipse.", ha="center", transform=hairs.transAxes)
        else:
            times = draw_hairs(hairs, spot, judged, window)
            hairs.set(ylabel="", title=f"residuals, {times:g} times as long")
        words = f"The measured boundary of the spot in {drawable(name)} and its residuals"
        return picture(figure, words, photograph=True)


def residuals(spot: Spot, fit: PoseFit) -> Picture:
    """Draw the residuals in standard deviations against the angle round the spot, and how they are distributed."""
    order = np.argsort(fit.judged.angles)
    angles, whitened = fit.judged.angles[order], fit.whitened[order]
    reach = max(3.3, 1.08 * float(np.max(np.abs(whitened))))
    with page_figure(PAGE_WIDTH, 2.7) as figure:
        around, spread = figure.subplots(1, 2, width_ratios=(4.2, 1), sharey=True)
        for times, shade in zip((2, 1), BAND, strict=True):
            around.axhspan(-times, times, color=shade, lw=0, label=rf"$\pm${times} $\sigma$")
        around.plot(angles, whitened, ".", ms=3.5, color=DARK, label="points")
        if len(spot) >= _BINS * _PER_BIN:
            around.plot(*_running_mean(angles, whitened), color=ELLIPSE, lw=1.5, label=f"mean over {360 // _BINS} deg")
        around.axhline(0, color="black", lw=0.7)
        around.set(
            xlabel="angle round the spot in the image, 0 at the right, 90 at the bottom (deg)",
            ylabel=r"residual ($\sigma$, + outside)",
            xlim=(0, 360),
            ylim=(-reach, reach),
            xticks=range(0, 361, 45),
        )
        around.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, borderpad=0.1)
        _distribution(spread, whitened, reach)
        return picture(figure, "Residuals of the boundary points round the spot, in standard deviations")


def _distribution(axes: Axes, whitened: NDArray[np.float64], reach: float) -> None:
    bins = np.linspace(-reach, reach, max(9, min(41, int(2.5 * np.sqrt(len(whitened))) // 2 * 2 + 1)))
    axes.hist(whitened, bins=bins.tolist(), density=True, orientation="horizontal", color=DARK, alpha=0.75)
    grid = np.linspace(-reach, reach, 200)
    axes.plot(scipy.stats.norm.pdf(grid), grid, color=ELLIPSE, lw=1.5, label="expected")
    axes.set(xlabel=r"density (1/$\sigma$)", xlim=(0, None))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, borderpad=0.1)


def _running_mean(angles: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the middles of the bins and the means in them; NaN, and no line, where a bin has too few points."""
    places = np.minimum((angles * _BINS / 360).astype(int), _BINS - 1)
    counts = np.bincount(places, minlength=_BINS)
    means = np.bincount(places, weights=values, minlength=_BINS) / np.maximum(counts, 1)
    return (np.arange(_BINS) + 0.5) * 360 / _BINS, np.where(counts >= _PER_BIN, means, np.nan)


def _frame(axes: Axes, window: Window) -> None:
    axes.set(
        xlim=(window.left, window.right),
        ylim=(window.bottom, window.top),
        aspect="equal",
        xlabel="x (px)",
        ylabel="y (px)",
    )


def _outline(window: Window) -> NDArray[np.float64]:
    x, y = (window.left, window.right), (window.top, window.bottom)
    return np.array([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]), (x[0], y[0])])
