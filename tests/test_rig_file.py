"""rig.toml: what is written reads back equal, and each thing wrong with a file has its own clear line."""

import math
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.errors import InputError
from planeopt.rig import PARAMETERS, Beam, Camera, Rig, RigCovariance, SpotDefinition, load_rig, rig_from_dict, save_rig

EXAMPLE = Path(__file__).parents[1] / "calibration" / "example" / "truth_rig.toml"
FULL = """\
format = 1
[camera]
image_size = [960, 720]
fx = 2181.8
fy = 2181.8
cx = 481.2
cy = 357.6
distortion = [-0.163, 0.104, 0.0003, 0.0004, 0.0]
pixel_pitch_mm = 0.0055
[laser]
radius_mm = 6.0
offset_mm = [21.4, 15.8]
direction = [0.0, 0.0, 1.0]
[spot]
kind = "ring"
level = 0.25
channel = "red"
gamma = 2.2
[covariance]
parameters = ["f", "e_x"]
matrix = [[0.81, -0.03], [-0.03, 0.0016]]
"""

numbers = st.floats(-1e6, 1e6)
positives = st.floats(1e-3, 1e5)
coefficients = st.floats(-1, 1)


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    f = draw(positives)
    camera = Camera(
        (draw(st.integers(1, 20000)), draw(st.integers(1, 20000))),
        f,
        f,
        draw(numbers),
        draw(numbers),
        draw(st.tuples(*[coefficients] * 5)),
        draw(st.none() | positives),
    )
    if not draw(st.booleans()):
        return Rig(camera)
    x, y = draw(st.floats(-0.5, 0.5)), draw(st.floats(-0.5, 0.5))
    beam = Beam(draw(positives), draw(st.tuples(numbers, numbers)), (x, y, math.sqrt(1 - x * x - y * y)))
    names = draw(st.lists(st.sampled_from([n for n in PARAMETERS if n not in ("fx", "fy")]), min_size=1, unique=True))
    scales = 10.0 ** np.random.default_rng(len(names)).integers(-6, 3, size=len(names))
    factor = np.random.default_rng(len(names) + 1).normal(size=(len(names), 2 * len(names)))
    covariance = RigCovariance(tuple(names), factor @ factor.T * np.outer(scales, scales))
    spot = SpotDefinition("disc", draw(st.floats(0.01, 0.99)), "green", draw(st.floats(0.5, 3)))
    return Rig(camera, beam, draw(st.sampled_from([None, spot])), covariance)


@given(rig=rigs())
@settings(max_examples=40, derandomize=True, deadline=None)
def test_what_is_written_reads_back_equal(tmp_path_factory: pytest.TempPathFactory, rig: Rig) -> None:
    file = tmp_path_factory.getbasetemp() / "rig.toml"
    save_rig(rig, file)
    assert load_rig(file) == rig


def test_the_example_is_read() -> None:
    rig = load_rig(EXAMPLE)
    assert rig.camera.image_size == (960, 720)
    assert rig.camera.distortion == (-0.163, 0.104, 0.0003, 0.0004, 0.0)
    assert rig.require_beam().offset == (21.4, 15.8)
    assert rig.focal_length == pytest.approx(12.0, abs=1e-4)
    assert rig.spot is None
    assert rig.covariance is None


def test_every_key_arrives() -> None:
    rig = rig_from_dict(tomllib.loads(FULL), "rig.toml")
    assert rig.spot == SpotDefinition("ring", 0.25, "red", 2.2)
    assert rig.covariance == RigCovariance(("f", "e_x"), np.array([[0.81, -0.03], [-0.03, 0.0016]]))
    assert rig.require_beam() == Beam(6.0, (21.4, 15.8), (0.0, 0.0, 1.0))


