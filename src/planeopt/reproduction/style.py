"""What the figures share: colours far apart in lightness, and one look."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

# Apart in lightness as well as in hue, so that they survive a grey print and colour-blind eyes; dashes help too.
TRUE = "#123a6b"
SECOND = "#e08214"
BEAM = "#c9382a"
FAINT = "0.62"

_STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "axes.labelsize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
}

SAVED: dict[Any, Any] = {"svg.hashsalt": "planeopt", "svg.fonttype": "path"}
"""How figures are saved: ids in SVG files are random unless salted, and the same numbers are to give the same file."""


@contextmanager
def new_figure(width: float, height: float, heading: str) -> Iterator[Figure]:
    """Yield a figure (inches) with its heading, not attached to any window; draw it inside the context.

    Titles and labels are laid out when drawn, so the figure is drawn once while the look holds.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained", dpi=160)
        figure.suptitle(heading, x=0.01, ha="left", fontsize=12.5, fontweight="bold")
        yield figure
        figure.canvas.draw()
