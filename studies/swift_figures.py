"""The figures of the study of SWIFT."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from planeopt import paper
from studies.style import DARK, FAINT, LIGHT, RED, figure
from studies.swift_paths import ValleyRow, WorkRow
from studies.swift_runs import AT_MINIMISER, DEFAULT, READINGS, STARTS
from studies.swift_summary import IN_WORDS, EndRow, Tables, ends, median_calls, slope_of_tolerance
from studies.swift_weights import ToleranceRow, WeightRow

_FLOOR = 1e-17
_MARKERS = "osD^v"


def weights_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw what the weight does to the minimiser, the beam's equation, the error and a simplex of equal values."""
    heading = (
        f"J = 0: the weight moves the minimiser by at most {said['J_0_minimiser_moves_at_most']:.0e}; "
        f"J = image block: the violation goes as weight^"
        f"{said['image_objective_violation_falls_with_weight_to_the_power']:.2f}"
    )
    with figure(11.5, 7.4, heading) as made:
        (moved, violation), (error, tolerance) = made.subplots(2, 2)
        _over_weights(moved, tables.weights, "most_from_weight_1")
        moved.set(title="how far the minimiser is from that at weight 1", ylabel="relative in depth, or rad")
        _over_weights(violation, tables.weights, "laser_violation")
        _guide(violation, -1.0, 1e-3, 1e-9)
        violation.set(title="violation of the beam's equation", ylabel="|R cos(alpha) - r| / r (median)")
        _over_weights(error, tables.weights, "over_constrained")
        error.axhline(1, color="black", lw=0.8)
        error.set(title="RMS error over that of the constrained programme", ylabel="ratio (1: Constrained)")
        error.set_yscale("log")
        error.set_yticks([1, 1.5, 2, 3, 5], ["1", "1.5", "2", "3", "5"], minor=False)
        error.minorticks_off()
        _draw_tolerances(tolerance, tables.tolerances)
        for axes in (moved, violation, error):
            axes.set(xlabel="weight of (29)", xscale="log")
        for axes in (moved, violation, error, tolerance):
            axes.grid(visible=True)
        made.legend(*moved.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return made


def _over_weights(axes: Axes, rows: Sequence[WeightRow], column: str) -> None:
    problems = list(dict.fromkeys(row.problem for row in rows))
    looks: tuple[dict[str, Any], ...] = ({"color": DARK, "ls": "-"}, {"color": LIGHT, "ls": "--"})
    for reading, look in zip(READINGS, looks, strict=True):
        for problem, marker in zip(problems, _MARKERS, strict=False):
            # From itself the answer at weight 1 is nowhere.
            left_out = 1.0 if column == "most_from_weight_1" else None
            own = [row for row in rows if (row.problem, row.reading) == (problem, reading) and row.weight != left_out]
            y = np.maximum([getattr(row, column) for row in own], _FLOOR)
            label = f"{IN_WORDS[reading]}, {problem}"
            axes.plot([row.weight for row in own], y, marker=marker, ms=4, lw=1.1, label=label, **look)
    if column != "over_constrained":
        axes.set_yscale("log")


def _guide(axes: Axes, power: float, x: float, y: float) -> None:
    other = x * 1e4
    axes.plot([x, other], [y, y * (other / x) ** power], color="black", lw=1.6, ls=":")
    axes.annotate(f"weight^{power:g}", (x, y), (4, 4), textcoords="offset points")


def _draw_tolerances(axes: Axes, rows: Sequence[ToleranceRow]) -> None:
    problems = list(dict.fromkeys(row.problem for row in rows))
    for problem, marker in zip(problems, _MARKERS, strict=False):
        own = [row for row in rows if row.problem == problem]
        weight, off = ([getattr(row, name) for row in own] for name in ("weight", "to_minimiser"))
        axes.plot(weight, off, marker=marker, ms=4, lw=1.1, color=DARK, label=problem)
    axes.set(xscale="log", yscale="log", xlabel="weight, J = 0, the only one of its schedule")
    _guide(axes, -0.5, 1e4, 1e-4)
    title = f"where a simplex of equal values ends: weight^{slope_of_tolerance(rows):.2f}"
    axes.set(title=title, ylabel="to the minimiser: relative, or rad")
    axes.legend(loc="lower left")


def schedules_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw where the searches from the paper's start end, by schedule and reading."""
    heading = (
        f"From the paper's start: J = image block and a rising weight find the minimiser in "
        f"{said['image_objective_schedule_at_minimiser']} of {said['searches_from_paper_start']} problems, J = 0 in "
        f"{said['J_0_schedule_at_minimiser']}"
    )
    with figure(11.5, 4.6, heading) as made:
        for axes, reading in zip(made.subplots(1, 2, sharex=True), READINGS, strict=True):
            rows = [row for row in tables.ends if row.start == "paper's" and row.reading == reading]
            _draw_ends(axes, rows)
            axes.set_title(f"(29) with {IN_WORDS[reading]}")
        axes = made.axes[0]
        handles, labels = axes.get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=3)
    return made


_ENDS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("minimiser", "at the minimiser", {"color": DARK}),
    (
        "local",
        "at another point with a minimum's conditions",
        {"facecolor": LIGHT, "hatch": "///", "edgecolor": "black"},
    ),
    ("none", "elsewhere", {"color": "white", "hatch": "...", "ec": "0.4"}),
)


