"""Figures of what a session covers: the image, the tilts, the depths."""

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from planeopt.calibration.record import AdjustmentRecord, CalibrationFile
from planeopt.look import DARK, LIGHT
from planeopt.report.content import Picture
from planeopt.report.style import ELLIPSE, PAGE_WIDTH, mark_size, page_figure, picture

_CELLS = 8  # across the image
_NAMED = 40  # views at most that get their number
_ENOUGH_DEG = 20.0


def coverage(file: CalibrationFile) -> Picture:
    """Draw where in the image corners and spots were seen."""
    seen = file.observations
    width, height = seen.image_size
    corners = np.vstack([np.reshape(view.corners_px, (-1, 2)) for view in seen.views])
    with page_figure(6.6, 0.55 + 5.9 * height / width) as figure:
        axes = figure.subplots()
        rows = max(1, round(_CELLS * height / width))
        edges = np.linspace(-0.5, width - 0.5, _CELLS + 1), np.linspace(-0.5, height - 0.5, rows + 1)
        count, _, _ = np.histogram2d(*corners.T, bins=edges)
        empty = np.where(count.T > 0, np.nan, 0.0)
        axes.pcolormesh(*edges, empty, cmap="gray", vmin=-0.8, vmax=0.2, lw=0)
        size = mark_size(2.4, len(corners), 2000)
        axes.plot(*corners.T, "o", ms=size, color=DARK, mew=0, label=f"{len(corners)} corners")
        spots = [view.spot for view in seen.views if view.spot is not None]
        for i, spot in enumerate(spots):
            around = _closed(np.array(spot.points_px))
            axes.plot(*around.T, color=ELLIPSE, lw=1.0, label=f"{len(spots)} spots" if i == 0 else None)
        share = 100 * np.count_nonzero(count) / count.size
        axes.set_title(f"corners in {share:.0f} % of {count.size} cells", loc="left")
        axes.set(xlim=edges[0][[0, -1]], ylim=edges[1][[-1, 0]], aspect="equal", xlabel="x (px)", ylabel="y (px)")
        axes.spines[["top", "right"]].set_visible(True)
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1.0), ncols=2, frameon=False, borderpad=0.1, markerscale=3)
        return picture(figure, "The image with all corners and spots that were seen")


def _closed(points: np.ndarray) -> np.ndarray:
    """Return boundary points in their order round their middle, the first again at the end."""
    away = points - points.mean(axis=0)
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]))
    return points[[*order, order[0]]]


def poses(adjustment: AdjustmentRecord) -> Picture:
    """Draw the boards' tilts with their directions, and the depths of boards and spots."""
    views = adjustment.views
    tilt = np.array([view.tilt_deg for view in views])
    direction = np.radians([view.direction_deg for view in views])
    with page_figure(PAGE_WIDTH, 4.0) as figure:
        left: Any = figure.add_subplot(1, 2, 1, projection="polar")
        right = figure.add_subplot(1, 2, 2)
        left.set_theta_direction(-1)  # clockwise, as angles are in an image whose y points down
        top = 5 * np.ceil((max(float(tilt.max()), _ENOUGH_DEG) + 4) / 5)
        around = np.linspace(0, 2 * np.pi, 181)
        left.plot(around, np.full_like(around, _ENOUGH_DEG), color=LIGHT, lw=1.3, ls="--")
        size = mark_size(1.0, len(views), 60)
        left.plot(direction, tilt, "o", color=DARK, ms=5 * size)
        if len(views) <= _NAMED:
            for i, place in enumerate(zip(direction, tilt, strict=True)):
                left.annotate(str(i + 1), place, (4, 3), textcoords="offset points", fontsize=7.5)
        left.set_ylim(0, top)
        left.set_yticks(np.arange(10, top, 10), [f"{value:.0f}°" for value in np.arange(10, top, 10)])
        left.set_xticks(np.radians([0, 90, 180, 270]), ["right", "down", "left", "up"])
        left.set_rlabel_position(np.degrees(_widest_gap(direction)))
        left.set_title("tilt of the boards, and where their far side lies", fontsize=9)
        left.grid(True)
        number = np.arange(1, len(views) + 1)
        boards = [view.depth_mm for view in views]
        ratio = max(boards) / min(boards)
        right.plot(number, boards, "o", color=DARK, ms=5 * size, label=f"boards, farthest over nearest {ratio:.2f}")
        spots = [(i, view.section.along_mm) for i, view in zip(number, views, strict=True) if view.section is not None]
        if spots:
            places, depths = zip(*spots, strict=True)
            ratio = max(depths) / min(depths)
            right.plot(
                places,
                depths,
                "D",
                mfc="none",
                color=ELLIPSE,
                ms=6 * size,
                mew=size,
                label=f"spots, along the beam {ratio:.2f}",
            )
        right.set(xlabel="view", ylabel="depth (mm)", xlim=(0.4, len(views) + 0.6), ylim=(0, None))
        right.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        right.grid(True, axis="y")
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, borderpad=0.1)
        return picture(figure, "Tilts of the boards as points of a polar plot, and depths of boards and spots")


def _widest_gap(directions: np.ndarray) -> float:
    """Return the direction in the middle of where there are none, rad: room for labels."""
    order = np.sort(directions)
    gaps = np.diff([*order, order[0] + 2 * np.pi])
    widest = int(np.argmax(gaps))
    return float(order[widest] + gaps[widest] / 2)
