"""Pairs of formulation and solver side by side: error over the bound, evaluations, time; with the finding."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, ScalarFormatter

from planeopt.comparison import Comparison, Pooled, Summary
from planeopt.look import DARK, LIGHT
from planeopt.report.style import drawable, look

_LETTER_SIZE = 8.5
_FAINT = "0.45"
_LINE = 0.23  # inches a pair takes
_AROUND = 2.9  # inches for heading, axes and legend
_HEADING_LETTERS = 112  # a line
_CAPTION_LETTERS = 165
_WITHIN = 2.0  # Monte Carlo standard deviations at which an error still counts as the bound's
_MANY = 20  # inputs, from which their scatter tells the Monte Carlo error well enough
_DECADE = 8.0  # ratio of largest to smallest error from which the axis is logarithmic
_WITH_PLANE = ("converged", "inconsistent", "no_noise_scale", "at_bound", "no_covariance")


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
    answering = [s for s in summary if s.answered == s.problems]
    errors = [(s, s.error) for s in answering if s.error is not None]
    differences = [s.from_closed_form.rms for s in summary if s.from_closed_form and s.formulation != "ClosedForm"]
    count = min((pooled.count for _, pooled in errors), default=0)
    if count >= _MANY:
        finding = _of_many(errors)
    elif errors:
        size = _range([pooled.rms for _, pooled in errors])
        few = "one draw" if count == 1 else f"{count} draws"
        finding = f"errors are {size} times the bound's RMS: {few}, too few to say whether methods reach it"
    elif differences:
        finding = f"answers are {_range(differences)} bound sigmas (RMS) from the closed form's"
    else:
        finding = "no pair gives an answer to every input" if any(s.answered for s in summary) else "no plane was found"
    drawn = _drawn(summary)
    failing = [s for s in drawn if s.answered < s.problems]
    without = f"; {len(failing)} of {len(drawn)} searches fail on some" if failing and summary[0].problems > 1 else ""
    if failing and summary[0].problems == 1:
        without = f"; {len(failing)} of {len(drawn)} searches fail"
    truth = "from the truth" if any(s.error for s in summary) else "from the closed form"
    caption = (
        f"Left: distance {truth}, RMS over (z_L, p, q), in standard deviations of the Cramér-Rao bound; bars are one "
        "Monte Carlo standard deviation. Middle: points at which functions and derivatives were evaluated. Right: time "
        "to build the programme once, and to solve it once built. Medians over the inputs."
    )
    if failing and summary[0].problems > 1:
        caption += " Hollow marks: of those inputs that have an answer."
    refused = len(summary) - len(drawn)
    if refused:
        caption += f" {refused} of {len(summary)} pairs were refused before any search: the tables say why."
    return Words(f"{name}: {finding}{without}.", caption)


def _drawn(summary: Sequence[Summary]) -> list[Summary]:
    """Those that ran."""
    return [s for s in summary if s.answered or s.evaluations or s.iterations] or list(summary)


def _of_many(errors: Sequence[tuple[Summary, Pooled]]) -> str:
    groups: dict[str, list[tuple[Summary, Pooled]]] = {}
    for summary, pooled in errors:
        margin = _WITHIN * (pooled.monte_carlo or 0.0)
        place = "beyond" if pooled.rms > 1 + margin else "below" if pooled.rms < 1 - margin else "at"
        groups.setdefault(place, []).append((summary, pooled))
    said = {"at": "at the bound within Monte Carlo error", "beyond": "beyond the bound", "below": "below the bound"}
    parts = []
    for place, where in said.items():
        if place in groups:
            names = list(dict.fromkeys(s.formulation for s, _ in groups[place]))
            verb = "is" if len(names) == 1 else "are"
            parts.append(f"{', '.join(names)} {verb} {where} ({_range([pooled.rms for _, pooled in groups[place]])})")
    return "; ".join(parts)


def _range(values: Sequence[float]) -> str:
    low, high = (f"{value:.2f}" if 0.1 <= value < 100 else f"{value:.2g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


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
    summary = _drawn(comparison.summary)
    text = words(comparison, drawable(name))
    with look(_LETTER_SIZE):
        figure = Figure(figsize=(11.0, _AROUND + _LINE * len(summary)), layout="constrained", dpi=150)
        heading = textwrap.fill(text.heading, _HEADING_LETTERS)
        figure.suptitle(heading, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
        left, middle, right = figure.subplots(1, 3, sharey=True, width_ratios=(1.3, 1, 1))
        _draw_errors(left, summary)
        _draw_evaluations(middle, summary)
        _draw_times(right, summary)
        left.set_yticks(range(len(summary)), [s.method for s in summary])
        left.set_ylim(len(summary) - 0.4, -0.6)
        for axes in (left, middle, right):
            axes.grid(axis="both")
        caption = textwrap.fill(text.caption, _CAPTION_LETTERS)
        figure.supxlabel(caption, x=0.01, ha="left", fontsize=_LETTER_SIZE, color="0.25")
        # Titles and labels are laid out when drawn: draw while the style holds.
        figure.canvas.draw()
    return figure


def _draw_errors(axes: Axes, summary: Sequence[Summary]) -> None:
    truth = any(s.error is not None for s in summary)
    axes.set_title("error against the truth" if truth else "difference from the closed form")
    axes.set_xlabel("RMS over the Cramér-Rao bound (1)")
    shown = [
        (place, pooled)
        for place, s in enumerate(summary)
        if (pooled := s.error if truth else s.from_closed_form) is not None and pooled.rms > 0
    ]
    if truth:
        axes.axvline(1.0, color="0.3", lw=1.2, ls="--")
    for place, pooled in shown:
        bar = None if pooled.monte_carlo is None or pooled.monte_carlo >= pooled.rms else pooled.monte_carlo
        # A hollow mark: not of all inputs.
        whole = summary[place].answered == summary[place].problems
        face = DARK if whole else "white"
        axes.errorbar(pooled.rms, place, xerr=bar, fmt="o", color=DARK, mfc=face, ms=4.5, capsize=2.5, lw=1.2)
    sizes = [pooled.rms for _, pooled in shown] or [1.0]
    if max(sizes) > _DECADE * min(sizes):
        _logarithmic(axes)
    low, high = axes.get_xlim()
    # Room on the right for what failed.
    if any(s.answered < s.problems for s in summary):
        logarithmic = axes.get_xscale() == "log"
        axes.set_xlim(low, high * (high / low) ** 0.6 if logarithmic else high + 0.6 * (high - low))
    for place, s in enumerate(summary):
        if s.answered < s.problems:
            axes.annotate(
                _failed(s),
                (0.99, place),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                color=_FAINT,
                style="italic",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )


def _failed(s: Summary) -> str:
    """Return how most of the inputs without an answer ended, and how many there are."""
    failures = {outcome: count for outcome, count in s.outcomes.items() if outcome not in _WITH_PLANE}
    most = max(failures, key=lambda outcome: failures[outcome]).replace("_", " ")
    return most if s.problems == 1 else f"{most}: {s.problems - s.answered} of {s.problems}"


def _draw_evaluations(axes: Axes, summary: Sequence[Summary]) -> None:
    axes.set_title("evaluations")
    axes.set_xlabel("points a solve (1)")
    kinds = (
        ("functions", "o", DARK, [s.evaluations for s in summary]),
        ("first derivatives", "s", LIGHT, [s.first_derivatives for s in summary]),
        ("second derivatives", "x", "black", [s.second_derivatives for s in summary]),
    )
    _scatter(axes, kinds)


def _draw_times(axes: Axes, summary: Sequence[Summary]) -> None:
    axes.set_title("time")
    axes.set_xlabel("ms")
    kinds = (
        ("to solve", "o", DARK, [s.solve_ms for s in summary]),
        ("to build, once", "s", LIGHT, [s.build_ms for s in summary]),
    )
    _scatter(axes, kinds)


def _scatter(axes: Axes, kinds: Sequence[tuple[str, str, str, list[float | None]]]) -> None:
    for size, (label, marker, colour, values) in zip((4.5, 7.0, 5.0), kinds, strict=False):
        shown = [(value, place) for place, value in enumerate(values) if value and math.isfinite(value)]
        if shown:
            x, y = zip(*shown, strict=True)
            face = "none" if marker == "s" else colour
            axes.plot(x, y, marker, color=colour, ms=size, mfc=face, mew=1.2, label=label)
    _logarithmic(axes)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), borderaxespad=1.0, ncols=1, frameon=False)


def _logarithmic(axes: Axes) -> None:
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    if high < 10 * low:
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
    else:
        axes.xaxis.set_major_locator(LogLocator(numticks=6))
        axes.xaxis.set_major_formatter(LogFormatterSciNotation())
    axes.xaxis.set_minor_formatter(NullFormatter())
