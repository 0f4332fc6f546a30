"""Files of cameras that cannot be used: one clear line each, with the file and the key, whatever is in the file."""

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from example_rig import RIG_FILE
from planeopt.errors import InputError
from planeopt.formats import export_camera, import_camera
from planeopt.formats.opencv import from_opencv
from planeopt.formats.ros import from_ros
from planeopt.rig import Camera, Rig, load_rig

EXAMPLE = load_rig(RIG_FILE)
ROS = export_camera(EXAMPLE, "ros").text
OPENCV = export_camera(EXAMPLE, "opencv").text
DISTORTION = "[-0.163, 0.104, 0.0003, 0.0004, 0.0]"


def refusal(kind: str, text: str) -> str:
    """Return the one line by which a text is refused."""
    read = from_ros if kind == "ros" else from_opencv
    with pytest.raises(InputError) as caught:
        read(text, "camera.yaml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("camera.yaml")
    return message


@pytest.mark.parametrize("kind", ["ros", "opencv"])
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("image_width: 960", "image_width: 96O", ": image_width must be a whole number, not '96O'"),
        ("image_width: 960", "image_width: 960.5", ": image_width must be a whole number, not '960.5'"),
        ("image_width: 960", "image_width: [960]", ": image_width must be a whole number, not a list"),
        ("image_width: 960", "image_width: 0", ": camera.image_size must be two positive whole numbers"),
        ("cols: 3", "cols: 4", ": camera_matrix.data must be 3 x 4 numbers, not 9"),
        ("rows: 3", "rows: three", ": camera_matrix: rows must be a whole number, not 'three'"),
        ("data: [2181.8, 0.0,", "data: [2181.8, 0.5,", ": camera_matrix has the skew 0.5, which OpenCV's model does"),
        ("0.0, 0.0, 1.0]", "0.0, 0.0, 2.0]", ": camera_matrix must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], row by row"),
        ("[2181.8", "[-2181.8", ": camera.fx must be positive (px), not -2181.8"),
        ("[2181.8", "[.nan", ": camera_matrix.data: the value 1 must be a finite number, not '.nan'"),
        ("[2181.8", "[.Inf", ": camera_matrix.data: the value 1 must be a finite number, not '.Inf'"),
        ("[2181.8", "[1e999", ": camera_matrix.data: the value 1 must be a finite number, not '1e999'"),
        ("[2181.8", "[2_181.8", ": camera_matrix.data: the value 1 must be a finite number, not '2_181.8'"),
        ("[2181.8, 0.0", "[[2181.8], 0.0", ": camera_matrix.data must be a plain list of numbers"),
        ("-0.163, 0.104", "-0.163; 0.104", ": distortion_coefficients.data: the value 1 must be a finite number"),
        (DISTORTION, "[]", ": distortion_coefficients.data must be 1 x 5 numbers, not 0"),
        ("  cols: 5", "  cols: 5\n colour: 3", ", line "),
        ("image_height", "image_width: 960\nimage_height", ", line "),
        ("image_height", "image_height: [", ", line "),
        ("image_height", "\timage_height", ", line "),
    ],
)
def test_what_is_wrong_is_named(kind: str, old: str, new: str, message: str):
    text = ROS if kind == "ros" else OPENCV
    assert old in text
    assert refusal(kind, text.replace(old, new, 1)).startswith(f"camera.yaml{message}")


def test_a_key_that_stands_twice_is_named_with_its_line():
    assert refusal("ros", f"image_width: 1\n{ROS}") == (
        "camera.yaml, line 4: not valid YAML: the key 'image_width' stands there twice"
    )


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        ([0.1, 0.2, 0.0], "distortion_coefficients must be k1, k2, p1, p2 and k3, but there are 3"),
        ([0.1, 0.2, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0], "has 8 coefficients, of which more than five are not 0: "),
        ([0.1, 0.2, 0.0, 0.0, 0.0, *[0.0] * 8, 0.3], "has 14 coefficients, of which more than five are not 0: "),
    ],
)
def test_other_models_are_refused(coefficients: list[float], message: str):
    for kind, text in (("ros", ROS), ("opencv", OPENCV)):
        changed = text.replace("cols: 5", f"cols: {len(coefficients)}").replace(DISTORTION, str(coefficients))
        assert message in refusal(kind, changed)


