"""Images and boundary points on disk, and the spot's own checks."""

import math
import pickle
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.errors import InputError
from planeopt.spot import NoSpotReason, Spot, SpotFlag, SpotNotFound, read_image, read_points, write_points
from planeopt.spot.points import SIGMAS

FIVE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 1.5]])
VALID: dict[str, Any] = {"points": FIVE}
ROWS = "1,2\n3,4\n5,6\n7,8\n9,1\n"

numbers = st.floats(allow_nan=False, allow_infinity=False)
sigmas = st.floats(*SIGMAS)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(rows=st.lists(st.tuples(numbers, numbers, sigmas), min_size=5, max_size=9), with_sigma=st.booleans())
def test_points_come_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, ...]], with_sigma: bool
) -> None:
    table = np.array(rows)
    spot = Spot(table[:, :2], table[:, 2] if with_sigma else None)
    path = tmp_path_factory.mktemp("points") / "spot.csv"
    write_points(spot, path)
    back = read_points(path)
    np.testing.assert_array_equal(back.points, spot.points)
    if spot.sigma is None:
        assert back.sigma is None
        assert back.flags == (SpotFlag.SIGMA_UNKNOWN,)
    else:
        assert back.sigma is not None
        np.testing.assert_array_equal(back.sigma, spot.sigma)
        assert back.flags == ()
    assert back.source == str(path)
    assert [p.name for p in path.parent.iterdir()] == ["spot.csv"], "nothing is left beside the file"


def test_points_as_other_programs_write_them(tmp_path: Path) -> None:
    path = tmp_path / "spot.csv"
    path.write_bytes(b"\xef\xbb\xbfx_px, y_px\r\n" + ROWS.replace("\n", "\r\n").encode() + b"\r\n")
    np.testing.assert_array_equal(read_points(path).points[:2], [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\n \n", "empty"),
        (ROWS.encode(), "line 1: the header must be x_px,y_px"),
        (b"x,y\n" + ROWS.encode(), "line 1: the header must be x_px,y_px"),
        (b"x_px,y_px,weight\n1,2,3\n", "line 1: the header"),
        (b"x_px,y_px\n1,2\n\n1,2,3\n", "line 4: 2 values expected .* found 3"),
        (b"x_px,y_px,sigma_px\n1,2\n", "line 2: 3 values expected .* found 2"),
        (b"x_px,y_px\n1,two\n", "line 2: y_px must be a number, not 'two'"),
        (b"x_px,y_px\n,2\n", "line 2: x_px must be a number, not ''"),
        (b"x_px,y_px\nnan,2\n", "line 2: x_px must be finite, not nan"),
        (b"x_px,y_px\n1,-inf\n", "line 2: y_px must be finite, not -inf"),
        (b"x_px,y_px,sigma_px\n1,2,0\n", "line 2: sigma_px must be positive, not 0"),
        (b"x_px,y_px,sigma_px\n1,2,-0.1\n", "line 2: sigma_px must be positive, not -0.1"),
        (b"x_px,y_px,sigma_px\n1,2,1e200\n", "line 2: sigma_px must be from 1e-30 to 1e.30, not 1e200"),
        (b"x_px,y_px\n1,2\n3,4\n5,6\n7,8\n", "at least 5 boundary points, the file has 4"),
        (b"x_px,y_px\n", "at least 5 boundary points, the file has 0"),
        (b"x_px,y_px\n1,\xff\n", "not a text file in UTF-8"),
        (b'x_px,y_px\n"1,2\n', "spot.csv, line 2"),
        (b"x_px,y_px\n1," + b"2" * 200_000, "spot.csv, line 2: not CSV"),
    ],
)
def test_a_bad_row_is_named_with_its_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "spot.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_points(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    for read in (read_image, read_points):
        with pytest.raises(InputError, match=r"nowhere: there is no such"):
            read(tmp_path / "nowhere")
        with pytest.raises(InputError, match="this is a folder"):
            read(tmp_path)
        with pytest.raises(InputError, match="not a usable file name"):
            read("a\0b")
    with pytest.raises(InputError, match="cannot be written"):
        write_points(Spot(FIVE), tmp_path / "missing" / "spot.csv")