def _draw_ends(axes: Axes, rows: Sequence[EndRow]) -> None:
    place = np.arange(len(rows))
    left = np.zeros(len(rows))
    for name, label, look in _ENDS:
        width = np.array([getattr(row, name) for row in rows], dtype=float)
        axes.barh(place, width, left=left, height=0.7, label=label, **look)
        left += width
    axes.set_yticks(
        place,
        [f"{row.method}, {row.schedule}\n{row.median_calls:.0f} calls" for row in rows],
        fontsize=8,
    )
    axes.invert_yaxis()
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("problems; beside them weights, and calls of values and derivatives (median)")
    axes.xaxis.label.set_fontsize(8)


def work_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw distances to the minimiser against calls, J = 0, from both starts."""
    del said
    found = {
        name: ends(tables.ends, "paper's", "printed", method, schedule)
        for name, method, schedule in (
            ("SWIFT with the weight 1", "Swift", "1"),
            (f"SWIFT with weights {DEFAULT}", "Swift", DEFAULT),
            ("IPOPT", "Ipopt", None),
        )
    }
    work = (
        f"{row.minimiser} of {row.searches} by {name}"
        + (f" ({median_calls(tables.runs, row):.0f} calls in the median)" if row.minimiser else "")
        for name, row in found.items()
    )
    heading = f"J = 0, from the paper's start, at the minimiser: {', '.join(work)}"
    looks: dict[str, dict[str, Any]] = {
        "Swift, 1": {"color": LIGHT, "marker": "o", "ls": "-"},
        f"Swift, {DEFAULT}": {"color": RED, "marker": "s", "ls": "--"},
        "Ipopt": {"color": DARK, "marker": "^", "ls": "-"},
        "Sqp": {"color": "0.55", "marker": "v", "ls": ":"},
    }
    with figure(11.5, 4.8, heading) as made:
        for axes, start in zip(made.subplots(1, 2, sharey=True), STARTS, strict=True):
            for method, look in looks.items():
                _draw_work(axes, [r for r in tables.work if (r.start, r.method) == (start, method)], method, look)
            axes.axhline(AT_MINIMISER, color="black", lw=0.8)
            axes.set(xscale="log", yscale="log", ylim=(1e-16, 30), title=f"from the {start}{_word(start)}")
            axes.set_xlabel("values and derivatives asked for")
            axes.grid(visible=True)
        made.axes[0].set_ylabel("to the minimiser: relative in depth, or rad")
        made.axes[0].legend(loc="lower left")
    return made


def _word(start: str) -> str:
    return " start" if start == "paper's" else ""


def _draw_work(axes: Axes, rows: Sequence[WorkRow], method: str, look: dict[str, Any]) -> None:
    for i, problem in enumerate(dict.fromkeys(row.problem for row in rows)):
        own = [row for row in rows if row.problem == problem]
        y = np.clip([row.to_minimiser for row in own], 2e-16, 20)
        label = method if i == 0 else None
        axes.plot([row.calls for row in own], y, ms=3, lw=0.8, label=label, markevery=max(1, len(own) // 15), **look)


def paths_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw the searches' paths in depth and tilt over the least sum of squares."""
    del said
    last = {method: [row for row in tables.paths if row.method == method][-1] for method in _paths(tables)}
    ends = ", ".join(f"{row.z_L_mm:.1f} ({_named(name)})" for name, row in last.items())
    with figure(11.5, 5.4, f"Paths from the paper's start end at z_L = {ends} mm") as made:
        axes = made.subplots()
        _draw_valley(axes, tables.valley)
        looks = (("o", DARK, "-"), ("s", LIGHT, "--"), ("^", RED, ":"))
        for method, (marker, colour, line) in zip(last, looks, strict=True):
            own = [row for row in tables.paths if row.method == method]
            x, y = [row.z_L_mm for row in own], [row.alpha_deg for row in own]
            axes.plot(x, y, color="white", lw=3.2)
            axes.plot(x, y, color=colour, lw=1.5, ls=line, marker=marker, ms=4, markevery=6, label=_named(method))
            axes.plot(x[-1], y[-1], marker, ms=10, mfc="none", mec=colour, mew=2)
        start, truth = paper.START, paper.TRUTH
        axes.plot(start.z_L, np.degrees(start.alpha), "X", ms=10, color="black", label="the paper's start")
        axes.plot(truth.z_L, np.degrees(truth.alpha), "*", ms=15, mfc="white", mec="black", label="the true plane")
        axes.set(xlabel="z_L (mm)", ylabel="alpha (deg)", xscale="log")
        axes.set_xticks([40, 60, 75, 100, 150, 250], ["40", "60", "75", "100", "150", "250"])
        axes.minorticks_off()
        axes.legend(loc="lower left", facecolor="white", framealpha=0.9, frameon=True)
    return made


def _named(method: str) -> str:
    solver, reading = method.split(", ")
    return f"{solver.upper()}, {IN_WORDS[reading]}"


def _paths(tables: Tables) -> list[str]:
    return list(dict.fromkeys(row.method for row in tables.paths))


def _draw_valley(axes: Axes, rows: Sequence[ValleyRow]) -> None:
    z_L, alpha = (sorted({getattr(row, name) for row in rows}) for name in ("z_L_mm", "alpha_deg"))
    values = np.log10(np.array([row.least_sum for row in rows]).reshape(len(z_L), len(alpha)))
    axes.set_facecolor(FAINT)
    shown = axes.contourf(z_L, alpha, values.T, levels=14, cmap="Greys_r", alpha=0.75)
    figure_of = axes.get_figure()
    if figure_of is not None:
        figure_of.colorbar(shown, ax=axes, label="log10 of the least sum of the ten squares over beta")
