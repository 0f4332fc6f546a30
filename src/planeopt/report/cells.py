"""Cells of tables that show numbers of a file of plain JSON values, and know where these stand in it."""

from collections.abc import Mapping, Sequence
from typing import Any

from planeopt.report.content import Cell, Table
from planeopt.report.words import fixed, p_text

DASH = Cell("-")


def value_at(data: Any, key: str) -> Any:
    """Return what stands at a dotted key of plain JSON values; None where a part of the way is missing."""
    for part in key.split("."):
        if isinstance(data, Mapping):
            data = data.get(part)
        elif isinstance(data, Sequence) and not isinstance(data, str) and int(part) < len(data):
            data = data[int(part)]
        else:
            return None
    return data


def cell(data: Mapping[str, Any], key: str, places: int) -> Cell:
    """Return the number at a key with so many decimals; a dash where there is none."""
    value = value_at(data, key)
    return DASH if value is None else Cell(fixed(value, places), key)


def pair(data: Mapping[str, Any], low: str, high: str, places: int) -> Cell:
    """Return an interval by the keys of its ends; a dash where one of them is missing."""
    first, second = value_at(data, low), value_at(data, high)
    if first is None or second is None:
        return DASH
    return Cell(f"{fixed(first, places)} to {fixed(second, places)}", f"{low} {high}")


def chance(data: Mapping[str, Any], key: str) -> Cell:
    """Return the p-value at a key; a dash where there is none."""
    value = value_at(data, key)
    return DASH if value is None else Cell(p_text(value), key)


def facts(title: str, pairs: Sequence[tuple[str, str]], key: str) -> Table:
    """Return a table of names and what they are, in words."""
    rows = tuple((Cell(name), Cell(value)) for name, value in pairs)
    return Table(title, ("", ""), rows, words=2, key=key)
