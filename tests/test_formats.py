"""The camera in others' formats: what is written, their own readers read; what they write is read; no bit is lost."""

import ast
import math
import re
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from example_rig import RIG_FILE
from planeopt.errors import InputError
from planeopt.formats import ExportFormat, export_camera, import_camera
from planeopt.formats.kalibr import without_k3
from planeopt.formats.opencv import from_opencv
from planeopt.formats.ros import from_ros
from planeopt.rig import Camera, Rig, RigCovariance, load_rig

FORMATS: tuple[ExportFormat, ...] = ("ros", "opencv", "kalibr", "mrcal")
EXAMPLE = load_rig(RIG_FILE)
# Seventeen digits needed, an exponent without a point in Python's own notation, the smallest number, and -0.
AWKWARD = Camera((4096, 3000), 2181.8123456789012, 0.1 + 0.2, 1e-05, 1e16, (-1e-07, 5e-324, -0.0, 1e300, 2.5e-10))

positive = st.floats(5e-324, 1e300)
finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def cameras(
    draw: st.DrawFn, k3: st.SearchStrategy[float] = finite, centre: st.SearchStrategy[float] = finite
) -> Camera:
    size = draw(st.tuples(st.integers(1, 100_000), st.integers(1, 100_000)))
    bent = draw(st.tuples(finite, finite, finite, finite, k3))
    return Camera(size, draw(positive), draw(positive), draw(centre), draw(centre), bent)


def bits(camera: Camera) -> bytes:
    """Every bit of a camera's numbers: 0 and -0 differ."""
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    return struct.pack("<2I9d", *camera.image_size, *numbers)


def as_opencv_sees(text: str) -> Camera:
    """Read by OpenCV itself; a text that planeopt wrote does not end the process."""
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    matrix, distortion = (storage.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients"))
    assert matrix.dtype == distortion.dtype == np.float64
    assert matrix.shape == (3, 3)
    assert distortion.shape == (1, 5)
    assert matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]].tolist() == [0, 0, 0, 0, 1]
    size = int(storage.getNode("image_width").real()), int(storage.getNode("image_height").real())
    k1, k2, p1, p2, k3 = distortion.ravel().tolist()
    return Camera(size, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], (k1, k2, p1, p2, k3))


