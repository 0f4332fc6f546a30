"""Corners on disk."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.board import Board, View
from planeopt.calibration.detections_file import load_detections, save_detections
from planeopt.errors import InputError

BOARD = Board((7, 5), (10, 10), 7.5, "DICT_4X4_50")
HEAD = "image,id,x_px,y_px,sigma_px\n"

coordinates = st.floats(-1e6, 1e6, allow_nan=False)


@given(
    st.dictionaries(
        st.text("abc ,\"'é/._", min_size=1).filter(lambda name: name == name.strip()),
        st.dictionaries(st.integers(0, 23), st.tuples(coordinates, coordinates, st.floats(1e-6, 10)), min_size=1),
        min_size=1,
        max_size=3,
    )
)
@settings(max_examples=40, derandomize=True, deadline=None)
def test_written_and_read_back_nothing_changes(tmp_path_factory: pytest.TempPathFactory, seen: dict):
    file = tmp_path_factory.mktemp("corners") / "corners.csv"
    views = [
        View(name, np.array(list(rows)), np.array(list(rows.values()))[:, :2], np.array(list(rows.values()))[:, 2])
        for name, rows in seen.items()
    ]
    save_detections(views, file)
    back = load_detections(file, BOARD)
    assert list(back) == [view.name for view in views]
    for view in views:
        for name in ("ids", "corners", "sigma"):
            np.testing.assert_array_equal(getattr(back[view.name], name), getattr(view, name))


def test_without_sigma_all_weigh_the_same(tmp_path: Path):
    file = tmp_path / "corners.csv"
    file.write_text("image,id,x_px,y_px\n\na.png,3,1.5,2\na.png,4,3,4\n", encoding="utf-8-sig")
    assert len(set(load_detections(file, BOARD)["a.png"].sigma.tolist())) == 1


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "the file is empty"),
        ("x,y\n", "line 1: the header must be"),
        (HEAD + "a.png,3,1,2\n", "line 2: 5 values expected"),
        (HEAD + "a.png,24,1,2,1\n", "id must be a whole number from 0 to 23, not '24'"),
        (HEAD + "a.png,-1,1,2,1\n", "id must be"),
        (HEAD + "a.png,1.0,1,2,1\n", "id must be"),
        (HEAD + "a.png,1,x,2,1\n", "x_px must be a number"),
        (HEAD + "a.png,1,1,nan,1\n", "y_px must be finite"),
        (HEAD, "holds no corners, only the header"),
        ("image,id,x_px,y_px\n\n", "holds no corners"),
        (HEAD + "a.png,1,1,2,0\n", "line 2: sigma_px must be from 1e-06 to 1000, not 0"),
        (HEAD + "a.png,1,1,2,1\na.png,2,1,2,1e-200\n", "line 3: sigma_px must be from"),
        (HEAD + "a.png,1,1,2,1e200\n", "line 2: sigma_px must be from"),
        (HEAD + ",1,1,2,1\n", "the image's name is missing"),
        (HEAD + "a.png,1,1,2,1\na.png,1,1,2,1\n", "line 3: the corner 1 of a.png stands there a second time"),
        (HEAD + "a.png,1,1,2,1\n\xff", "not a text file in UTF-8"),
    ],
)
def test_what_is_wrong_is_one_line_with_the_file_and_the_line(tmp_path: Path, text: str, complaint: str):
    file = tmp_path / "corners.csv"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError) as error:
        load_detections(file, BOARD)
    assert complaint in str(error.value)
    assert str(file) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file(tmp_path: Path):
    with pytest.raises(InputError, match="there is no such file"):
        load_detections(tmp_path / "none.csv", BOARD)
