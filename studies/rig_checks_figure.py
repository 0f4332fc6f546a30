"""The figure of the study of rigs in use."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.rig_checks_cells import COMPONENTS, RIGHT, CheckRow, UpdateRow
from studies.style import DARK, FAINT, LIGHT, RED, figure

Limits = Mapping[tuple[str, str], tuple[float, float]]
"""Of a mean squared error, by what moved and the component."""

_LOOKS = (
    (DARK, "o", "-"),
    (LIGHT, "s", "--"),
    (RED, "^", "-."),
    ("black", "D", ":"),
    ("0.5", "v", "-"),
    ("0.35", "P", "--"),
)
_WORDS = {"parameters": "all parameters", "four": "the four numbers\nthat images see", "plane": "a new plane"}


def rig_checks_figure(checks: Sequence[CheckRow], updates: Sequence[UpdateRow], limits: Limits) -> Figure:
    """Draw the checks' statistics over what is expected, with what has moved, and the updates' squared errors."""
    right = [row for row in checks if row.moved == RIGHT]
    called = sum(round(row.degraded * row.checks) for row in right)
    moved = [row for row in checks if row.moved != RIGHT]
    found = sum(round(row.degraded * row.checks) for row in moved)
    errors = [getattr(row, name) for row in updates for name in COMPONENTS]
    heading = (
        f"Of {sum(row.checks for row in right)} right rigs {called} are called degraded, of "
        f"{sum(row.checks for row in moved)} moved ones {found}; updated rigs' squared errors are {min(errors):.2f} to "
        f"{max(errors):.2f} of what they state"
    )
    with figure(13.0, 5.0, heading) as made:
        left, middle, far = made.subplots(1, 3, width_ratios=(1, 1.15, 1))
        _laws(left, right)
        _moves(middle, moved)
        _updates(far, updates, limits)
        middle.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, -0.14))
        left.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, -0.14))
        far.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, -0.14))
    return made


def _laws(axes: Axes, right: Sequence[CheckRow]) -> None:
    views = [row.views for row in right]
    parts = {"pooled": "pooled", "shift": "moved like the rig", "rest": "the rest", "spots": "spots"}
    for (colour, marker, line), (part, label) in zip(_LOOKS, parts.items(), strict=False):
        found = [getattr(row, part) for row in right]
        axes.plot(range(len(views)), found, line, marker=marker, color=colour, label=label)
    axes.axhline(1, color="black", lw=0.8)
    axes.set_xticks(range(len(views)), [str(count) for count in views])
    axes.set(xlabel="new views", ylabel="chi-squared over its degrees of freedom", title="Rigs as calibrated")
    away = max(abs(getattr(row, part) - 1) for row in right for part in parts if not np.isnan(getattr(row, part)))
    axes.set_ylim(1 - 1.5 * away, 1 + 1.5 * away)
    axes.grid(axis="y")


def _moves(axes: Axes, moved: Sequence[CheckRow]) -> None:
    views = sorted({row.views for row in moved})
    for (colour, marker, line), group in zip(_LOOKS, dict.fromkeys(row.moved for row in moved), strict=True):
        shift = {row.views: row.shift for row in moved if row.moved == group}
        axes.plot(range(len(views)), [shift[count] for count in views], line, marker=marker, color=colour, label=group)
    axes.axhline(1, color="black", lw=0.8)
    axes.set_xticks(range(len(views)), [str(count) for count in views])
    named = 100 * np.average([row.named for row in moved], weights=[row.checks for row in moved])
    axes.set(
        yscale="log", xlabel="new views", ylabel="the same, of the shift", title=f"What moved, named in {named:.0f} %"
    )
    axes.grid(axis="y")


def _updates(axes: Axes, updates: Sequence[UpdateRow], limits: Limits) -> None:
    for place, name in enumerate(COMPONENTS):
        for shift, row, (colour, marker, _) in zip((-0.15, 0.15), updates, _LOOKS, strict=False):
            at = place + shift
            axes.fill_between([at - 0.12, at + 0.12], *limits[row.moved, name], color=FAINT, alpha=0.5, lw=0)
            label = f"moved: {row.moved}" if place == 0 else None
            axes.plot(at, getattr(row, name), marker, color=colour, label=label)
    axes.axhline(1, color="black", lw=0.8)
    axes.set_xticks(range(len(COMPONENTS)), list(_WORDS.values()))
    axes.set(ylabel="squared error over the covariance", title="Field recalibration (grey: limits)")
    axes.grid(axis="y")
