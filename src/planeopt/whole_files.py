"""Files that are there whole or not at all: written beside their place, then renamed into it."""

import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from planeopt.errors import InputError


def place_of(path: str | os.PathLike[str]) -> Path:
    """Return the place that a file is renamed into: of a symbolic link its target, so that the link stays.

    Parameters
    ----------
    path : path-like
        Of a file to write, there already or not.

    Raises
    ------
    InputError
        If something other than a file is there, such as a folder, a pipe or a device: a rename would put a file in its
        stead. A link is judged by what it opens, as that of standard output need not lead to any name.
    """
    file = Path(path)
    try:
        mode = file.stat().st_mode
    except FileNotFoundError:
        return Path(os.path.realpath(file)) if file.is_symlink() else file
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror})") from error
    if stat.S_ISDIR(mode):
        raise InputError(f"{file}: is a folder; name the file to write in it")
    if not stat.S_ISREG(mode):
        raise InputError(f"{file}: is not a regular file; name one to write")
    if not file.is_symlink():
        return file
    target = Path(os.path.realpath(file))
    if not target.exists():
        raise InputError(f"{file}: leads to a file without a name; name another one to write")
    return target


def write_whole(path: str | os.PathLike[str], write_to: Callable[[Path], object]) -> None:
    """Have a file written beside its place, with the same suffix, and rename it into it.

    Parameters
    ----------
    path : path-like
        Of a symbolic link the target is written.
    write_to : callable
        Writes the file whose path it is given.

    Raises
    ------
    InputError
        If the file cannot be written, or its place is none for a file (`place_of`).
    """
    file = Path(path)
    place = place_of(file)
    beside = place.with_name(f".{os.getpid()}.{file.name}")
    try:
        write_to(beside)
        beside.replace(place)
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
