"""Figures of the coverage study: intervals against what they claim, ranks against uniform, the wrong rig."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from studies.coverage_checks import LEVELS, RANKS, Checks
from studies.coverage_draws import QUANTITIES
from studies.coverage_rig import COUNTED, IGNORED, WrongRigRow
from studies.coverage_summary import (
    IGNORING,
    METHODS,
    UNCERTAIN,
    CoverageRow,
    RankRow,
    bins_for,
    held,
    ranks_of,
    sigmas_of,
)
from studies.statistics import LEVEL
from studies.style import DARK, LIGHT, RED, figure

LABELS = {"z_L": "$z_L$", "p": "$p$", "q": "$q$", "alpha": r"$\alpha$", "R": "$R$"}
_LOOKS = {"z_L": (DARK, "-"), "p": (LIGHT, "-"), "q": (RED, "-."), "alpha": ("0.35", "--"), "R": ("black", ":")}
_MARKERS = {"z_L": "o", "p": "s", "q": "^", "alpha": "D", "R": "v"}
_CLAIMS = np.linspace(0.02, 0.98, 49)
_APART = 8
"""Claims between two markers of a line."""


def coverage_figure(groups: Mapping[str, Sequence[Checks]], coverage: Sequence[CoverageRow], tests: int) -> Figure:
    """Draw for each group and method how much more often than claimed an interval held the truth, over the claim."""
    judged = [row for row in coverage if row.group != IGNORING]
    inside = sum(row.within for row in judged)
    heading = f"{inside} of {len(judged)} proportions of intervals that hold the truth are within their limits (grey)"
    panels = [(group, method) for group in groups for method in METHODS]
    with figure(12.0, 4.0 * len(groups), heading) as made:
        grid = np.ravel(made.subplots(len(groups), len(METHODS), sharex=True, sharey="row"))
        for axes, (group, method) in zip(grid, panels, strict=True):
            _deviations(axes, groups[group], method, tests)
            trusted = "where it may be trusted, " if method == "Laplace" else ""
            axes.set_title(f"{group}: {method}, {trusted}{_counts(groups[group], method)}")
        for axes in grid[-len(METHODS) :]:
            axes.set_xlabel("what the interval claims (%)")
        for axes in grid[:: len(METHODS)]:
            axes.set_ylabel("truth held, less the claim (%)")
        handles, labels = grid[0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return made


def _counts(rows: Sequence[Checks], method: str) -> str:
    of = sigmas_of if method == "Laplace" else ranks_of
    least, most = (f(len(of(rows, name)) for name in QUANTITIES) for f in (min, max))
    return f"{most} sets" if least == most else f"{least} to {most} sets"


def _deviations(axes: Axes, rows: Sequence[Checks], method: str, tests: int) -> None:
    of = sigmas_of if method == "Laplace" else ranks_of
    fewest = min(len(of(rows, name)) for name in QUANTITIES)
    # Where the fewest sets are the limits are widest; the judgement takes each quantity's own number.
    most = max(len(of(rows, name)) for name in QUANTITIES)
    for count, shade in ((fewest, 0.10), (most, 0.18)):
        limits = scipy.stats.binom.ppf(np.array([[LEVEL / 2 / tests], [1 - LEVEL / 2 / tests]]), count, _CLAIMS)
        axes.fill_between(100 * _CLAIMS, *(100 * (limits / count - _CLAIMS)), color="0.5", alpha=shade, lw=0)
    axes.axhline(0, color="black", lw=0.8)
    for name in QUANTITIES:
        colour, line = _LOOKS[name]
        inside = held(rows, method, name)
        above = [100 * (inside(claim).mean() - claim) for claim in _CLAIMS]
        axes.plot(
            100 * _CLAIMS,
            above,
            line,
            color=colour,
            lw=1.4,
            marker=_MARKERS[name],
            ms=4.5,
            markevery=_APART,
            label=LABELS[name],
        )
        marks = [100 * (inside(level).mean() - level) for level in LEVELS]
        axes.plot([100 * level for level in LEVELS], marks, _MARKERS[name], ms=4.5, color=colour)
    for level in LEVELS:
        axes.axvline(100 * level, color="black", lw=0.6, ls=":", zorder=0)
    axes.set_xlim(0, 100)
    axes.set_xticks([0, 20, 40, 68, 80, 95])
    axes.grid(axis="y")


def rank_figure(groups: Mapping[str, Sequence[Checks]], ranks: Sequence[RankRow], tests: int) -> Figure:
    """Draw how often each rank of the truth among the posterior's draws occurred."""
    shown = [row for row in ranks if row.group in groups]
    heading = (
        f"Ranks of the truth among {RANKS - 1} draws of the posterior: the smallest of {len(shown)} p-values is "
        f"{min(row.p_value for row in shown):.2g} (right: above {shown[0].least:.1g}); grey: limits of a bin"
    )
    with figure(13.0, 2.7 * len(groups), heading) as made:
        grid = made.subplots(len(groups), len(QUANTITIES), sharex=True, sharey="row", squeeze=False)
        for line, (group, rows) in zip(grid, groups.items(), strict=True):
            for axes, name in zip(line, QUANTITIES, strict=True):
                _histogram(axes, ranks_of(rows, name), tests)
                p_value = next(row.p_value for row in shown if (row.group, row.quantity) == (group, name))
                axes.set_title(f"{LABELS[name]}, {group}: p = {p_value:.2g}")
            line[0].set_ylabel("sets in a bin")
        for axes in grid[-1]:
            axes.set_xlabel("rank of the truth")
    return made


