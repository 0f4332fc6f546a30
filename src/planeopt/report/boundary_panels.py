"""The boundary of a spot in a figure: on the image, and its residuals as lines across it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from planeopt.look import DARK
from planeopt.report.pixels import Window, show
from planeopt.report.spot_judged import Judged
from planeopt.report.style import ELLIPSE, POINT, REJECTED
from planeopt.spot import Spot

MARGIN = 1.3  # half side of the piece of the image that is shown, over the spot's
_DRAWN = 72  # points at most where all of the spot is seen: more would hide the ellipse and the edge
_USUAL, _LARGEST = 0.1, 0.22  # of half the panel: how long the residuals are drawn, at most


def bounds(points: NDArray[np.float64]) -> Window:
    """Return the smallest rectangle around points (N, 2), px."""
    (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return Window(left, top, right, bottom)


def draw_spot(
    axes: Axes,
    image: NDArray[Any],
    spot: Spot,
    judged: Judged | None,
    window: Window,
    channel: str,
    *,
    ellipse: str = "fitted ellipse",
) -> tuple[float, float]:
    """Draw the part of an image with a spot, its boundary points and the ellipse; return what is black and white."""
    low, high = show(axes, image, window, channel)
    draw_points(axes, spot, judged, -(-len(spot) // _DRAWN), size=3.2, edge=0.5, ellipse=ellipse)
    axes.set(xlabel="x (px)", ylabel="y (px)")
    # Above the image, of which it would hide something.
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, borderpad=0.1)
    return low, high


def draw_points(
    axes: Axes,
    spot: Spot,
    judged: Judged | None,
    step: int,
    *,
    size: float,
    edge: float,
    ellipse: str = "fitted ellipse",
) -> None:
    """Draw boundary points, one in `step`, those left out, and the ellipse."""
    if judged is not None:
        axes.plot(*judged.curve.T, color=ELLIPSE, lw=1.2, label=ellipse, zorder=2)
    said = f"{len(spot)} points" if step == 1 else f"one in {step} of {len(spot)} points"
    axes.plot(*spot.points[::step].T, "o", ms=size, mfc=POINT, mec="black", mew=edge, label=said, zorder=3)
    if len(spot.rejected):
        left_out = f"{len(spot.rejected)} rejected"
        axes.plot(*spot.rejected.T, "x", ms=size + 2.5, color=REJECTED, mew=1.3, label=left_out, zorder=4)


def draw_hairs(axes: Axes, spot: Spot, judged: Judged, window: Window) -> float:
    """Draw the residuals out of the ellipse, magnified; return how many times."""
    times = magnification(judged.residuals, (window.right - window.left) / 2)
    tips = spot.points + times * judged.residuals[:, None] * judged.normals
    axes.plot(*judged.curve.T, color=ELLIPSE, lw=0.8)
    axes.add_collection(
        LineCollection(
            list(np.stack([spot.points, tips], axis=1)), colors=DARK, linewidths=0.8 if len(spot) < 800 else 0.3
        )
    )
    if len(spot.rejected):
        axes.plot(*spot.rejected.T, "x", ms=4.5, color=REJECTED, mew=1.0)
    axes.set(
        xlabel="x (px)",
        ylabel="y (px)",
        xlim=(window.left, window.right),
        ylim=(window.bottom, window.top),
        aspect="equal",
    )
    return times


def magnification(residuals: NDArray[np.float64], size: float) -> float:
    """Return a round number by which the usual residual and the largest grow to their shares of a size, px."""
    usual, largest = float(np.sqrt(np.mean(residuals**2))), float(np.max(np.abs(residuals)))
    wanted = size * min(_USUAL / max(usual, 1e-9), _LARGEST / max(largest, 1e-9))
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(digit for digit in (1, 2, 5) if digit * power <= wanted * (1 + 1e-9)))


def shown(low: float, high: float) -> str:
    """Say which stored values are black and white."""
    return f"black is {low:.4g}, white {high:.4g}"
