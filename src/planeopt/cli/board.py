"""`planeopt board`: a ChArUco board to print, and its specification as drawn or as measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.types import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from planeopt.cli.messages import tables
from planeopt.errors import InputError
from planeopt.whole_files import write_whole

if TYPE_CHECKING:
    from planeopt.board import Board
    from planeopt.board.design import Wishes
    from planeopt.board.page import Page
    from planeopt.board.paper import Paper

BOARD = "board.toml"
_DRAWINGS = (".pdf", ".png")
_NONE = Parameter(negative="")
Pair = Annotated[tuple[PositiveFloat, PositiveFloat] | None, _NONE]
Rectangle = Annotated[tuple[NonNegativeFloat, NonNegativeFloat, PositiveFloat, PositiveFloat] | None, _NONE]


@Parameter(name="*")
@dataclass(frozen=True)
class Shape:
    """What the board is to be.

    Parameters
    ----------
    squares
        Columns and rows; without: 13 9. Odd rows are read alike by all versions of OpenCV.
    square_mm
        Side of a square, or its width and height; without: as large as fits, a round number.
    marker_mm
        Side of a marker; without: three quarters of a square.
    dictionary
        One of OpenCV's, such as DICT_5X5_100; without: the smallest of 4 x 4 bits that has enough markers.
    legacy
        With even rows, the pattern of OpenCV before 4.6.
    first_id
        Of the markers.
    window_mm
        x, y, width, height from the outer corner of the top left square; without: whole squares in the middle.
    no_window
        Squares everywhere. Each view is then needed a second time with the laser off.
    view_mm
        Width and height of what the camera sees at the working distance: the board is made 1.4 times as large.
    spot_mm
        Diameter of the beam: the window is made at least 2.5 times as wide and high.
    """

    squares: Annotated[tuple[PositiveInt, PositiveInt] | None, _NONE] = None
    square_mm: Annotated[tuple[PositiveFloat, ...] | None, Parameter(negative="", consume_multiple=True)] = None
    marker_mm: PositiveFloat | None = None
    dictionary: str | None = None
    legacy: Annotated[bool, _NONE] = False
    first_id: NonNegativeInt = 0
    window_mm: Rectangle = None
    no_window: Annotated[bool, _NONE] = False
    view_mm: Pair = None
    spot_mm: PositiveFloat | None = None

    def wishes(self) -> "Wishes":
        """Return what `planeopt.board.design` asks for."""
        from planeopt.board.design import SQUARES, Wishes

        if sum((self.no_window, self.window_mm is not None, self.spot_mm is not None)) > 1:
            raise InputError("--no-window, --window-mm and --spot-mm exclude each other")
        return Wishes(
            squares=self.squares or SQUARES,
            square_mm=_width_and_height(self.square_mm),
            marker_mm=self.marker_mm,
            dictionary=self.dictionary,
            legacy=self.legacy,
            first_id=self.first_id,
            window_mm=None if self.no_window else self.window_mm or "chosen",
            view_mm=self.view_mm,
            spot_mm=self.spot_mm,
        )


def _width_and_height(sides: tuple[float, ...] | None) -> tuple[float, float] | None:
    if sides is None:
        return None
    if len(sides) not in (1, 2):
        raise InputError(f"--square-mm takes one number or two, width and height, not {len(sides)}")
    return sides[0], sides[-1]


@Parameter(name="*")
@dataclass(frozen=True)
class Measured:
    """What the print measures.

    Parameters
    ----------
    measured_size_mm
        Width and height of all squares together, from outer edge to outer edge, on the print. Goes into board.toml, not
        into the drawing. Refused if more than 10 % off, or off by more than 2 % differently in width and height.
    measured_square_mm
        The same of one square, where that is what was measured, or where the print is scaled by more than that: without
        these limits.
    """

    measured_size_mm: Pair = None
    measured_square_mm: Pair = None

    def __bool__(self) -> bool:
        """Whether anything was measured."""
        return self != Measured()

    def of(self, board: "Board") -> "Board":
        """Return the board as measured, or as it is if it was not."""
        from planeopt.board.design import as_measured

        return as_measured(board, square_mm=self.measured_square_mm, size_mm=self.measured_size_mm) if self else board


_SHAPE, _MEASURED = Shape(), Measured()


def board(
    *,
    output: Annotated[list[Path] | None, Parameter(name=["--output", "-o"], negative="")] = None,
    paper: str | None = None,
    margin_mm: NonNegativeFloat | None = None,
    shape: Shape = _SHAPE,
    source: Annotated[Path | None, Parameter(name="--from")] = None,
    measured: Measured = _MEASURED,
    pixels_per_square: PositiveInt | None = None,
    force: Annotated[bool, _NONE] = False,
) -> int:
    """Write a ChArUco board to print, and board.toml beside it; or write into board.toml what the print measures.

    Without more: 13 x 9 squares, as large as A4 allows, with a white window of 5 x 3 squares for the spot.
    calibration/README.md says how to print, measure and mount it, and what to shoot.

    Parameters
    ----------
    output
        FILE.pdf (vectors at true scale), FILE.png (whole pixels a square) or FILE.toml (the specification alone); may
        be repeated. May be left out with --from and a measurement: that file is then rewritten.
    paper
        A5 to A0, Letter, Legal, Tabloid, or width x height in mm as 300x200. Without: the smallest of A5 to A0 that
        holds the board, or A4 if nothing says how large that is.
    margin_mm
        Least white border of the sheet; without: 8.
    source
        Take the board from this board.toml instead of from flags.
    pixels_per_square
        Of a PNG; without: about 300 dots an inch.
    force
        Write over existing files.
    """
    from planeopt.board.page import MARGIN_MM, lay_out

    drawings, specifications = _by_kind(output or [])
    in_place = source is not None and bool(measured) and not output
    if not output and not in_place:
        raise InputError("say with -o where the board goes, as in -o board.pdf")
    margin = MARGIN_MM if margin_mm is None else margin_mm
    name = max((path.name for path in drawings), key=len, default="board.pdf")
    if source is not None and shape != _SHAPE:
        raise InputError(f"--from takes the board from {source}: leave out the flags that describe one")
    drawn, sheet = _board_and_paper(shape, source, paper, name, margin)
    final = measured.of(drawn)
    pages = {path: lay_out(drawn, sheet, path.name, margin_mm=margin) for path in drawings}
    files = {path: _encoded(page, path, pixels_per_square) for path, page in pages.items()}
    beside = list(dict.fromkeys(path.parent / BOARD for path in drawings))
    text = _specification(final, known=bool(measured) or source is not None)
    for path in specifications or beside or [source]:
        # The file that the board came from holds it already.
        if path is not None and (measured or source is None or path.resolve() != source.resolve()):
            files[path] = text.encode()
    _write(files, force=force or in_place)
    _say(drawn, final, list(pages.values()), list(files), shape.view_mm)
    return 0


def _board_and_paper(
    shape: Shape, source: Path | None, paper: str | None, name: str, margin_mm: float
) -> "tuple[Board, Paper]":
    from planeopt.board import load_board
    from planeopt.board.design import design, paper_for
    from planeopt.board.paper import paper_of

    sheet = None if paper is None else paper_of(paper)
    if source is None:
        return design(shape.wishes(), sheet, name=name, margin_mm=margin_mm)
    board = load_board(source)
    return board, sheet or paper_for(board, name=name, margin_mm=margin_mm)


def _by_kind(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the drawings and the tables among the files to write."""
    drawings = [path for path in paths if path.suffix.lower() in _DRAWINGS]
    specifications = [path for path in paths if path.suffix.lower() == ".toml"]
    other = [path for path in paths if path not in drawings and path not in specifications]
    if other:
        raise InputError(f"{other[0]}: a board is written as .pdf, .png or .toml")
    return drawings, specifications


