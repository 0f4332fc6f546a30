"""A report on paper: the blocks of the page, set by ReportLab.

ReportLab is BSD, pure Python and needs nothing of the system, it breaks tables across pages, and it can be told to
write the same bytes each time. Others were left: WeasyPrint needs Pango, PyMuPDF is AGPL, xhtml2pdf reads half of CSS.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import matplotlib as mpl
from reportlab import rl_config
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    Image,
    KeepTogether,
    LongTable,
    PageBreak,
    PageTemplate,
    Paragraph,
    TableStyle,
)

from planeopt.report.content import Block, Bullets, Cell, Figure, Heading, Page, Section, Table, Text
from planeopt.report.style import PAGE_WIDTH, drawable

_MARGIN = 15 * mm
_FOOT = 8 * mm
_WIDTH = A4[0] - 2 * _MARGIN
_SCALE = 0.93  # of the figures: an input then takes three pages
_TALLEST = 0.62 * A4[1]  # a figure, so that its title and caption fit on its page
_INK, _FAINT, _LINE = (colors.HexColor(code) for code in ("#16202c", "#5a6675", "#c9d0d8"))
_TONES = {
    "ok": colors.HexColor("#1d6b3a"),
    "degraded": colors.HexColor("#9a5b00"),
    "refused": colors.HexColor("#a3261b"),
    "error": colors.HexColor("#a3261b"),
}
_FONT, _BOLD = "DejaVu Sans", "DejaVu Sans Bold"
_CELL = 6.6  # pt; of a table with many columns
_WIDE = 7  # columns from which a table has small letters


def to_pdf(page: Page, time: str) -> bytes:
    """Return the page as PDF (A4), the same bytes for the same page.

    Parameters
    ----------
    page : Page
    time : str
        When it was made, RFC 3339: the file's date.
    """
    _register()
    file = BytesIO()
    document = BaseDocTemplate(
        file,
        pagesize=A4,
        title=page.title,
        author="planeopt",
        subject=page.subtitle,
        creator="planeopt",
        lang="en",
        invariant=1,
        leftMargin=_MARGIN,
        rightMargin=_MARGIN,
        topMargin=_MARGIN,
        bottomMargin=_MARGIN,
    )
    frame = Frame(_MARGIN, _MARGIN, _WIDTH, A4[1] - 2 * _MARGIN, 0, 0, 0, 0)
    document.addPageTemplates([PageTemplate(frames=[frame], onPage=_headed(page, time))])
    with _binary_streams():
        document.build(_story(page), canvasmaker=_Numbered)
    return file.getvalue()


@contextmanager
def _binary_streams() -> Iterator[None]:
    """Have ReportLab write streams as they are: as letters they take a quarter more room, and a third of the time."""
    before = rl_config.useA85
    rl_config.useA85 = 0
    try:
        yield
    finally:
        rl_config.useA85 = before


@cache
def _register() -> None:
    """Take the letters that matplotlib brings along: Latin, Greek, Cyrillic, Armenian."""
    folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
    for name, file in ((_FONT, "DejaVuSans.ttf"), (_BOLD, "DejaVuSans-Bold.ttf")):
        pdfmetrics.registerFont(TTFont(name, str(folder / file)))
    pdfmetrics.registerFontFamily(_FONT, normal=_FONT, bold=_BOLD, italic=_FONT, boldItalic=_BOLD)


def _headed(page: Page, time: str) -> Callable[[Canvas, Any], None]:
    """Return what writes the foot of a page, and gives the document its date: ReportLab would take the clock's."""
    when = datetime.fromisoformat(time)
    title = drawable(page.title)

    def begin(canvas: Canvas, document: Any) -> None:
        del document
        canvas.setDateFormatter(lambda *_: when.strftime("D:%Y%m%d%H%M%S+00'00'"))
        canvas.saveState()
        _small(canvas)
        canvas.drawString(_MARGIN, _FOOT, title if len(title) <= _TITLE else f"{title[: _TITLE - 3]}...")
        end = A4[0] - _MARGIN - pdfmetrics.stringWidth("0000", _FONT, 7)
        canvas.drawRightString(end, _FOOT, f"page {canvas.getPageNumber()} of ")
        canvas.translate(end, _FOOT - 2)
        canvas.doForm(_PAGES)
        canvas.restoreState()

    return begin