def _histogram(axes: Axes, ranks: np.ndarray, tests: int) -> None:
    bins = bins_for(len(ranks))
    edges = np.linspace(0, RANKS, bins + 1)
    tail = LEVEL / 2 / tests / bins
    least, most = scipy.stats.binom.ppf([tail, 1 - tail], len(ranks), 1 / bins)
    axes.stairs(np.histogram(ranks, edges)[0], edges, fill=True, color=DARK, alpha=0.45, lw=0)
    axes.axhspan(least, most, color="0.5", alpha=0.18, lw=0)
    for limit in (least, most):
        axes.axhline(limit, color="black", lw=0.8, ls=":")
    axes.axhline(len(ranks) / bins, color="black", lw=0.8)
    axes.set_xlim(0, RANKS)
    axes.set_ylim(0, 1.1 * most)


def rig_figure(rows: Sequence[WrongRigRow], coverage: Sequence[CoverageRow]) -> Figure:
    """Draw what becomes of intervals that take a calibration with offsets uncertain by 0.04 mm as exact."""
    counted, ignored = (
        [100 * row.share for row in coverage if (row.group, row.method, row.level) == (group, "posterior", LEVELS[1])]
        for group in (UNCERTAIN, IGNORING)
    )
    heading = (
        f"Offset known to 0.04 mm: ignored, 95 % intervals hold the truth in {_span(ignored)} % of sets; counted, in "
        f"{_span(counted)} %"
    )
    with figure(12.0, 4.6, heading) as made:
        claims, examples = made.subplots(1, 2, width_ratios=(1, 1.25))
        _claims(claims, rows)
        _examples(examples, rows)
    return made


def _span(percents: Sequence[float]) -> str:
    least, most = f"{min(percents):.0f}", f"{max(percents):.0f}"
    return least if least == most else f"{least} to {most}"


def _claims(axes: Axes, rows: Sequence[WrongRigRow]) -> None:
    axes.plot([0, 100], [0, 100], color="black", lw=0.8, zorder=0)
    for group in (COUNTED, IGNORED):
        members = [row for row in rows if row.rig == group]
        # With an exact radius R says what the tilt says.
        for name in QUANTITIES[:-1]:
            inside = held(members, "posterior", name)
            line = "-" if group == COUNTED else "--"
            shares = [100 * inside(claim).mean() for claim in _CLAIMS]
            label = LABELS[name] if group == COUNTED else None
            axes.plot(
                100 * _CLAIMS,
                shares,
                line,
                color=_LOOKS[name][0],
                lw=1.3,
                marker=_MARKERS[name],
                ms=4.5,
                markevery=_APART,
                label=label,
            )
    axes.set(
        xlim=(0, 100),
        ylim=(0, 100),
        xlabel="what the interval claims (%)",
        ylabel="held the truth (%)",
        title=f"posterior, {len(ranks_of(rows, 'q')) // 2} sets; full lines: covariance counted, broken: ignored",
    )
    axes.grid()
    axes.legend(loc="upper left")


_EXAMPLES = 30


def _examples(axes: Axes, rows: Sequence[WrongRigRow]) -> None:
    shown = 0
    for group, colour, shift in ((COUNTED, DARK, -0.17), (IGNORED, LIGHT, 0.17)):
        members = [row for row in rows if row.rig == group and np.isfinite(row.q_low95)][:_EXAMPLES]
        shown = len(members)
        at = np.arange(shown) + 1 + shift
        low, high = (np.array([getattr(row, end) for row in members]) for end in ("q_low95", "q_high95"))
        axes.vlines(at, low, high, color=colour, lw=2.0, label=f"calibration's covariance {group}")
        missed = (low > 0) | (high < 0)
        axes.plot(at[missed], ((low + high) / 2)[missed], "x", color=colour, ms=5)
    axes.axhline(0, color="black", lw=0.8)
    axes.set(
        xlabel="set",
        ylabel="95 % interval of the slope $q$, less the true $q$",
        title=f"the first {shown} sets; crosses: the truth is outside",
        xlim=(0, shown + 1),
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(axis="y")
    axes.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, -0.14))
