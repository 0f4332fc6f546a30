"""The figures of the study of the constraints."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from studies.constraints_culprit import CulpritRow
from studies.constraints_estimates import ESTIMATORS, EstimateRow, TripleRow
from studies.constraints_ranks import EdgeRow, RankRow
from studies.constraints_subsets import SINGULAR, SubsetRow
from studies.constraints_summary import Tables, laser_rank
from studies.style import DARK, FAINT, LIGHT, RED, figure

_LOOKS: tuple[dict[str, Any], ...] = (
    {"marker": "o", "color": DARK, "ls": "-"},
    {"marker": "s", "color": LIGHT, "ls": "--"},
    {"marker": "^", "color": "0.45", "ls": "-."},
    {"marker": "D", "color": RED, "ls": ":"},
    {"marker": "v", "color": "black", "ls": (0, (1, 3))},
)


def ranks_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw the whitened system's condition over tilts and depths, and what happens at planes through the camera."""
    heading = (
        f"Over {said['planes']:.0f} planes the laser block has rank {laser_rank(said)}; all ten have condition numbers "
        f"of {min(row.condition for row in tables.ranks):.0f} to {max(row.condition for row in tables.ranks):.0f}"
    )
    with figure(11.5, 4.6, heading) as made:
        over, edge = made.subplots(1, 2)
        _draw_conditions(over, tables.ranks)
        _draw_edge(edge, tables.edge)
        for axes in (over, edge):
            axes.grid(visible=True)
    return made


def _draw_conditions(axes: Axes, rows: Sequence[RankRow]) -> None:
    for depth, look in zip(dict.fromkeys(row.z_L_mm for row in rows), _LOOKS, strict=False):
        tilts = sorted({row.alpha_deg for row in rows if row.z_L_mm == depth})
        groups = [[r.condition for r in rows if (r.z_L_mm, r.alpha_deg) == (depth, tilt)] for tilt in tilts]
        axes.fill_between(tilts, [min(g) for g in groups], [max(g) for g in groups], color=look["color"], alpha=0.15)
        axes.plot(tilts, [np.median(g) for g in groups], lw=1.3, ms=5, label=f"z_L = {depth:g} mm", **look)
    axes.set(yscale="log", xlabel="tilt alpha (deg)", ylabel="condition number, whitened")
    offsets = [row.offset_mm for row in rows]
    axes.set_title(f"median and range over azimuths and offsets, {min(offsets):g} to {max(offsets):g} mm")
    axes.legend(loc="upper left")


def _draw_edge(axes: Axes, rows: Sequence[EdgeRow]) -> None:
    columns = (("smallest_over_largest", "coefficients"), ("whitened_smallest_over_largest", "whitened"))
    looks = iter(_LOOKS)
    for column, name in columns:
        for offset in dict.fromkeys(row.offset_mm for row in rows):
            own = [row for row in rows if row.offset_mm == offset]
            y = [getattr(row, column) for row in own]
            label = f"{name}, offset {offset:g} mm"
            axes.plot([row.intercept_over_z_L for row in own], y, lw=1.3, ms=5, label=label, **next(looks))
    axes.set(xscale="log", yscale="log", xlabel="c / z_L (0: the plane goes through the camera)")
    axes.set(ylabel="smallest over largest singular value", title="towards a plane through the camera")
    axes.legend(loc="lower right")


_ENDS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("on_the_plane", "at the plane", {"color": DARK}),
    ("off_the_beam", "at a minimum off the beam", {"color": LIGHT, "hatch": "///", "ec": "black"}),
    ("elsewhere", "at another minimum", {"color": "0.6"}),
    ("no_minimum", "no minimum", {"color": "white", "hatch": "...", "ec": "0.4"}),
)


def subsets_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw for each choice of hard laser rows where searches end, and how singular the KKT matrix is."""
    heading = (
        f"At the plane: by R cos(alpha) = r {said['independent_form_searches_on_the_plane_percent']:.0f} %, by several "
        f"of (11)-(15) {said['several_rows_searches_on_the_plane_percent']:.0f} %; by one alone "
        f"{said['one_row_searches_off_the_beam_percent']:.0f} % off the beam"
    )
    rows = tables.subsets
    with figure(11.5, 1.6 + 0.22 * len(rows), heading) as made:
        ends, ratio = made.subplots(1, 2, sharey=True, width_ratios=(1.5, 1))
        _draw_ends(ends, rows)
        place = np.arange(len(rows))
        # An exact zero is drawn at the axis's left end.
        values = np.array([row.kkt_smallest_over_largest for row in rows])
        ratio.plot(np.maximum(values, 1e-22), place, "o", color=DARK, ms=5)
        ratio.axvspan(1e-23, SINGULAR, color=FAINT, alpha=0.35, lw=0, label="singular")
        ratio.set(xscale="log", xlim=(1e-23, 10), xlabel="smallest over largest singular value (1e-22: or less)")
        ratio.set_title("the KKT matrix with these rows")
        ratio.grid(visible=True, axis="x")
        ratio.legend(loc="center")
        handles, labels = ends.get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=4)
    return made


def _draw_ends(axes: Axes, rows: Sequence[SubsetRow]) -> None:
    place, left = np.arange(len(rows)), np.zeros(len(rows))
    for name, label, look in _ENDS:
        width = np.array([getattr(row, name) for row in rows], dtype=float)
        axes.barh(place, width, left=left, height=0.75, label=label, **look)
        left += width
    for i, row in enumerate(rows):
        if not row.searches:
            axes.annotate(
                "more rows than unknowns: not searched", (0, i), (3, 0), textcoords="offset points", va="center"
            )
    axes.set_yticks(place, [row.rows for row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="searches", title="where searches from random starts end")


def estimates_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw every estimator's error over the bound, and that of all choices of three hard rows."""
    heading = (
        f"Worst RMS error over the bound: {said['weighted_slack_worst_over_bound']:.2f} with weighted slack, "
        f"{said['unweighted_slack_worst_over_bound']:.1f} without weights, "
        f"{said['best_three_hard_rows_worst_over_bound']:.1f} with the best three rows hard"
    )
    with figure(11.5, 5.0, heading) as made:
        drawn, triples = made.subplots(1, 2, width_ratios=(1.3, 1))
        _draw_estimates(drawn, tables.estimates)
        _draw_triples(triples, tables.triples)
        for axes in (drawn, triples):
            axes.axvline(1, color="black", lw=0.8)
            _plain(axes)
            axes.grid(visible=True, axis="x")
    return made


