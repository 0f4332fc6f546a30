"""Images that hold no spot and files that are damaged: each an answer or a reason, none a wrong pose, no traceback."""

import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from example_rig import TARGETS, example_rig
from mutations import mutated, whole_files
from planeopt.batch import measure
from planeopt.cli import main
from planeopt.record import PoseRecord
from planeopt.rig import Rig, save_rig
from planeopt.spot import read_image

SMALLER = 4
"""The example's camera with pixels so much larger: its images shrink, its planes stay."""

TARGET = TARGETS[5]
TRUTH = json.loads(TARGET.with_suffix(".json").read_text())
SIGMAS = 4.9  # one in a million


def small_rig() -> Rig:
    rig = example_rig()
    camera = rig.camera
    width, height = camera.image_size
    small = replace(
        camera,
        image_size=(width // SMALLER, height // SMALLER),
        fx=camera.fx / SMALLER,
        fy=camera.fy / SMALLER,
        cx=(camera.cx + 0.5) / SMALLER - 0.5,
        cy=(camera.cy + 0.5) / SMALLER - 0.5,
        pixel_pitch_mm=None,
    )
    return replace(rig, camera=small)


def small_target() -> NDArray[np.uint8]:
    image = read_image(TARGET)
    height, width = image.shape
    blocks = image.reshape(height // SMALLER, SMALLER, width // SMALLER, SMALLER)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def is_right(record: PoseRecord) -> bool:
    """Whether a pose is the target's, within its own standard deviations."""
    if record.z_L_mm is None or record.normal is None or record.sigma.z_L_mm is None or record.sigma.normal_deg is None:
        return False
    angle = math.degrees(math.acos(min(1.0, float(np.dot(record.normal, TRUTH["normal"])))))
    depth = abs(record.z_L_mm - TRUTH["z_L_mm"])
    return depth < SIGMAS * record.sigma.z_L_mm and angle < SIGMAS * record.sigma.normal_deg


# A float image whose largest value is damaged to 1e38 overflows here and there on the way to being refused.
@pytest.mark.filterwarnings("ignore:.*(overflow|invalid value|divide by zero):RuntimeWarning")
def test_500_damaged_files_give_the_right_pose_or_none(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    rig, files = small_rig(), whole_files(small_target())
    path = tmp_path / "image"
    outcomes: dict[str, Counter[str]] = {name: Counter() for name in files}
    rng = np.random.default_rng(20)
    for i in range(500):
        name = list(files)[i % len(files)]
        path.write_bytes(mutated(files[name], rng))
        record = measure(path, rig).record
        outcomes[name][record.status] += 1
        assert "broke down" not in record.message, (i, name, record.message)
        assert "\n" not in record.message
        assert record.status != "ok" or is_right(record), (i, name, record)
    assert capfd.readouterr().err == ""
    for name, data in files.items():
        path.write_bytes(data)
        whole = measure(path, rig).record
        assert whole.status == "ok", (name, whole.message)
        assert is_right(whole), (name, whole)
        # Some of the damage was found, and some was such that the pose stood it.
        assert outcomes[name]["error"], name
        assert outcomes[name]["ok"], name


WIDTH, HEIGHT = small_rig().camera.image_size
RNG = np.random.default_rng(4)


def dim() -> NDArray[np.float64]:
    return 20 + np.random.default_rng(1).normal(0, 2, (HEIGHT, WIDTH))


def blurred(image: NDArray[np.float64], sigma: float = 1.0) -> NDArray[np.float64]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=np.float64)


def bytes_of(image: NDArray[Any]) -> NDArray[np.uint8]:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def disc(x: float, y: float, radius: float) -> NDArray[np.uint8]:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    inside = np.clip(radius + 0.5 - np.hypot(columns - x, rows - y), 0, 1)
    return bytes_of(blurred(dim() + 180 * inside))


def blobs() -> NDArray[np.uint8]:
    """Bright clouds without an edge, as of lights out of focus and reflections."""
    noise = blurred(np.random.default_rng(2).normal(size=(HEIGHT, WIDTH)), 5.0)
    return bytes_of(dim() + 180 * np.clip(noise / noise.std() - 0.8, 0, 1))


def chessboard() -> NDArray[np.uint8]:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return bytes_of(blurred(dim() + 180.0 * ((rows // 20 + columns // 20) % 2)))


def lamp() -> NDArray[np.uint8]:
    """A light that over-exposes the camera, with its halo."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return bytes_of(dim() + 2e4 / (1 + ((columns - 70.0) ** 2 + (rows - 40.0) ** 2) / 9) ** 1.5)


def with_alpha() -> NDArray[np.uint8]:
    target = small_target()
    return np.dstack([target, target, target, np.full_like(target, 128)])


def with_nan() -> NDArray[np.float32]:
    image = (small_target() / 255).astype(np.float32)
    image[50, 60:64] = np.nan
    return image


HALF = (0.0, 90.0, 20.0)
"""Centre and radius of a disc of which one half is seen; what is seen of it may be enough, if it is measured right."""

# Image, suffix, what `pose` may say with a rig, and what `spot` may say without one.
NO_POSE = {"refused", "error"}
IMAGES: dict[str, tuple[Callable[[], NDArray[Any]], str, set[str], set[str]]] = {
    "black": (lambda: np.zeros((HEIGHT, WIDTH), np.uint8), ".png", {"refused"}, {"refused"}),
    "white": (lambda: np.full((HEIGHT, WIDTH), 255, np.uint8), ".png", {"refused"}, {"refused"}),
    "white, 16 bit": (lambda: np.full((HEIGHT, WIDTH), 65535, np.uint16), ".tiff", {"refused"}, {"refused"}),
    "flat": (lambda: np.full((HEIGHT, WIDTH), 90, np.uint8), ".bmp", {"refused"}, {"refused"}),
    "dim noise": (lambda: bytes_of(dim()), ".png", {"refused"}, {"refused"}),
    "noise": (lambda: RNG.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8), ".png", {"refused"}, {"refused"}),
    "colour noise": (lambda: RNG.integers(0, 65536, (HEIGHT, WIDTH, 3), np.uint16), ".png", {"refused"}, {"refused"}),
    "noise in floats": (lambda: RNG.random((HEIGHT, WIDTH)).astype(np.float32), ".tiff", {"refused"}, {"refused"}),
    "clutter of blobs": (blobs, ".png", {"refused"}, {"refused"}),
    "chessboard": (chessboard, ".png", {"refused"}, {"refused"}),
    "bright lamp": (lamp, ".png", {"refused"}, {"refused", "degraded"}),
    "cut in half": (lambda: disc(*HALF), ".png", {"refused"}, {"ok", "refused"}),
    "cut by a corner": (lambda: disc(239, 179, 30), ".png", {"refused"}, {"refused"}),
    "3 px spot": (lambda: disc(120, 90, 1.5), ".png", {"refused"}, {"refused"}),
    "1x1": (lambda: np.full((1, 1), 200, np.uint8), ".png", {"error"}, {"refused"}),
    "one row": (lambda: np.full((1, 400), 200, np.uint8), ".pgm", {"error"}, {"refused"}),
    "float with NaN": (with_nan, ".tiff", {"error"}, {"error"}),
    "all NaN": (lambda: np.full((HEIGHT, WIDTH), np.nan, np.float32), ".tiff", {"error"}, {"error"}),
    "infinite": (lambda: np.full((HEIGHT, WIDTH), np.inf, np.float32), ".tiff", {"error"}, {"error"}),
    "negative floats": (lambda: -RNG.random((HEIGHT, WIDTH)).astype(np.float32), ".tiff", {"refused"}, {"refused"}),
    "huge floats": (lambda: np.full((HEIGHT, WIDTH), 3e38, np.float32), ".tiff", {"refused"}, {"refused"}),
    "signed": (lambda: np.full((HEIGHT, WIDTH), -5, np.int16), ".tiff", {"error"}, {"error"}),
    "RGBA": (with_alpha, ".png", {"ok"}, {"ok"}),
    "RGBA in TIFF": (with_alpha, ".tiff", {"ok"}, {"ok"}),
    "float": (lambda: (small_target() / 255).astype(np.float32), ".tiff", {"ok"}, {"ok"}),
    "16 bit": (lambda: small_target().astype(np.uint16) * 257, ".png", {"ok"}, {"ok"}),
    "grey": (small_target, ".pgm", {"ok"}, {"ok"}),
}


@pytest.mark.parametrize("case", IMAGES)
def test_any_image_gives_an_answer_or_a_reason(case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    make, suffix, with_rig, without = IMAGES[case]
    image, rig, out = tmp_path / f"image{suffix}", tmp_path / "rig.toml", tmp_path / "out"
    assert cv2.imwrite(str(image), make())
    save_rig(small_rig(), rig)
    expected = {"ok": 0, "degraded": 2, "refused": 2, "error": 1}

    status = main(["pose", str(image), "--rig", str(rig)])
    printed = capfd.readouterr()
    (record,) = [json.loads(line) for line in printed.out.splitlines()]
    assert record["status"] in with_rig, record
    assert status == expected[record["status"]]
    assert printed.err.count("\n") == (record["status"] != "ok")
    assert "Traceback" not in printed.err
    assert (record["z_L_mm"] is None) == (record["status"] in NO_POSE)
    if record["status"] == "ok":
        assert abs(record["z_L_mm"] - TRUTH["z_L_mm"]) < SIGMAS * record["sigma"]["z_L_mm"]

    status = main(["spot", str(image), "-o", str(out)])
    printed = capfd.readouterr()
    (record,) = [json.loads(line) for line in (out / "spots.jsonl").read_text("ascii").splitlines()]
    assert record["status"] in without, record
    assert status == expected[record["status"]]
    assert printed.err.count("\n") == (record["status"] != "ok")
    assert "Traceback" not in printed.err
    assert (out / "image.csv").exists() == (record["status"] in ("ok", "degraded"))
    assert (out / "image.png").exists() == (record["status"] != "error")
    if case == "cut in half" and record["status"] == "ok":
        measured, sigma = record["ellipse"], record["ellipse"]["sigma"]
        x, y, radius = HALF
        assert np.all(np.abs(np.subtract(measured["centre_px"], (x, y))) < SIGMAS * np.array(sigma["centre_px"]))
        assert np.all(np.abs(np.subtract(measured["semi_axes_px"], radius)) < SIGMAS * np.array(sigma["semi_axes_px"]))