@pytest.mark.parametrize("kind", ["ros", "opencv"])
@pytest.mark.parametrize("key", ["image_height", "camera_matrix", "distortion_coefficients"])
def test_missing_keys_are_named(kind: str, key: str):
    text = (ROS if kind == "ros" else OPENCV).replace(key, "something_else")
    message = refusal(kind, text)
    if kind == "opencv" and key == "image_height":
        assert "image_width and image_height are missing" in message
    else:
        assert f"the key {key!r} is missing" in message


@pytest.mark.parametrize("part", ["rows", "cols", "data"])
def test_missing_parts_of_a_matrix_are_named(part: str):
    assert f"camera_matrix has no {part!r}" in refusal("ros", ROS.replace(f"  {part}:", "  other:", 1))


def test_what_is_ros_alone():
    assert "distortion_model 'equidistant' is not supported" in refusal("ros", ROS.replace("plumb_bob", "equidistant"))
    assert "distortion_model must be a text" in refusal("ros", ROS.replace("plumb_bob", "[plumb_bob]"))
    message = refusal("ros", "height: 720\nwidth: 960\nD: [0.0]\nK: [1.0]\n")
    assert "this is a camera_info message, not a calibration file" in message
    assert "camera_matrix must be 3 x 3, not 1 x 9" in refusal(
        "ros", ROS.replace("rows: 3", "rows: 1", 1).replace("cols: 3", "cols: 9", 1)
    )
    assert "camera_matrix must be a matrix with rows, cols and data, not '1.0'" in refusal(
        "ros", re.sub(r"camera_matrix:\n.*\n.*\n.*\n", "camera_matrix: 1.0\n", ROS)
    )


def test_what_is_opencv_alone():
    assert "fisheye_model is set" in refusal("opencv", f"{OPENCV}fisheye_model: 1\n")
    assert "holds 'image_width' and 'imageWidth': which is meant?" in refusal("opencv", f"{OPENCV}imageWidth: 960\n")
    matrix = OPENCV.replace("rows: 1", "rows: 2").replace("cols: 5", "cols: 2").replace(DISTORTION, "[1, 2, 3, 4]")
    assert "distortion_coefficients must be one row or one column, not 2 x 2" in refusal("opencv", matrix)
    size = re.sub(r"image_width.*\nimage_height.*\n", "imageSize: [ 960.5, 720 ]\n", OPENCV)
    assert "imageSize must be two whole numbers, width and height" in refusal("opencv", size)
    size = re.sub(r"image_width.*\nimage_height.*\n", "", OPENCV)
    assert "image_width and image_height are missing: give --image-size" in refusal("opencv", size)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": holds no keys at all"),
        ("just words", ": holds no keys at all"),
        ("- 1\n- 2\n", ": holds no keys at all"),
        ("a: 1\n---\nb: 2\n", ", line 2: not valid YAML: "),
        ("%YAML 2.0\n---\na: 1\n", ": image_width and image_height are missing"),
        ("[" * 20_000, ": not valid YAML: "),
        ("a: \x00", ": not valid YAML: "),
        ("? [a]\n: 1\n", ", line 1: not valid YAML: "),
        ("&a [*a]\n", ", line 1: not valid YAML: "),
        ("a: &a {a: *a}\n", ", line 1: not valid YAML: "),
        ("<opencv_storage><image_width>", ", line 1: not valid XML: "),
        ("<svg></svg>", ": OpenCV's XML begins with <opencv_storage>, not <svg>"),
        ("<opencv_storage><_>1</_></opencv_storage>", ": holds no keys at all"),
        ("<opencv_storage><k>1</k><k>2</k></opencv_storage>", ": the key 'k' stands there twice"),
        ("<opencv_storage></opencv_storage>", ": image_width and image_height are missing"),
    ],
)
def test_what_is_no_such_file_at_all(text: str, message: str):
    assert refusal("opencv", text).startswith(f"camera.yaml{message}")