# BMP and JPEG hold 8 bits.
@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [(s, np.uint8) for s in (".png", ".tiff", ".bmp", ".pgm", ".jpg")]
    + [(s, np.uint16) for s in (".png", ".tiff", ".pgm")],
)
def test_images_keep_their_depth(tmp_path: Path, suffix: str, dtype: type) -> None:
    image = np.arange(64 * 48, dtype=np.uint32).reshape(48, 64).astype(dtype) * dtype(3)
    ok, data = cv2.imencode(suffix, image)
    assert ok
    (tmp_path / f"a{suffix}").write_bytes(data.tobytes())
    back = read_image(tmp_path / f"a{suffix}")
    assert back.dtype == dtype
    assert back.shape == image.shape
    if suffix != ".jpg":
        np.testing.assert_array_equal(back, image)


def test_damaged_images_are_one_line_and_silent(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 64), dtype=np.uint8)
    encoded = {suffix: cv2.imencode(suffix, image)[1].tobytes() for suffix in (".png", ".jpg", ".bmp", ".tiff", ".pgm")}
    contents = [b"", b"hello", b"\x89PNG\r\n\x1a\n" + b"x" * 100, b"\xff\xd8\xff\xe0" + b"x" * 100]
    contents += [data[: len(data) // 2] for suffix, data in encoded.items() if suffix in (".png", ".jpg", ".tiff")]
    for number, content in enumerate(contents):
        path = tmp_path / f"{number}.png"
        path.write_bytes(content)
        with pytest.raises(InputError, match=re.escape(str(path))) as caught:
            read_image(path)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points": FIVE[:4]}, "at least 5 points, not 4"),
        ({"points": FIVE.T}, r"shape \(N, 2\)"),
        ({"points": FIVE * math.nan}, "points must be finite"),
        ({"points": "abc"}, "points must be numbers"),
        ({"sigma": [1, 1, 1]}, "one value for each of the 5 points"),
        ({"sigma": [1, 1, 0, 1, 1]}, "sigma must be positive, but is .* at point 2"),
        ({"sigma": [1, 1, 1e200, 1, 1]}, r"sigma must be from 1e-30 to 1e\+30 px, but is 1e\+200 at point 2"),
        ({"sigma": math.inf}, "sigma must be finite"),
        ({"kind": "square"}, 'kind must be "disc" or "ring"'),
        ({"arc_fraction": 1.5}, "arc_fraction must be between 0 and 1"),
        ({"blur": math.nan}, "blur must be between"),
    ],
)
def test_a_spot_refuses_what_is_none(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Spot(**(VALID | changes))


def test_a_spot_cannot_be_changed_from_outside() -> None:
    points = FIVE.copy()
    spot = Spot(points, np.full(5, 0.1), flags=(SpotFlag.SATURATED, SpotFlag.SATURATED))
    points[0] = 99
    assert spot.points[0, 0] == 0
    assert spot.flags == (SpotFlag.SATURATED,)
    with pytest.raises(ValueError, match="read-only"):
        spot.points[0] = 99


def test_not_found_survives_another_process() -> None:
    original = SpotNotFound(NoSpotReason.SEVERAL, "At (1, 2).")
    copy = pickle.loads(pickle.dumps(original))
    assert copy.reason is NoSpotReason.SEVERAL
    assert str(copy) == str(original) == f"{NoSpotReason.SEVERAL.value} At (1, 2)."


def test_every_reason_and_flag_is_a_sentence() -> None:
    for member in [*NoSpotReason, *SpotFlag]:
        assert re.fullmatch(r"[A-Z].*\.", member.value), member
