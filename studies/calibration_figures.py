"""Figures of the calibration study."""

from collections.abc import Sequence

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.calibration_fits import QUANTITIES, Errors, of
from studies.calibration_judged import Groups, Judged, pooled
from studies.calibration_models import BOWED, OBLIQUE, ModelRow
from studies.calibration_repeats import ALL
from studies.calibration_sessions import SessionRow
from studies.calibration_summary import ModelSummary
from studies.statistics import LEVEL
from studies.style import DARK, LIGHT, RED, figure

TEX = {
    "f": "$f$",
    "cx": "$c_x$",
    "cy": "$c_y$",
    "e_x": "$e_x$",
    "e_y": "$e_y$",
    "radius": "$r$",
    "direction_x": "$d_x$",
    "direction_y": "$d_y$",
}
_LOOKS = {
    "f": (DARK, "-"),
    "cx": (LIGHT, "-"),
    "cy": (LIGHT, "--"),
    "e_x": (RED, "-"),
    "e_y": (RED, "--"),
    "radius": ("black", "-"),
    "direction_x": ("0.5", "-"),
    "direction_y": ("0.5", "--"),
}
_CLAIMS = np.linspace(0.02, 0.98, 49)


def coverage_figure(groups: Groups, judged: Judged) -> Figure:
    """Draw how much more often than claimed intervals held the truth, and the joint chi-squared's p-values."""
    heading = f"{judged.kept} of {judged.tests} tests of calibrations' claims are within their limits (grey)"
    with figure(13.0, 7.6, heading) as made:
        grid = made.subplots(2, len(groups))
        for column, (group, rows) in enumerate(groups.items()):
            _deviations(grid[0, column], rows, judged.tests)
            _p_values(grid[1, column], rows, judged.tests)
            grid[0, column].set_title(f"{group}: {len(of(rows, 'f_sigmas'))} sessions")
            grid[1, column].set_title(f"{group}: all parameters together")
        grid[0, 0].set_ylabel("truth held, less the claim (%)")
        grid[1, 0].set_ylabel("share of sessions below (%)")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return made


def _deviations(axes: Axes, rows: Sequence[Errors], tests: int) -> None:
    count = len(of(rows, "f_sigmas"))
    limits = scipy.stats.binom.ppf(np.array([[LEVEL / 2 / tests], [1 - LEVEL / 2 / tests]]), count, _CLAIMS)
    axes.fill_between(100 * _CLAIMS, *(100 * (limits / count - _CLAIMS)), color="0.5", alpha=0.18, lw=0)
    axes.axhline(0, color="black", lw=0.8)
    for name, (colour, line) in _LOOKS.items():
        errors = np.abs(of(rows, f"{name}_sigmas"))
        above = [100 * (np.mean(errors <= scipy.stats.norm.ppf((1 + claim) / 2)) - claim) for claim in _CLAIMS]
        axes.plot(100 * _CLAIMS, above, line, color=colour, lw=1.3, label=TEX[name])
    for level in (68, 95):
        axes.axvline(level, color="black", lw=0.6, ls=":", zorder=0)
    axes.set(xlim=(0, 100), xlabel="what the interval claims (%)")
    axes.set_xticks([0, 20, 40, 68, 80, 95])
    axes.grid(axis="y")


def _p_values(axes: Axes, rows: Sequence[Errors], tests: int) -> None:
    values = np.sort(of(rows, "p_value"))
    count = len(values)
    band = scipy.stats.kstwo.isf(LEVEL / tests, count)
    line = np.array([0.0, 1.0])
    axes.fill_between(line, 100 * (line - band), 100 * (line + band), color="0.5", alpha=0.18, lw=0)
    axes.plot(line, 100 * line, color="black", lw=0.8)
    axes.step(np.concatenate([[0], values, [1]]), 100 * np.arange(count + 2) / (count + 1), where="post", color=DARK)
    axes.set(xlim=(0, 1), ylim=(0, 100), xlabel="p-value of the squared error over the joint covariance")
    axes.grid()


