"""Figures of the basins study: maps of the starts, and shares of ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from planeopt import paper
from studies.basins_example import DEPTHS, RANDOM, TILTS, EndRow
from studies.basins_finding import CONSTRAINED, from_papers_start, share, total
from studies.basins_rigs import DEFAULT, RUNS
from studies.basins_searches import (
    AT_BOUND,
    BEHIND,
    ELSEWHERE,
    INFEASIBLE,
    NOT_CONVERGED,
    OBVIOUS,
    PLANE,
    REFUSED,
    UNSAID,
)
from studies.basins_summary import ShareRow
from studies.style import DARK, LIGHT, RED, figure


@dataclass(frozen=True)
class _Look:
    said: str
    face: str
    hatch: str | None = None


# White, black and one grey for the three kinds of minimum; what is none is light and hatched.
_LOOKS = {
    PLANE: _Look("the plane", "#e3edf7"),
    BEHIND: _Look("the plane behind", DARK),
    ELSEWHERE: _Look("another minimum, told", LIGHT),
    UNSAID: _Look("another minimum, not told", RED, "**"),
    AT_BOUND: _Look("at an inequality's or bound's edge", "#c9c9c9", "---"),
    NOT_CONVERGED: _Look("failed: not converged", "white", "...."),
    INFEASIBLE: _Look("failed: constraints do not hold", "white", "////"),
    REFUSED: _Look("refused", "white", "xxxx"),
}


def _patch(end: str, **more: Any) -> dict[str, Any]:
    look = _LOOKS[end]
    return {"facecolor": look.face, "hatch": look.hatch, "edgecolor": "0.35", "linewidth": 0.0, **more}


def tilts_figure(ends: Sequence[EndRow]) -> Figure:
    """Map the ends over alpha and beta of the start."""
    return _maps(ends, TILTS)


def depths_figure(ends: Sequence[EndRow]) -> Figure:
    """Map the ends over z_L and alpha of the start."""
    return _maps(ends, DEPTHS)


_PAIRS_A_ROW = 3


def _maps(ends: Sequence[EndRow], starts: str) -> Figure:
    shown = [row for row in ends if row.starts == starts]
    methods = list(dict.fromkeys(row.method for row in shown if row.method != OBVIOUS.method))
    obvious, free, kept = (
        _behind(shown, method, inequality)
        for method, inequality in ((OBVIOUS.method, "without"), (CONSTRAINED, "without"), (CONSTRAINED, "with"))
    )
    papers = "is" if from_papers_start(ends)[OBVIOUS.method, "without"] == BEHIND else "is not"
    fixed = "R 10 mm and z_L 250 mm" if starts == TILTS else "R 10 mm and beta 20 deg"
    heading = (
        f"Unless told that the lit side is seen (c > 0) Ipopt goes to the plane behind from {obvious} of these starts "
        f"by the obvious programme (the paper's start, a star, {papers} among them), from {free} by Constrained; when "
        f"told from {kept}. All starts have {fixed}"
    )
    rows = -(-(len(methods) + 1) // _PAIRS_A_ROW)
    with figure(13.5, 2.35 * rows + 1.2, heading) as made:
        grid = made.subplots(rows, 2 * _PAIRS_A_ROW, squeeze=False, sharex=True, sharey=True)
        panels = [(OBVIOUS.method, "without"), None]
        panels += [(method, inequality) for method in methods for inequality in ("without", "with")]
        edges = []
        for axes, panel in zip(grid.flat, [*panels, *[None] * (grid.size - len(panels))], strict=True):
            if panel is None:
                axes.set_axis_off()
                continue
            method, inequality = panel
            edges.append(_map(axes, [r for r in shown if (r.method, r.inequality) == panel], starts))
            tail = "" if method == OBVIOUS.method else f"\n{inequality} c > 0"
            axes.set_title(f"{_title(method)}{tail}", fontsize=8.5)
        least, most = np.min(edges, axis=0)[:2], np.max(edges, axis=0)[2:]
        grid[0, 0].set(xlim=(least[0], most[0]), ylim=(least[1], most[1]))
        _tick(grid[0, 0], starts)
        for axes in grid[:, 0]:
            axes.set_ylabel("start's beta, deg" if starts == TILTS else "start's alpha, deg")
        for axes in grid[-1, :]:
            axes.set_xlabel("start's alpha, deg" if starts == TILTS else "start's z_L, mm")
        present = {row.end for row in shown}
        made.legend(
            handles=[Patch(**_patch(end, linewidth=0.5), label=_LOOKS[end].said) for end in _LOOKS if end in present],
            loc="outside lower center",
            ncols=4,
            handlelength=2.2,
            handleheight=1.4,
        )
    return made


def _behind(rows: Sequence[EndRow], method: str, inequality: str) -> str:
    ends = [row.end for row in rows if (row.method, row.inequality) == (method, inequality)]
    return f"{100 * sum(end == BEHIND for end in ends) / len(ends):.0f} %"


def _title(method: str) -> str:
    return "no inequality, no bounds\n(the obvious programme) Ipopt" if method == OBVIOUS.method else method


def _map(axes: Axes, rows: Sequence[EndRow], starts: str) -> tuple[float, float, float, float]:
    """Draw the cells and the paper's start; return the map's least and largest x and y: least x, least y, and so on."""
    _, z_L, alpha, beta = paper.START
    if starts == TILTS:
        x, y = ([r.start_alpha_deg for r in rows], [r.start_beta_deg for r in rows])
        mark = np.degrees([alpha, beta])
    else:
        x, y = ([np.log10(r.start_z_L_mm) for r in rows], [r.start_alpha_deg for r in rows])
        mark = np.array([np.log10(z_L), np.degrees(alpha)])
    width, height = _step(x), _step(y)
    for end in _LOOKS:
        cells = [
            Rectangle((a - width / 2, b - height / 2), width, height)
            for a, b, row in zip(x, y, rows, strict=True)
            if row.end == end
        ]
        if cells:
            axes.add_collection(PatchCollection(cells, **_patch(end)))
    axes.plot(*mark, marker="*", ms=12, mfc="white", mec="black", mew=1.2, ls="none")
    return min(x) - width / 2, min(y) - height / 2, max(x) + width / 2, max(y) + height / 2


def _tick(axes: Axes, starts: str) -> None:
    """Put ticks at round values inside the limits."""
    if starts == TILTS:
        low, high = axes.get_ylim()
        axes.set_yticks(
            [b for b in ((-90, 0, 90, 180) if high - low > 180 else (-40, -20, 0, 20, 40)) if low <= b <= high]
        )
        return
    low, high = axes.get_xlim()
    depths = [depth for depth in (20, 50, 250, 1000, 4000) if low <= np.log10(depth) <= high]
    axes.set_xticks(np.log10(depths), [str(depth) for depth in depths])


def _step(values: Sequence[float]) -> float:
    """Return the grid's step; of a single place, one that shows it."""
    places = np.unique(np.round(values, 9))
    return float(np.min(np.diff(places))) if len(places) > 1 else 1.0


