"""Checks of single numbers, each with a message that names the key as the file does."""

import math

from planeopt.errors import InputError


def finite(key: str, value: float) -> float:
    """Return the value as a float, or raise an `InputError` that names the key."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{key} must be a number, not {value!r}") from error
    if not math.isfinite(number):
        raise InputError(f"{key} must be a finite number, not {number}")
    return number


def positive(key: str, value: float, unit: str) -> float:
    """Return the value as a positive float, or raise an `InputError` that names the key and the unit."""
    number = finite(key, value)
    if number <= 0:
        raise InputError(f"{key} must be positive ({unit}), not {number}")
    return number
