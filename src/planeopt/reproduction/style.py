"""What the figures share: colours far apart in lightness, and one look."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from planeopt.look import CHART, DARK, LIGHT, RED

TRUE, SECOND, BEAM = DARK, LIGHT, RED
FAINT = "0.62"

_STYLE: dict[Any, Any] = {
    **CHART,
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.labelsize": 10,
    "legend.fontsize": 9.5,
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
