"""Images and boundary points on disk."""

import codecs
import csv
import io
import logging
import math
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.spot.headers import coding_of
from planeopt.spot.points import MIN_POINTS, SIGMAS, Spot, SpotFlag
from planeopt.whole_files import write_text

_log = logging.getLogger(__name__)
_DECODING = threading.Lock()  # standard error is one for the whole process

_DAMAGE = re.compile(r"error|corrupt|premature|truncated|not enough|too much image|extra compressed", re.IGNORECASE)
_ORIGIN = re.compile(r"^\[[^]]*\] global \S+ \S+ ")  # OpenCV's own: time, file and line
_HEADERS = (["x_px", "y_px"], ["x_px", "y_px", "sigma_px"])
_EXPECTED = "the header must be x_px,y_px or x_px,y_px,sigma_px"


@dataclass(frozen=True, eq=False)
class StoredImage:
    """An image as a file holds it.

    Parameters
    ----------
    pixels : (H, W) or (H, W, C) array
        Depth kept; colour in the order blue, green, red (and alpha).
    encoded : bool
        The file says, or its format means, that the values are coded for display and not proportional to light: JPEG,
        GIF, WebP; a PNG with a gamma, sRGB or a colour profile; a TIFF with a colour profile.
    """

    pixels: NDArray[Any]
    encoded: bool


def read_image(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read an image as it is stored; `load_image` tells more.

    Parameters
    ----------
    path : path
        PNG, TIFF, JPEG, BMP or PGM; grey or colour; 8 or 16 bit, TIFF also floats. Of several pages the first.

    Returns
    -------
    (H, W) or (H, W, C) ndarray
        The pixels in the order of the file, whatever orientation it notes (EXIF, TIFF): the camera's pixels are what
        the rig speaks of. Depth kept; colour in the order blue, green, red (and alpha, by which nothing is multiplied).

    Raises
    ------
    InputError
        If there is no such file, or it is not a readable image: damaged ones are refused where it can be told.
    """
    return load_image(path).pixels


def load_image(path: str | os.PathLike[str]) -> StoredImage:
    """Read an image as `read_image` does, and what its file says of the coding of the values.

    Raises
    ------
    InputError
        As `read_image`.
    """
    data = _read_bytes(Path(path), "image", "an")
    if not data:
        raise InputError(f"{path}: the file is empty, not an image")
    try:
        coding = coding_of(data)
        return StoredImage(_decoded(coding.data), coding.encoded)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _decoded(data: bytes) -> NDArray[Any]:
    import cv2

    with _captured_stderr() as complaint:
        try:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            raise InputError(_refusal(error.err)) from None
    if image is None:
        raise InputError("not an image that can be read (PNG, TIFF, JPEG, BMP and PGM can), or damaged")
    # What a decoder gives although something was wrong is partly made up.
    wrong = [line for line in complaint.text.splitlines() if _DAMAGE.search(line)]
    if wrong:
        raise InputError(f"the image is damaged ({_ORIGIN.sub('', wrong[-1]).strip()[:120]})")
    return image


def _refusal(reason: str) -> str:
    if "CV_IO_MAX" in reason:
        return "the image claims more pixels than can be read"
    return f"not a readable image ({' '.join(reason.split())[:120]})"


def read_points(path: str | os.PathLike[str]) -> Spot:
    """Read boundary points from CSV with the header ``x_px,y_px`` or ``x_px,y_px,sigma_px``.

    Parameters
    ----------
    path : path
        UTF-8; raw (distorted) pixels, pixel centres at integers; blank lines are skipped.

    Returns
    -------
    Spot
        With ``sigma=None`` and `SpotFlag.SIGMA_UNKNOWN` if the file has no ``sigma_px``.

    Raises
    ------
    InputError
        If the file cannot be read or a row cannot be used; names the file and the line.
    """
    try:
        text = _read_bytes(Path(path), "file of boundary points", "a").removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 (byte {error.start}); boundary points are CSV") from None
    reader = csv.reader(io.StringIO(text, newline=""))
    header: list[str] | None = None
    rows: list[list[float]] = []
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if not any(cells):
                continue
            if header is None:
                header = cells
                if header not in _HEADERS:
                    raise InputError(f"{path}, line {reader.line_num}: {_EXPECTED}, not {','.join(header)[:80]!r}")
                continue
            rows.append(_row(cells, header, f"{path}, line {reader.line_num}"))
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: not CSV ({error})") from None
    if header is None:
        raise InputError(f"{path}: the file is empty; {_EXPECTED}")
    if len(rows) < MIN_POINTS:
        raise InputError(f"{path}: an ellipse needs at least {MIN_POINTS} boundary points, the file has {len(rows)}")
    table = np.array(rows)
    if table.shape[1] == 3:
        return Spot(points=table[:, :2], sigma=table[:, 2], source=str(path))
    return Spot(points=table, flags=(SpotFlag.SIGMA_UNKNOWN,), source=str(path))


def write_points(spot: Spot, path: str | os.PathLike[str]) -> None:
    """Write a spot's boundary points as CSV, exactly: `read_points` gives the same numbers back.

    The file is written beside its place and then renamed into it, so that a reader never sees half of it.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    columns = [spot.points[:, 0], spot.points[:, 1]] + ([] if spot.sigma is None else [spot.sigma])
    header = _HEADERS[len(columns) - 2]
    rows = (",".join(repr(float(value)) for value in row) for row in zip(*columns, strict=True))
    text = "\n".join([",".join(header), *rows]) + "\n"
    write_text(path, text)


@dataclass
class _Complaint:
    text: str = ""


@contextmanager
def _captured_stderr() -> Iterator[_Complaint]:
    """Catch what the image libraries write to the process's standard error from below Python."""
    complaint = _Complaint()
    with _DECODING, tempfile.TemporaryFile() as file:
        sys.stderr.flush()
        try:
            saved = os.dup(2)
        except OSError:  # the process has no standard error
            yield complaint
            return
        os.dup2(file.fileno(), 2)
        try:
            yield complaint
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            complaint.text = file.read().decode("utf-8", "replace")
            if complaint.text:
                _log.debug("the image decoder says: %s", complaint.text.strip())


def _read_bytes(path: Path, what: str, article: str) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such {what}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a folder, not {article} {what}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # a NUL in the name
        raise InputError(f"{str(path)!r}: not a usable file name ({error})") from None


def _row(cells: list[str], header: list[str], where: str) -> list[float]:
    if len(cells) != len(header):
        raise InputError(f"{where}: {len(header)} values expected ({','.join(header)}), found {len(cells)}")
    return [_number(cell, name, where) for cell, name in zip(cells, header, strict=True)]


def _number(cell: str, name: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise InputError(f"{where}: {name} must be a number, not {cell[:40]!r}") from None
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} must be finite, not {cell}")
    if name == "sigma_px" and value <= 0:
        raise InputError(f"{where}: sigma_px must be positive, not {cell}")
    if name == "sigma_px" and not SIGMAS[0] <= value <= SIGMAS[1]:
        raise InputError(f"{where}: sigma_px must be from {SIGMAS[0]:g} to {SIGMAS[1]:g}, not {cell}")
    return value
