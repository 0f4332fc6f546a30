"""What the keys of a camera's file may hold, each refusal naming file and key."""

import math
import re
from collections.abc import Sequence
from typing import Any

from planeopt.errors import InputError
from planeopt.formats.documents import Document

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WHOLE = re.compile(r"\d{1,9}(?:\.0*)?")
# A 3 x 3 camera matrix, row by row: what stands where in a pinhole camera without skew.
_SKEW = 1
_ZEROS, _ONE = (3, 6, 7), 8


def text(document: Document, key: str, source: str) -> str | None:
    """Return a text, or None where the key is missing."""
    value = document.get(key)
    if value is None or isinstance(value, str):
        return value
    raise InputError(f"{source}: {key} must be a text")


def whole(document: Document, key: str, source: str) -> int:
    """Return a whole number that is not negative."""
    if key not in document:
        raise InputError(f"{source}: the key {key!r} is missing")
    value = document[key]
    if not isinstance(value, str) or not _WHOLE.fullmatch(value):
        raise InputError(f"{source}: {key} must be a whole number, not {shown(value)}")
    return int(float(value))


def matrix(document: Document, key: str, source: str) -> tuple[tuple[int, int], tuple[float, ...]]:
    """Return the shape of a matrix and its numbers, row by row.

    Raises
    ------
    InputError
        If it is missing, no matrix, or has other than rows x cols numbers.
    """
    if key not in document:
        raise InputError(f"{source}: the key {key!r} is missing")
    table = document[key]
    if not isinstance(table, dict):
        raise InputError(f"{source}: {key} must be a matrix with rows, cols and data, not {shown(table)}")
    for part in ("rows", "cols", "data"):
        if part not in table:
            raise InputError(f"{source}: {key} has no {part!r}: a matrix has rows, cols and data")
    shape = whole(table, "rows", f"{source}: {key}"), whole(table, "cols", f"{source}: {key}")
    found = numbers(table["data"], f"{source}: {key}.data")
    if len(found) != shape[0] * shape[1]:
        raise InputError(f"{source}: {key}.data must be {shape[0]} x {shape[1]} numbers, not {len(found)}")
    return shape, found


def numbers(value: Any, where: str) -> tuple[float, ...]:
    """Return numbers from a list, or from a text that holds them between spaces; XML, and old files of ROS, have that.

    Raises
    ------
    InputError
        If one is no finite number; names it by its place.
    """
    items = value if isinstance(value, list) else [value]
    if not all(isinstance(item, str) for item in items):
        raise InputError(f"{where} must be a plain list of numbers")
    words = [word for item in items for word in item.split()]
    found = []
    for place, word in enumerate(words, start=1):
        number = float(word) if _NUMBER.fullmatch(word) else math.nan
        if not math.isfinite(number):
            raise InputError(f"{where}: the value {place} must be a finite number, not {shown(word)}")
        found.append(number)
    return tuple(found)


def pinhole(document: Document, key: str, source: str) -> tuple[float, float, float, float]:
    """Return (fx, fy, cx, cy) of a camera matrix.

    Raises
    ------
    InputError
        If it is not the 3 x 3 matrix of a pinhole camera, or has skew.
    """
    shape, found = matrix(document, key, source)
    if shape != (3, 3):
        raise InputError(f"{source}: {key} must be 3 x 3, not {shape[0]} x {shape[1]}")
    if found[_SKEW] != 0:
        raise InputError(
            f"{source}: {key} has the skew {found[_SKEW]:g}, which OpenCV's model does not have: calibrate without it"
        )
    if any(found[place] != 0 for place in _ZEROS) or found[_ONE] != 1:
        raise InputError(f"{source}: {key} must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], row by row")
    return found[0], found[4], found[2], found[5]


def five(coefficients: Sequence[float], where: str, other_models: str) -> tuple[float, float, float, float, float]:
    """Return (k1, k2, p1, p2, k3); what is missing is 0, and what follows must be.

    Raises
    ------
    InputError
        If further coefficients are not 0, or there are too few to tell the model.
    """
    count = len(coefficients)
    if count not in (0, 4) and count < 5:
        raise InputError(f"{where} must be k1, k2, p1, p2 and k3, but there are {count}")
    if any(coefficients[5:]):
        raise InputError(f"{where} has {count} coefficients, of which more than five are not 0: {other_models}")
    k1, k2, p1, p2, k3 = (*coefficients[:5], *([0.0] * (5 - min(count, 5))))
    return k1, k2, p1, p2, k3


def shown(value: Any) -> str:
    """Return a value as a message shows it: short, and a table or list by that name."""
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else f"{value[:40]}...")
    return "a list" if isinstance(value, list) else "a table"