def as_mrcal_sees(text: str) -> Camera:
    """Read as mrcal does: its Python by `literal_eval`; its C with this notion of a number, the model's name first."""
    model = ast.literal_eval(text)
    assert set(model) == {"lensmodel", "intrinsics", "extrinsics", "imagersize"}
    assert next(iter(model)) == "lensmodel"
    assert model["lensmodel"] == "LENSMODEL_OPENCV5"
    assert model["extrinsics"] == [0, 0, 0, 0, 0, 0]
    for line in text.splitlines():
        for word in re.findall(r"[\[ ]([^\[\] ,]+)(?=[,\]])", line) if not line.lstrip().startswith("#") else ():
            assert re.fullmatch(r"-?[0-9]*(\.[0-9]*)?([eE][+-]?[0-9]+)?", word) or "LENSMODEL" in word
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = model["intrinsics"]
    width, height = model["imagersize"]
    return Camera((width, height), fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def as_kalibr_sees(text: str) -> Camera:
    """Read with the checks of kalibr's ConfigReader."""
    chain = yaml.safe_load(text)
    assert list(chain) == ["cam0"]
    camera = chain["cam0"]
    assert camera["camera_model"] == "pinhole"
    assert camera["distortion_model"] == "radtan"
    assert isinstance(camera["rostopic"], str)
    assert len(camera["intrinsics"]) == len(camera["distortion_coeffs"]) == 4
    assert all(isinstance(value, float) for value in camera["intrinsics"] + camera["distortion_coeffs"])
    assert min(camera["intrinsics"]) >= 0
    assert all(isinstance(value, int) for value in camera["resolution"])
    fx, fy, cx, cy = camera["intrinsics"]
    k1, k2, p1, p2 = camera["distortion_coeffs"]
    return Camera(tuple(camera["resolution"]), fx, fy, cx, cy, (k1, k2, p1, p2, 0.0))


def as_ros_sees(text: str) -> Camera:
    """Read as ROS does: fixed keys, matrices taken on trust; numbers by PyYAML, which is stricter than yaml-cpp."""
    info = yaml.safe_load(text)
    shapes = {"camera_matrix": (3, 3), "rectification_matrix": (3, 3), "projection_matrix": (3, 4)}
    matrices: dict[str, Any] = {}
    for key, (rows, columns) in (shapes | {"distortion_coefficients": (1, 5)}).items():
        table = info[key]
        assert (table["rows"], table["cols"], len(table["data"])) == (rows, columns, rows * columns)
        assert all(isinstance(value, float) for value in table["data"])
        matrices[key] = np.reshape(table["data"], (rows, columns))
    assert info["distortion_model"] == "plumb_bob"
    assert isinstance(info["camera_name"], str)
    assert np.array_equal(matrices["rectification_matrix"], np.eye(3))
    K = matrices["camera_matrix"]
    assert np.array_equal(matrices["projection_matrix"], np.column_stack([K, np.zeros(3)]))
    k1, k2, p1, p2, k3 = info["distortion_coefficients"]["data"]
    return Camera((info["image_width"], info["image_height"]), K[0, 0], K[1, 1], K[0, 2], K[1, 2], (k1, k2, p1, p2, k3))


READERS = {"ros": as_ros_sees, "opencv": as_opencv_sees, "kalibr": as_kalibr_sees, "mrcal": as_mrcal_sees}


@pytest.mark.parametrize("to", FORMATS)
def test_their_readers_find_every_bit_of_the_example(to: ExportFormat):
    assert bits(READERS[to](export_camera(EXAMPLE, to).text)) == bits(EXAMPLE.camera)


@pytest.mark.parametrize("to", ["ros", "opencv", "mrcal"])
def test_awkward_numbers_keep_every_bit(to: ExportFormat):
    assert bits(READERS[to](export_camera(Rig(AWKWARD), to).text)) == bits(AWKWARD)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(cameras())
def test_their_readers_find_every_bit(camera: Camera):
    for to in ("ros", "opencv", "mrcal"):
        assert bits(READERS[to](export_camera(Rig(camera), to).text)) == bits(camera)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(cameras(k3=st.just(0.0), centre=st.floats(0, 1e300)))
def test_kalibr_finds_every_bit(camera: Camera):
    assert bits(as_kalibr_sees(export_camera(Rig(camera), "kalibr").text)) == bits(camera)


@settings(max_examples=100, derandomize=True, deadline=None)
@given(cameras(), st.none() | st.floats(1e-4, 1))
def test_round_trips_keep_every_bit(camera: Camera, pitch: float | None):
    rig = Rig(replace(camera, pixel_pitch_mm=pitch))
    as_ros, as_opencv = export_camera(rig, "ros").text, export_camera(rig, "opencv").text
    for found in (from_ros(as_ros, "camera.yaml", pitch), from_opencv(as_opencv, "camera.yaml", pitch)):
        assert bits(found.camera) == bits(camera)
        assert found.camera == rig.camera
        off_the_image = not (0 <= camera.cx < camera.image_size[0] and 0 <= camera.cy < camera.image_size[1])
        assert len(found.notes) == off_the_image


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@settings(max_examples=25, derandomize=True, deadline=None)
@given(camera=cameras(), comment=st.sampled_from(["it's", 'a "quoted" one', "5: no", "a\\", "[", "{a:1}", "%", "<x>&"]))
def test_what_opencv_writes_is_read_to_the_last_bit(suffix: str, camera: Camera, comment: str):
    written = opencv_file(camera, comment, suffix)
    found = from_opencv(written, f"camera.{suffix}").camera
    # OpenCV writes whole numbers as such, and with that -0 as 0.
    assert found == camera
    assert from_opencv(written, f"camera.{suffix}", 0.0055).camera.pixel_pitch_mm == 0.0055


def opencv_file(camera: Camera, comment: str, suffix: str) -> str:
    """Write with the installed OpenCV, among things that are in the way."""
    storage = cv2.FileStorage(f"camera.{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("calibration_time", comment)
    storage.write("image_width", camera.image_size[0])
    storage.write("image_height", camera.image_size[1])
    storage.startWriteStruct("board", cv2.FILE_NODE_MAP | cv2.FILE_NODE_FLOW)
    storage.write("columns", 11)
    storage.write("name", "charuco")
    storage.endWriteStruct()
    storage.write("camera_matrix", camera.matrix)
    storage.writeComment("as found")
    storage.write("distortion_coefficients", np.array([camera.distortion]).T)
    storage.write("per_view_reprojection_errors", np.full((14, 1), 0.25, np.float32))
    storage.startWriteStruct("names", cv2.FILE_NODE_SEQ)
    storage.write("", "view 1.png")
    storage.write("", comment)
    storage.endWriteStruct()
    storage.write("avg_reprojection_error", 1 / 3)
    return storage.releaseAndGetString()


MATRICES = """\
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 2181.8123456789012, 0., 481.19999999999999, 0.,
       2181.8000000000002, 357.60000000000002, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.16300000000000001, 1.0000000000000001e-05,
       2.9999999999999997e-04, 0., 0. ]
"""
SIZE = "image_width: 960\nimage_height: 720\n"


@pytest.mark.parametrize(
    "text",
    [
        f"%YAML:1.0\n---\n{SIZE}{MATRICES}",  # as OpenCV 4 writes it
        f"%YAML 1.2\n---\n{SIZE}{MATRICES}",  # as OpenCV 5 does
        f"\ufeff%YAML:1.0\r\n{SIZE}{MATRICES}".replace("\n", "\r\n"),
        f'%YAML:1.0\n---\nnote: "it\\\'s"\nflow: {{ a:960, b:x y }}\n{MATRICES}cameraResolution: [ 960, 720 ]\n',
        f"{MATRICES}{SIZE}".replace("camera_matrix", "Camera_Matrix").replace("image_w", "image_W"),
        f"{MATRICES}{SIZE}".replace("camera_matrix", "cameraMatrix").replace("distortion_coefficients", "dist_coeffs"),
        f"{SIZE}{MATRICES}".replace("cols: 5", "cols: 1").replace("rows: 1", "rows: 5"),
        f"{SIZE}{MATRICES}".replace("cols: 5", "cols: 8").replace("0., 0. ]", "0., 0., 0, 0., -0. ]"),
        f"{SIZE}fisheye_model: 0\n{MATRICES}",
    ],
    ids=["4", "5", "windows", "invalid_yaml", "2.4", "other_names", "column", "eight", "not_fisheye"],
)
def test_opencv_files_as_they_occur(text: str):
    found = from_opencv(text, "camera.yml")
    expected = Camera((960, 720), 2181.8123456789012, 2181.8, 481.2, 357.6, (-0.163, 1e-5, 3e-4, 0.0, 0.0))
    assert bits(found.camera) == bits(expected)
    assert found.notes == ()


def test_four_coefficients_may_be_another_models():
    found = from_opencv(f"{SIZE}{MATRICES}".replace("cols: 5", "cols: 4").replace("0., 0. ]", "0. ]"), "camera.yml")
    assert found.camera.distortion == (-0.163, 1e-5, 3e-4, 0.0, 0.0)
    assert len(found.notes) == 1
    assert "cv2.fisheye" in found.notes[0]


def test_the_image_size_can_be_given_and_must_agree():
    assert from_opencv(MATRICES, "camera.yml", image_size=(960, 720)).camera.image_size == (960, 720)
    assert from_opencv(SIZE + MATRICES, "camera.yml", image_size=(960, 720)).camera.image_size == (960, 720)
    with pytest.raises(InputError, match=re.escape("camera.yml: the image size is [960, 720] there, but [640, 480]")):
        from_opencv(SIZE + MATRICES, "camera.yml", image_size=(640, 480))


# Of ROS's camera_calibration, as its issue 533 shows it: no commas between the coefficients.
OST = """\
image_width: 1920
image_height: 1200
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [1043.889715, 0.000000, 946.091722, 0.000000, 1045.536555, 601.201155, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.034062 0.026819 0.000826 -0.002720 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.000000, 0.000000, 0.000000, 0.000000, 1.000000, 0.000000, 0.000000, 0.000000, 1.000000]
projection_matrix:
  rows: 3
  cols: 4
  data: [1041.022827, 0.000000, 938.549637, 0.000000, 0.000000, 1045.705078, 602.181309, 0.000000, 0.000000, 0.000000, \
1.000000, 0.000000]
"""


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("", "", None),
        ("-0.034062 0.026819 0.000826 -0.002720", "-0.034062, 0.026819, 0.000826, -2.720e-03,", None),
        ("distortion_model", "camera_model", None),
        ("distortion_model: plumb_bob\n", "", "distortion_model is missing"),
        ("plumb_bob", "rational_polynomial", None),
        ("  cols: 5\n", "  cols: 4\n", "4 distortion coefficients"),
        ("image_width", "%YAML:1.0\nimage_width", None),
        ("narrow_stereo", "no", None),
        ("rows: 3", "rows: 3.", None),
    ],
)
def test_ros_files_as_they_occur(old: str, new: str, note: str | None):
    text = OST.replace(old, new, 1) if old else OST
    if "cols: 4\n" in new:
        text = text.replace(" 0.000000]\nrectification", "]\nrectification")
    found = from_ros(text, "ost.yaml")
    bent = (-0.034062, 0.026819, 0.000826, -0.002720, 0.0)
    assert found.camera == Camera((1920, 1200), 1043.889715, 1045.536555, 946.091722, 601.201155, bent)
    about_rectification = "rectification_matrix and projection_matrix describe the rectified image and were left out"
    assert found.notes[-1] == about_rectification
    assert [sentence.partition(":")[0] for sentence in found.notes[:-1]] == ([] if note is None else [note])


