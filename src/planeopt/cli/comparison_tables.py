"""Tables of a comparison for the terminal, each within a hundred characters."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from planeopt.cli.tables import table

if TYPE_CHECKING:
    from rich.console import Console

    from planeopt.comparison import Case, Summary

Columns = Sequence[tuple[str, str, str]]
"""Heading, key, format."""

_ANSWERS = (("z_L mm", "z_L_mm", ".4f"), ("alpha deg", "alpha_deg", ".4f"), ("beta deg", "beta_deg", ".4f"))
_FROM_CLOSED_FORM = (
    ("depth mm", "z_L_minus_closed_form_mm", "+.1e"),
    ("normal deg", "normal_to_closed_form_deg", ".1e"),
    ("over bound", "closed_form_over_bound", ".4f"),
    ("chi2", "chi2", ".3g"),
)
_ERRORS = (
    ("depth mm", "z_L_error_mm", "+.4f"),
    ("normal deg", "normal_error_deg", ".4f"),
    ("over bound", "error_over_bound", ".3f"),
    ("in z_L", "z_L", "+.2f"),
    ("in p", "p", "+.2f"),
    ("in q", "q", "+.2f"),
)
_COUNTS = (
    ("steps", "iterations"),
    ("values", "evaluations"),
    ("first", "first_derivatives"),
    ("second", "second_derivatives"),
)
_TIMES = (("build ms", "build_ms", ".1f"), ("solve ms", "solve_ms", ".2f"), ("all ms", "total_ms", ".1f"))
_EFFORT = (*((heading, key, "d") for heading, key in _COUNTS), *_TIMES)
_MEDIANS = (*((heading, key, ".6g") for heading, key in _COUNTS), *_TIMES)
_EFFORT_OF = "points with function values, with first and with second derivatives; times"
_POOLED = (
    ("RMS", "rms", ".4g"),
    ("Monte Carlo", "monte_carlo", ".4g"),
    ("median", "median", ".4g"),
    ("of z_L", "z_L", ".4g"),
    ("of p", "p", ".4g"),
    ("of q", "q", ".4g"),
    ("inputs", "count", "d"),
)
_ROOTS = {"visible": "visible", "other": "second", "elsewhere": "neither"}


def print_case(console: "Console", case: "Case") -> None:
    """Print all tables of one problem, and why which pairs have no answer."""
    rows = [row.to_dict() for row in case.rows]
    named = [
        {**row, "outcome": row["outcome"].replace("_", " "), "root": _ROOTS.get(row["root"] or "")} for row in rows
    ]
    words = (("outcome", "outcome"), ("plane", "root"))
    _print(console, f"{case.name}: answers", named, _ANSWERS, words)
    _reasons(console, [(row["method"], row["message"]) for row in rows if row["status"] != "ok"])
    answered = [row for row in rows if row["z_L_mm"] is not None]
    _print(console, "difference from the closed form, also over the Cramér-Rao bound", answered, _FROM_CLOSED_FORM)
    if case.truth is not None:
        nothing = dict.fromkeys(("z_L", "p", "q"))
        errors = [{**row, **(row["error_in_bound_sigmas"] or nothing)} for row in answered]
        _print(
            console,
            "error, also over the Cramér-Rao bound: all together, and in its standard deviations",
            errors,
            _ERRORS,
        )
        if case.reachable is False:
            _say(console, "Here the bound is out of reach of any method: first order does not hold.")
    ran = [row for row in rows if row["residuals"]]
    _print(console, f"effort: {_EFFORT_OF}", ran, _EFFORT)
    _print_residuals(console, "where each search ended, left minus right", ran)


def print_summary(console: "Console", summary: Sequence["Summary"], problems: int) -> None:
    """Print what each method did over many problems, and why which pairs have no answer."""
    rows = [{**entry.to_dict(), **entry.roots, **entry.statuses} for entry in summary]
    statuses = ((name, name, "d") for name in ("ok", "degraded", "refused"))
    counts = (*statuses, *((name, key, "d") for key, name in _ROOTS.items()))
    _print(console, f"{problems} inputs: how they ended, and near which plane the searches did", rows, counts)
    _reasons(console, [(entry.method, _failure(entry)) for entry in summary if entry.reason is not None])
    for title, key in (
        (
            "error over the Cramér-Rao bound, pooled over inputs and (z_L, p, q); median over chi(3)'s",
            "error_over_bound",
        ),
        ("difference from the closed form, likewise", "closed_form_over_bound"),
    ):
        _print(console, title, [{**row, **row[key]} for row in rows if row[key] is not None], _POOLED)
    ran = [row for row in rows if row["residuals"]]
    _print(console, f"medians of the effort: {_EFFORT_OF}", ran, _MEDIANS)
    _print_residuals(console, "root mean square where the searches ended", ran)


def _failure(entry: "Summary") -> str:
    refused = entry.statuses["refused"]
    return (
        f"{entry.reason}" if refused == entry.problems else f"{refused} of {entry.problems}, the first: {entry.reason}"
    )


def _print_residuals(console: "Console", what: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the residuals of the laser block, then those of the image block."""
    equations = dict.fromkeys(equation for row in rows for equation in row["residuals"])
    for title, numbers in (("laser block", range(11, 16)), ("image block", range(17, 22))):
        block = [name for name in equations if int(name[1:3]) in numbers]
        values = [{**row, **{name: row["residuals"].get(name) for name in block}} for row in rows]
        _print(console, f"{title}, {what}", values, [(name, name, ".1e") for name in block])


def _print(
    console: "Console",
    title: str,
    rows: Sequence[Mapping[str, Any]],
    numbers: Columns,
    words: Sequence[tuple[str, str]] = (),
) -> None:
    """Print a table, a formulation's name in the first of its rows only; nothing of no rows."""
    before = [None, *(row["formulation"] for row in rows)]
    shown = [
        {
            **row,
            "formulation": "" if row["formulation"] == last else row["formulation"],
            "solver": None if row["solver"] == "none" else row["solver"],
        }
        for row, last in zip(rows, before, strict=False)
    ]
    if shown:
        console.print(table(title, "formulation", shown, numbers, words=(("solver", "solver"), *words), dense=True))


def _reasons(console: "Console", failures: Sequence[tuple[str, str]]) -> None:
    """Say why pairs have no answer, those with the same reason together."""
    reasons: dict[str, list[str]] = {}
    for method, message in failures:
        reasons.setdefault(message, []).append(method)
    for message, methods in reasons.items():
        _say(console, f"{', '.join(methods)}: {message}")


def _say(console: "Console", text: str) -> None:
    console.print(text, markup=False, highlight=False)
