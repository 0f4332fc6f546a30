"""The sheet to print: what OpenCV finds on the PDF and the PNG, true scale, rulers, words; which board suits a rig."""

import io
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from pypdf import PdfReader
from pypdf.generic import ContentStream

from planeopt.board import (
    Board,
    Paper,
    Wishes,
    as_measured,
    as_pdf,
    as_pixels,
    as_png,
    black_rectangles,
    design,
    lay_out,
    load_board,
    paper_of,
    printed_markers,
)
from planeopt.board.drawing import default_pixels
from planeopt.board.page import Page
from planeopt.errors import InputError

FloatArray = NDArray[np.float64]
MM = 72 / 25.4
BOARDS = Path(__file__).parents[1] / "calibration" / "boards"

PLAIN = Board((13, 9), (19.0, 19.0), 14.25, "DICT_4X4_100", window_mm=(76.0, 57.0, 95.0, 57.0))
SHEETS = {
    "A4": (PLAIN, "A4"),
    "A5": (Board((13, 9), (11.0, 11.0), 8.25, "DICT_4X4_100", window_mm=(44.0, 33.0, 55.0, 33.0)), "A5"),
    "legacy, even rows": (Board((8, 6), (25.0, 25.0), 18.0, "DICT_5X5_100", legacy=True, first_id=7), "A4"),
    "even rows": (Board((6, 8), (12.0, 12.0), 8.0, "DICT_6X6_250", window_mm=(24.0, 36.0, 24.0, 24.0)), "150x200"),
    "sides differ": (Board((7, 5), (20.0, 21.0), 15.0, "DICT_APRILTAG_36h11", first_id=500), "A4"),
}
"""Boards with what OpenCV may read differently, and their paper."""


@dataclass(frozen=True)
class Drawn:
    """What a PDF says: the sheet, mm, and all filled rectangles, mm from its top left corner."""

    size_mm: tuple[float, float]
    rectangles: FloatArray
    text: str


def read_pdf(content: bytes) -> Drawn:
    """Follow the drawing operators of a PDF; anything but rectangles filled in black, and text, is an error."""
    reader = PdfReader(io.BytesIO(content))
    assert len(reader.pages) == 1
    page = reader.pages[0]
    width, height = float(page.mediabox.width), float(page.mediabox.height)
    matrix, stack, path, filled = np.eye(3), [], [], []
    grey = None
    for operands, operator in ContentStream(page.get_contents(), reader).operations:
        numbers = (
            [float(value) for value in operands if not isinstance(value, str | bytes)] if operator != b"Tf" else []
        )
        if operator == b"q":
            stack.append(matrix)
        elif operator == b"Q":
            matrix = stack.pop()
        elif operator == b"cm":
            a, b, c, d, e, f = numbers
            matrix = np.array([[a, b, 0], [c, d, 0], [e, f, 1]]) @ matrix
        elif operator == b"g":
            grey = numbers
        elif operator == b"re":
            x, y, w, h = numbers
            corners = np.array([[x, y, 1], [x + w, y + h, 1]]) @ matrix
            path.append([*corners[:, :2].min(axis=0), *corners[:, :2].max(axis=0)])
        elif operator == b"f":
            assert grey == [0]
            filled += path
            path = []
        else:
            assert operator in {b"n", b"BT", b"ET", b"Tf", b"TL", b"Tm", b"Tj", b"T*"}, operator
    x0, y0, x1, y1 = np.array(filled).T
    rectangles = np.stack([x0, height - y1, x1, height - y0], axis=1) / MM
    return Drawn((width / MM, height / MM), rectangles, page.extract_text())


def rasterised(drawn: Drawn, pixels_per_mm: int) -> NDArray[np.uint8]:
    """Draw what a PDF says, each pixel black by the share that is covered."""
    width, height = (math.ceil(side * pixels_per_mm) for side in drawn.size_mm)
    covered = np.zeros((height, width))
    for x0, y0, x1, y1 in drawn.rectangles * pixels_per_mm:
        rows, columns = (
            np.clip(np.minimum(end, np.arange(n) + 1.0) - np.maximum(begin, np.arange(n)), 0, None)
            for begin, end, n in ((y0, y1, height), (x0, x1, width))
        )
        i, j = np.flatnonzero(rows), np.flatnonzero(columns)
        covered[i[0] : i[-1] + 1, j[0] : j[-1] + 1] += np.outer(rows[i], columns[j])
    return np.rint(255 * (1 - np.minimum(covered, 1))).astype(np.uint8)


