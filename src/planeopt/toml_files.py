"""TOML files: read with one clear line for what is wrong, written beside their place and then renamed into it."""

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from planeopt.errors import InputError

FORMAT = 1
"""Version of the file formats that this reads and writes."""

T = TypeVar("T")

_TYPES = {
    "float": "a number",
    "int": "a whole number",
    "array": "a list",
    "object": "a table",
    "str": "a text",
    "bool": "true or false",
    "date": "a date",
    "datetime": "a date and time",
}
_LIMITS = {">=": "at least", ">": "above", "<=": "at most", "<": "below"}


def read_toml(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """Return what a TOML file holds.

    Parameters
    ----------
    path : path-like
    what : str
        What the file is, in a word: a rig, a scene.

    Raises
    ------
    InputError
        If the file is missing, unreadable or not TOML.
    """
    text = read_text(path, what)
    try:
        return tomllib.loads(text)
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error


def read_text(path: str | os.PathLike[str], what: str) -> str:
    """Return what a text file holds, in UTF-8 with or without a mark at its head.

    Parameters
    ----------
    path : path-like
    what : str
        What the file is, in a word.

    Raises
    ------
    InputError
        If the file is missing, unreadable or not text.
    """
    file = Path(path)
    try:
        return file.read_bytes().decode("utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(f"{file}: there is no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{file}: this is a folder; name the {what} file in it") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text file in UTF-8 (byte {error.start})") from error


def as_tables(mapping: Mapping[str, Any], kind: type[T], source: str) -> T:
    """Return the tables of a file of this format.

    Parameters
    ----------
    mapping : mapping
        As read.
    kind : type
        A `msgspec.Struct`.
    source : str
        Where it came from; messages begin with it.

    Raises
    ------
    InputError
        If the format is not known, or a key is missing, unknown or not of its type.
    """
    version = mapping.get("format", FORMAT)
    if isinstance(version, int) and not isinstance(version, bool) and version != FORMAT:
        raise InputError(f"{source}: format {version} is not known; this version of planeopt reads format {FORMAT}")
    try:
        return msgspec.convert(dict(mapping), kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{source}: {_in_words(str(error))}") from error


def _in_words(message: str) -> str:
    """Turn msgspec's message ("Expected `float`, got `str` - at `$.camera.fx`") into the words of the file."""
    what, _, where = message.partition(" - at ")
    key = where.strip("`").removeprefix("$").removeprefix(".").replace("[...]", "")
    name = key or "the file"
    place = f"[{key}]" if key else name
    if found := re.fullmatch(r"Object missing required field `(.+)`", what):
        return f"{place} lacks the key {found[1]!r}"
    if found := re.fullmatch(r"Object contains unknown field `(.+)`", what):
        return f"{place} has the unknown key {found[1]!r}: check its spelling, or remove it"
    if found := re.fullmatch(r"Expected `(.+)`, got `(.+)`", what):
        wanted = " or ".join(_TYPES.get(part, part) for part in found[1].split(" | ") if part != "null")
        given = "a decimal number" if found[2] == "float" else _TYPES.get(found[2], found[2])
        return f"{name} must be {wanted}, not {given}"
    if found := re.fullmatch(r"Expected `array` of length (\d+), got (\d+)", what):
        return f"{name} must be a list of {found[1]}, not of {found[2]}"
    if found := re.fullmatch(r"Expected `\w+` (>=|>|<=|<) (.+)", what):
        return f"{name} must be {_LIMITS[found[1]]} {found[2]}"
    if what.startswith("Invalid enum value"):
        return f"{name} cannot be {what.removeprefix('Invalid enum value ')}"
    # What the tables themselves say names its key already.
    return what if key and what.startswith(key.split(".")[0]) else f"{name}: {what}"
