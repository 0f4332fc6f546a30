"""What all figures have in common: their colours and their frame."""

from collections.abc import Mapping
from typing import Any

# Apart in lightness as well as in hue, so that they survive a grey print and colour-blind eyes.
DARK = "#123a6b"
RED = "#c9382a"
LIGHT = "#e08214"

# Keys of Matplotlib's settings are literal types in its stubs.
FRAME: Mapping[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
}
"""Settings of every figure: two axes, a faint grid behind."""

CHART: Mapping[Any, Any] = {
    **FRAME,
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 9,
}
"""Settings of a figure that stands alone."""
