"""Sheets of paper: by their names, or by width and height."""

import re
from dataclasses import dataclass

from planeopt.errors import InputError

PAPERS = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "Letter": (215.9, 279.4),
    "Legal": (215.9, 355.6),
    "Tabloid": (279.4, 431.8),
}
"""Width and height in mm, upright."""

SERIES = ("A5", "A4", "A3", "A2", "A1", "A0")
"""From the smallest to the largest: what a size is chosen from."""

_CUSTOM = re.compile(r"([\d.]+)\s*[xX×]\s*([\d.]+)(?:\s*mm)?")  # noqa: RUF001 - the multiplication sign is meant
_LIMITS = (30.0, 5000.0)  # mm; a PDF reader takes up to 5080 mm


@dataclass(frozen=True)
class Paper:
    """A sheet, which may be turned.

    Parameters
    ----------
    name : str
    size_mm : tuple of float
        Width and height.
    """

    name: str
    size_mm: tuple[float, float]

    def __str__(self) -> str:
        """Return the name and, where it does not say it, the size."""
        size = _in_words(self.size_mm)
        return size if self.name == size else f"{self.name} ({size})"

    def holding(self, needed_mm: tuple[float, float]) -> tuple[float, float] | None:
        """Return (width, height) in the position in which something has room, lying where both do; None if neither."""
        width, height = sorted(self.size_mm, reverse=True)
        turned = [(width, height), (height, width)]
        if needed_mm[1] > needed_mm[0]:
            turned.reverse()
        return next((size for size in turned if needed_mm[0] <= size[0] and needed_mm[1] <= size[1]), None)


def paper_of(name: str) -> Paper:
    """Return the sheet of a name such as A4 or Letter, or of a size such as 300x200, mm.

    Raises
    ------
    InputError
        If there is no such paper, or its size is absurd.
    """
    known = {key.lower(): key for key in PAPERS}
    if name.lower() in known:
        key = known[name.lower()]
        return Paper(key, PAPERS[key])
    custom = _CUSTOM.fullmatch(name.strip())
    try:
        size = (float(custom[1]), float(custom[2])) if custom else None
    except ValueError:
        size = None
    if size is None:
        raise InputError(f"paper {name!r} is not known: give {', '.join(PAPERS)}, or width x height in mm as 300x200")
    if not all(_LIMITS[0] <= side <= _LIMITS[1] for side in size):
        raise InputError(f"paper {name!r}: its sides must be {_LIMITS[0]:g} to {_LIMITS[1]:g} mm")
    return Paper(_in_words(size), size)


def _in_words(size_mm: tuple[float, float]) -> str:
    return f"{size_mm[0]:g} x {size_mm[1]:g} mm"
