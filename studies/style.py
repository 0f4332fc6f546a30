"""One look for the studies' figures."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

# Apart in lightness as well as in hue, so that they survive a grey print and colour-blind eyes; markers differ too.
DARK = "#123a6b"
LIGHT = "#e08214"
RED = "#c9382a"
FAINT = "0.72"

_STYLE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9,
}


@contextmanager
def figure(width: float, height: float, heading: str) -> Iterator[Figure]:
    """Yield a figure (inches) with its finding as heading; draw in the context, where the look holds."""
    with mpl.rc_context(_STYLE):
        made = Figure(figsize=(width, height), layout="constrained", dpi=130)
        made.suptitle(heading, x=0.01, ha="left", fontsize=12, fontweight="bold")
        yield made
        made.draw_without_rendering()