def test_a_principal_point_off_the_image_is_remarked_on():
    found = from_ros(OST.replace("image_width: 1920", "image_width: 640"), "ost.yaml")
    assert "was the camera calibrated at another resolution?" in found.notes[-1]


def test_what_is_left_out_is_said_in_the_file(tmp_path: Path):
    covariance = RigCovariance(("f",), np.array([[0.25]]))
    rig = replace(EXAMPLE, covariance=covariance, refused="all views\nare frontal")
    alone = Rig(replace(EXAMPLE.camera, pixel_pitch_mm=None))
    for to in FORMATS:
        refusal, missing = export_camera(rig, to).notes
        assert refusal == "the calibration of this rig was refused: all views are frontal"
        assert ": the laser beam, the covariance, the pixel pitch; " in missing
        said = [line.removeprefix("# ") for line in export_camera(rig, to).text.splitlines() if line.startswith("#")]
        assert said[-2:] == [refusal, missing]
        assert export_camera(alone, to).notes == ()
        assert "laser" not in export_camera(alone, to).text
    file = tmp_path / "camera.yaml"
    file.write_text(export_camera(rig, "ros").text, encoding="utf-8")
    assert import_camera(file, "ros", pixel_pitch_mm=0.0055).camera == rig.camera
    file.write_text(export_camera(rig, "opencv").text, encoding="utf-8")
    assert import_camera(file, "opencv", pixel_pitch_mm=0.0055).camera == rig.camera


