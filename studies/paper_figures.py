"""The figures of the study of the paper."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from planeopt import equations as eq
from planeopt import paper
from studies.paper_rows import AnswerRow, MisprintRow, PointRow, Tables
from studies.style import DARK, FAINT, LIGHT, figure

_LEAST = 1e-3
"""Of what is allowed: where deviations at rounding level are drawn."""


def reproduction_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw Table 1 with the ellipse of (6), what (3) as printed gives, and the methods' errors over what is allowed."""
    heading = (
        f"{said['methods_within_rounding']} of {said['methods']} methods give the stated solution within "
        f"{said['largest_error_over_what_rounding_allows']:.2f} of what Table 1's rounding allows"
    )
    with figure(11.5, 4.6, heading) as made:
        image, errors = made.subplots(1, 2, width_ratios=(1, 1.25))
        _draw_image(image, tables.table_1)
        _draw_errors(errors, tables.answers)
    return made


def repeats_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw where each method ends from tables that round alike."""
    heading = (
        f"From {said['tables_that_round_alike']} tables that round alike SWIFT with J = 0 finds the plane in "
        f"{said['swift_J_0_on_the_plane']}, IPOPT with slack in {said['constrained_on_the_plane']}"
    )
    looks: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("on_the_plane", "on the plane", {"color": DARK}),
        ("on_the_second_plane", "on the second plane", {"color": LIGHT, "hatch": "///", "ec": "black"}),
        ("on_neither", "on neither", {"color": "white", "hatch": "...", "ec": "0.4"}),
    )
    rows = tables.repeats
    with figure(9.5, 2.9, heading) as made:
        axes = made.subplots()
        left = np.zeros(len(rows))
        for name, label, look in looks:
            width = np.array([getattr(row, name) for row in rows], dtype=float)
            axes.barh(np.arange(len(rows)), width, left=left, height=0.65, label=label, **look)
            left += width
        axes.set_yticks(range(len(rows)), [f"{row.method}\n{row.median_evaluations:.0f} evaluations" for row in rows])
        axes.invert_yaxis()
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("tables, each coordinate of a point off by up to 0.00005 mm; from the paper's start")
        made.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return made


def _draw_image(axes: Axes, rows: Sequence[PointRow]) -> None:
    turn = np.linspace(0, 2 * np.pi, 241)
    curve = eq.image_point(np, paper.SETUP, *eq.spot_point(np, paper.TRUTH, paper.SETUP, turn))
    axes.plot(*curve, color=DARK, lw=1.2, label="(5) of the corrected (3): the ellipse (6)")
    axes.plot([row.x_mm for row in rows], [row.y_mm for row in rows], "o", ms=4, color=DARK, label="Table 1")
    x, y = ([getattr(row, name) for row in rows] for name in ("x_as_printed_mm", "y_as_printed_mm"))
    axes.plot([*x, x[0]], [*y, y[0]], "^--", ms=4, lw=0.9, color=LIGHT, label="(5) of (3) as printed")
    # As the camera sees it: y down.
    axes.set(aspect="equal", xlabel="x in the image (mm)", ylabel="y in the image (mm)", title="The spot's boundary")
    axes.invert_yaxis()
    axes.grid(visible=True)
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.16), ncols=1)


def _draw_errors(axes: Axes, rows: Sequence[AnswerRow]) -> None:
    methods = list(dict.fromkeys(row.method for row in rows))
    unknowns = list(dict.fromkeys((row.unknown, row.unit) for row in rows))
    axes.axvspan(-1, 1, color=FAINT, alpha=0.35, lw=0, label="what rounding allows")
    axes.axvline(0, color="black", lw=0.8)
    for method, marker, shade in zip(methods, "osD^", (DARK, "0.45", LIGHT, "black"), strict=True):
        own = [row for row in rows if row.method == method]
        place = np.arange(len(unknowns)) + 0.16 * (methods.index(method) - 1.5)
        x = [row.error / row.allowed_worst for row in own]
        axes.plot(x, place, marker, ms=6, mfc="none" if marker in "sD" else shade, color=shade, label=method)
    axes.set_yticks(range(len(unknowns)), [name for name, _ in unknowns])
    axes.invert_yaxis()
    axes.set(
        xlim=(-1.25, 1.25),
        xlabel="found minus stated, over the worst that the rounding of Table 1 can do",
        title="From Table 1 and the paper's start (10 mm, 250 mm, 20 deg, 20 deg)",
    )
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.16), ncols=2)


def misprints_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw for each deciding number how far both readings are from it, over what rounding allows."""
    heading = (
        f"Corrected readings are within {said['corrected_largest_deviation_over_rounding']:.2f} of what "
        f"rounding allows, printed ones off by at least "
        f"{said['printed_least_deviation_over_rounding']:.1f} times as much"
    )
    rows = tables.misprints
    with figure(11.5, 5.2, heading) as made:
        axes = made.subplots()
        place = np.arange(len(rows))
        axes.axvspan(_LEAST / 3, 1, color=FAINT, alpha=0.35, lw=0, label="what rounding allows")
        right = np.maximum([row.right_over_allowed for row in rows], _LEAST)
        printed = [row.printed_over_allowed for row in rows]
        axes.hlines(place, right, printed, color="0.6", lw=0.8, zorder=1)
        axes.plot(right, place, "o", ms=7, color=DARK, label="corrected")
        axes.plot(printed, place, "^", ms=8, color=LIGHT, label="as printed")
        axes.set_yticks(place, [_label(row) for row in rows])
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set(
            xlim=(_LEAST / 3, 1e17),
            xlabel="deviation from what the number must be, over what rounding allows (0.001 stands for all below)",
        )
        axes.grid(visible=True, axis="x")
        axes.legend(loc="lower right", ncols=3, bbox_to_anchor=(1, 1))
    return made


def _label(row: MisprintRow) -> str:
    return f"{row.where}\n{row.quantity}"
