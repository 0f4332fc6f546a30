"""One target with its measured boundary, and the errors of all targets with their error bars."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch, Rectangle
from numpy.typing import NDArray

from planeopt.accuracy import Score
from planeopt.look import DARK, LIGHT
from planeopt.report.style import ELLIPSE, POINT, look
from planeopt.spot import Spot

_LETTER_SIZE = 9.0
_MARGIN = 1.3  # half side of the piece of the image that is shown, over the spot's
_ZOOM_PX = 9.0  # half side of the piece that is magnified


def accuracy_figure(image: NDArray[np.generic], spot: Spot, scores: Sequence[Score], shown: str) -> Figure:
    """Draw a target and the errors of all.

    Parameters
    ----------
    image : (H, W) or (H, W, C) array
        The target, colour in the order blue, green, red.
    spot : Spot
        Its measured boundary, px.
    scores : sequence of Score
        Of all targets.
    shown : str
        Name of the target that the image shows.

    Returns
    -------
    Figure
        Of matplotlib, not attached to any window.
    """
    with look(_LETTER_SIZE):
        figure = Figure(figsize=(11.0, 3.8), layout="constrained", dpi=160)
        axes = figure.subplot_mosaic([["spot", "zoom", "depth"], ["spot", "zoom", "normal"]], width_ratios=(1, 1, 1.25))
        _draw_spot(axes["spot"], image, spot, shown)
        _draw_zoom(axes["zoom"], axes["spot"], image, spot)
        _draw_depth(axes["depth"], scores)
        _draw_normal(axes["normal"], scores)
        axes["depth"].sharex(axes["normal"])
        axes["depth"].tick_params(labelbottom=False)
        # Titles and labels are laid out when drawn: draw while the style holds.
        figure.canvas.draw()
    return figure


def _draw_spot(axes: Axes, image: NDArray[np.generic], spot: Spot, shown: str) -> None:
    _show(axes, image)
    low, high = spot.points.min(axis=0), spot.points.max(axis=0)
    x, y = (low + high) / 2
    half = _MARGIN * float(np.max(high - low)) / 2
    axes.plot(*np.vstack([spot.points, spot.points[:1]]).T, color=ELLIPSE, lw=1.4)
    axes.set(title=f"{shown}: measured boundary", xlim=(x - half, x + half), ylim=(y + half, y - half))


def _draw_zoom(axes: Axes, whole: Axes, image: NDArray[np.generic], spot: Spot) -> None:
    """Magnify the rightmost piece of the boundary, and mark it in the whole."""
    x, y = spot.points[int(np.argmax(spot.points[:, 0]))].tolist()
    left, right, top, bottom = x - _ZOOM_PX, x + _ZOOM_PX, y - _ZOOM_PX, y + _ZOOM_PX
    _show(axes, image)
    axes.plot(*spot.points.T, "o", ms=5, mfc=POINT, mec="black", mew=0.7)
    axes.set(title=f"{len(spot)} points, between the pixels", xlim=(left, right), ylim=(bottom, top))
    # On the right, clear of the lines that join the two views.
    axes.yaxis.set(ticks_position="right", label_position="right")
    whole.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, ec=ELLIPSE, lw=1.2))
    for corner in (top, bottom):
        line = ConnectionPatch(
            (right, corner), (left, corner), "data", "data", axesA=whole, axesB=axes, color="0.55", lw=0.8
        )
        whole.figure.add_artist(line)


def _show(axes: Axes, image: NDArray[np.generic]) -> None:
    axes.imshow(image if image.ndim == 2 else image[..., 2::-1], cmap="gray", interpolation="nearest")
    axes.set(xlabel="x (px)", ylabel="y (px)")
    axes.spines[:].set_visible(False)


def _draw_depth(axes: Axes, scores: Sequence[Score]) -> None:
    def micrometres(score: Score) -> tuple[float, float]:
        return 1e3 * score.error.depth, 1e3 * (np.nan if score.sigma is None else score.sigma.z_L)

    _error_bars(axes, scores, micrometres, 0.0, "o", DARK, "depth")
    axes.set(title="measured minus true, with bars of one $\\sigma$", ylabel="depth error (µm)")
    _finish(axes)


def _draw_normal(axes: Axes, scores: Sequence[Score]) -> None:
    _error_bars(axes, scores, lambda s: _in_degrees(s.along), -0.5, "o", DARK, r"along the tilt, $\alpha$")
    _error_bars(axes, scores, lambda s: _in_degrees(s.across), 0.5, "s", LIGHT, r"across it, $\beta\,\sin\alpha$")
    axes.set(xlabel="tilt of the target (deg)", ylabel="error of normal (deg)")
    _finish(axes)
    axes.legend(loc="lower center", ncols=2, frameon=False, bbox_to_anchor=(0.5, 0.96), borderpad=0)


def _error_bars(
    axes: Axes,
    scores: Sequence[Score],
    value: Callable[[Score], tuple[float, float]],
    shift: float,
    marker: str,
    colour: str,
    label: str,
) -> None:
    tilt = np.degrees([score.truth.pose.alpha for score in scores]) + shift
    error, sigma = np.array([value(score) for score in scores]).reshape(-1, 2).T
    axes.errorbar(
        tilt, error, sigma, fmt=marker, color=colour, mec="black", mew=0.6, ms=6, capsize=3, lw=1.4, label=label
    )


def _in_degrees(value: tuple[float, float]) -> tuple[float, float]:
    return float(np.degrees(value[0])), float(np.degrees(value[1]))


def _finish(axes: Axes) -> None:
    axes.axhline(0.0, color="black", lw=0.8, zorder=0)
    axes.grid(axis="y", color="0.88", lw=0.6)
    axes.set_axisbelow(True)
    # Errors of both signs at one scale: the zero line in the middle, with room for the legend.
    reach = 1.15 * max(abs(limit) for limit in axes.get_ylim())
    axes.set_ylim(-reach, reach)
