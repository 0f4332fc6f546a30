"""Files that are there whole or not at all: written beside their place, then renamed into it."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from planeopt.errors import InputError


def write_whole(path: str | os.PathLike[str], write_to: Callable[[Path], object]) -> None:
    """Have a file written beside its place, with the same suffix, and rename it into it.

    Parameters
    ----------
    path : path-like
    write_to : callable
        Writes the file whose path it is given.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    file = Path(path)
    beside = file.with_name(f".{os.getpid()}.{file.name}")
    try:
        write_to(beside)
        beside.replace(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8, its lines as they are, in the manner of `write_whole`.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_whole(path, lambda beside: beside.write_text(text, encoding="utf-8", newline=""))
