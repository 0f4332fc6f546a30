"""All pairs of formulation and solver side by side: error over the bound, evaluations, time; with the finding."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from planeopt.comparison import Comparison, Summary
from planeopt.report.style import DARK, LIGHT, look

_LETTER_SIZE = 8.5
_FAINT = "0.55"
_MIDDLE = "#b03a2e"
_LINE = 0.21  # inches a pair takes
_AROUND = 2.5  # inches for heading, axes and legend
_WRAP = 118  # letters of the heading's lines
_WITHIN = 2.0  # Monte Carlo standard deviations at which an error still counts as the bound's


@dataclass(frozen=True)
class Words:
    """What a comparison found: a heading, and what to know to read the figure."""

    heading: str
    caption: str


def words(comparison: Comparison, name: str) -> Words:
    """Return the finding in words, made from the numbers.

    Parameters
    ----------
    comparison : Comparison
    name : str
        What was compared on: an input, or several.
    """
    summary = comparison.summary
    errors = [(s, s.error.rms, s.error.monte_carlo or 0.0) for s in summary if s.error is not None]
    differences = [(s, s.from_closed_form.rms) for s in summary if s.from_closed_form is not None]
    many = len([case for case in comparison.cases if case.rows]) > 1
    if errors and many:
        finding = _of_many(errors)
    elif errors:
        low, high = _range([rms for _, rms, _ in errors])
        finding = f"errors are {low} to {high} of the bound's RMS (one draw: ratios to each other, not to 1, tell)"
    elif differences:
        low, high = _range([rms for s, rms in differences if s.formulation != "ClosedForm"])
        finding = f"answers are {low} to {high} bound sigmas (RMS) from the closed form's"
    else:
        finding = "no plane was found"
    refused = [s for s in summary if not s.answered]
    without = f"; {len(refused)} of {len(summary)} pairs give no answer" if refused else ""
    caption = (
        "Left: RMS over (z_L, p, q) in standard deviations of the Cramér-Rao bound; bars are one Monte Carlo standard "
        "deviation. Middle: points at which functions and derivatives were evaluated. Right: time to build the "
        "programme once, and to solve it once it is built. Medians over the inputs."
    )
    return Words(f"{name}: {finding}{without}.", caption)


def _of_many(errors: Sequence[tuple[Summary, float, float]]) -> str:
    at = [entry for entry in errors if abs(entry[1] - 1) <= _WITHIN * entry[2]]
    beyond = [entry for entry in errors if entry[1] - 1 > _WITHIN * entry[2]]
    parts = []
    if at:
        low, high = _range([rms for _, rms, _ in at])
        parts.append(f"{_names([s for s, _, _ in at])} reach the bound ({low} to {high})")
    if beyond:
        low, high = _range([rms for _, rms, _ in beyond])
        verb = "err" if len(beyond) > 1 else "errs"
        parts.append(f"{_names([s for s, _, _ in beyond])} {verb} by {low} to {high} times it")
    return "; ".join(parts) or "all answers are nearer than the bound"


def _names(summaries: Sequence[Summary]) -> str:
    return ", ".join(dict.fromkeys(s.formulation for s in summaries))


def _range(values: Sequence[float]) -> tuple[str, str]:
    if not values:
        return "0", "0"
    return f"{min(values):.3g}", f"{max(values):.3g}"


def comparison_figure(comparison: Comparison, name: str) -> Figure:
    """Draw a comparison.

    Parameters
    ----------
    comparison : Comparison
    name : str
        What was compared on.

    Returns
    -------
    Figure
        Of matplotlib, not attached to any window.
    """
    summary = comparison.summary
    text = words(comparison, name)
    with look(_LETTER_SIZE):
        figure = Figure(figsize=(11.0, _AROUND + _LINE * len(summary)), layout="constrained", dpi=150)
        figure.suptitle(textwrap.fill(text.heading, _WRAP), x=0.01, ha="left", fontsize=10.5, fontweight="bold")
        left, middle, right = figure.subplots(1, 3, sharey=True, width_ratios=(1.25, 1, 1))
        _draw_errors(left, summary)
        _draw_evaluations(middle, summary)
        _draw_times(right, summary)
        left.set_yticks(range(len(summary)), [s.method for s in summary])
        left.set_ylim(len(summary) - 0.4, -0.6)
        for axes in (left, middle, right):
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(numticks=6))
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(axis="both")
        figure.supxlabel(textwrap.fill(text.caption, 170), x=0.01, ha="left", fontsize=_LETTER_SIZE, color="0.25")
        # Titles and labels are laid out when drawn: draw while the style holds.
        figure.canvas.draw()
    return figure


def _draw_errors(axes: Axes, summary: Sequence[Summary]) -> None:
    truth = any(s.error is not None for s in summary)
    axes.set_title("error against the truth" if truth else "difference from the closed form")
    axes.set_xlabel("RMS over the Cramér-Rao bound")
    if truth:
        axes.axvline(1.0, color="0.3", lw=1.2, ls="--")
    for place, s in enumerate(summary):
        pooled = s.error if truth else s.from_closed_form
        if pooled is not None and pooled.rms > 0:
            bar = None if pooled.monte_carlo is None or pooled.monte_carlo >= pooled.rms else pooled.monte_carlo
            axes.errorbar(pooled.rms, place, xerr=bar, fmt="o", color=DARK, ms=4.5, capsize=2.5, lw=1.2)
        note = _note(s)
        if note:
            axes.annotate(
                note,
                (0.99, place),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                fontsize=_LETTER_SIZE - 1.5,
                color=_FAINT if s.answered else _MIDDLE,
            )
    if not any((s.error if truth else s.from_closed_form) is not None for s in summary):
        axes.set_xlim(0.1, 10)


def _note(s: Summary) -> str:
    """How many inputs have no answer, and why most of them."""
    if s.answered == s.problems:
        return ""
    good = ("converged", "inconsistent", "no_noise_scale", "at_bound", "no_covariance")
    failures = {outcome: count for outcome, count in s.outcomes.items() if outcome not in good}
    worst = max(failures, key=lambda outcome: failures[outcome]).replace("_", " ")
    return worst if s.problems == 1 else f"{worst}: {s.problems - s.answered} of {s.problems}"


def _draw_evaluations(axes: Axes, summary: Sequence[Summary]) -> None:
    axes.set_title("evaluations")
    axes.set_xlabel("points a solve")
    kinds = (
        ("functions", "o", DARK, [s.evaluations for s in summary]),
        ("first derivatives", "s", LIGHT, [s.first_derivatives for s in summary]),
        ("second derivatives", "|", "black", [s.second_derivatives for s in summary]),
    )
    _scatter(axes, kinds)


def _draw_times(axes: Axes, summary: Sequence[Summary]) -> None:
    axes.set_title("time")
    axes.set_xlabel("ms")
    kinds = (
        ("build once", "s", LIGHT, [s.build_ms for s in summary]),
        ("solve", "o", DARK, [s.solve_ms for s in summary]),
    )
    _scatter(axes, kinds)


def _scatter(axes: Axes, kinds: Sequence[tuple[str, str, str, list[float]]]) -> None:
    for label, marker, colour, values in kinds:
        shown = [(value, place) for place, value in enumerate(values) if value > 0 and math.isfinite(value)]
        if shown:
            axes.plot(
                *zip(*shown, strict=True),
                marker,
                color=colour,
                ms=5,
                mfc="none" if marker == "s" else colour,
                label=label,
            )
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=len(handles), frameon=False)
