"""Files that commands write: beside their place and renamed into it, so that a reader never sees half of one."""

import csv
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from planeopt.errors import InputError
from planeopt.whole_files import place_of, write_whole


@contextmanager
def output_folder(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a folder to write into, whose files are in `path` when all is done; nothing is there if it fails.

    Parameters
    ----------
    path : Path
        Missing parents are made.
    force : bool
        Let the folder exist; files of the same name are replaced, others stay. Of a file that is a symbolic link the
        target is written.

    Raises
    ------
    InputError
        If the folder exists, without `force`, or cannot be made, or holds what is no file where one is to be written.
    """
    if path.exists() and not force:
        raise InputError(f"{path}: exists already; name another folder, or give --force to write into it")
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, not a folder to write into")
    # Beside the folder itself, not beside a link to it: nothing can be renamed into another file system.
    folder = Path(os.path.realpath(path))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror})") from error
    try:
        yield staging
        _move_into(path, staging)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _move_into(path: Path, staging: Path) -> None:
    """Move all that is in a folder into another; nothing if one of them has no place there."""
    written = [(file, path / file.relative_to(staging)) for file in sorted(staging.rglob("*"))]
    for file, place in written:
        if not file.is_dir():
            place_of(place)
    # Of a link that leads nowhere yet, what it leads to.
    Path(os.path.realpath(path)).mkdir(exist_ok=True)
    for file, place in written:
        if file.is_dir():
            place.mkdir(exist_ok=True)
        elif place.is_symlink():
            write_whole(place, partial(shutil.copyfile, file))
        else:
            file.replace(place)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with the same keys as a table with a header; None is an empty cell, numbers are exact."""
    with path.open("w", encoding="utf-8", newline="") as file:
        if rows:
            table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)


def spare_what_is_read(output: Path, read: Iterable[str | Path]) -> None:
    """Refuse to write over an input or the rig, or over what is no regular file, whatever was forced."""
    target = output.resolve()
    # Tens of thousands of names take a while to resolve; a file that is not there is none of those that are read.
    if target.exists() and any(Path(name).resolve() == target for name in read):
        raise InputError(f"{output}: is read in this run; name another file to write")
    # Itself, not its resolved name: what standard output leads to has none where it is a pipe.
    if output.exists() and not output.is_file() and not output.is_dir():
        raise InputError(f"{output}: is not a regular file; name one to write")


def may_write(output: Path, read: Iterable[str | Path], *, force: bool) -> None:
    """Refuse a file to write that is a folder, is read in the same run, or exists without `force`.

    Raises
    ------
    InputError
        If one of these holds.
    """
    spare_what_is_read(output, read)
    if output.is_dir():
        raise InputError(f"{output}: is a folder; name the file to write in it")
    if output.exists() and not force:
        raise InputError(f"{output}: exists already; --force overwrites it")


def spare_inputs(written: Iterable[Path], read: Iterable[str | Path]) -> None:
    """Refuse to write files of an output folder over what is read in the same run, whatever was forced."""
    sources = {Path(name).resolve(): name for name in read}
    for path in written:
        if path.resolve() in sources:
            source = sources[path.resolve()]
            raise InputError(f"{source}: is read in this run and would be written over; name another output folder")


def names_in(path: Path) -> list[str]:
    """Return the names that a file lists, one a line, or standard input where the path is ``-``.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        content = sys.stdin.buffer.read() if str(path) == "-" else path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    return [os.fsdecode(line) for line in content.splitlines() if line.strip()]
