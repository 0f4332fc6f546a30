"""Corners on disk: CSV with the header ``image,id,x_px,y_px`` or ``image,id,x_px,y_px,sigma_px``."""

import codecs
import csv
import io
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from planeopt.board import Board, View
from planeopt.errors import InputError
from planeopt.whole_files import write_text

_HEADER = ["image", "id", "x_px", "y_px", "sigma_px"]
_EXPECTED = "the header must be image,id,x_px,y_px or image,id,x_px,y_px,sigma_px"
UNKNOWN_SIGMA = 0.1
"""px: of corners whose file does not say; only ratios matter, as the adjustment finds the common factor."""
_SIGMAS = (1e-6, 1e3)  # px: beyond, no corner was measured, and weights overflow


def save_detections(views: Iterable[View], path: str | os.PathLike[str]) -> None:
    """Write the corners of views, exactly: `load_detections` gives the same numbers back.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADER)
    for view in views:
        for number, (x, y), sigma in zip(view.ids.tolist(), view.corners.tolist(), view.sigma.tolist(), strict=True):
            writer.writerow([view.name, number, repr(x), repr(y), repr(sigma)])
    write_text(path, text.getvalue())


def load_detections(path: str | os.PathLike[str], board: Board) -> Mapping[str, View]:
    """Read corners: a view by the name of each image, in the order in which the images are first named.

    Parameters
    ----------
    path : path-like
        UTF-8; raw (distorted) pixels, pixel centres at integers; blank lines are skipped.
    board : Board
        Whose corners they are.

    Raises
    ------
    InputError
        If the file cannot be read, holds no corners, or a row cannot be used; names the file and the line.
    """
    rows: dict[str, dict[int, tuple[float, float, float]]] = {}
    header: list[str] | None = None
    reader = csv.reader(io.StringIO(_text_of(Path(path)), newline=""))
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            where = f"{path}, line {reader.line_num}"
            if not any(cells):
                continue
            if header is None:
                header = cells
                if header not in (_HEADER, _HEADER[:-1]):
                    raise InputError(f"{where}: {_EXPECTED}, not {','.join(header)[:80]!r}")
                continue
            if len(cells) != len(header):
                raise InputError(f"{where}: {len(header)} values expected ({','.join(header)}), found {len(cells)}")
            name, number, corner = _row(cells, where, len(board.corners))
            of_image = rows.setdefault(name, {})
            if number in of_image:
                raise InputError(f"{where}: the corner {number} of {name} stands there a second time")
            of_image[number] = corner
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: not CSV ({error})") from None
    if header is None:
        raise InputError(f"{path}: the file is empty; {_EXPECTED}")
    if not rows:
        raise InputError(f"{path}: holds no corners, only the header")
    return {name: _view(name, corners) for name, corners in rows.items()}


def _view(name: str, corners: dict[int, tuple[float, float, float]]) -> View:
    table = np.array(list(corners.values()))
    return View(name, np.array(list(corners)), table[:, :2], table[:, 2])


def _row(cells: list[str], where: str, count: int) -> tuple[str, int, tuple[float, float, float]]:
    name, number, *numbers = cells
    if not name:
        raise InputError(f"{where}: the image's name is missing")
    if not (number.isascii() and number.isdigit()) or int(number) >= count:
        raise InputError(f"{where}: id must be a whole number from 0 to {count - 1}, not {number[:40]!r}")
    x, y, *rest = (_number(cell, key, where) for cell, key in zip(numbers, _HEADER[2:], strict=False))
    sigma = rest[0] if rest else UNKNOWN_SIGMA
    if not _SIGMAS[0] <= sigma <= _SIGMAS[1]:
        raise InputError(f"{where}: sigma_px must be from {_SIGMAS[0]:g} to {_SIGMAS[1]:g}, not {sigma:g}")
    return name, int(number), (x, y, sigma)


def _number(cell: str, key: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise InputError(f"{where}: {key} must be a number, not {cell[:40]!r}") from None
    if not math.isfinite(value):
        raise InputError(f"{where}: {key} must be finite, not {cell}")
    return value


def _text_of(file: Path) -> str:
    try:
        return file.read_bytes().removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except FileNotFoundError:
        raise InputError(f"{file}: there is no such file of corners") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text file in UTF-8 (byte {error.start}); corners are CSV") from None
