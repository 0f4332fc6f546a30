"""One look for the studies' figures."""

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
from matplotlib.figure import Figure

from planeopt.look import CHART, DARK, LIGHT, RED

__all__ = ["DARK", "FAINT", "LIGHT", "RED", "figure"]

FAINT = "0.72"
_LETTERS_AN_INCH = 9.2
"""Of a heading, on average."""


@contextmanager
def figure(width: float, height: float, heading: str) -> Iterator[Figure]:
    """Yield a figure (inches) with its finding as heading, wrapped; draw in the context, where the look holds."""
    with mpl.rc_context(dict(CHART)):
        made = Figure(figsize=(width, height), layout="constrained", dpi=130)
        wrapped = textwrap.fill(heading, int(_LETTERS_AN_INCH * width))
        made.suptitle(wrapped, x=0.01, ha="left", fontsize=12, fontweight="bold")
        yield made
        made.draw_without_rendering()
