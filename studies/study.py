"""What every study gives, and how it is written: tables, figures, and a finding made from the numbers."""

import csv
import dataclasses
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar, get_args, get_type_hints

import matplotlib as mpl
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Mode = Literal["quick", "full"]
"""Quick: what the tests run, seconds. Full: what is committed, minutes."""

Row = TypeVar("Row")
Instance = TypeVar("Instance", bound="DataclassInstance")

_SAVED: dict[Any, Any] = {"svg.hashsalt": "planeopt", "svg.fonttype": "path"}


HEADLINE = "headline"
"""The table of the numbers that a study's headline says."""


@dataclass(frozen=True)
class Number:
    """A number of a headline, by its name; a row of `headline.csv`."""

    name: str
    value: float


@dataclass(frozen=True)
class Result:
    """What a study found.

    Attributes
    ----------
    tables : mapping of str to sequence of dataclass instances
        A CSV file each, a row an instance, a column a field.
    headline : str
        The answer in a sentence, for the index of the studies.
    finding : str
        The answer in words, in Markdown; every number in both is made from the tables.
    figures : mapping of str to Figure
        A PNG each.
    numbers : mapping of str to number
        Every number that the headline says, by a name that tells what it is and in which unit: `headline.csv`, by which
        a reader can check the index.
    """

    tables: Mapping[str, Sequence["DataclassInstance"]]
    headline: str
    finding: str
    figures: Mapping[str, Figure] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)


class Study(Protocol):
    """A module of this package that is a study: its docstring states the question."""

    __doc__: str | None

    @staticmethod
    def run(mode: Mode, executor: Executor | None) -> Result:
        """Answer the question; the result does not depend on where the executor works."""
        ...

    @staticmethod
    def from_tables(folder: Path) -> Result:
        """Return the words and figures of tables that were written, without computing what they hold."""
        ...


def write(result: Result, folder: Path) -> None:
    """Write the tables, the figures and the finding; the same numbers give the same files.

    Parameters
    ----------
    result : Result
    folder : Path
        Made if it is not there; files of the same names are written over.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in result.tables.items():
        _write_table(folder / f"{name}.csv", rows)
    write_words(result, folder)


def write_words(result: Result, folder: Path) -> None:
    """Write the headline's numbers, the figures and the finding, but no table that they are made from."""
    if result.numbers:
        _write_table(folder / f"{HEADLINE}.csv", [Number(name, value) for name, value in result.numbers.items()])
    with mpl.rc_context(_SAVED):
        for name, figure in result.figures.items():
            figure.savefig(folder / f"{name}.png", dpi=130, metadata={"Software": None})
    (folder / "finding.md").write_text(result.finding.rstrip() + "\n", encoding="utf-8")


def _write_table(path: Path, rows: Sequence["DataclassInstance"]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(column.name for column in dataclasses.fields(rows[0]))
        writer.writerows([cell(value) for _, value in _fields(row)] for row in rows)


def put_headline(index: Path, name: str, headline: str) -> None:
    """Put a study's headline between the two comments with its name, in a document that has them.

    Parameters
    ----------
    index : Path
        A Markdown file with ``<!-- NAME -->`` and ``<!-- /NAME -->`` on lines of their own.
    name, headline : str
    """
    text = index.read_text(encoding="utf-8")
    begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->\n"
    if begin not in text:
        return
    before, rest = text.split(begin)
    after = rest.split(end)[1]
    index.write_text(f"{before}{begin}{textwrap.fill(headline, 120)}\n{end}{after}", encoding="utf-8")


def read_rows(path: Path, kind: type[Row]) -> list[Row]:
    """Return the rows of a table that was written, with the digits that it holds."""
    hints = get_type_hints(kind)
    with path.open(encoding="utf-8", newline="") as stream:
        return [
            kind(**{name: _read(text, hints[name]) for name, text in row.items()}) for row in csv.DictReader(stream)
        ]


def read_tables(folder: Path, kind: type[Instance]) -> Instance:
    """Return the tables of a folder as a dataclass that has a sequence of rows for each."""
    hints = get_type_hints(kind)
    return kind(**{name: read_rows(folder / f"{name}.csv", get_args(hint)[0]) for name, hint in hints.items()})


def named(tables: "DataclassInstance") -> dict[str, Sequence[Any]]:
    """Return the tables of such a dataclass by name."""
    return dict(_fields(tables))


def rounded_tables(tables: Instance) -> Instance:
    """Return such a dataclass with each of its tables `rounded`."""
    return dataclasses.replace(tables, **{name: rounded(rows) for name, rows in named(tables).items()})


def rounded(rows: Iterable[Instance]) -> list[Instance]:
    """Return rows with the digits that a table holds, so that words made of them are those made of the table."""
    return [dataclasses.replace(row, **{name: _as_told(value) for name, value in _fields(row)}) for row in rows]


def _as_told(value: object) -> object:
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _read(text: str, hint: Any) -> object:
    kinds = get_args(hint)
    if NoneType in kinds:
        others = [kind for kind in kinds if kind is not NoneType]
        return _read(text, others[0]) if text else None
    if hint is float:
        return float(text) if text else math.nan
    if hint is bool:
        return text == str(True)
    return int(text) if hint is int else text


def cell(value: object) -> str:
    """Return a value as tables hold it: six digits of a float; nothing where there is no number."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _fields(row: "DataclassInstance") -> list[tuple[str, Any]]:
    return [(column.name, getattr(row, column.name)) for column in dataclasses.fields(row)]