def repeats_figure(judged: Judged) -> Figure:
    """Draw reported standard deviations over the scatter of repeats."""
    ratios = [row.ratio for row in pooled(judged).values()]
    heading = (
        f"Reported standard deviations are {min(ratios):.3f} to {max(ratios):.3f} times the scatter over all sessions "
        "(grey: limits; dotted: 15 %)"
    )
    names = [row.session for row in judged.repeats if row.quantity == QUANTITIES[0]]
    with figure(11.0, 4.6, heading) as made:
        axes = made.subplots()
        for place, session in enumerate(names):
            rows = [row for row in judged.repeats if row.session == session]
            at = place + np.linspace(-0.36, 0.36, len(rows))
            axes.fill_between([place - 0.44, place + 0.44], rows[0].least, rows[0].most, color="0.5", alpha=0.18, lw=0)
            for x, row in zip(at, rows, strict=True):
                colour, line = _LOOKS[row.quantity]
                marker = "o" if line == "-" else "s"
                label = TEX[row.quantity] if place == 0 else None
                axes.plot(x, row.ratio, marker, ms=5, color=colour, mfc=colour if line == "-" else "white", label=label)
        axes.axhline(1, color="black", lw=0.8)
        for limit in (0.85, 1.15):
            axes.axhline(limit, color="black", lw=0.8, ls=":")
        labels = [f"all, {_draws(judged, ALL)}" if name == ALL else f"{name}, {_draws(judged, name)}" for name in names]
        axes.set_xticks(range(len(names)), labels)
        axes.set(xlabel="session, draws", ylabel="reported sigma / scatter")
        axes.grid(axis="y")
        axes.legend(loc="upper center", ncols=len(QUANTITIES), bbox_to_anchor=(0.5, -0.16))
    return made


def _draws(judged: Judged, session: str) -> int:
    return next(row.draws for row in judged.repeats if row.session == session)


def models_figure(
    rows: Sequence[ModelRow], summaries: Sequence[ModelSummary], sessions: Sequence[SessionRow]
) -> Figure:
    """Draw what models are worth that lack something, and what the joint covariance is."""
    flat, free = (
        next(row for row in summaries if row.case == BOWED and word in row.model) for word in ("flat", "free")
    )
    heading = (
        f"Errors of f with a bow of 0.5 mm: {100 * flat.f_bias:.2g} % where it is taken as flat, "
        f"{100 * free.f_bias:.2g} % where it is free"
    )
    with figure(13.0, 4.8, heading) as made:
        intervals, beam, planes = made.subplots(1, 3, width_ratios=(1.35, 1, 1))
        _intervals(intervals, summaries)
        _found_angle(beam, rows)
        _apart(planes, sessions)
    return made


def _intervals(axes: Axes, summaries: Sequence[ModelSummary]) -> None:
    places = np.arange(len(summaries))[::-1]
    axes.barh(places + 0.18, [100 * row.covered_95 for row in summaries], 0.34, color=DARK, label="all quantities")
    axes.barh(places - 0.18, [100 * row.worst_95 for row in summaries], 0.34, color=LIGHT, label="the worst")
    axes.axvline(95, color="black", lw=0.8)
    axes.set_yticks(places, [f"{row.case}:\n{row.model}" for row in summaries], fontsize=8)
    axes.set(xlim=(0, 100), xlabel="95 % intervals that hold the truth (%)")
    axes.legend(loc="lower center", ncols=2, bbox_to_anchor=(0.5, 1.0))


def _found_angle(axes: Axes, rows: Sequence[ModelRow]) -> None:
    own = [row for row in rows if row.case == OBLIQUE and row.off_axis_sigma_mrad > 0]
    order = np.argsort([row.off_axis_mrad for row in own])
    found = np.array([own[index].off_axis_mrad for index in order])
    sigma = np.array([own[index].off_axis_sigma_mrad for index in order])
    axes.errorbar(np.arange(1, len(own) + 1), found, 1.96 * sigma, fmt="o", ms=3, color=DARK, lw=1)
    axes.axhline(5, color=RED, lw=1)
    axes.set(
        xlabel="session",
        ylabel="angle found (mrad)",
        title=f"Beam 5 mrad off the axis: {np.mean(found):.2f} ± {np.std(found):.2f}",
    )
    axes.grid(axis="y")


def _apart(axes: Axes, rows: Sequence[SessionRow]) -> None:
    own = [row for row in rows if row.model == "default" and row.z_L_sigma_mm > 0]
    axes.loglog([row.z_L_sigma_mm for row in own], [row.z_L_apart_mm for row in own], ".", color=DARK)
    ends = np.array([min(row.z_L_sigma_mm for row in own), max(row.z_L_apart_mm for row in own)])
    axes.plot(ends, ends, color="black", lw=0.8)
    axes.set(
        xlabel="sigma of $z_L$ by the joint covariance (mm)",
        ylabel="camera and beam as independent (mm)",
        title="One joint covariance",
    )
    axes.grid()
