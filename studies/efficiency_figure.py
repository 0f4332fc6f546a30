"""The figure of the efficiency study: errors over the bound, and coverage, against the criterion."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from studies.efficiency_cells import CellRow
from studies.efficiency_summary import EFFICIENT, VerdictRow, limits
from studies.style import DARK, FAINT, LIGHT, figure


def efficiency_figure(rows: Sequence[CellRow], found: Sequence[VerdictRow]) -> Figure:
    """Draw each cell's error over the bound, and its coverage, against how far it is from the criterion's limits."""
    above = ", ".join(f"{verdict.above} of {verdict.cells} cells {verdict.criterion} it" for verdict in found)
    heading = (
        f"Within the criterion the error over the bound is {found[0].pooled_over_bound:.3f}; "
        f"above {EFFICIENT} by more than chance: {above}"
    )
    excess = np.array([row.excess for row in rows])
    far = np.isfinite(excess)
    edge = 3 * float(np.max(excess[far]))
    x = np.where(far, excess, edge)
    across, iso = (np.array([getattr(row, name) for row in rows]) for name in ("over_bound", "isotropic_over_bound"))
    with figure(10.5, 9.5, heading) as made:
        near, over, covered = made.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
        near.axhspan(1.0, EFFICIENT, color=LIGHT, alpha=0.25, lw=0, label=f"1 to {EFFICIENT}, what is asked within")
        most = limits(rows)[1]
        inside = [high for row, high in zip(rows, most, strict=True) if row.excess <= 1]
        label = f"{EFFICIENT} and what chance adds within"
        near.plot([float(np.min(x)), 1], [max(inside)] * 2, color="black", lw=0.9, ls=":", label=label)
        for axes in (near, over):
            axes.plot(x, iso, "^", ms=4, color=FAINT, label="isotropic noise (half the draws)", zorder=1)
            axes.plot(x, across, "o", ms=4, color=DARK, label="noise across the boundary", zorder=2)
        near.set(
            title="RMS error of (z_L, p, q), pooled by the bound; a dot is a cell; beyond 3 with a tenth of the draws",
            ylabel="over the bound",
            ylim=(0.9, 1.15),
        )
        near.legend(loc="upper left", ncols=2)
        over.set_yscale("log")
        over.yaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100]))
        over.yaxis.set_minor_locator(NullLocator())
        over.yaxis.set_major_formatter("{x:g}")
        over.set(title="the same, all of it", ylabel="over the bound")
        covered.plot(x, [row.covered_95 for row in rows], "o", ms=4, color=DARK)
        covered.axhline(0.95, color="black", lw=0.8, zorder=0)
        covered.set(
            title="coverage of the 95 % ellipsoid of each answer's own covariance",
            ylabel="share of the draws",
            xlabel="the worst of noise share, curvature and slope sigma, over its limit in the criterion",
        )
        for axes in (near, over, covered):
            axes.set_xscale("log")
            axes.axvline(1.0, color="black", lw=0.8)
            axes.grid(visible=True)
    return made
