"""Figures of what a calibration leaves unexplained: over the image, view by view, and how it is distributed."""

from dataclasses import dataclass

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from numpy.typing import NDArray

from planeopt.calibration.noise import ELLIPSE as ELLIPSE_NUMBERS
from planeopt.calibration.record import AdjustmentRecord, CalibrationFile
from planeopt.look import DARK, LIGHT
from planeopt.report.content import Picture
from planeopt.report.style import BAND, ELLIPSE, PAGE_WIDTH, REJECTED, page_figure, picture

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ARROWS = 4000  # drawn at most
_CELLS = 12  # across the image
_PER_CELL = 4  # corners at least
_SHARE = 28  # of the image's width takes an arrow of the key's length
_CHANCE = 0.01  # of marking any cell of a picture without cause
_DOTTED = 80  # views at most whose single residuals are drawn
_REACH = 5.0  # sigma, of the strips


@dataclass(frozen=True, eq=False)
class Left:
    """What is left of all observations; N corners, M points of boundaries.

    Parameters
    ----------
    places : (N, 2) array
        Of the corners, px.
    corners : (N, 2) array
        Observed minus predicted, px.
    sigma : (N,) array
        Of each coordinate, px, as the adjustment found it.
    used : (N,) array of bool
    view : (N,) array of int
    spots : (M,) array
        Standard deviations.
    spot_used : (M,) array of bool
    spot_view : (M,) array of int
    spot_rms : (V,) array
        Root mean square of the five numbers of each view's ellipse, standard deviations; NaN without a spot in use.
    """

    places: Array
    corners: Array
    sigma: Array
    used: Mask
    view: NDArray[np.int64]
    spots: Array
    spot_used: Mask
    spot_view: NDArray[np.int64]
    spot_rms: Array

    @classmethod
    def of(cls, file: CalibrationFile, adjustment: AdjustmentRecord) -> "Left":
        """Return what is left of the observations of a file."""
        seen, fits, noise = file.observations.views, adjustment.views, adjustment.noise
        spots, kept, whose = [], [], []
        misfit = [fit.spot_chi2 if fit.spot_used and fit.spot_chi2 is not None else np.nan for fit in fits]
        for i, (view, fit) in enumerate(zip(seen, fits, strict=True)):
            if view.spot is None or not fit.spot_residuals_px:
                continue
            residuals = np.array(fit.spot_residuals_px)
            sigma = 1.0 if view.spot.sigma_px is None else np.array(view.spot.sigma_px)
            spots.append(residuals / (sigma * noise.spot_factor))
            kept.append(np.full(len(residuals), fit.spot_used))
            whose.append(np.full(len(residuals), i))
        return cls(
            places=np.vstack([np.reshape(view.corners_px, (-1, 2)) for view in seen]),
            corners=np.vstack([np.reshape(fit.corner_residuals_px, (-1, 2)) for fit in fits]),
            sigma=np.concatenate([view.sigma_px for view in seen]) * noise.corner_factor,
            used=np.concatenate([fit.corner_used for fit in fits]).astype(bool),
            view=np.repeat(np.arange(len(seen)), [len(view.ids) for view in seen]),
            spots=np.concatenate(spots) if spots else np.empty(0),
            spot_used=np.concatenate(kept) if kept else np.empty(0, dtype=bool),
            spot_view=np.concatenate(whose) if whose else np.empty(0, dtype=np.int64),
            spot_rms=np.sqrt(np.array(misfit) / ELLIPSE_NUMBERS) / noise.spot_factor,
        )

    @property
    def whitened(self) -> Array:
        """Corners (N, 2) in standard deviations."""
        return self.corners / self.sigma[:, None]