def shares_figure(shares: Sequence[ShareRow], of_rigs: Sequence[ShareRow]) -> Figure:
    """Draw the shares of ends: the worked example from random starts, and random rigs."""
    solve, cold = total(of_rigs, DEFAULT), total(of_rigs, "random_ipopt_without")
    heading = (
        f"Told that the lit side is seen (c > 0), {solve.behind} searches from the closed form on {solve.searches} "
        f"random rigs end on the plane behind; not told and from random starts {100 * cold.behind_share:.1f} % do, and "
        f"{100 * share(shares, RANDOM, CONSTRAINED, 'without').behind_share:.1f} % of those on the worked example"
    )
    with figure(12.5, 9.5, heading) as made:
        example, rigs = made.subplots(2, 1, height_ratios=(25, 11))
        _bars(example, [(f"{_short(s)}, {s.inequality} c > 0", s) for s in _of_example(shares)])
        example.set_title("The paper's worked example, random starts")
        _bars(rigs, [(_of_rig(name, total(of_rigs, name)), total(of_rigs, name)) for name in (DEFAULT, *RUNS)])
        rigs.set_title("Random rigs and planes")
        present = {end for end in _LOOKS if any(_count(s, end) for s in (*shares, *of_rigs))}
        rigs.set_xlabel("share of the searches, %; at the right how many end behind, of how many")
        made.legend(
            handles=[Patch(**_patch(end, linewidth=0.5), label=_LOOKS[end].said) for end in _LOOKS if end in present],
            loc="outside lower center",
            ncols=4,
            handlelength=2.2,
            handleheight=1.4,
        )
    return made


def _of_example(shares: Sequence[ShareRow]) -> list[ShareRow]:
    return [s for s in shares if s.starts == RANDOM]


def _short(s: ShareRow) -> str:
    return "obvious programme, Ipopt" if s.search == OBVIOUS.method else s.search


def _of_rig(name: str, s: ShareRow) -> str:
    method = f"solve = {CONSTRAINED}" if name == DEFAULT else RUNS[name].search.method
    method = "obvious programme, Ipopt" if method == OBVIOUS.method else method
    return f"{method}, {s.inequality} c > 0, {s.starts} start".replace("form start", "form")


def _bars(axes: Axes, named: Sequence[tuple[str, ShareRow]]) -> None:
    places = np.arange(len(named))[::-1]
    left = np.zeros(len(named))
    for end in _LOOKS:
        parts = np.array([100 * _count(s, end) / s.searches for _, s in named])
        axes.barh(places, parts, left=left, height=0.78, **_patch(end, linewidth=0.3))
        left += parts
    for place, (_, s) in zip(places, named, strict=True):
        axes.text(100.6, place, f"{s.behind} of {s.searches}", va="center", fontsize=8)
    axes.set_yticks(places, [name for name, _ in named], fontsize=8)
    axes.set(xlim=(0, 100), ylim=(-0.6, len(named) - 0.4))


def _count(s: ShareRow, end: str) -> int:
    return int(getattr(s, end.replace(" ", "_")))
