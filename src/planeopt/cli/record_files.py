"""A file of records, one a line, that an interrupted run leaves and the same command continues."""

import math
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planeopt.errors import InputError
from planeopt.whole_files import place_of

if TYPE_CHECKING:
    from planeopt.record import PoseRecord

WORKER_LOST = "worker_lost"


@dataclass(frozen=True)
class Kept:
    """The complete records that a run left, which are gone through and never held.

    Attributes
    ----------
    source : Path
        The file that holds them.
    count : int
        How many there are.
    size : int
        Bytes that they take: what follows is a line that was cut off.
    samples : tuple of (int, PoseRecord)
        Some of them with their lines, which together tell with what rig and options they were measured: the last of
        each status, of images and of files of points.
    """

    source: Path
    count: int = 0
    size: int = 0
    samples: tuple[tuple[int, "PoseRecord"], ...] = ()

    def records(self) -> Iterator["PoseRecord"]:
        """Yield the records, one after the other from the file."""
        from planeopt.record import record_from_json

        if not self.count:
            return
        with self.source.open("rb") as file:
            yield from map(record_from_json, islice(file, self.count))


def partial_file(path: Path) -> Path:
    """Return where the records are until the last of them is written."""
    return path.with_name(f"{path.name}.part")


def kept_records(path: Path, inputs: Sequence[str], formulation: str) -> Kept:
    """Go through what a run left, to be continued; nothing is written.

    Parameters
    ----------
    path : Path
        The output file; where `FILE.part` is, that counts.
    inputs : sequence of str
        All inputs of the run, in order.
    formulation : str
        By which the run solves; records of another one are not continued.

    Raises
    ------
    InputError
        If the file cannot be read, or holds what is no record, or records of other inputs or another formulation.
    """
    partial = partial_file(path)
    source = partial if partial.exists() else path
    if not source.exists():
        return Kept(source)
    size = 0
    count = 0
    samples: dict[tuple[bool, str], tuple[int, PoseRecord]] = {}
    try:
        with source.open("rb") as file:
            for count, line in enumerate(_whole_lines(file), start=1):
                if count > len(inputs):
                    continue
                record = _record(source, count, line, inputs[count - 1], formulation)
                size += len(line)
                if WORKER_LOST not in record.flags:
                    samples[record.input.lower().endswith(".csv"), record.status] = (count, record)
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror})") from error
    if count > len(inputs):
        raise InputError(f"{source}: holds {count} records, but {len(inputs)} inputs were given; see --force")
    return Kept(source, count, size, tuple(sorted(samples.values(), key=lambda sample: sample[0])))


def check_kept(kept: Kept, measure: Callable[[list[str]], Iterator["PoseRecord"]]) -> bool:
    """Measure some of the kept inputs again: the rig and the options are not in the records, but their effect is.

    Numbers may differ by what rounding does from one machine to another.

    Parameters
    ----------
    kept : Kept
    measure : callable
        Yields the records of inputs, in order.

    Returns
    -------
    bool
        Whether there was something to tell by: inputs whose files are still there.

    Raises
    ------
    InputError
        If a record comes out otherwise.
    """
    there = [(number, record) for number, record in kept.samples if Path(record.input).exists()]
    again = measure([record.input for _, record in there])
    for (number, record), other in zip(there, again, strict=True):
        key = _difference(record.to_dict(), other.to_dict())
        if key is not None and WORKER_LOST not in other.flags:
            raise InputError(
                f"{kept.source}, line {number}: {record.input!r} measured again gives another {key}: the rig, the "
                "options, planeopt or that input changed since; --force begins anew"
            )
    return bool(there) or not kept.samples


@contextmanager
def record_file(path: Path, kept: Kept | None, *, force: bool) -> Iterator[Callable[["PoseRecord"], None]]:
    """Open a file of records, one a line, that can be continued after an interruption.

    Records go to `FILE.part`, each as soon as it is given; at the end that file is renamed.

    Parameters
    ----------
    path : Path
        No symbolic link, but where it leads (`planeopt.whole_files.place_of`).
    kept : Kept or None
        What to continue; None begins anew.
    force : bool
        Overwrite what is there.

    Yields
    ------
    What takes the records of the remaining inputs, in order.

    Raises
    ------
    InputError
        If the file cannot be written, or exists without `kept` or `force`.
    """
    may_begin(path, resume=kept is not None, force=force)
    partial = partial_file(path)
    try:
        if kept is not None and kept.source == path and path.exists():
            shutil.copyfile(path, partial)
        file = partial.open("r+b" if kept is not None and partial.exists() else "wb")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        with file:
            file.truncate(0 if kept is None else kept.size)
            file.seek(0, os.SEEK_END)

            def write(record: "PoseRecord") -> None:
                file.write(f"{record.to_json()}\n".encode("ascii"))
                file.flush()

            yield write
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        if partial.exists() and partial.stat().st_size == 0:
            partial.unlink()


def may_begin(path: Path, *, resume: bool, force: bool) -> None:
    """Refuse an output file that cannot be one, or is there without `resume` or `force`.

    Raises
    ------
    InputError
        If it is so, or both are given.
    """
    partial = partial_file(path)
    place_of(path)
    # It is renamed at the end: where it is a link, what it leads to would be left behind.
    if place_of(partial) != partial:
        raise InputError(f"{partial}: is a link; remove it, the records are written there first")
    if resume and force:
        raise InputError("--resume keeps what is there and --force overwrites it: give one of them")
    if resume or force:
        return
    if path.exists():
        raise InputError(f"{path}: exists already; --force overwrites it, --resume continues it")
    if partial.exists():
        raise InputError(f"{partial}: is left from an interrupted run; --resume continues it, --force begins anew")


def _whole_lines(lines: Iterator[bytes]) -> Iterator[bytes]:
    """Leave out a last line that was cut off."""
    return (line for line in lines if line.endswith(b"\n"))


def _record(source: Path, number: int, line: bytes, name: str, formulation: str) -> "PoseRecord":
    """Return the record of a line, if it is the one that the run would continue."""
    from planeopt.record import record_from_json

    try:
        record = record_from_json(line)
    except InputError as error:
        raise InputError(f"{source}, line {number}: {error}; see --force") from error
    if record.input != name:
        raise InputError(
            f"{source}, line {number}: is the record of {record.input!r}, not of {name!r}: --resume needs the same "
            "inputs in the same order; see --force"
        )
    if record.formulation not in (None, formulation):
        asked = f"but {formulation} was asked for; see --force"
        raise InputError(f"{source}, line {number}: is a record of {record.formulation}, {asked}")
    return record


def _difference(one: Any, other: Any, key: str = "record") -> str | None:
    """Return the key of the first value that differs by more than rounding, None where there is none."""
    if isinstance(one, dict) and isinstance(other, dict):
        pairs = [(name, one[name], other.get(name)) for name in one]
    elif isinstance(one, list | tuple) and isinstance(other, list | tuple) and len(one) == len(other):
        pairs = [(key, *pair) for pair in zip(one, other, strict=True)]
    elif isinstance(one, float) and isinstance(other, float):
        return None if math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-9) else key
    else:
        return None if one == other else key
    found = (_difference(left, right, name) for name, left, right in pairs)
    return next((name for name in found if name is not None), None)