def vectors(file: CalibrationFile, left: Left) -> Picture:
    """Draw the corners' residuals over the image, each and the means of cells."""
    width, height = file.observations.image_size
    shape = height / width
    with page_figure(PAGE_WIDTH, 0.62 + 4.9 * shape) as figure:
        each, means = figure.subplots(1, 2, sharey=True)
        step = max(1, -(-len(left.places) // _ARROWS))
        lengths = np.linalg.norm(left.corners[left.used], axis=1)
        unit = _round(float(np.quantile(lengths, 0.95)))
        _arrows(each, left.places[left.used][::step], left.corners[left.used][::step], unit, width, DARK)
        out = ~left.used
        if np.any(out):
            each.plot(*left.places[out].T, "x", color=REJECTED, ms=6, mew=1.6, label="left out by rule")
            each.legend(loc="lower left", bbox_to_anchor=(0.17, 1.0), frameon=False, borderpad=0.1)
        drawn = "each corner" if step == 1 else f"one corner in {step}"
        each.set_title(drawn, loc="right")
        _means(means, left, width, height)
        for axes in (each, means):
            axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="x (px)")
            axes.spines[["top", "right"]].set_visible(True)
        each.set_ylabel("y (px)")
        return picture(figure, "Residuals of the corners as arrows over the image, each and averaged in cells")


def _arrows(
    axes: Axes, places: Array, arrows: Array, unit: float, width: int, colour: str | list[str], *, thick: float = 1
) -> None:
    """Draw arrows, one of length `unit` taking a share of the image, and a key above them."""
    drawn = axes.quiver(
        *places.T,
        *arrows.T,
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=_SHARE * unit / width,
        width=0.0022 * thick,
        headwidth=3.5,
        headlength=4,
        headaxislength=3.6,
    )
    axes.quiverkey(drawn, 0.035, 1.045, unit, f"{unit:g} px", labelpos="E", coordinates="axes", color=DARK)


def _means(axes: Axes, left: Left, width: int, height: int) -> None:
    size = width / _CELLS
    across = np.clip(((left.places[:, 0] + 0.5) / size).astype(int), 0, _CELLS - 1)
    rows = max(1, round(height / size))
    down = np.clip(((left.places[:, 1] + 0.5) / (height / rows)).astype(int), 0, rows - 1)
    cell = (down * _CELLS + across)[left.used]
    count = np.bincount(cell, minlength=rows * _CELLS)
    weight = 1 / left.sigma[left.used] ** 2
    total = np.bincount(cell, weight, minlength=rows * _CELLS)
    mean = [np.bincount(cell, weight * part, minlength=rows * _CELLS) for part in left.corners[left.used].T]
    enough = count >= _PER_CELL
    shift = np.stack(mean, axis=1)[enough] / total[enough, None]
    odd = scipy.stats.chi2.sf(np.sum(shift**2, axis=1) * total[enough], 2) < _CHANCE / max(len(shift), 1)
    where = np.flatnonzero(enough)
    middle = [(where % _CELLS + 0.5) * size - 0.5, (where // _CELLS + 0.5) * height / rows - 0.5]
    places = np.stack(middle, axis=1).astype(np.float64)
    for line in np.arange(1, _CELLS) * size - 0.5:
        axes.axvline(line, color="0.92", lw=0.7, zorder=0)
    for line in np.arange(1, rows) * height / rows - 0.5:
        axes.axhline(line, color="0.92", lw=0.7, zorder=0)
    axes.set_title(f"means of cells, {np.count_nonzero(odd)} of {len(where)} beyond chance", loc="right")
    if not len(where):
        return
    unit = _round(float(np.quantile(np.linalg.norm(shift, axis=1), 0.9)))
    _arrows(axes, places, shift, unit, width, np.where(odd, LIGHT, DARK).tolist(), thick=1.7)


def _round(value: float) -> float:
    """Return a number that begins with 1, 2 or 5 and is close below a value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-12)))
    return float(power * max(digit for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-9) or digit == 1))


def strips(left: Left) -> Picture:
    """Draw the residuals view by view, in standard deviations."""
    views = int(left.view.max()) + 1
    with_spots = bool(left.spots.size)
    with page_figure(PAGE_WIDTH, 4.4 if with_spots else 2.6) as figure:
        made = figure.subplots(2 if with_spots else 1, 1, sharex=True, squeeze=False)[:, 0]
        spread = np.concatenate([left.whitened[:, 0], left.whitened[:, 1]])
        used, view = np.tile(left.used, 2), np.tile(left.view, 2)
        _strip(made[0], spread, used, view, views)
        _bars(made[0], _rms(spread[used], view[used], views), "root mean square")
        made[0].set_ylabel(r"corners ($\sigma$)")
        if with_spots:
            _strip(made[1], left.spots, left.spot_used, left.spot_view, views)
            _bars(made[1], left.spot_rms, "root mean square of the ellipse's five numbers")
            made[1].set_ylabel(r"spot's boundary ($\sigma$)")
        made[-1].set_xlabel("view")
        for axes in made:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1.0), ncols=4, frameon=False, borderpad=0.1)
        return picture(figure, "Residuals of corners and of the spots' boundaries in each view, in standard deviations")


def _strip(axes: Axes, values: Array, used: Mask, view: NDArray[np.int64], views: int) -> None:
    for times, shade in zip((2, 1), BAND, strict=True):
        axes.axhspan(-times, times, color=shade, lw=0)
    if views <= _DOTTED:
        # Spread over the width of the view's place in the order in which they come.
        order = np.arange(len(values)) * 0.6180339887498949 % 1 - 0.5
        shown = np.clip(values, -_REACH, _REACH)
        axes.plot((view + 1 + 0.62 * order)[used], shown[used], ".", ms=1.8, color=DARK, alpha=0.55, label="each")
        if not np.all(used):
            axes.plot(
                (view + 1 + 0.62 * order)[~used],
                shown[~used],
                "x",
                ms=4.5,
                mew=1.3,
                color=REJECTED,
                label=f"left out ({_REACH:g} and beyond at the edge)",
            )
    axes.axhline(0, color="black", lw=0.6)
    axes.set(xlim=(0.4, views + 0.6), ylim=(-_REACH - 0.3, _REACH + 0.3))


def _rms(values: Array, view: NDArray[np.int64], views: int) -> Array:
    """Return the root mean squares (views,) of each view's values, NaN where there are none."""
    squares, count = np.bincount(view, values**2, minlength=views), np.bincount(view, minlength=views)
    return np.sqrt(np.divide(squares, count, out=np.full(views, np.nan), where=count > 0))


def _bars(axes: Axes, rms: Array, label: str) -> None:
    """Draw a root mean square of each view where there is one, above and below zero; beyond the edge, at it."""
    there = np.flatnonzero(np.isfinite(rms))
    height = np.minimum(rms[there], _REACH)
    both = np.concatenate([height, -height])
    axes.hlines(both, np.tile(there + 0.6, 2), np.tile(there + 1.4, 2), color=ELLIPSE, lw=1.8, label=label)


def histograms(left: Left, adjustment: AdjustmentRecord) -> Picture:
    """Draw how the residuals are distributed, against the normal that is expected."""
    noise = adjustment.noise
    shrunk = float(np.sqrt(noise.dof_corners / max(2 * noise.corners, 1)))
    panels = [("corners, x and y", left.whitened[left.used].ravel(), shrunk)]
    if left.spot_used.any():
        panels.append(("points of the spots' boundaries", left.spots[left.spot_used], 1.0))
    with page_figure(PAGE_WIDTH if len(panels) > 1 else 5.0, 2.9) as figure:
        for axes, (title, values, width) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            reach = max(4.2, 1.05 * float(np.max(np.abs(values), initial=0.0)))
            bins = max(15, min(61, int(2 * len(values) ** (1 / 3)) // 2 * 2 + 1))
            axes.hist(values, bins=np.linspace(-reach, reach, bins).tolist(), density=True, color=DARK, alpha=0.75)
            grid = np.linspace(-reach, reach, 241)
            axes.plot(grid, scipy.stats.norm.pdf(grid, scale=width), color=ELLIPSE, lw=1.6, label="expected")
            spread = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
            axes.set(xlabel=r"residual ($\sigma$)", ylabel=r"density (1/$\sigma$)", xlim=(-reach, reach))
            axes.set_title(f"{title}: {len(values)}, root mean square {spread:.2f}", loc="left")
            axes.legend(loc="upper right", frameon=False)
        return picture(figure, "Histograms of the residuals in standard deviations, with the normal curve")
