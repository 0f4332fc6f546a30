"""Read and write `board.toml`: strict in what it accepts, exact in what it writes."""

import os
from collections.abc import Mapping
from typing import Any

import msgspec

from planeopt.board.spec import Board
from planeopt.errors import InputError
from planeopt.toml_files import FORMAT, as_tables, read_toml
from planeopt.whole_files import write_text


class _File(msgspec.Struct, forbid_unknown_fields=True):
    squares: list[int]
    square_mm: float | list[float]
    marker_mm: float
    dictionary: str
    format: int = FORMAT
    legacy: bool = False
    first_id: int = 0
    window_mm: list[float] | None = None


def load_board(path: str | os.PathLike[str]) -> Board:
    """Read a board from a TOML file.

    Raises
    ------
    InputError
        If the file is missing, unreadable or invalid: one line with the file, the key and what is wrong.
    """
    return board_from_dict(read_toml(path, "board"), str(path))


def board_from_dict(mapping: Mapping[str, Any], source: str) -> Board:
    """Return the board described by a mapping with the keys of `board.toml`.

    Parameters
    ----------
    mapping : mapping
        As read from the file.
    source : str
        Where it came from; messages begin with it.

    Raises
    ------
    InputError
        If a key is missing, unknown or has an impossible value, or the format is not known.
    """
    tables = as_tables(mapping, _File, source)
    # Lengths are left to the class, whose messages say what the numbers are.
    sides: Any = tables.square_mm if isinstance(tables.square_mm, list) else [tables.square_mm] * 2
    squares: Any = tables.squares
    window: Any = tables.window_mm
    try:
        return Board(
            squares=tuple(squares),
            square_mm=tuple(sides),
            marker_mm=tables.marker_mm,
            dictionary=tables.dictionary,
            legacy=tables.legacy,
            first_id=tables.first_id,
            window_mm=None if window is None else tuple(window),
        )
    except InputError as error:
        raise InputError(f"{source}: {error}") from error


def save_board(board: Board, path: str | os.PathLike[str]) -> None:
    """Write a board to a TOML file that reads back equal, in whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_text(path, board_as_toml(board))


def board_as_toml(board: Board) -> str:
    """Return the text of `board.toml`."""
    x, y = board.square_mm
    lines = [
        f"format = {FORMAT}",
        f"squares = [{board.squares[0]}, {board.squares[1]}]  # columns, rows",
        f"square_mm = {x!r}" if x == y else f"square_mm = [{x!r}, {y!r}]  # along x, along y, as measured",
        f"marker_mm = {board.marker_mm!r}",
        f'dictionary = "{board.dictionary}"',
    ]
    if board.legacy:
        lines.append("legacy = true")
    if board.first_id:
        lines.append(f"first_id = {board.first_id}")
    if board.window_mm is not None:
        lines.append("window_mm = [" + ", ".join(map(repr, board.window_mm)) + "]  # x, y, width, height")
    return "\n".join(lines) + "\n"
