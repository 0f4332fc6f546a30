"""Measure a plane with one camera and one cylindrical laser beam.

Names are imported on first use, so that ``planeopt --help`` starts without CasADi, SciPy or OpenCV.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planeopt.errors import InputError

__version__ = "0.1.0"

_HOMES = {
    "InputError": "planeopt.errors",
}

__all__ = ["InputError", "__version__"]


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'planeopt' has no attribute {name!r}")
    return getattr(import_module(home), name)
