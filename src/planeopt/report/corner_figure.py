"""The samples of a posterior against each other, with the first-order Gaussian over them."""

import math

import corner
import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from planeopt.look import DARK
from planeopt.report.content import Picture
from planeopt.report.style import ELLIPSE, page_figure, picture

Array = NDArray[np.float64]

LEVELS = (0.68, 0.95)
_NAMES = ("z_L", "p", "q")
_FEWEST_FOR_CONTOURS = 300
_SMOOTHED = 1.0  # bins: the contours, which become 2 % wider; without it 2,000 samples leave them ragged
_SHOWN = 0.98  # of the samples, at least, between the ends of each axis, and more by the room beside them
_ROOM = 0.22  # of that: of a Gaussian the ends are then 3.35 sigma away
_AROUND = np.linspace(0, 2 * np.pi, 181)


def corner_figure(samples: Array, plane: Array | None, covariance: Array | None) -> Picture:
    """Draw a corner plot of (z_L, p, q).

    Parameters
    ----------
    samples : (S, 3)
        Of (z_L along the beam, p, q): mm, 1, 1.
    plane : (3,), optional
        Middle of the first-order Gaussian; none is drawn without it.
    covariance : (3, 3), optional
        Its covariance.

    Returns
    -------
    Picture
        Axes count from the medians, whose values are in the titles.
    """
    middle = np.median(samples, axis=0)
    spread = np.maximum(np.diff(np.quantile(samples, [0.16, 0.84], axis=0), axis=0)[0] / 2, 1e-15)
    units = [_unit(width) for width in spread]
    scale = np.array([unit for unit, _ in units])
    labels = [f"{_math(name)} ({_named(name, power)})" for name, (_, power) in zip(_NAMES, units, strict=True)]
    scaled = (samples - middle) * scale
    gauss = None
    if plane is not None and covariance is not None:
        gauss = ((plane - middle) * scale, covariance * np.outer(scale, scale))
    with page_figure(7.4, 7.0, constrained=False) as figure:
        axes = figure.subplots(3, 3)
        corner.corner(
            scaled,
            fig=figure,
            labels=labels,
            range=_ranges(scaled, gauss),
            bins=30,
            levels=LEVELS,
            color=DARK,
            plot_contours=len(samples) >= _FEWEST_FOR_CONTOURS,
            plot_density=False,
            fill_contours=len(samples) >= _FEWEST_FOR_CONTOURS,
            smooth=_SMOOTHED,
            contourf_kwargs={"colors": ["white", "#c9d6e6", "#93adcc"]},
            contour_kwargs={"linewidths": 1.0},
            data_kwargs={"ms": 1.6, "alpha": 0.5},
            hist_kwargs={"density": True, "lw": 1.3},
            max_n_ticks=4,
            use_math_text=True,
        )
        for i, (name, value, decimals) in enumerate(zip(_NAMES, middle, _decimals(spread), strict=True)):
            unit = " mm" if name == "z_L" else ""
            axes[i, i].set_title(f"{_math(name)} from {value:.{decimals}f}{unit}", fontsize=9)
            if gauss is not None:
                _gaussian(axes[i, i], *gauss, i)
            axes[2, i].xaxis.set_label_coords(0.5, -0.17)
            axes[2, i].tick_params(axis="x", labelrotation=0)
        for row in (1, 2):
            axes[row, 0].yaxis.set_label_coords(-0.2, 0.5)
            axes[row, 0].tick_params(axis="y", labelrotation=0)
        if gauss is not None:
            for row, column in ((1, 0), (2, 0), (2, 1)):
                _ellipses(axes[row, column], *gauss, (column, row))
        handles = [Line2D([], [], color=DARK, lw=1.3, label="posterior, samples; areas of 68 and 95 %")]
        if gauss is not None:
            handles.append(Line2D([], [], color=ELLIPSE, lw=1.3, ls="--", label="first order; ellipses of 68 and 95 %"))
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.98, 0.93), frameon=False)
        figure.subplots_adjust(left=0.1, right=0.98, bottom=0.075, top=0.96, wspace=0.07, hspace=0.07)
        return picture(figure, "Corner plot of depth and slopes: posterior samples and the first-order Gaussian")


def _math(name: str) -> str:
    return "$z_L$" if name == "z_L" else f"${name}$"


def _unit(spread: float) -> tuple[float, int]:
    """Return what to multiply by, and the power of ten of the unit: a multiple of three, so that numbers are 1 to 999.

    Depths stay in mm where they spread by 0.1 mm or more.
    """
    power = 3 * math.floor((math.log10(spread) + 1) / 3)
    return 10.0**-power, power


def _named(name: str, power: int) -> str:
    if name == "z_L":
        return {0: "mm", -3: "µm", -6: "nm"}.get(power, rf"$10^{{{power}}}$ mm")
    return "1" if power == 0 else rf"$10^{{{power}}}$"


def _decimals(spread: Array) -> list[int]:
    return [min(max(0, 2 - math.floor(math.log10(width))), 12) for width in spread]


def _ranges(scaled: Array, gauss: tuple[Array, Array] | None) -> list[tuple[float, float]]:
    """Ends of the axes: most samples, the Gaussian's 2.33 sigmas where those are not much wider, and some room."""
    low, high = np.quantile(scaled, [(1 - _SHOWN) / 2, (1 + _SHOWN) / 2], axis=0)
    if gauss is not None:
        reach = scipy.stats.norm.ppf((1 + _SHOWN) / 2) * np.sqrt(np.diagonal(gauss[1]))
        width = high - low
        low = np.maximum(np.minimum(low, gauss[0] - reach), low - width)
        high = np.minimum(np.maximum(high, gauss[0] + reach), high + width)
    room = _ROOM * np.maximum(high - low, 1e-12)
    return [(float(a), float(b)) for a, b in zip(low - room, high + room, strict=True)]


def _gaussian(axes: Axes, centre: Array, covariance: Array, i: int) -> None:
    grid = np.linspace(*axes.get_xlim(), 200)
    density = scipy.stats.norm.pdf(grid, centre[i], math.sqrt(covariance[i, i]))
    axes.plot(grid, density, color=ELLIPSE, lw=1.3, ls="--")
    axes.set_ylim(0, 1.08 * max(axes.get_ylim()[1] / 1.1, float(density.max())))


def _ellipses(axes: Axes, centre: Array, covariance: Array, pair: tuple[int, int]) -> None:
    limits = axes.get_xlim(), axes.get_ylim()
    part = np.ix_(pair, pair)
    factor = np.linalg.cholesky(covariance[part] + 1e-300 * np.eye(2))
    circle = np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=1)
    for level in LEVELS:
        edge = centre[list(pair)] + math.sqrt(scipy.stats.chi2.ppf(level, 2)) * circle @ factor.T
        axes.plot(*edge.T, color=ELLIPSE, lw=1.3, ls="--")
    axes.set(xlim=limits[0], ylim=limits[1])