def _plain(axes: Axes) -> None:
    """Put ticks at round numbers along a logarithmic axis, few enough for their labels."""
    low, high = axes.get_xlim()
    ticks = (1, 1.1, 1.2, 1.5, 2, 3) if high < 4 * low else (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
    axes.xaxis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_locator(NullLocator())


def _draw_estimates(axes: Axes, rows: Sequence[EstimateRow]) -> None:
    for scene, look in zip(dict.fromkeys(row.scene for row in rows), _LOOKS, strict=False):
        own = [row for row in rows if row.scene == scene]
        x = [row.rms_over_bound for row in own]
        place = [ESTIMATORS.index(row.estimator) for row in own]
        axes.plot(x, place, lw=0, ms=7, mfc="none", mew=1.6, label=scene, marker=look["marker"], color=look["color"])
    axes.set_yticks(range(len(ESTIMATORS)), ESTIMATORS)
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="RMS error of (z_L, p, q), pooled, over the bound")
    axes.set_title(f"{rows[0].draws} draws, noise 0.3 px")
    axes.legend(loc="upper left", bbox_to_anchor=(-0.35, -0.13), ncols=2)


def _draw_triples(axes: Axes, rows: Sequence[TripleRow]) -> None:
    scenes = list(dict.fromkeys(row.scene for row in rows))
    place = [scenes.index(row.scene) for row in rows]
    axes.plot([row.predicted_over_bound for row in rows], place, "|", ms=16, color="0.5", label="each of the ten")
    for way, marker, colour, shift in (("largest", "s", LIGHT, -0.2), ("largest in sigmas", "o", DARK, 0.2)):
        own = [row for row in rows if way in row.chosen.split(", ")]
        y = [scenes.index(row.scene) + shift for row in own]
        axes.plot([row.predicted_over_bound for row in own], y, marker, ms=7, color=colour, label=f"chosen as {way}")
    axes.set_yticks(range(len(scenes)), [scene.replace(", ", ",\n") for scene in scenes], fontsize=8)
    axes.set_ylim(len(scenes) - 0.5, -0.5)
    axes.set(xscale="log", xlabel="RMS error over the bound, to first order", title="three hard image rows")
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.13), ncols=1)


def culprits_figure(tables: Tables, said: Mapping[str, float]) -> Figure:
    """Draw how often the largest slack names the equation at fault, and the error of the plane."""
    heading = (
        f"An error of {said['outlier_px']:.0f} px: the largest L1 slack names its equation in "
        f"{said['elastic_names_percent']:.0f} %, the largest least-squares slack in "
        f"{said['constrained_names_percent']:.0f} %"
    )
    with figure(11.5, 4.4, heading) as made:
        named, error = made.subplots(1, 2)
        _draw_culprits(named, error, tables.culprits)
    return made


_FORMS: dict[str, dict[str, Any]] = {
    "Elastic": {"color": DARK},
    "Constrained": {"color": LIGHT, "hatch": "///", "ec": "black"},
    "LeastSquares": {"color": "white", "hatch": "...", "ec": "0.4"},
}
_WORDS = {"Elastic": "L1 slack", "Constrained": "weighted slack", "LeastSquares": "all ten without weights"}


def _draw_culprits(named: Axes, error: Axes, rows: Sequence[CulpritRow]) -> None:
    groups = list(dict.fromkeys((row.scene, row.outlier_px) for row in rows))
    for i, (formulation, look) in enumerate(_FORMS.items()):
        own = [[r for r in rows if (r.scene, r.outlier_px, r.formulation) == (*group, formulation)] for group in groups]
        place = np.arange(len(groups)) + 0.27 * (i - 1)
        share = [100 * sum(r.named for r in g) / sum(r.draws for r in g) for g in own]
        rms = [float(np.sqrt(np.mean([r.rms_over_bound**2 for r in g]))) for g in own]
        named.barh(place, share, height=0.25, label=_WORDS[formulation], **look)
        error.barh(place, rms, height=0.25, **look)
    labels = [f"{scene.replace(', ', chr(10))}\n{size:g} px" for scene, size in groups]
    for axes in (named, error):
        axes.set_yticks(range(len(groups)), labels, fontsize=8)
        axes.invert_yaxis()
        axes.grid(visible=True, axis="x")
    named.axvline(20, color="black", lw=0.8, ls=":")
    named.set(xlabel="named, % of draws (dotted: by chance, one in five)", title="the equation at fault")
    error.set(
        xscale="log", xlim=(1, None), xlabel="RMS error of the plane over the clean points' bound", title="the plane"
    )
    named.legend(loc="upper left", bbox_to_anchor=(0, -0.15), ncols=3)
