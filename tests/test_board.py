"""The board: its geometry is OpenCV's, its file reads back equal, each thing wrong with it has its own clear line."""

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.board import Board, Observations, View, board_from_dict, load_board, save_board
from planeopt.board.file import board_as_toml
from planeopt.errors import InputError

PLAIN = """\
squares = [11, 9]
square_mm = 20.0
marker_mm = 15.0
dictionary = "DICT_4X4_100"
"""
WINDOW = "window_mm = [80.0, 60.0, 60.0, 60.0]\n"
DICTIONARIES = sorted(
    [
        *(f"DICT_{bits}X{bits}_{size}" for bits in (4, 5, 6, 7) for size in (50, 100, 250, 1000)),
        "DICT_ARUCO_ORIGINAL",
        "DICT_ARUCO_MIP_36h12",
        *(f"DICT_APRILTAG_{name}" for name in ("16h5", "25h9", "36h10", "36h11")),
    ]
)


def board(text: str = PLAIN) -> Board:
    return board_from_dict(tomllib.loads(text), "board.toml")


def opencv_board(spec: Board) -> Any:
    """Return OpenCV's board of the same specification; it knows only square squares."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
    ids = np.arange(spec.first_id, spec.last_id + 1)
    made = cv2.aruco.CharucoBoard(spec.squares, spec.square_mm[0], spec.marker_mm, dictionary, ids)
    made.setLegacyPattern(spec.legacy)
    return made


@st.composite
def boards(draw: st.DrawFn) -> Board:
    squares = draw(st.integers(3, 12)), draw(st.integers(3, 12))
    sides = draw(st.floats(0.5, 200)), draw(st.floats(0.5, 200))
    if draw(st.booleans()):
        sides = sides[0], sides[0]
    dictionary = draw(st.sampled_from(["DICT_5X5_250", "DICT_6X6_1000", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11"]))
    window = None
    if draw(st.booleans()):
        share = st.floats(0, 0.4)
        x, y = (draw(share) * n * side for n, side in zip(squares, sides, strict=True))
        width, height = ((draw(share) + 0.01) * n * side for n, side in zip(squares, sides, strict=True))
        window = x, y, width, height
    marker = draw(st.floats(0.1, 0.95)) * min(sides)
    return Board(squares, sides, marker, dictionary, draw(st.booleans()), draw(st.integers(0, 100)), window)


@settings(max_examples=100, derandomize=True, deadline=None)
@given(boards())
def test_the_file_reads_back_equal(spec: Board):
    assert board(board_as_toml(spec)) == spec


def test_the_file_on_disk(tmp_path: Path):
    file = tmp_path / "board.toml"
    spec = Board((11, 9), (20.02, 19.97), 15.0, "DICT_4X4_100", True, 7, (80.0, 60.0, 60.0, 60.0))
    save_board(spec, file)
    assert load_board(file) == spec
    assert [path.name for path in tmp_path.iterdir()] == ["board.toml"]
    assert "square_mm = [20.02, 19.97]" in file.read_text(encoding="utf-8")
    # Whole numbers will do where a length is meant, and one side for two.
    assert board(PLAIN.replace("20.0", "20").replace("15.0", "15")) == board()
    assert board(PLAIN.replace("20.0", "[20, 20]")) == board() == board(f"format = 1\n{PLAIN}")
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'none.toml'}: there is no such file")):
        load_board(tmp_path / "none.toml")
    with pytest.raises(InputError, match="this is a folder; name the board file in it"):
        load_board(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("11, 9", "2, 9", "squares must be two whole numbers [columns, rows], 3 or more each, not [2, 9]"),
        ("11, 9", "11", "squares must be two whole numbers [columns, rows], 3 or more each, not [11]"),
        ("11, 9", "11.5, 9", "squares[0] must be a whole number, not a decimal number"),
        ("squares = [11, 9]\n", "", "the file lacks the key 'squares'"),
        ("squares", "square", "the file has the unknown key 'square': check its spelling, or remove it"),
        ("20.0", '"20"', "square_mm must be a number or a list, not a text"),
        ("20.0", "[20.0, 20.0, 20.0]", "square_mm must be one number or two, [x, y], not 3"),
        ("20.0", "[]", "square_mm must be one number or two, [x, y], not 0"),
        ("20.0", "0.0", "square_mm must be positive (mm), not 0.0"),
        ("20.0", "[20.0, -1.0]", "square_mm must be positive (mm), not -1.0"),
        ("20.0", "inf", "square_mm must be a finite number, not inf"),
        ("15.0", "nan", "marker_mm must be a finite number, not nan"),
        ("15.0", "-15.0", "marker_mm must be positive (mm), not -15.0"),
        ("15.0", "20.0", "marker_mm is 20, but a marker must be smaller than its square, 20 mm"),
        ("20.0", "[20.0, 14.5]", "marker_mm is 15, but a marker must be smaller than its square, 14.5 mm"),
        (
            "4X4_100",
            "4X5_100",
            "dictionary 'DICT_4X5_100' is not known: give one of OpenCV's, DICT_4X4_100 for example",
        ),
        ("4X4_100", "4X4_99", "dictionary 'DICT_4X4_99' is not known: give one of OpenCV's, DICT_4X4_100 for example"),
        (
            "4X4_100",
            "APRILTAG_16h5",
            "the board needs the markers 0 to 48, but DICT_APRILTAG_16h5 ends at 29: take a larger dictionary or fewer "
            "squares",
        ),
        ('100"', '100"\nfirst_id = -1', "first_id must be a whole number from 0, not -1"),
        ('100"', '100"\nfirst_id = 0.5', "first_id must be a whole number, not a decimal number"),
        (
            '100"',
            '100"\nfirst_id = 52',
            "the board needs the markers 52 to 100, but DICT_4X4_100 ends at 99: take a larger dictionary or fewer "
            "squares",
        ),
        ('100"', '100"\nlegacy = 1', "legacy must be true or false, not a whole number"),
        ('100"', '100"\nwindow_mm = [1.0, 2.0]', "window_mm must be four numbers [x, y, width, height], not 2"),
        ('100"', '100"\nwindow_mm = []', "window_mm must be four numbers [x, y, width, height], not 0"),
        ('100"', '100"\nwindow_mm = [0, 0, nan, 1]', "window_mm must be a finite number, not nan"),
        ('100"', '100"\nwindow_mm = [0, 0, 0, 20]', "window_mm: width and height must be positive, not 0 and 20"),
        (
            '100"',
            '100"\nwindow_mm = [180.0, 0.0, 40.5, 20.0]',
            "window_mm [180.0, 0.0, 40.5, 20.0] does not lie on the board, which is 220 x 180 mm without margin",
        ),
        (
            '100"',
            '100"\nwindow_mm = [-0.5, 0.0, 40.0, 20.0]',
            "window_mm [-0.5, 0.0, 40.0, 20.0] does not lie on the board, which is 220 x 180 mm without margin",
        ),
        ("squares", "format = 2\nsquares", "format 2 is not known; this version of planeopt reads format 1"),
    ],
)
def test_what_is_wrong_with_a_board_is_named(old: str, new: str, message: str):
    assert old in PLAIN
    with pytest.raises(InputError) as caught:
        board(PLAIN.replace(old, new, 1))
    assert str(caught.value) == f"board.toml: {message}"


@pytest.mark.parametrize("name", DICTIONARIES)
def test_dictionaries_are_opencvs(name: str):
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    assert Board((3, 3), (20.0, 20.0), 15.0, name).dictionary_size == len(dictionary.bytesList)


def test_no_dictionary_of_opencvs_is_missing():
    # DICT_APRILTAG_16H5 is another spelling of DICT_APRILTAG_16h5, and so on.
    known = {name.upper() for name in dir(cv2.aruco) if name.startswith("DICT_")}
    assert known == {name.upper() for name in DICTIONARIES}


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("squares", [(3, 3), (11, 9), (5, 4), (4, 7), (6, 8)])
def test_corners_and_markers_are_opencvs(squares: tuple[int, int], legacy: bool):
    spec = Board(squares, (20.0, 20.0), 15.0, "DICT_5X5_250", legacy, 3)
    theirs = opencv_board(spec)
    # OpenCV keeps them in single precision.
    np.testing.assert_allclose(spec.corners, theirs.getChessboardCorners().reshape(-1, 3)[:, :2], rtol=1e-6)
    assert np.ravel(theirs.getIds()).tolist() == list(range(spec.first_id, spec.last_id + 1))
    assert spec.marker_count == len(theirs.getIds())


def test_ids_run_along_rows_and_sides_may_differ():
    spec = Board((4, 3), (20.0, 10.0), 8.0, "DICT_4X4_50")
    assert spec.corners.tolist() == [[20, 10], [40, 10], [60, 10], [20, 20], [40, 20], [60, 20]]
    assert spec.size_mm == (80.0, 30.0)
    assert not spec.corners.flags.writeable
    assert spec.printed.all()
    assert not spec.printed.flags.writeable


@pytest.mark.parametrize(
    ("window", "hidden"),
    [
        ((20.0, 20.0, 20.0, 20.0), {0, 1, 3, 4}),  # its corners are those of four squares: each lacks a square
        ((22.0, 22.0, 16.0, 16.0), set()),  # within one square
        ((30.0, 30.0, 20.0, 20.0), {4}),
        ((30.0, 0.0, 20.0, 80.0), {1, 4, 7}),
        ((0.0, 0.0, 80.0, 80.0), set(range(9))),
        ((0.0, 0.0, 20.0 - 1e-9, 80.0), {0, 3, 6}),  # an edge that was meant to touch
        ((0.0, 0.0, 19.9, 80.0), set()),
    ],
)
def test_corners_at_the_window_are_not_printed(window: tuple[float, float, float, float], hidden: set[int]):
    spec = Board((4, 4), (20.0, 20.0), 15.0, "DICT_4X4_50", window_mm=window)
    assert set(np.flatnonzero(~spec.printed).tolist()) == hidden


@settings(max_examples=100, derandomize=True, deadline=None)
@given(boards())
def test_a_corner_is_printed_where_all_four_squares_are(spec: Board):
    if spec.window_mm is None:
        assert spec.printed.all()
        return
    x, y, width, height = spec.window_mm
    (left, top), (right, bottom) = (x, y), (x + width, y + height)
    # A little round the corner, so that the four squares are looked at beside it.
    step = 1e-4 * min(spec.square_mm)
    for (u, v), printed in zip(spec.corners.tolist(), spec.printed.tolist(), strict=True):
        touched = [left <= u + du <= right and top <= v + dv <= bottom for du in (-step, step) for dv in (-step, step)]
        near = min(abs(u - left), abs(u - right), abs(v - top), abs(v - bottom)) < 2 * step
        assert near or printed == (not any(touched))


@settings(max_examples=60, derandomize=True, deadline=None)
@given(boards(), st.floats(0, 1), st.floats(0, 1))
def test_bow_is_one_in_the_middle_and_nothing_at_the_edges(spec: Board, s: float, t: float):
    width, height = spec.size_mm
    assert spec.bow([width / 2, height / 2]).tolist() == [1.0, 1.0]
    edges = np.array([[0, t * height], [width, t * height]]), np.array([[s * width, 0], [s * width, height]])
    assert spec.bow(edges[0])[:, 0].tolist() == [0.0, 0.0]
    assert spec.bow(edges[1])[:, 1].tolist() == [0.0, 0.0]
    # A parabola along its own axis only, the same on both sides of the middle, whatever the shape of the input.
    found = spec.bow(np.array([[[s * width, t * height]], [[(1 - s) * width, (1 - t) * height]]]))
    assert found.shape == (2, 1, 2)
    expected = [4 * s * (1 - s), 4 * t * (1 - t)]
    np.testing.assert_allclose(found[:, 0], [expected, expected], rtol=0, atol=1e-12)


def test_a_board_is_a_value():
    assert board() == board()
    assert hash(board()) == hash(board())
    assert board() != board(PLAIN + WINDOW)
    one = Board((11, 9), (20, 20), 15, "DICT_4X4_100", window_mm=(80, 60, 60, 60))
    assert one == board(PLAIN + WINDOW)
    assert all(isinstance(value, float) for value in (*one.square_mm, one.marker_mm, *(one.window_mm or ())))


def test_squares_are_counted_in_whole_numbers():
    for squares in ((math.nan, 9), (math.inf, 9), (9.5, 9), (0, 9), (-11, 9)):
        with pytest.raises(InputError, match="squares must be two whole numbers"):
            Board(squares, (20.0, 20.0), 15.0, "DICT_4X4_100")  # type: ignore[arg-type]  # untyped callers do this


def view(**changes: Any) -> View:
    given = {"name": "view.png", "ids": [0, 3], "corners": [[1.0, 2.0], [3.0, 4.0]], "sigma": [0.1, 0.2]}
    return View(**(given | changes))


def test_a_view_keeps_what_it_was_given():
    seen = view()
    assert (len(seen), seen.ids.tolist(), seen.sigma.tolist()) == (2, [0, 3], [0.1, 0.2])
    assert not any(array.flags.writeable for array in (seen.ids, seen.corners, seen.sigma))
    empty = view(ids=[], corners=np.empty((0, 2)), sigma=[])
    assert len(empty) == 0
    corners = np.array([[1.0, 2.0], [3.0, 4.0]])
    seen = view(corners=corners)
    corners[:] = 0
    assert seen.corners.tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ids": [0]}, "1 ids need corners of shape (1, 2) and as many sigmas, not (2, 2) and (2,)"),
        ({"corners": [[1.0, 2.0, 3.0]] * 2}, "2 ids need corners of shape (2, 2) and as many sigmas, not (2, 3)"),
        ({"ids": [3, 3]}, "the corner 3 stands there more than once"),
        ({"corners": [[1.0, math.nan], [3.0, 4.0]]}, "corners must be finite (no NaN, no infinity)"),
        ({"corners": "nothing"}, "corners must be numbers"),
        ({"sigma": [0.1, math.inf]}, "sigma_px must be finite (no NaN, no infinity)"),
        ({"sigma": [0.1, 0.0]}, "sigma_px must be positive, not 0"),
        ({"sigma": [0.1]}, "2 ids need corners of shape (2, 2) and as many sigmas, not (2, 2) and (1,)"),
    ],
)
def test_what_is_wrong_with_a_view_is_named(changes: dict[str, Any], message: str):
    with pytest.raises(InputError) as caught:
        view(**changes)
    assert str(caught.value).startswith("view.png: ")
    assert message in str(caught.value)


def test_observations_know_the_boards_corners():
    spec = Board((4, 3), (20.0, 10.0), 8.0, "DICT_4X4_50")
    seen = Observations(spec, (960, 720), (view(),))
    assert (seen.spot, seen.pixel_pitch_mm, len(seen.views)) == ("disc", None, 1)
    for wrong in (6, -1):
        with pytest.raises(InputError, match=re.escape(f"view.png: the board has the corners 0 to 5, not {wrong}")):
            Observations(spec, (960, 720), (view(ids=[0, wrong]),))
