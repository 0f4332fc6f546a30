"""Figure 7: how the searches run from the paper's start."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from planeopt import paper
from planeopt.reproduction.results import Reproduction
from planeopt.reproduction.searches import Search
from planeopt.reproduction.style import FAINT, SECOND, TRUE, new_figure

_ROWS = (r"$R$ (mm)", r"$z_L$ (mm)", r"$\alpha$ (deg)", r"$\beta$ (deg)")
_TO_SHOWN = np.array([1.0, 1.0, 180 / np.pi, 180 / np.pi])
_GUARDED = {"color": TRUE, "lw": 1.8}
_HALVED = {"color": FAINT, "lw": 1.5, "ls": (0, (1, 1.2))}
_UNGUARDED = {"color": SECOND, "lw": 1.8, "ls": (0, (4, 1.5))}


def figure7(result: Reproduction) -> Figure:
    """Draw the four unknowns and the misfit of the ten equations against the iterations, IPOPT left, SWIFT right."""
    ipopt, swift, unguarded, halved = result.searches
    heading = "Figure 7: searches from the paper's start, $R$ = 10 mm, $z_L$ = 250 mm, $\\alpha$ = $\\beta$ = 20 deg"
    with new_figure(11.0, 9.6, heading) as figure:
        axes = figure.subplots(5, 2, sharex="col", sharey="row")
        left, right = axes[:, 0].tolist(), axes[:, 1].tolist()
        _lines(left, halved, _HALVED, f"IPOPT, the same with the objective halved: ends on {halved.end}")
        _lines(left, unguarded, _UNGUARDED, f"IPOPT without the visibility inequalities: ends on {unguarded.end}")
        _lines(left, ipopt, _GUARDED, f"IPOPT, Constrained: ends on {ipopt.end}")
        _lines(right, swift, _GUARDED, f"SWIFT, Penalty: ends on {swift.end}")
        _references(left, result)
        _references(right, result)
        _stages(left, ipopt, "weighted by\n$\\Sigma_B^{-1}$ from here")
        _stages(right, swift, "weight times 10\nhere and on")
        _finish(left, right, ipopt, swift)
        _legend(figure, left[0])
    return figure


def _lines(column: list[Axes], search: Search, look: dict, label: str) -> None:
    iterations = np.arange(len(search.poses))
    for axes, values in zip(column, [*(search.poses * _TO_SHOWN).T, search.misfit], strict=True):
        axes.plot(iterations, values, label=label, **look)


def _references(column: list[Axes], result: Reproduction) -> None:
    """Mark the true and the second plane's values as lines."""
    pose = result.second_plane.pose
    second = np.array([pose.R, pose.z_L, pose.alpha, pose.beta], dtype=float) * _TO_SHOWN
    truth = np.array(paper.TRUTH) * _TO_SHOWN
    # The row of the residual, the last one, has no such value.
    for axes, true, other in zip(column[: len(truth)], truth, second, strict=True):
        axes.axhline(true, color="black", lw=0.8, zorder=1, label="the plane")
        axes.axhline(other, color=SECOND, lw=0.8, ls=(0, (6, 3)), zorder=1, label="the second plane")


def _stages(column: list[Axes], search: Search, label: str) -> None:
    """Mark where the weights change."""
    changes = np.flatnonzero(np.diff(search.stage)) + 1
    for axes in column:
        for change in changes.tolist():
            axes.axvline(change, color="0.8", lw=0.8, zorder=0)
    top = column[0]
    text = {"textcoords": "offset points", "va": "top", "fontsize": 8.5, "color": "0.3"}
    top.annotate(label, (changes[0], 1), xytext=(4, -2), xycoords=top.get_xaxis_transform(), **text)


def _finish(left: list[Axes], right: list[Axes], ipopt: Search, swift: Search) -> None:
    for axes, label in zip(left, [*_ROWS, "largest relative\nresidual of the ten"], strict=True):
        axes.set_ylabel(label)
    for column in (left, right):
        column[4].set_yscale("log")
        for axes in column:
            axes.grid(axis="y")
    left[0].set_title(f"IPOPT, Constrained: {_cost(ipopt)}")
    right[0].set_title(f"SWIFT, Penalty: {_cost(swift)}")
    left[4].set_xlabel("iteration")
    right[4].set_xlabel("iteration")


def _cost(search: Search) -> str:
    effort = search.effort
    return f"{effort.evaluations} evaluations, {effort.derivative_evaluations or 'none'} of derivatives"


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    halved, unguarded, guarded, true, second = handles
    order = [guarded, unguarded, halved, true, second]
    names = [labels[handles.index(handle)] for handle in order]
    figure.legend(order, names, loc="outside lower left", ncols=2, columnspacing=2.5)
