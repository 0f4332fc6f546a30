"""`planeopt simulate`, end to end, and `planeopt pose` on what it wrote."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from planeopt.accuracy import read_truth
from planeopt.cli import main
from planeopt.example import example_folder
from planeopt.record import record_from_json
from planeopt.rig import load_rig
from planeopt.simulation import frame, load_scene, render

EXAMPLE = example_folder() / "scene.toml"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_images_truth_rig_and_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "deep" / "out"
    assert main(["simulate", str(EXAMPLE), "-o", str(out), "--frames", "2"]) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")
    expected = ["image_0001.json", "image_0001.png", "image_0002.json", "image_0002.png", "rig.toml", "scene.toml"]
    assert names(out) == expected
    scene = load_scene(EXAMPLE)
    assert load_rig(out / "rig.toml") == scene.rig
    for index in range(2):
        single = frame(scene, index)
        image = cv2.imread(str(out / f"image_{index + 1:04d}.png"), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert np.array_equal(image, render(single).image)
        record = record_from_json((out / f"image_{index + 1:04d}.json").read_text())
        assert record.input == f"image_{index + 1:04d}.png"
        truth = read_truth(out / f"image_{index + 1:04d}.json")
        assert truth.pose.z_L == single.pose.z_L
        assert truth.plane.angle_to(single.true_plane) < 1e-12


def test_the_scene_that_is_written_gives_the_same_images_again(tmp_path: Path):
    arguments = ["--frames", "2", "--seed", "11"]
    assert main(["simulate", str(EXAMPLE), "-o", str(tmp_path / "a"), *arguments]) == 0
    assert main(["simulate", str(tmp_path / "a" / "scene.toml"), "-o", str(tmp_path / "b")]) == 0
    assert names(tmp_path / "a") == names(tmp_path / "b")
    for name in names(tmp_path / "a"):
        if name.endswith(".png"):
            assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert load_scene(tmp_path / "b" / "scene.toml").seed == 11
    assert main(["simulate", str(EXAMPLE), "-o", str(tmp_path / "c"), "--frames", "1"]) == 0
    first = [(tmp_path / folder / "image_0001.png").read_bytes() for folder in "ac"]
    assert first[0] != first[1]


def test_images_without_laser_and_of_16_bits(tmp_path: Path):
    text = EXAMPLE.read_text(encoding="utf-8").replace(
        '"truth_rig.toml"', json.dumps(str(EXAMPLE.parent / "truth_rig.toml"))
    )
    scene = tmp_path / "mine.toml"
    scene.write_text(
        text.replace("frames = 3", "frames = 1\nlaser_off = true") + "\n[sensor]\nbits = 12\ncolor = true\n"
    )
    assert main(["simulate", str(scene), "-o", str(tmp_path / "out")]) == 0
    assert names(tmp_path / "out")[0] == "dark_0001.png"
    images = [
        cv2.imread(str(tmp_path / "out" / f"{name}_0001.png"), cv2.IMREAD_UNCHANGED) for name in ("image", "dark")
    ]
    assert [(image.dtype, image.shape) for image in images if image is not None] == [(np.uint16, (720, 960, 3))] * 2
    assert np.max(images[0]) > 2 * np.max(images[1])  # type: ignore[arg-type]  # both are there


def test_the_pose_of_a_simulated_image_is_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert main(["simulate", str(EXAMPLE), "-o", str(out)]) == 0
    images = [str(path) for path in sorted(out.glob("image_*.png"))]
    status = main(["pose", *images, "--rig", str(out / "rig.toml")])
    assert status in (0, 2)
    records = [record_from_json(line) for line in capsys.readouterr().out.splitlines()]
    assert len(records) == 3
    for record, image in zip(records, images, strict=True):
        truth = record_from_json(Path(image).with_suffix(".json").read_text())
        assert record.status in ("ok", "degraded"), record.message
        assert record.z_L_mm is not None
        assert truth.z_L_mm is not None
        assert record.sigma.z_L_mm is not None
        assert record.sigma.normal_deg is not None
        # Beyond 6 standard deviations it would be another plane; and the answer must not be a vague one.
        assert abs(record.z_L_mm - truth.z_L_mm) < 6 * record.sigma.z_L_mm
        cosine = float(np.dot(np.array(record.normal), np.array(truth.normal)))
        assert math.degrees(math.acos(min(1.0, cosine))) < 6 * record.sigma.normal_deg
        assert record.sigma.z_L_mm < 1e-3 * truth.z_L_mm
        assert record.sigma.normal_deg < 2


def test_existing_output_is_refused_without_force_and_sources_always(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    assert main(["simulate", str(EXAMPLE), "-o", str(out), "--frames", "1"]) == 0
    assert main(["simulate", str(EXAMPLE), "-o", str(out), "--frames", "1"]) == 1
    assert "give --force" in capsys.readouterr().err
    assert main(["simulate", str(EXAMPLE), "-o", str(out), "--frames", "1", "--force"]) == 0
    before = (out / "scene.toml").read_bytes()
    assert main(["simulate", str(out / "scene.toml"), "-o", str(out), "--force"]) == 1
    assert "would be written over" in capsys.readouterr().err
    assert (out / "scene.toml").read_bytes() == before
    other = tmp_path / "other.toml"
    other.write_text(EXAMPLE.read_text(encoding="utf-8").replace("truth_rig.toml", "out/rig.toml"))
    assert main(["simulate", str(other), "-o", str(out), "--force"]) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.toml", "-o", "out"], "nothing.toml: there is no such file"),
        ([str(EXAMPLE), "-o", "out", "--seed", "-1"], "--seed must not be negative"),
        ([str(EXAMPLE), "-o", "out", "--frames", "0"], "frames"),
        ([str(EXAMPLE)], "--output"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_nothing(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *arguments]) == 1
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_scene_that_cannot_be_seen_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = EXAMPLE.read_text(encoding="utf-8").replace(
        '"truth_rig.toml"', json.dumps(str(EXAMPLE.parent / "truth_rig.toml"))
    )
    scene = tmp_path / "near.toml"
    scene.write_text(text.split("[sweep]")[0].replace("236.0", "20.0").replace("35.0", "0.0"))
    assert main(["simulate", str(scene), "-o", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "outside of the image" in said
    assert str(scene) in said
    assert names(tmp_path) == ["near.toml"]
