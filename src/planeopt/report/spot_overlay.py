"""A picture of one measured spot, by which a person can judge the measurement."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from planeopt.look import DARK
from planeopt.report.boundary_panels import MARGIN, bounds, draw_hairs, draw_points, draw_spot, shown
from planeopt.report.pixels import Window, show
from planeopt.report.spot_judged import Judged, judge
from planeopt.report.style import BAND, ELLIPSE, POINT, REJECTED, drawable, look
from planeopt.rig import Camera
from planeopt.spot import Spot

_SIZE, _DPI, _LETTER_SIZE = (13.0, 9.2), 100, 8.5
_ZOOMED = 9.0  # px: half side of a magnified piece
_BINS = 72  # of the angle, for the running mean
_PER_BIN = 4  # points at least, else there is no mean worth drawing
_DIRECTIONS = {"right": (1, 0), "bottom": (0, 1), "left": (-1, 0), "top": (0, -1)}
_PANELS: list[Any] = [
    ["spot"] * 4 + ["hairs"] * 4 + ["whole"] * 3,
    ["spot"] * 4 + ["hairs"] * 4 + ["text"] * 3,
    [at for at in _DIRECTIONS for _ in range(2)] + ["text"] * 3,
    ["residuals"] * 8 + ["text"] * 3,
]
_LETTERS = 48  # in a line of the text
_LINES = 38  # of text that the panel holds at its full size


def spot_overlay(
    image: NDArray[Any], spot: Spot, name: str, *, camera: Camera | None = None, channel: str = "gray"
) -> Figure:
    """Draw a spot, its boundary, its residuals and what is to be known about it.

    Parameters
    ----------
    image : (H, W) or (H, W, C) array
        Colour in the order blue, green, red.
    spot : Spot
        Measured in it.
    name : str
        Of the image.
    camera : Camera, optional
        Frees the residuals from the lens's distortion.
    channel : {"gray", "red", "green", "blue"}
        In which the spot was measured.

    Returns
    -------
    Figure
        Of matplotlib, not attached to any window.
    """
    judged = judge(spot, camera)
    with look(_LETTER_SIZE):
        figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
        axes = figure.subplot_mosaic(_PANELS, height_ratios=(1.2, 1.0, 1.1, 1.0), gridspec_kw={"wspace": 0.05})
        window = bounds(np.vstack([spot.points, *([] if judged is None else [judged.curve])]))
        _draw_whole(axes["whole"], image, window.around(MARGIN), name)
        limits = draw_spot(axes["spot"], image, spot, judged, window.around(MARGIN), channel)
        room = 32 if len(spot.rejected) else 18  # for the legend
        axes["spot"].set_title(f"boundary points and fitted ellipse; {shown(*limits)}", pad=room)
        for at in _DIRECTIONS:
            _draw_zoom(axes[at], image, spot, judged, at, channel)
        if judged is None:
            for panel in (axes["hairs"], axes["residuals"]):
                _say(panel, "The points lie on no ellipse.")
        else:
            times = draw_hairs(axes["hairs"], spot, judged, window.around(MARGIN))
            axes["hairs"].set_title(f"residuals along the normals, drawn {times:g} times as long")
            _draw_residuals(axes["residuals"], spot, judged)
        _write(axes["text"], [*_facts(spot, judged), "", *_in_words(spot)])
        _settle(figure)
    return figure


def refusal_picture(image: NDArray[Any], reason: str, name: str) -> Figure:
    """Draw an image in which no spot was measured, with the reason."""
    with look(_LETTER_SIZE):
        figure = Figure(figsize=(8.0, 7.0), dpi=_DPI, layout="constrained")
        axes = figure.subplots(2, 1, height_ratios=(6, 1))
        low, high = show(axes[0], image)
        axes[0].set(title=f"{drawable(name)}: {_size(image)}; {shown(low, high)}", xlabel="x (px)", ylabel="y (px)")
        _write(axes[1], ["No spot was measured.", *textwrap.wrap(reason, 100)])
        _settle(figure)
    return figure


def _settle(figure: Figure) -> None:
    """Make ticks and layout while the style holds, and keep them: else they are made anew for the file."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def _draw_whole(axes: Axes, image: NDArray[Any], window: Window, name: str) -> None:
    show(axes, image)
    corner, width, height = (window.left, window.top), window.right - window.left, window.bottom - window.top
    axes.add_patch(Rectangle(corner, width, height, fill=False, ec=ELLIPSE, lw=1.4))
    title = "\n".join([textwrap.shorten(drawable(name), 50, placeholder="..."), _size(image)])
    axes.set(title=title, xlabel="x (px)", ylabel="y (px)")


