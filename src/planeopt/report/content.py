"""What a report says, apart from how it looks: HTML and PDF are both made from this, so that neither says less."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

Tone = Literal["plain", "ok", "degraded", "refused", "error", "note"]
"""`ok` ... `error` are the statuses of a record; `note` is a remark."""


@dataclass(frozen=True)
class Picture:
    """A figure as PNG, its size in inches, and what it shows in words."""

    png: bytes = field(repr=False)
    width: float
    height: float
    words: str


@dataclass(frozen=True)
class Text:
    """A paragraph; one with a `tone` stands out."""

    text: str
    tone: Tone = "plain"


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Parameters
    ----------
    text : str
    key : str
        Where its number stands in `poses.json`, as ``records.0.z_L_mm``; empty where it is none.
    link : str
        Anchor of the section that it leads to.
    tone : Tone
    """

    text: str
    key: str = ""
    link: str = ""
    tone: Tone = "plain"


@dataclass(frozen=True)
class Table:
    """Rows, and a heading for each column.

    Parameters
    ----------
    title : str
    columns : tuple of str
    rows : tuple of tuple of Cell
    caption : str
    words : int
        How many columns at the left are words; the others are numbers.
    last_in_words : bool
        The last column is words too.
    key : str
        Names the table.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    words: int = 1
    last_in_words: bool = False
    key: str = ""


@dataclass(frozen=True)
class Figure:
    """A picture with the caption that says what good looks like; `key` names it."""

    key: str
    title: str
    caption: str
    picture: Picture


@dataclass(frozen=True)
class Heading:
    """Of a part of a section."""

    text: str


Block = Text | Bullets | Table | Figure | Heading


@dataclass(frozen=True)
class Section:
    """A titled part of the page with an anchor of its own."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    tone: Tone = "plain"
    flows: bool = False

    @property
    def long(self) -> bool:
        """Whether it deserves pages of its own: it has figures, and is not to flow on after what is before it."""
        return not self.flows and any(isinstance(block, Figure) for block in self.blocks)


@dataclass(frozen=True)
class Page:
    """All of a report."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]

    def blocks(self) -> Iterator[Block]:
        """Go through everything in its order."""
        for section in self.sections:
            yield from section.blocks
