"""When each image of a sequence was taken, from a table beside the images."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.estimation.sequence import Positions

HEADER = ["image", "time_s"]


def read_times(path: Path, names: Sequence[str]) -> "Positions":
    """Read a CSV table with the header `image,time_s`: a row an image, by its name with or without folders.

    Parameters
    ----------
    path : Path
        Rows of other images are let pass.
    names : sequence of str
        Of the inputs.

    Raises
    ------
    InputError
        If the file cannot be read, is not such a table, or lacks an input.
    """
    from planeopt.estimation.sequence import Positions

    times = _times(path)
    seconds = []
    for name in names:
        time = times.get(name, times.get(Path(name).name))
        if time is None:
            raise InputError(f"{path}: has no row for {name}")
        seconds.append(time)
    return Positions.at_times(seconds)


def _times(path: Path) -> dict[str, float]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a CSV table in UTF-8 ({error})") from error
    if not rows or [cell.strip() for cell in rows[0]] != HEADER:
        raise InputError(f"{path}: must begin with the header {','.join(HEADER)}")
    times: dict[str, float] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        name = row[0].strip()
        time = _seconds(row)
        if time is None:
            raise InputError(f"{path}, line {number}: must be an image and a finite number of seconds, not {row}")
        if name in times:
            raise InputError(f"{path}, line {number}: {name} stands there twice")
        times[name] = time
    return times


def _seconds(row: list[str]) -> float | None:
    try:
        time = float(row[1]) if len(row) == len(HEADER) else math.nan
    except ValueError:
        return None
    return time if math.isfinite(time) else None