@pytest.mark.parametrize("name", ["no", "e1", "left/camera-1"])
def test_a_name_stays_a_text(name: str):
    assert yaml.safe_load(export_camera(EXAMPLE, "ros", name=name).text)["camera_name"] == name
    assert yaml.safe_load(export_camera(EXAMPLE, "kalibr", name=name).text)["cam0"]["rostopic"] == f"/{name}/image_raw"


def test_kalibr_refuses_k3_and_says_what_would_be_lost():
    camera = replace(EXAMPLE.camera, distortion=(-0.1, 0.05, 0.0, 0.0, 0.02))
    there, _ = camera.normalise([[0, 0], [959, 0], [0, 719], [959, 719]])
    # k3 stands with the sixth power of the radius: the farthest corner of the image loses most.
    lost = 0.02 * float(np.max(np.hypot(*there.T))) ** 7 * camera.fx
    with pytest.raises(InputError) as caught:
        export_camera(Rig(camera), "kalibr")
    words = r"k3 = 0\.02, which moves pixels by up to (\S+) px; --approximate .* right to (\S+) px"
    found = re.search(words, str(caught.value))
    assert found is not None
    # Written with three digits.
    assert math.isclose(float(found[1]), lost, rel_tol=6e-3)
    assert float(found[2]) < lost / 5
    [note] = export_camera(Rig(replace(camera, pixel_pitch_mm=None)), "kalibr", approximate=True).notes
    assert note.endswith(f"fitted anew in place of k3 too: pixels move by up to {found[2]} px")