def detected(board: Board, image: NDArray[np.uint8]) -> tuple[list[int], FloatArray, set[int]]:
    """Return ids and places of the corners that OpenCV finds, px, and the ids of the markers."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    ids = np.arange(board.first_id, board.last_id + 1)
    # OpenCV's board has square squares; where they are to be found does not depend on their size.
    charuco = cv2.aruco.CharucoBoard(board.squares, board.square_mm[0], board.marker_mm, markers, ids)
    charuco.setLegacyPattern(board.legacy)
    corners, found, _, seen = cv2.aruco.CharucoDetector(charuco).detectBoard(image)
    # Versions before 5 are half a pixel off (opencv#25539); refined, all agree.
    refined = cv2.cornerSubPix(
        image,
        np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2).copy(),
        (5, 5),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4),
    )
    ids = np.asarray(found, dtype=np.int64).ravel()
    order = np.argsort(ids)
    ids = ids[order]
    # A corner of the window may have both its markers, yet a square is missing there: nobody promised it.
    printed = board.printed[ids]
    places = np.asarray(refined, dtype=np.float64).reshape(-1, 2)[order]
    return ids[printed].tolist(), places[printed], {int(number) for number in seen.ravel()}


def sheet(name: str) -> Page:
    board, paper = SHEETS[name]
    return lay_out(board, paper_of(paper), "board.pdf")


@pytest.mark.parametrize("name", SHEETS)
def test_opencv_finds_every_printed_corner_on_the_pdf_where_it_should_be(name: str):
    page = sheet(name)
    drawn = read_pdf(as_pdf(page))
    scale = 6
    # A little blur, as any lens has: edges as sharp as a pixel are not what the refinement is for.
    image = np.asarray(cv2.GaussianBlur(rasterised(drawn, scale), (0, 0), 1.0), dtype=np.uint8)
    ids, corners, markers = detected(page.board, image)
    assert ids == np.flatnonzero(page.board.printed).tolist()
    assert markers == set(printed_markers(page.board))
    # Pixel centres are at integers, so that the sheet's corner is at -0.5. What remains is the refinement's own error.
    expected = (page.board.corners[ids] + page.origin_mm) * scale - 0.5
    np.testing.assert_allclose(corners, expected, rtol=0, atol=0.05)


@pytest.mark.parametrize("name", SHEETS)
def test_opencv_finds_every_printed_corner_on_the_png_between_whole_pixels(name: str):
    page = sheet(name)
    n = 72
    image = as_pixels(page, n)
    ids, corners, _ = detected(page.board, image)
    assert ids == np.flatnonzero(page.board.printed).tolist()
    origin = np.rint(np.array(page.origin_mm) * n / page.board.square_mm)
    expected = page.board.corners[ids] / page.board.square_mm * n + origin - 0.5
    np.testing.assert_allclose(corners, expected, rtol=0, atol=0.01)


def test_png_is_black_and_white_and_tells_its_scale():
    page = sheet("sides differ")
    picture = Image.open(io.BytesIO(as_png(page)))
    assert picture.mode == "1"
    assert np.array_equal(np.asarray(picture), as_pixels(page, default_pixels(page.board)) > 127)
    # A PNG holds whole pixels a metre: at 11,811 of them, half of one is 4e-5.
    np.testing.assert_allclose(np.array(picture.size) / picture.info["dpi"] * 25.4, page.size_mm, rtol=1e-3)
    ratio = picture.info["dpi"][0] / picture.info["dpi"][1]
    assert ratio == pytest.approx(21 / 20, abs=1e-4)


def test_cells_of_markers_are_whole_pixels_where_they_can_be():
    assert default_pixels(PLAIN) % 8 == 0
    assert default_pixels(PLAIN) == pytest.approx(19 / 25.4 * 300, abs=4)
    # No whole number of pixels of at most 64 suits this marker: the squares are whole all the same.
    assert default_pixels(replace(PLAIN, marker_mm=math.pi)) == round(19 / 25.4 * 300)


@pytest.mark.parametrize("name", SHEETS)
def test_rulers_measure_what_they_say_in_both_directions(name: str):
    page = sheet(name)
    drawn = read_pdf(as_pdf(page))
    middles = (drawn.rectangles[:, :2] + drawn.rectangles[:, 2:]) / 2
    sides = drawn.rectangles[:, 2:] - drawn.rectangles[:, :2]
    right, below = np.array(page.origin_mm) + page.board.size_mm
    length = int(re.findall(r"both rulers must measure\s+(\d+)", drawn.text)[0])
    for axis, beyond in ((0, middles[:, 1] > below), (1, middles[:, 0] > right)):
        ticks = middles[beyond & (sides[:, axis] < 1), axis]
        assert len(ticks) == length + 1
        np.testing.assert_allclose(np.sort(ticks), page.origin_mm[axis] + np.arange(length + 1.0), rtol=0, atol=1e-4)
        # White around the board, so that its outer markers are found.
        assert (drawn.rectangles[beyond, 1 - axis]).min() - (below, right)[axis] > 4
    assert 0.4 * min(page.board.size_mm) > length / 2.3


@pytest.mark.parametrize("name", SHEETS)
def test_the_sheet_says_what_it_is(name: str):
    page = sheet(name)
    drawn = read_pdf(as_pdf(page))
    board, text = page.board, " ".join(drawn.text.split())
    for words in (
        f"{board.squares[0]} x {board.squares[1]} squares",
        f"markers {board.marker_mm:g} mm, {board.dictionary}, ids {board.first_id} to {board.last_id}",
        f"legacy: {'yes' if board.legacy else 'no'}",
        "Print at 100 %",
        f"{board.size_mm[0]:g} x {board.size_mm[1]:g} mm as drawn",
        "File: board.pdf",
        "No window"
        if board.window_mm is None
        else f"Window for the spot: {board.window_mm[2]:g} x {board.window_mm[3]:g} mm",
    ):
        assert words in text
    np.testing.assert_allclose(sorted(drawn.size_mm), sorted(page.paper.size_mm), atol=1e-3)


def test_pdf_asks_not_to_be_scaled_and_is_the_same_each_time():
    page = sheet("A4")
    content = as_pdf(page)
    assert content == as_pdf(page)
    assert PdfReader(io.BytesIO(content)).trailer["/Root"]["/ViewerPreferences"]["/PrintScaling"] == "/None"  # pyright: ignore[reportIndexIssue, reportOptionalSubscript]


def test_a_name_in_any_letters_can_be_on_the_sheet():
    page = lay_out(PLAIN, paper_of("A4"), "Körper 板.pdf")
    assert "File: Körper ?.pdf" in read_pdf(as_pdf(page)).text
    as_png(page, 24)


@pytest.mark.parametrize("name", SHEETS)
def test_all_is_on_the_sheet_within_its_margins(name: str):
    page = sheet(name)
    drawn = read_pdf(as_pdf(page))
    assert drawn.rectangles.min() >= 8 - 0.08  # half a line of a ruler
    assert np.all(drawn.rectangles[:, 2:] <= np.array(page.size_mm) - 8 + 0.08)
    for words in page.words:
        begin = words.x - words.width / 2 if words.centred else words.x
        assert begin > 5
        assert begin + words.width < page.size_mm[0] - 5
        assert words.y < page.size_mm[1] - 8


@pytest.mark.parametrize(
    ("board", "paper", "message"),
    [
        (replace(PLAIN, square_mm=(20.0, 20.0)), "A4", "needs a sheet of 290 x 216 mm"),
        (PLAIN, "A5", "does not fit A5 \\(148 x 210 mm\\): take larger"),
        (PLAIN, "250x230", "does not fit 250 x 230 mm: take"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(board: Board, paper: str, message: str):
    with pytest.raises(InputError, match=message) as refusal:
        lay_out(board, paper_of(paper), "board.pdf")
    assert "\n" not in str(refusal.value)


def test_a_sheet_lies_as_the_board_needs_it():
    upright = Board((5, 7), (20.0, 20.0), 15.0, "DICT_4X4_50")
    assert lay_out(upright, paper_of("A4"), "a").size_mm == (210.0, 297.0)
    assert lay_out(PLAIN, paper_of("A4"), "a").size_mm == (297.0, 210.0)


def test_papers_are_known_by_name_or_size():
    assert paper_of("a4") == paper_of("A4") == Paper("A4", (210.0, 297.0))
    assert paper_of("letter").size_mm == (215.9, 279.4)
    assert paper_of("300 x 200.5 mm").size_mm == (300.0, 200.5)
    for wrong in ("A9", "300", "1.2.3x4", "0x100", "1e9x3", "9000x9000", ""):
        with pytest.raises(InputError, match="paper"):
            paper_of(wrong)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(3, 12),
    st.integers(3, 12),
    st.booleans(),
    st.tuples(*[st.floats(0, 0.95)] * 2, *[st.floats(0.02, 1)] * 2),
)
@example(3, 3, False, (0.0, 0.0, 1.0, 1.0))
def test_nothing_is_black_under_a_window_wherever_it_is(
    columns: int, rows: int, legacy: bool, shares: tuple[float, float, float, float]
):
    plain = Board((columns, rows), (10.0, 10.0), 7.5, "DICT_4X4_100", legacy=legacy)
    x, y = shares[0] * plain.size_mm[0], shares[1] * plain.size_mm[1]
    width, height = shares[2] * (plain.size_mm[0] - x), shares[3] * (plain.size_mm[1] - y)
    board = replace(plain, window_mm=(x, y, width, height))

    def covered(rectangles: FloatArray) -> float:
        low, high = np.maximum(rectangles[:, :2], (x, y)), np.minimum(rectangles[:, 2:], (x + width, y + height))
        return float(np.prod(np.clip(high - low, 0, None), axis=1).sum())

    left = black_rectangles(board)
    assert covered(left) < 1e-6
    # What is gone was under the window, or is a marker that the window touches.
    area = [np.prod(r[:, 2:] - r[:, :2], axis=1).sum() for r in (black_rectangles(plain), left)]
    gone = set(printed_markers(plain)) - set(printed_markers(board))
    assert area[0] - area[1] <= covered(black_rectangles(plain)) + 7.5**2 * len(gone) + 1e-6
    for number in gone:
        x0, y0, x1, y1 = printed_markers(plain)[number]
        assert x0 < x + width
        assert x1 > x
        assert y0 < y + height
        assert y1 > y


def test_the_board_of_no_wishes_is_as_large_as_the_paper_allows():
    for name, side in (("A5", 11.0), ("A4", 19.0), ("A3", 29.0), ("Letter", 19.0)):
        board, paper = design(Wishes(), paper_of(name))
        assert (board.squares, board.square_mm, paper.name) == ((13, 9), (side, side), name)
        assert board.window_mm == (4 * side, 3 * side, 5 * side, 3 * side)
        lay_out(board, paper, "board.pdf")
        with pytest.raises(InputError, match="larger paper"):
            lay_out(Wishes().board((side + 1, side + 1)), paper, "board.pdf")
    assert design(Wishes())[1].name == "A4"


def test_the_board_is_larger_than_what_the_camera_sees_and_the_paper_follows():
    for view, name in (((95.0, 71.0), "A5"), ((150.0, 110.0), "A4"), ((400.0, 300.0), "A1")):
        board, paper = design(Wishes(view_mm=view))
        assert paper.name == name
        # Rounded down to whole or half millimetres of a square.
        reach = min(size / seen for size, seen in zip(board.size_mm, view, strict=True))
        assert 1.25 < reach <= 1.4
    # The paper is too small: as large as it allows.
    assert design(Wishes(view_mm=(400.0, 300.0)), paper_of("A4"))[0].square_mm == (19.0, 19.0)


def test_the_window_is_large_enough_for_the_spot():
    for diameter in (4.0, 12.0, 20.0, 30.0):
        board, _ = design(Wishes(spot_mm=diameter))
        assert board.window_mm is not None
        x, y, width, height = board.window_mm
        assert min(width, height) >= 2.5 * diameter
        assert (x + width / 2, y + height / 2) == tuple(np.array(board.size_mm) / 2)
        assert min(x, y) >= 2 * board.square_mm[0]
    with pytest.raises(InputError, match=r"spot of 80 mm.*19 mm: take larger"):
        design(Wishes(spot_mm=80.0))


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        (Wishes(squares=(4, 4)), "a board without window"),
        (Wishes(marker_mm=25.0), "smaller than its square, 19 mm"),
        (Wishes(squares=(80, 60)), "DICT_4X4_1000 ends at 999"),
        (Wishes(dictionary="DICT_4X4_50"), "ends at 49"),
        (Wishes(view_mm=(5.0, 4.0)), "take fewer squares"),
        (Wishes(view_mm=(0.0, 4.0)), "the view's width"),
    ],
)
def test_impossible_wishes_are_refused_with_their_reason(wishes: Wishes, message: str):
    with pytest.raises(InputError, match=message):
        design(wishes)


def test_paper_too_small_for_anything_is_refused():
    with pytest.raises(InputError, match="do not fit 60 x 40 mm at any size"):
        design(Wishes(), paper_of("60x40"))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(3, 20), st.integers(3, 20), st.floats(120, 1200), st.floats(120, 1200), st.booleans())
def test_what_was_designed_for_a_paper_fits_it(columns: int, rows: int, width: float, height: float, window: bool):
    wishes = Wishes(squares=(columns, rows), window_mm="chosen" if window and min(columns, rows) > 5 else None)
    board, paper = design(wishes, Paper("custom", (width, height)))
    lay_out(board, paper, "board.pdf")


def test_a_measured_board_is_scaled_in_each_direction():
    measured = as_measured(PLAIN, size_mm=(246.35, 171.9))
    assert measured.square_mm == pytest.approx((18.95, 19.1), abs=1e-6)
    assert measured.window_mm == pytest.approx((4 * 18.95, 3 * 19.1, 5 * 18.95, 3 * 19.1), abs=1e-5)
    assert measured.marker_mm == pytest.approx(0.75 * math.sqrt(18.95 * 19.1), abs=1e-6)
    assert np.array_equal(measured.printed, PLAIN.printed)
    again = as_measured(PLAIN, square_mm=(18.95, 19.1))
    assert again == measured
    assert as_measured(measured, size_mm=(246.35, 171.9)) == measured
    assert as_measured(replace(PLAIN, window_mm=None), square_mm=(19.0, 19.0)).window_mm is None


def test_measurements_in_other_units_are_refused():
    for size in ((24.7, 17.1), (9.7, 6.7), (171.0, 24.7)):
        with pytest.raises(InputError, match="give mm, width first"):
            as_measured(PLAIN, size_mm=size)
    with pytest.raises(InputError, match="either"):
        as_measured(PLAIN)
    with pytest.raises(InputError, match="either"):
        as_measured(PLAIN, square_mm=(19.0, 19.0), size_mm=(247.0, 171.0))


@pytest.mark.parametrize(("pixels", "message"), [(15, "too few"), (20_000, "take fewer, or a PDF")])
def test_pictures_of_absurd_size_are_refused(pixels: int, message: str):
    with pytest.raises(InputError, match=message):
        as_pixels(sheet("A4"), pixels)


@pytest.mark.parametrize("name", ["A5", "A4", "A3", "Letter"])
def test_the_ready_boards_are_what_the_command_draws(name: str):
    folder = BOARDS / name
    board, paper = design(Wishes(), paper_of(name))
    assert load_board(folder / "board.toml") == board
    kept = (folder / f"board_{name}.pdf").read_bytes()
    drawn = as_pdf(lay_out(board, paper, f"board_{name}.pdf"))
    # Each version of ReportLab writes its own name into the head; what is drawn is the same.
    if kept.splitlines()[1] == drawn.splitlines()[1]:
        assert kept == drawn
    old, new = read_pdf(kept), read_pdf(drawn)
    assert np.array_equal(old.rectangles, new.rectangles)
    assert (old.text, old.size_mm) == (new.text, new.size_mm)
