"""Tables for the terminal: a row a thing, its numbers each in a format of its own."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from rich.table import Table


def table(
    title: str,
    first: str,
    rows: Sequence[Mapping[str, Any]],
    numbers: Sequence[tuple[str, str, str]],
    *,
    words: Sequence[tuple[str, str]] = (),
    dense: bool = False,
) -> "Table":
    """Return a table of some keys of the rows.

    Parameters
    ----------
    title : str
    first : str
        Heading and key of the first column, what the row is about.
    rows : sequence of mapping
    numbers : sequence of (heading, key, format)
    words : sequence of (heading, key)
        Between the first column and the numbers.
    dense : bool
        Two spaces between columns in place of three, and none at the edges.
    """
    from rich import box
    from rich.table import Table

    made = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, collapse_padding=dense, pad_edge=not dense)
    made.add_column(first, no_wrap=True)
    for heading, _ in words:
        made.add_column(heading)
    for heading, _, _ in numbers:
        made.add_column(heading, justify="right")
    for row in rows:
        made.add_row(
            row[first],
            *(row[key] or "-" for _, key in words),
            *(_number(row[key], style) for _, key, style in numbers),
        )
    return made


def text_table(
    title: str, columns: Sequence[tuple[str, Literal["left", "right"]]], rows: Sequence[Sequence[str]]
) -> "Table":
    """Return a table of texts.

    Parameters
    ----------
    title : str
    columns : sequence of (heading, "left" or "right")
    rows : sequence of sequence of str
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    made = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for i, (heading, side) in enumerate(columns):
        made.add_column(heading, justify=side, no_wrap=i == 0 or side == "right")
    for row in rows:
        # As they are: a file's name may hold what is markup elsewhere.
        made.add_row(*map(Text, row))
    return made


def _number(value: float | None, style: str) -> str:
    return "-" if value is None else format(value, style)