@settings(max_examples=40, derandomize=True, deadline=None)
@given(st.tuples(*[st.floats(-0.08, 0.08)] * 2, *[st.floats(-2e-3, 2e-3)] * 2), st.floats(-0.08, 0.08))
def test_the_nearest_camera_without_k3(four: tuple[float, float, float, float], k3: float):
    camera = Camera((1280, 960), 1100.0, 1090.0, 650.0, 470.0, (*four, k3))
    near = without_k3(camera)
    assert near.distortion[4] == 0
    assert (near.fx, near.fy, near.cx, near.cy) == (camera.fx, camera.fy, camera.cx, camera.cy)
    # At the least: no change of one coefficient brings the images nearer.
    u, v = np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 959, 33))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays, _ = camera.normalise(pixels)
    least = float(np.sum((near.project(rays) - pixels) ** 2))
    for place in range(4):
        for step in (-1e-4, 1e-4):
            bent = [k + step * (i == place) for i, k in enumerate(near.distortion)]
            k1, k2, p1, p2, _ = bent
            other = replace(near, distortion=(k1, k2, p1, p2, 0.0))
            assert float(np.sum((other.project(rays) - pixels) ** 2)) > least
    # What needs no change has none, to rounding.
    plain = replace(camera, distortion=(*four, 0.0))
    np.testing.assert_allclose(without_k3(plain).distortion, plain.distortion, rtol=0, atol=1e-10)


def test_approximating_changes_what_needs_it_alone():
    assert export_camera(EXAMPLE, "kalibr", approximate=True) == export_camera(EXAMPLE, "kalibr")
    bent = Rig(replace(EXAMPLE.camera, distortion=(-0.1, 0.05, 0.0, 0.0, 0.02)))
    for to in ("ros", "opencv", "mrcal"):
        assert export_camera(bent, to, approximate=True) == export_camera(bent, to)


def test_kalibr_refuses_where_the_loss_has_no_number():
    folding = Rig(replace(EXAMPLE.camera, distortion=(-40.0, 0.0, 0.0, 0.0, 1e-3)))
    for approximate in (False, True):
        with pytest.raises(InputError, match="distortion cannot be inverted"):
            export_camera(folding, "kalibr", approximate=approximate)