_TITLE = 100  # letters


class _Numbered(Canvas):
    """A canvas that knows at its end how many pages it has; each page refers to that number."""

    def save(self) -> None:
        self.beginForm(_PAGES, upperx=_MARGIN, uppery=_FOOT)
        _small(self)
        self.drawString(0, 2, str(self.getPageNumber() - 1))
        self.endForm()
        super().save()


_PAGES = "pages"


def _small(canvas: Canvas) -> None:
    canvas.setFont(_FONT, 7)
    canvas.setFillColor(_FAINT)


def _style(size: float, *, bold: bool = False, space: float = 0.0, colour: Any = _INK, **more: Any) -> ParagraphStyle:
    return ParagraphStyle(
        f"{size} {bold} {colour}",
        fontName=_BOLD if bold else _FONT,
        fontSize=size,
        leading=1.34 * size,
        spaceBefore=space,
        textColor=colour,
        splitLongWords=1,
        **more,
    )


def _words(text: str) -> str:
    return escape(drawable(text))


def _story(page: Page) -> list[Flowable]:
    story: list[Flowable] = [
        Paragraph(_words(page.title), _style(17, bold=True)),
        Paragraph(_words(page.subtitle), _style(8.5, colour=_FAINT, space=4)),
    ]
    for i, section in enumerate(page.sections):
        if i and (section.long or page.sections[i - 1].long):
            story.append(PageBreak())
        story += _section(section)
    return story


def _section(section: Section) -> list[Flowable]:
    tone = "" if section.tone == "plain" else f' <font size="9" color="{_hex(section.tone)}">{section.tone}</font>'
    title = f'<a name="{section.anchor}"/>{_words(section.title)}{tone}'
    made: list[Flowable] = [_Outline(section.anchor, drawable(section.title))]
    made.append(Paragraph(title, _style(13.5, bold=True, space=10, spaceAfter=4)))
    for block in section.blocks:
        made += _block(block)
    return made


class _Outline(Flowable):
    """An entry in the reader's list of contents; takes no room."""

    def __init__(self, key: str, title: str) -> None:
        super().__init__()
        self._key, self._title = key, title

    def wrap(self, aW: float, aH: float) -> tuple[float, float]:
        del aW, aH
        return 0, 0

    def draw(self) -> None:
        self.canv.bookmarkPage(self._key)
        self.canv.addOutlineEntry(self._title, self._key, 0)


def _block(block: Block) -> list[Flowable]:
    if isinstance(block, Heading):
        return [Paragraph(_words(block.text), _style(10, bold=True, space=8, keepWithNext=1))]
    if isinstance(block, Text):
        return [_text(block)]
    if isinstance(block, Bullets):
        style = _style(8.5, space=2, leftIndent=10, bulletIndent=2)
        return [Paragraph(_words(item), style, bulletText="•") for item in block.items]
    return _figure(block) if isinstance(block, Figure) else _table(block)


def _text(text: Text) -> Paragraph:
    if text.tone == "plain":
        return Paragraph(_words(text.text), _style(8.5, space=4))
    boxed = {"backColor": colors.HexColor("#f1f4f7"), "borderPadding": (3, 4, 3, 6), "leftIndent": 6, "spaceAfter": 5}
    return Paragraph(
        _words(text.text), _style(8.5, space=7, colour=_TONES.get(text.tone, _INK), rightIndent=4, **boxed)
    )


