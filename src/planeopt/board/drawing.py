"""A sheet as a file: vectors in a PDF, whole pixels in a PNG. The same sheet gives the same bytes."""

from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from reportlab.pdfgen.canvas import Canvas

from planeopt.board.markers import marker_cells
from planeopt.board.page import BOLD, FONT, Page, Words
from planeopt.board.spec import Board
from planeopt.errors import InputError

FloatArray = NDArray[np.float64]

_MM = 72 / 25.4  # points
_INCH = 25.4
_RESOLUTION = 300.0  # dots an inch that a PNG has at least about
_MOST_PIXELS = 300e6
_LEAST_CELL = 2  # px
_TRIED = 64
_GREY = 127


def as_pdf(page: Page) -> bytes:
    """Return a sheet as PDF at true scale, all of it vectors in pure black.

    It asks the reader not to scale it when printing, has no date of its own, and is not compressed: the same bytes
    whichever compressor a machine has.
    """
    file = BytesIO()
    width, height = page.size_mm
    canvas = Canvas(file, pagesize=(width * _MM, height * _MM), pageCompression=0, invariant=1, lang="en")
    canvas.setTitle(page.words[-1].text)
    canvas.setSubject("ChArUco board at true scale; print at 100 %")
    canvas.setAuthor("planeopt")
    canvas.setCreator("planeopt")
    canvas.setProducer("planeopt")
    canvas.setViewerPreference("PrintScaling", "None")
    canvas.setFillGray(0)
    x, y = page.origin_mm
    _fill(canvas, page.pattern, (x * _MM, (height - y) * _MM))
    _fill(canvas, page.rulers, (0.0, height * _MM))
    for words in page.words:
        canvas.setFont(BOLD if words.bold else FONT, words.size_pt)
        write = canvas.drawCentredString if words.centred else canvas.drawString
        write(words.x * _MM, (height - words.y) * _MM, _western(words.text))
    canvas.showPage()
    canvas.save()
    return file.getvalue()


def _fill(canvas: Canvas, rectangles: FloatArray, origin: tuple[float, float]) -> None:
    """Fill rectangles as one path, so that no reader draws a hair between those that touch."""
    canvas.saveState()
    canvas.translate(*origin)
    canvas.scale(_MM, -_MM)
    path = canvas.beginPath()
    for x0, y0, x1, y1 in rectangles.tolist():
        path.rect(x0, y0, x1 - x0, y1 - y0)
    canvas.drawPath(path, stroke=0, fill=1, fillMode=1)
    canvas.restoreState()


def _western(text: str) -> str:
    """Return text in the letters that every reader has."""
    return text.encode("cp1252", "replace").decode("cp1252")


def default_pixels(board: Board) -> int:
    """Return the pixels of a square: about 300 an inch, the cells of the markers whole ones too if they can be."""
    wanted = max(board.square_mm) / _INCH * _RESOLUTION
    cells = marker_cells(board.dictionary, [board.first_id]).shape[1]
    share = board.marker_mm / min(board.square_mm)
    for unit in range(1, _TRIED + 1):
        cell, border = share * unit / cells, (1 - share) * unit / 2
        if max(abs(cell - round(cell)), abs(border - round(border))) < 1e-9 * unit and round(cell):
            return unit * max(1, round(wanted / unit))
    return max(1, round(wanted))


def as_pixels(page: Page, pixels_per_square: int) -> NDArray[np.uint8]:
    """Return the picture of a sheet, shape (height, width): 0 black, 255 white; squares are whole numbers of pixels.

    The outer corner of the top left square lies where four pixels meet, and so do all corners of squares.

    Raises
    ------
    InputError
        If the markers would have less than two pixels a cell, or the picture would be enormous.
    """
    cells = marker_cells(page.board.dictionary, [page.board.first_id]).shape[1]
    if pixels_per_square * page.board.marker_mm / max(page.board.square_mm) < _LEAST_CELL * cells:
        raise InputError(
            f"{pixels_per_square} pixels a square are too few: a marker has {cells} cells of two pixels or more"
        )
    scale, width, height = _raster(page, pixels_per_square)
    if width * height > _MOST_PIXELS:
        raise InputError(
            f"{pixels_per_square} pixels a square make a picture of {width} x {height}: take fewer, or a PDF"
        )
    picture = Image.new("L", (width, height), 255)
    draw = ImageDraw.Draw(picture)
    fonts: dict[float, ImageFont.FreeTypeFont | ImageFont.ImageFont] = {}
    for words in page.words:
        _write(draw, words, scale, fonts)
    image = np.array(picture)
    origin = np.rint(np.array(page.origin_mm) * scale)
    for rectangles, shift, least in ((page.pattern, origin, 0), (page.rulers, np.zeros(2), 1)):
        edges = np.rint(rectangles * np.tile(scale, 2) + np.tile(shift, 2)).astype(int)
        edges[:, 2:] = np.maximum(edges[:, 2:], edges[:, :2] + least)
        for x0, y0, x1, y1 in edges.tolist():
            image[y0:y1, x0:x1] = 0
    return image


def _raster(page: Page, pixels_per_square: int) -> tuple[FloatArray, int, int]:
    """Return pixels a mm along x and y, and the picture's width and height."""
    scale = pixels_per_square / np.array(page.board.square_mm)
    width, height = np.rint(np.array(page.size_mm) * scale).astype(int).tolist()
    return scale, width, height


def _write(
    draw: ImageDraw.ImageDraw,
    words: Words,
    scale: FloatArray,
    fonts: dict[float, ImageFont.FreeTypeFont | ImageFont.ImageFont],
) -> None:
    text = _western(words.text)
    size = float(words.size_pt / _MM * scale[1])
    font = fonts.setdefault(size, ImageFont.load_default(size))
    # The letters are not those of the PDF: where they run wider they are made smaller.
    room = words.width * scale[0]
    if not words.centred and draw.textlength(text, font=font) > room:
        size *= room / draw.textlength(text, font=font)
        font = fonts.setdefault(size, ImageFont.load_default(size))
    place = (words.x * scale[0], words.y * scale[1])
    draw.text(place, text, fill=0, font=font, anchor="ms" if words.centred else "ls")


def as_png(page: Page, pixels_per_square: int | None = None) -> bytes:
    """Return a sheet as PNG that says its resolution, black and white, squares being whole numbers of pixels.

    Raises
    ------
    InputError
        As `as_pixels`.
    """
    pixels = default_pixels(page.board) if pixels_per_square is None else pixels_per_square
    image = as_pixels(page, pixels)
    scale, _, _ = _raster(page, pixels)
    file = BytesIO()
    Image.fromarray(image > _GREY).save(file, "PNG", dpi=tuple((scale * _INCH).tolist()), optimize=False)
    return file.getvalue()
