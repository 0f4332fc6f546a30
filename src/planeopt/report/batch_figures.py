"""Figures of many inputs: how the planes change, and whether chi-squared is distributed as it should be."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from planeopt.look import DARK, LIGHT
from planeopt.report.content import Picture
from planeopt.report.style import BAND, ELLIPSE, PAGE_WIDTH, page_figure, picture

Array = NDArray[np.float64]

DOF = 2
_CRITICAL = (0.95, 0.999)
_NAMED = 24  # points at most that get the number of their image


@dataclass(frozen=True)
class Trend:
    """A quantity over the inputs: NaN where there is none, with its 95 % interval."""

    label: str
    middle: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]


def trends(places: Sequence[float], along: str, quantities: Sequence[Trend], doubtful: Sequence[bool]) -> Picture:
    """Draw quantities against the images' numbers or times, with 95 % intervals.

    Parameters
    ----------
    places : sequence of float
        Of the inputs, along the axis.
    along : str
        What that is.
    quantities : sequence of Trend
    doubtful : sequence of bool
        Which inputs are degraded.
    """
    x, doubt = np.asarray(places, dtype=np.float64), np.asarray(doubtful)
    with page_figure(PAGE_WIDTH, 1.0 + 1.45 * len(quantities)) as figure:
        panels: list[Axes] = list(np.atleast_1d(np.asarray(figure.subplots(len(quantities), 1, sharex=True))))
        for axes, trend in zip(panels, quantities, strict=True):
            middle, low, high = (np.asarray(v, dtype=np.float64) for v in (trend.middle, trend.low, trend.high))
            for chosen, colour, marker, label in ((~doubt, DARK, "o", "ok"), (doubt, LIGHT, "s", "degraded")):
                use = chosen & np.isfinite(middle)
                if not use.any():
                    continue
                bars = np.nan_to_num(np.stack([middle - low, high - middle])[:, use], nan=0.0)
                bars = np.maximum(bars, 0.0)
                axes.errorbar(x[use], middle[use], bars, fmt=marker, color=colour, ms=5, capsize=3, lw=1.2, label=label)
            for place in x[~np.isfinite(middle)]:
                axes.axvline(place, color="0.6", lw=0.9, ls=":")
            axes.set_ylabel(trend.label)
            axes.ticklabel_format(axis="y", useOffset=False)
            axes.grid(axis="y")
            if not np.isfinite(middle).any():
                axes.text(0.5, 0.5, "no input has one", ha="center", va="center", transform=axes.transAxes)
                axes.set_yticks([])
        panels[-1].set_xlabel(along)
        panels[-1].margins(x=0.04)
        if np.all(x == np.round(x)):
            panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        handles, labels = _unique(panels)
        if handles:
            figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
        return picture(figure, "Depth and angles of each image with 95 % intervals")


def chi2_figure(numbers: Sequence[int], p_values: Sequence[float]) -> Picture:
    """Draw chi-squared of each image, and all of them against the distribution that a right rig gives.

    Parameters
    ----------
    numbers : sequence of int
        Of the images.
    p_values : sequence of float
        Theirs. Where a noise scale was estimated chi-squared has another distribution; drawn is the value
        of chi-squared that is as improbable.
    """
    places = np.asarray(numbers)
    values = scipy.stats.chi2.isf(np.clip(p_values, 1e-300, 1.0), DOF)
    top = 1.1 * max(float(values.max()), float(scipy.stats.chi2.ppf(_CRITICAL[1], DOF)))
    with page_figure(PAGE_WIDTH, 3.4) as figure:
        each, together = figure.subplots(1, 2, width_ratios=(1.5, 1))
        each.vlines(places, 0, values, color=DARK, lw=1.2)
        each.plot(places, values, "o", color=DARK, ms=5)
        for share, style in zip(_CRITICAL, ("--", "-"), strict=True):
            limit = float(scipy.stats.chi2.ppf(share, DOF))
            each.axhline(limit, color=ELLIPSE, lw=1.1, ls=style, label=f"{100 * share:g} % of a right rig's are below")
        each.set(xlabel="image", ylabel=r"$\chi^2$ (2 degrees of freedom)", ylim=(0, top))
        each.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        each.margins(x=0.06)
        each.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, borderpad=0.1)
        _quantiles(together, places, values)
        return picture(figure, "Chi-squared of each image, and against its expected distribution")


def _quantiles(axes: Axes, places: Array, values: Array) -> None:
    """Draw sorted values against the quantiles expected of so many, with the 95 % range of each."""
    order = np.argsort(values)
    n = len(values)
    rank = np.arange(1, n + 1)
    expected, low, high = (
        scipy.stats.chi2.ppf(scipy.stats.beta.ppf(share, rank, n + 1 - rank), DOF) for share in (0.5, 0.025, 0.975)
    )
    reach = 1.08 * float(max(expected.max(), 1e-3))
    if n > 1:
        axes.fill_between(expected, low, high, color=BAND[1], lw=0, label="95 % of right rigs")
    else:
        axes.bar(expected, high - low, 0.08 * reach, low, color=BAND[1], label="95 % of right rigs")
    axes.plot([0, reach], [0, reach], color=ELLIPSE, lw=1.1)
    axes.plot(expected, values[order], "o", color=DARK, ms=5)
    if n <= _NAMED:
        for x, y, place in zip(expected, values[order], places[order], strict=True):
            axes.annotate(str(place), (x, y), (4, 3), textcoords="offset points", fontsize=7.5)
    axes.set(xlabel=r"expected $\chi^2$ of that rank", ylabel=r"$\chi^2$, sorted", xlim=(0, reach))
    axes.set_ylim(0, 1.08 * max(float(values.max()), float(high.max())))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, borderpad=0.1)


def _unique(panels: Sequence[Axes]) -> tuple[list, list[str]]:
    found = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)
