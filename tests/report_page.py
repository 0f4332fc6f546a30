"""Reading the page of a report as a machine does."""

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

_VOID = {"meta", "link", "img", "br", "input", "hr"}
_NUMBER = re.compile(r"-?\d+(?:\.(\d+))?(?:e([-+]\d+))?")


@dataclass
class Figure:
    """A figure or a table: what names it, its heading and its caption, and the sources of its images."""

    key: str
    table: bool
    heading: str = ""
    caption: str = ""
    images: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)


class PageReader(HTMLParser):
    """Collects a page's figures, its cells with their keys, its words, and what it refers to."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.figures: list[Figure] = []
        self.cells: list[tuple[str, str]] = []
        self.words: list[str] = []
        self.references: list[str] = []
        self.tags: set[str] = set()
        self.anchors: set[str] = set()
        self.style = ""
        self._open: list[tuple[str, dict[str, str]]] = []
        self._cell: list[str] | None = None
        self._key = ""
        self.feed(html)
        self.close()
        assert not self._open, f"never closed: {[tag for tag, _ in self._open]}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.tags.add(tag)
        self.references += [given[name] for name in ("href", "src", "srcset", "action", "data") if name in given]
        assert not any(name.startswith("on") for name in given), f"{tag} runs something"
        if "id" in given:
            self.anchors.add(given["id"])
        if tag == "figure":
            table = "data-table" in given
            self.figures.append(Figure(given["data-table" if table else "data-figure"], table))
        if tag == "img":
            assert given["alt"]
            self.figures[-1].images.append(given["src"])
        if tag in ("td", "th"):
            self._cell, self._key = [], given.get("data-key", "")
        if tag not in _VOID:
            self._open.append((tag, given))

    def handle_endtag(self, tag: str) -> None:
        opened, _ = self._open.pop()
        assert opened == tag, f"{opened} is closed by {tag}"
        if tag in ("td", "th") and self._cell is not None:
            text = "".join(self._cell).strip()
            if self._key:
                self.cells.append((self._key, text))
            if text:
                self.figures[-1].words.append(text)
            self._cell = None

    def handle_data(self, data: str) -> None:
        inside = [tag for tag, _ in self._open]
        if "style" in inside:
            self.style += data
            return
        if self._cell is not None:
            self._cell.append(data)
        if data.strip():
            self.words.append(data.strip())
        if "figure" in inside and "figcaption" in inside:
            self.figures[-1].caption += data
        elif "figure" in inside and "h3" in inside:
            self.figures[-1].heading += data


class _Blank:
    """A canvas on which nothing is drawn."""

    def __init__(self, figure: object) -> None:
        del figure

    def draw(self) -> None:
        pass

    def buffer_rgba(self) -> NDArray[np.uint8]:
        return np.full((2, 2, 4), 255, np.uint8)


def undrawn(patch: pytest.MonkeyPatch) -> None:
    """Leave pictures blank, which takes less time than drawing them: all else of pages is as ever."""
    patch.setattr("planeopt.report.style.FigureCanvasAgg", _Blank)


def value_at(data: Any, key: str) -> Any:
    for part in key.split("."):
        data = data[int(part)] if isinstance(data, list) else data[part]
    return data


def differing(cells: list[tuple[str, str]], data: dict[str, Any]) -> list[str]:
    """Cells whose numbers are not those of the file, to the rounding of what is shown."""
    wrong = []
    for keys, text in cells:
        shown = list(_NUMBER.finditer(text))
        wanted = [value_at(data, key) for key in keys.split()]
        if len(shown) != len(wanted):
            wrong.append(f"{keys}: {text!r} shows {len(shown)} numbers")
            continue
        for match, value in zip(shown, wanted, strict=True):
            unit = 10.0 ** (int(match[2] or 0) - len(match[1] or ""))
            if not abs(float(match[0]) - value) <= 0.5 * unit * (1 + 1e-9):
                wrong.append(f"{keys}: {text!r} is not {value!r}")
    return wrong