def _draw_zoom(axes: Axes, image: NDArray[Any], spot: Spot, judged: Judged | None, at: str, channel: str) -> None:
    """Magnify the outermost piece of the boundary in one direction."""
    line = spot.points if judged is None else judged.curve
    x, y = line[int(np.argmax(line @ _DIRECTIONS[at]))].tolist()
    reach = min(_ZOOMED, 0.6 * float(np.max(np.ptp(line, axis=0))))
    show(axes, image, Window(x - reach, y - reach, x + reach, y + reach), channel)
    draw_points(axes, spot, judged, 1, size=5.0, edge=0.7)
    axes.set(title=f"{at} end", xlabel="x (px)", ylabel="y (px)")
    axes.locator_params(nbins=4)
    axes.ticklabel_format(useOffset=False)


def _draw_residuals(axes: Axes, spot: Spot, judged: Judged) -> None:
    order = np.argsort(judged.angles)
    angles, residuals = judged.angles[order], judged.residuals[order]
    reach = 1.15 * float(np.max(np.abs(residuals), initial=1e-6))
    if spot.sigma is not None:
        sigma = spot.sigma[order]
        reach = max(reach, 2.3 * float(np.median(sigma)))
        for times, shade in zip((2, 1), BAND, strict=True):
            label = rf"$\pm${times}$\sigma$"
            axes.fill_between(angles, -times * sigma, times * sigma, color=shade, lw=0, label=label)
    axes.plot(angles, residuals, ".", ms=3.5, color=DARK, label="points")
    if len(spot.rejected):
        within = np.clip(judged.rejected_residuals, -0.97 * reach, 0.97 * reach)
        axes.plot(judged.rejected_angles, within, "x", ms=4.5, color=REJECTED, label="rejected (at the edge: beyond)")
    if len(spot) >= _BINS * _PER_BIN:
        middles, means = _running_mean(angles, residuals)
        axes.plot(middles, means, color=POINT, lw=1.6, label=f"mean over {360 // _BINS} deg")
    axes.axhline(0.0, color=ELLIPSE, lw=1.0, zorder=5)
    axes.set_title("residuals", loc="left")
    axes.set(
        xlabel="angle round the centre, 0 at the right, 90 at the bottom (deg)",
        ylabel="residual (px, + outside)",
        xlim=(0, 360),
        ylim=(-reach, reach),
        xticks=range(0, 361, 45),
    )
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=5, frameon=False, borderpad=0.1)


def _running_mean(angles: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the middles of the bins and the means in them; NaN, and no line, where a bin has too few points."""
    bins = np.minimum((angles * _BINS / 360).astype(int), _BINS - 1)
    counts = np.bincount(bins, minlength=_BINS)
    means = np.bincount(bins, weights=values, minlength=_BINS) / np.maximum(counts, 1)
    return (np.arange(_BINS) + 0.5) * 360 / _BINS, np.where(counts >= _PER_BIN, means, np.nan)


def _facts(spot: Spot, judged: Judged | None) -> list[str]:
    scatter = None if judged is None else float(np.sqrt(np.mean(judged.residuals**2)))
    size = None if judged is None else np.ptp(judged.curve, axis=0) / 2
    sigma = None if spot.sigma is None else float(np.median(spot.sigma))
    rows = {
        "kind": spot.kind or "unknown",
        "half width, height": "unknown" if size is None else f"{size[0]:.2f}, {size[1]:.2f} px",
        "points, rejected": f"{len(spot)}, {len(spot.rejected)}",
        "arc covered": _number(spot.arc_fraction, 100, ".1f", " %"),
        "sigma, median": _number(sigma, 1, ".4f", " px"),
        "scatter about ellipse": _number(scatter, 1, ".4f", " px"),
        "blur": _number(spot.blur, 1, ".2f", " px"),
        "contrast": _number(spot.contrast, 100, ".1f", " % of full scale"),
        "noise of a pixel": _number(spot.noise, 100, ".2f", " % of full scale"),
        "saturated": _number(spot.saturation, 100, ".1f", " % of the spot"),
    }
    return [f"{name:23}{value}" for name, value in rows.items()]


def _in_words(spot: Spot) -> list[str]:
    if not spot.flags:
        return ["No flags."]
    return [
        line
        for flag in spot.flags
        for line in textwrap.wrap(flag.value, _LETTERS, initial_indent="- ", subsequent_indent="  ")
    ]


def _number(value: float | None, factor: float, style: str, unit: str) -> str:
    return "unknown" if value is None else f"{value * factor:{style}}{unit}"


def _write(axes: Axes, lines: Sequence[str]) -> None:
    axes.set_axis_off()
    size = 8.0 * min(1.0, _LINES / len(lines))
    axes.text(
        0, 1, "\n".join(lines), va="top", family="monospace", size=size, linespacing=1.35, transform=axes.transAxes
    )


def _say(axes: Axes, message: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, message, ha="center", va="center", transform=axes.transAxes)


def _size(image: NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px, {image.dtype}"