def test_entities_do_not_grow():
    lines = [f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 20)]
    bomb = f'<!DOCTYPE x [<!ENTITY a0 "lol">{"".join(lines)}]><opencv_storage><a>&a19;</a></opencv_storage>'
    assert "not valid XML" in refusal("opencv", bomb)
    aliases = "a0: &a0 [0]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 30))
    assert "missing" in refusal("opencv", aliases)


def test_files_that_cannot_be_read(tmp_path: Path):
    missing = tmp_path / "none.yaml"
    with pytest.raises(InputError, match=re.escape(f"{missing}: there is no such file")):
        import_camera(missing, "ros")
    with pytest.raises(InputError, match="this is a folder"):
        import_camera(tmp_path, "opencv")
    binary = tmp_path / "image.png"
    binary.write_bytes(b"\x89PNG\r\n")
    with pytest.raises(InputError, match=re.escape("not a text file in UTF-8 (byte 0)")):
        import_camera(binary, "ros")


def test_what_cannot_be_asked_for(tmp_path: Path):
    file = tmp_path / "camera.yaml"
    file.write_text(ROS, encoding="utf-8")
    with pytest.raises(InputError, match="leave --image-size out"):
        import_camera(file, "ros", image_size=(960, 720))
    for unknown in ("kalibr", "mrcal", ""):
        with pytest.raises(InputError, match="must be ros or opencv"):
            import_camera(file, unknown)  # type: ignore[arg-type]  # what a caller without a type checker does
    with pytest.raises(InputError, match="'ini' is not known: it must be one of ros, opencv, kalibr, mrcal"):
        export_camera(EXAMPLE, "ini")  # type: ignore[arg-type]  # as above
    with pytest.raises(InputError, match=re.escape("camera.pixel_pitch_mm must be positive (mm), not -1.0")):
        import_camera(file, "ros", pixel_pitch_mm=-1.0)
    for name in ("", "1", "a b", 'a"', "ä", "a\nb: c"):
        with pytest.raises(InputError, match="a camera's name begins with a letter"):
            export_camera(EXAMPLE, "ros", name=name)


def test_kalibr_refuses_a_negative_principal_point():
    camera = Camera((960, 720), 2000.0, 2000.0, -0.5, 300.0, (0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=re.escape("negative, as (-0.5, 300) px is")):
        export_camera(Rig(camera), "kalibr")


XML = """\
<?xml version="1.0"?>
<opencv_storage>
<image_width>960</image_width>
<image_height>720</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>2181.8 0. 481.2 0. 2181.8 357.6 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>1</rows><cols>5</cols><dt>d</dt>
  <data>-0.163 0.104 0.0003 0.0004 0.</data></distortion_coefficients>
</opencv_storage>
"""
JSON = json.dumps(
    {
        "image_width": 960,
        "image_height": 720,
        "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": [2181.8, 0.0, 481.2]},
        "distortion_coefficients": {"type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d", "data": [0.0] * 5},
    },
    indent=4,
)
JUNK = [*"0-:{}[]\"'<>!%#,. \n\t\x00&*|?\\/eE", "!!", "&a ", "*a", "<<: ", "---\n", "\ufeff", "99999999999", "ä"]
DAMAGE = st.tuples(st.integers(0, 2000), st.integers(0, 12), st.sampled_from(JUNK))


@settings(max_examples=300, derandomize=True, deadline=None)
@given(st.sampled_from([ROS, OPENCV, XML, JSON]), st.lists(DAMAGE, max_size=4))
def test_damaged_files_are_read_or_refused_in_one_line(text: str, damage: list[tuple[int, int, str]]):
    for place, removed, put in damage:
        text = text[:place] + put + text[place + removed :]
    for read in (from_ros, from_opencv):
        message = None
        try:
            found = read(text, "camera.yaml")
        except InputError as error:
            message = str(error)
        else:
            assert found.camera.fx > 0
        assert message is None or (message.startswith("camera.yaml") and "\n" not in message)
