"""One look for the studies' figures."""

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
from matplotlib.figure import Figure

from planeopt.look import CHART, DARK, LIGHT, RED

__all__ = ["DARK", "FAINT", "LIGHT", "RED", "figure"]

FAINT = "0.72"
_LETTERS_AN_INCH = 9.6
"""Of a heading, on average."""


def _wrapped(heading: str, letters: int) -> str:
    """Return a heading on as few lines as have room, all about as long."""
    heading = heading.replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
    lines = len(textwrap.wrap(heading, letters))
    least = next(n for n in range(letters // 2, letters + 1) if len(textwrap.wrap(heading, n)) == lines)
    return textwrap.fill(heading, least)


@contextmanager
def figure(width: float, height: float, heading: str) -> Iterator[Figure]:
    """Yield a figure (inches) with its finding as heading, wrapped; draw in the context, where the look holds."""
    with mpl.rc_context(dict(CHART)):
        made = Figure(figsize=(width, height), layout="constrained", dpi=130)
        made.suptitle(
            _wrapped(heading, int(_LETTERS_AN_INCH * width)), x=0.01, ha="left", fontsize=12, fontweight="bold"
        )
        yield made
        made.draw_without_rendering()
