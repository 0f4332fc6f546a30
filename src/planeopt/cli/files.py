"""Files that commands write: beside their place and renamed into it, so that a reader never sees half of one."""

import csv
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.record import PoseRecord


@contextmanager
def output_folder(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a folder to write into, whose files are in `path` when all is done; nothing is there if it fails.

    Parameters
    ----------
    path : Path
        Missing parents are made.
    force : bool
        Let the folder exist; files of the same name are replaced, others stay.

    Raises
    ------
    InputError
        If the folder exists, without `force`, or cannot be made.
    """
    if path.exists() and not force:
        raise InputError(f"{path}: exists already; name another folder, or give --force to write into it")
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, not a folder to write into")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror})") from error
    try:
        yield staging
        path.mkdir(exist_ok=True)
        for file in sorted(staging.rglob("*")):
            place = path / file.relative_to(staging)
            if file.is_dir():
                place.mkdir(exist_ok=True)
            else:
                file.replace(place)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with the same keys as a table with a header; None is an empty cell, numbers are exact."""
    with path.open("w", encoding="utf-8", newline="") as file:
        if rows:
            table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)


@contextmanager
def record_file(
    path: Path, inputs: Sequence[str], formulation: str, *, resume: bool, force: bool
) -> Iterator[tuple[list["PoseRecord"], Callable[["PoseRecord"], None]]]:
    """Open a file of records, one a line, that can be continued after an interruption.

    Records go to `FILE.part`, each as soon as it is given; at the end that file is renamed.

    Parameters
    ----------
    path : Path
    inputs : sequence of str
        All inputs of the run, in order.
    formulation : str
        By which the run solves; records of another one are not continued. The rig is not in the records: that it is the
        same is the user's to see to.
    resume : bool
        Keep the complete records that are there.
    force : bool
        Overwrite what is there.

    Yields
    ------
    kept : list of PoseRecord
        Of the first inputs.
    write : callable
        Takes the records of the remaining inputs, in order.

    Raises
    ------
    InputError
        If the file cannot be written, exists without `resume` or `force`, or holds records of other inputs
        or of another formulation.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name the file of records to write in it")
    partial = path.with_name(f"{path.name}.part")
    if resume and force:
        raise InputError("--resume keeps what is there and --force overwrites it: give one of them")
    kept: list[PoseRecord] = []
    content = b""
    if resume:
        kept, content = _kept(partial if partial.exists() else path, inputs, formulation)
    elif not force and path.exists():
        raise InputError(f"{path}: exists already; --force overwrites it, --resume continues it")
    elif not force and partial.exists():
        raise InputError(f"{partial}: is left from an interrupted run; --resume continues it, --force begins anew")
    try:
        file = partial.open("r+b" if resume and partial.exists() else "wb")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        with file:
            file.write(content)
            file.truncate()

            def write(record: "PoseRecord") -> None:
                file.write(f"{record.to_json()}\n".encode("ascii"))
                file.flush()

            yield kept, write
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        if partial.exists() and partial.stat().st_size == 0:
            partial.unlink()


def spare_what_is_read(output: Path, read: Iterable[str | Path]) -> None:
    """Refuse to write over an input or the rig, or over what is no regular file, whatever was forced."""
    target = output.resolve()
    if any(Path(name).resolve() == target for name in read):
        raise InputError(f"{output}: is read in this run; name another file to write")
    if target.exists() and not target.is_file() and not target.is_dir():
        raise InputError(f"{output}: is not a regular file; leave -o out to write to standard output")


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


def _kept(path: Path, inputs: Sequence[str], formulation: str) -> tuple[list["PoseRecord"], bytes]:
    """Return the complete records of a file, and the bytes they take; a last line that was cut off is left out."""
    from planeopt.record import record_from_json

    try:
        lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if lines and not lines[-1].endswith(b"\n"):
        lines.pop()
    if len(lines) > len(inputs):
        raise InputError(f"{path}: holds {len(lines)} records, but {len(inputs)} inputs were given; see --force")
    kept = []
    for number, (line, name) in enumerate(zip(lines, inputs, strict=False), start=1):
        try:
            record = record_from_json(line)
        except InputError as error:
            raise InputError(f"{path}, line {number}: {error}; see --force") from error
        if record.input != name:
            raise InputError(
                f"{path}, line {number}: is the record of {record.input!r}, not of {name!r}: --resume needs the same "
                "inputs in the same order; see --force"
            )
        if record.formulation not in (None, formulation):
            asked = f"but {formulation} was asked for; see --force"
            raise InputError(f"{path}, line {number}: is a record of {record.formulation}, {asked}")
        kept.append(record)
    return kept, b"".join(lines)