def _figure(figure: Figure) -> list[Flowable]:
    drawn = figure.picture
    width = min(_SCALE * _WIDTH * drawn.width / PAGE_WIDTH, _TALLEST * drawn.width / drawn.height)
    image = Image(BytesIO(drawn.png), width, width * drawn.height / drawn.width, hAlign="LEFT")
    title = Paragraph(_words(figure.title), _style(10, bold=True, space=8, spaceAfter=3))
    return [KeepTogether([title, image, _caption(figure.caption)])]


def _caption(text: str) -> Paragraph:
    return Paragraph(_words(text), _style(7.6, colour=_FAINT, space=2, spaceAfter=4))


def _table(table: Table) -> list[Flowable]:
    size = _CELL if len(table.columns) >= _WIDE else 7.8
    headed = any(table.columns)
    rows = [[_cell(Cell(name), table, i, size, bold=True) for i, name in enumerate(table.columns)]] if headed else []
    rows += [[_cell(cell, table, i, size) for i, cell in enumerate(row)] for row in table.rows]
    style = [
        ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ("LINEBELOW", (0, 0), (-1, -1), 0.4, _LINE),
        ("LEFTPADDING", (0, 0), (-1, -1), 2),
        ("RIGHTPADDING", (0, 0), (-1, -1), 2),
        ("TOPPADDING", (0, 0), (-1, -1), 1.5),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 2),
    ]
    if headed:
        style.append(("LINEBELOW", (0, 0), (-1, 0), 0.9, _INK))
    made = LongTable(
        rows, colWidths=_widths(table, size), repeatRows=1 if headed else 0, style=TableStyle(style), hAlign="LEFT"
    )
    title = Paragraph(_words(table.title), _style(10, bold=True, space=8, spaceAfter=3))
    parts: list[Flowable] = [title, made, *([_caption(table.caption)] if table.caption else [])]
    # A long table may be broken; a short one stays with its title and its caption.
    return [KeepTogether(parts)] if len(rows) <= _KEPT else [CondPageBreak(40 * mm), *parts]


_KEPT = 30  # rows


def _cell(cell: Cell, table: Table, column: int, size: float, *, bold: bool = False) -> Paragraph:
    text = _words(cell.text)
    if cell.link:
        text = f'<a href="#{cell.link}" color="#14528f">{text}</a>'
    word = column < table.words or (table.last_in_words and column == len(table.columns) - 1)
    return Paragraph(text, _style(size, bold=bold, colour=_TONES.get(cell.tone, _INK), alignment=0 if word else 2))


def _widths(table: Table, size: float) -> list[float]:
    """Widths of the columns: by their longest cells, the widest words giving way where all do not fit."""
    n = len(table.columns)
    words = [i < table.words or (table.last_in_words and i == n - 1) for i in range(n)]
    wanted = []
    for i in range(n):
        cells = [pdfmetrics.stringWidth(drawable(row[i].text), _FONT, size) for row in table.rows]
        # A heading may be broken between its words, a number must not be.
        parts = table.columns[i].split() if n >= _WIDE else [table.columns[i]]
        heading = max((pdfmetrics.stringWidth(part, _BOLD, size) for part in parts), default=0.0)
        wanted.append(max([*cells, heading]) + _PADDING)
    room = _WIDTH - sum(width for width, word in zip(wanted, words, strict=True) if not word)
    limit = _level([width for width, word in zip(wanted, words, strict=True) if word], max(room, _LEAST * _WIDTH))
    return [min(width, limit) if word else width for width, word in zip(wanted, words, strict=True)]


_PADDING = 6  # pt
_LEAST = 0.2  # of the page's width, for words


def _level(widths: list[float], room: float) -> float:
    """Return the width to which the widest must be cut down for all to fit."""
    left, narrower = room, sorted(widths)
    for i, width in enumerate(narrower):
        share = left / (len(narrower) - i)
        if width > share:
            return share
        left -= width
    return max(widths, default=room)


def _hex(tone: str) -> str:
    return f"#{_TONES[tone].hexval()[2:]}" if tone in _TONES else "#5a6675"