def test_a_hand_written_file_may_be_short(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    # No format, no laser, whole numbers, the byte order mark and line ends of another system.
    short = (
        "[camera]\r\nimage_size = [9, 7]\r\nfx = 10\r\nfy = 10\r\ncx = 4\r\ncy = 3\r\ndistortion = [0, 0, 0, 0, 0]\r\n"
    )
    file.write_bytes(b"\xef\xbb\xbf" + short.encode())
    rig = load_rig(file)
    assert rig == Rig(Camera((9, 7), 10, 10, 4, 3, (0, 0, 0, 0, 0)))
    assert isinstance(rig.camera.fx, float)
    with pytest.raises(InputError, match="camera alone"):
        rig.require_beam()


def test_a_spot_table_has_defaults() -> None:
    assert (
        rig_from_dict(tomllib.loads(re.sub(r'kind = "ring"\n(.*\n)*?\[cov', "[cov", FULL)), "r").spot
        == SpotDefinition()
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 1", "format = 2", "format 2 is not known; this version of planeopt reads format 1"),
        ("format = 1", "format = true", "format must be a whole number, not true or false"),
        ("format = 1", 'colour = "red"', "the file has the unknown key 'colour': check its spelling, or remove it"),
        ("[camera]", "[kamera]", "the file has the unknown key 'kamera'"),
        ("fx = 2181.8\n", "", "[camera] lacks the key 'fx'"),
        ("fx = 2181.8", "fx = 2181.8\nskew = 0.1", "[camera] has the unknown key 'skew'"),
        ("fx = 2181.8", "fx = true", "camera.fx must be a number, not true or false"),
        ("fx = 2181.8", 'fx = "wide"', "camera.fx must be a number, not a text"),
        ("fx = 2181.8", "fx = 2020-01-01", "camera.fx must be a number, not a date"),
        ("fx = 2181.8", "fx = nan", "camera.fx must be a finite number, not nan"),
        ("fx = 2181.8", "fx = -2181.8", "camera.fx must be positive (px), not -2181.8"),
        ("fx = 2181.8", "fx = " + "9" * 400, "camera.fx: "),
        (
            "[960, 720]",
            "[960, 0]",
            "camera.image_size must be two positive whole numbers [width, height], not [960, 0]",
        ),
        ("[960, 720]", "[960]", "camera.image_size must be two positive whole numbers"),
        ("[960, 720]", "[960.5, 720]", "must be a whole number, not a decimal number"),
        ("[960, 720]", "[true, 720]", "must be a whole number, not true or false"),
        ("[960, 720]", "960", "camera.image_size must be a list, not a whole number"),
        (
            "0.0003, 0.0004, 0.0]",
            "0.0003, 0.0004]",
            "camera.distortion must be the five numbers [k1, k2, p1, p2, k3], not 4",
        ),
        ("0.0004, 0.0]", "0.0004, 0.0, 0, 0, 0]", "not 8: OpenCV's rational model is not supported"),
        ("0.0004, 0.0]", "0.0004, inf]", "camera.distortion must be a finite number, not inf"),
        ("pixel_pitch_mm = 0.0055", "pixel_pitch_mm = 0", "camera.pixel_pitch_mm must be positive (mm), not 0.0"),
        ("radius_mm = 6.0", "radius_mm = -6.0", "laser.radius_mm must be positive (mm), not -6.0"),
        ("radius_mm = 6.0\n", "", "[laser] lacks the key 'radius_mm'"),
        ("[21.4, 15.8]", "[21.4]", "laser.offset_mm must be two numbers [e_x, e_y], not 1"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 1.1]", "laser.direction must be a unit vector, but its length is 1.1"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, -1.0]", "laser.direction must point forward"),
        ('"ring"', '"square"', "spot.kind must be one of disc, ring, not 'square'"),
        ("level = 0.25", "level = 1.5", "spot.level must be a fraction between 0 and 1, not 1.5"),
        ('"red"', '"infrared"', "spot.channel must be one of gray, red, green, blue, not 'infrared'"),
        ("gamma = 2.2", "gamma = 0", "spot.gamma must be positive"),
        ('["f", "e_x"]', '["f", "skew"]', "covariance.parameters: 'skew' is not a parameter; known are f, fx"),
        ('["f", "e_x"]', '["f", "f"]', "covariance.parameters: 'f' stands there more than once"),
        ('["f", "e_x"]', '["f", "fx"]', "covariance.parameters: 'f' is fx and fy in one"),
        ('["f", "e_x"]', "[]", "covariance.parameters is empty"),
        ('["f", "e_x"]', '["f", 2]', "must be a text, not a whole number"),
        ('["f", "e_x"]', '["f", "e_x", "cx"]', "covariance.matrix must be 3 x 3, one row per parameter, not 2 x 2"),
        ("fy = 2181.8", "fy = 2190.0", "covariance.parameters: 'f' needs camera.fx and camera.fy to be equal"),
        ("[[0.81, -0.03], [-0.03, 0.0016]]", "[]", "covariance.matrix must be 2 x 2, one row per parameter, not empty"),
        ("[-0.03, 0.0016]]", "[-0.03]]", "covariance.matrix must have rows of equal length"),
        ("[-0.03, 0.0016]]", "[nan, 0.0016]]", "covariance.matrix must be finite, but (e_x, f) is nan"),
        ("[-0.03, 0.0016]]", "[-0.02, 0.0016]]", "covariance.matrix must be symmetric, but (f, e_x) is -0.03"),
        ("[-0.03, 0.0016]]", "[-0.03, 0.0]]", "must be positive definite, but the variance of e_x is 0.0"),
        ("[-0.03, 0.0016]]", "[-0.03, 0.0001]]", "covariance.matrix must be positive definite: some mix"),
    ],
)
def test_each_fault_has_one_line_with_file_and_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert FULL.count(old) == 1
    file = tmp_path / "my-rig.toml"
    file.write_text(FULL.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_rig(file)
    text = str(caught.value)
    assert text.startswith(f"{file}: ")
    assert message in text
    assert "\n" not in text


def test_a_laser_that_the_covariance_needs() -> None:
    mapping = tomllib.loads(FULL)
    del mapping["laser"]
    with pytest.raises(InputError, match=r"^my rig: covariance.parameters: 'e_x' .* there is no \[laser\]"):
        rig_from_dict(mapping, "my rig")


def test_positive_definite_does_not_depend_on_the_units() -> None:
    # 1e-3 px and 1e-12: the plain Cholesky test would call this singular or not by its scale.
    scale = np.diag([1e3, 1e-12])
    correlation = np.array([[1, 0.9], [0.9, 1]])
    RigCovariance(("cx", "p1"), scale @ correlation @ scale)
    with pytest.raises(InputError, match="some mix"):
        RigCovariance(("cx", "p1"), scale @ np.array([[1, 1.1], [1.1, 1]]) @ scale)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b"# caf\xe9\n")
    (tmp_path / "broken.toml").write_text("[camera]\nfx = = 3\n", encoding="utf-8")
    for name, message in {
        "none.toml": "there is no such file",
        ".": "this is a folder",
        "latin.toml": r"not a text file in UTF-8 \(byte 5\)",
        "broken.toml": r"not valid TOML: .*line 2",
    }.items():
        with pytest.raises(InputError, match=message):
            load_rig(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read"):
        load_rig(tmp_path / "latin.toml" / "rig.toml")


def test_files_that_cannot_be_written(tmp_path: Path) -> None:
    rig = load_rig(EXAMPLE)
    with pytest.raises(InputError, match="this is a folder"):
        save_rig(rig, tmp_path)
    with pytest.raises(InputError, match="cannot be written \\(No such file"):
        save_rig(rig, tmp_path / "none" / "rig.toml")


def test_a_file_is_replaced_whole_and_leaves_nothing_beside(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text("old", encoding="utf-8")
    save_rig(load_rig(EXAMPLE), file)
    assert load_rig(file) == load_rig(EXAMPLE)
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def test_the_rig_needs_no_heavy_library() -> None:
    # In a fresh interpreter: the command line reads a rig before it knows whether a solver is needed.
    code = "import sys, planeopt.rig; print(sorted({'casadi', 'scipy', 'cv2', 'matplotlib'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