def _specification(board: "Board", *, known: bool) -> str:
    from planeopt.board import board_as_toml

    remark = "" if known else "# As drawn. Measure the print: planeopt board --from board.toml --measured-size-mm W H\n"
    return remark + board_as_toml(board)


def _encoded(page: "Page", path: Path, pixels_per_square: int | None) -> bytes:
    from planeopt.board.drawing import as_pdf, as_png

    return as_pdf(page) if path.suffix.lower() == ".pdf" else as_png(page, pixels_per_square)


def _write(files: Mapping[Path, bytes], *, force: bool) -> None:
    """Write all files or none; one that has its content already is let be."""
    for path, content in files.items():
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a regular file")
        if not force and path.exists() and path.read_bytes() != content:
            raise InputError(f"{path}: exists already and differs; name another file, or give --force to write over it")
    for path, content in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, lambda beside, content=content: beside.write_bytes(content))


def _say(
    drawn: "Board",
    final: "Board",
    pages: Sequence["Page"],
    written: Sequence[Path],
    view_mm: tuple[float, float] | None,
) -> None:
    """Say what was made, and what is left to do."""
    from planeopt.board.design import REACH
    from planeopt.board.page import sides_in_words

    x, y, width, height = drawn.window_mm or (0.0, 0.0, 0.0, 0.0)
    window = f"window {width:g} x {height:g} mm at ({x:g}, {y:g}) mm" if drawn.window_mm else "no window"
    lines = [
        f"board: {drawn.squares[0]} x {drawn.squares[1]} squares of {sides_in_words(drawn)}, {drawn.dictionary}, "
        f"{window}, {int(drawn.printed.sum())} corners",
        *(f"sheet: {page.paper.name}, {_lying(page)}; print at 100 %" for page in pages[:1]),
    ]
    if final != drawn:
        x, y = (100 * (now / before - 1) for now, before in zip(final.square_mm, drawn.square_mm, strict=True))
        lines.append(f"measured: squares of {sides_in_words(final)}, {x:+.3f} % and {y:+.3f} % of what they were")
    if view_mm is not None:
        reach = min(size / seen for size, seen in zip(drawn.size_mm, view_mm, strict=True))
        if reach < _NEARLY * REACH:
            lines.append(f"note: the board is {reach:.2f} times what the camera sees; {REACH:g} times is better")
    lines.append(f"written: {', '.join(map(str, written))}")
    for line in lines:
        tables().print(line, soft_wrap=True, highlight=False, markup=False)


_NEARLY = 0.9


def _lying(page: "Page") -> str:
    return "lying" if page.size_mm[0] > page.size_mm[1] else "upright"
