"""`planeopt check`: the verdict, its record, its exit status, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from example_rig import RIG_FILE, example_rig, points_file, pose_at
from planeopt.cli import main
from planeopt.rig import save_rig
from planeopt.spot import Spot, write_points

POSES = [(180, 0.3, 0.8), (240, 0.6, -2.0), (300, 0.9, 2.5), (220, 0.5, -0.4)]
KEYS = [
    *("rig", "status", "message", "untested", "chi2", "dof", "p_value", "tests", "shift", "trend", "worst", "images"),
]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("points")
    made = []
    for number, pose in enumerate(POSES, start=1):
        made.append(str(points_file(folder, f"view_{number:03d}.csv", pose_at(*pose), seed=number)))
    return made


def check(*arguments: str, rig: Path = RIG_FILE) -> int:
    return main(["check", *arguments, "--rig", str(rig)])


def moved_rig(folder: Path) -> Path:
    """A rig file whose beam is 0.3 mm from where the images have it."""
    rig = example_rig()
    file = folder / "moved.toml"
    save_rig(rig.with_parameters({"e_x": rig.parameter("e_x") + 0.3}), file)
    return file


def test_a_rig_as_calibrated_is_ok(inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "check.json"
    assert check(*inputs, "-o", str(file)) == 0
    printed, complained = capsys.readouterr()
    assert complained == ""
    assert "OK: " in printed
    assert "calibrate with a board" in printed
    record = json.loads(file.read_text(encoding="ascii"))
    assert list(record) == KEYS
    assert record["status"] == "ok"
    assert record["message"] in " ".join(printed.split("\n"))
    assert (record["dof"], record["rig"]) == (8, str(RIG_FILE))
    assert [test["part"] for test in record["tests"]] == ["pooled", "shift", "trend"]
    assert [image["position"] for image in record["images"]] == [1, 2, 3, 4]
    assert all(image["used"] and image["dof"] == 2 for image in record["images"])
    for image in record["images"]:
        assert Path(image["input"]).name in printed


def test_a_rig_that_moved_is_degraded_with_the_reason(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check(*inputs, "-o", str(tmp_path / "check.json"), rig=moved_rig(tmp_path)) == 2
    printed = capsys.readouterr().out
    record = json.loads((tmp_path / "check.json").read_text(encoding="ascii"))
    assert record["status"] == "degraded"
    assert record["message"].startswith("DEGRADED: ")
    assert "DEGRADED: " in printed
    assert "not explained by chance" in printed
    assert len(record["shift"]) == 4
    assert not next(test for test in record["tests"] if test["part"] == "shift")["ok"]
    assert "The beam is not where the rig file has it" in record["message"]


def test_an_unreadable_input_is_an_error_and_the_others_are_tested_all_the_same(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = str(tmp_path / "view_005.csv")
    assert check(*inputs, missing, "-o", str(tmp_path / "check.json")) == 1
    printed, complained = capsys.readouterr()
    assert complained.count("\n") == 1
    assert "view_005.csv" in complained
    assert "Not in this: 1 image" in printed
    record = json.loads((tmp_path / "check.json").read_text(encoding="ascii"))
    assert record["status"] == "ok"
    assert [image["used"] for image in record["images"]] == [True] * 4 + [False]
    assert check(*inputs, missing, rig=moved_rig(tmp_path)) == 1


def test_nothing_to_test_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points that lie outside the image have no plane."""
    outside = tmp_path / "outside.csv"
    turn = 2 * np.pi * np.arange(12) / 12
    points = np.stack([5000 + 60 * np.cos(turn), 400 + 50 * np.sin(turn)], axis=1)
    write_points(Spot(points, np.full(12, 0.1)), outside)
    assert check(str(outside), "-o", str(tmp_path / "check.json")) == 2
    record = json.loads((tmp_path / "check.json").read_text(encoding="ascii"))
    assert (record["status"], record["chi2"], record["tests"]) == ("refused", None, [])
    assert record["message"].startswith("UNTESTED: ")
    assert "UNTESTED: " in capsys.readouterr().out


def test_times_place_the_images(inputs: list[str], tmp_path: Path) -> None:
    times = tmp_path / "times.csv"
    rows = [f"{Path(name).name},{1000 + 60 * number}\n" for number, name in enumerate(reversed(inputs))]
    times.write_text("".join(["image,time_s\n", *rows]), encoding="utf-8")
    assert check(*inputs, "--times", str(times), "-o", str(tmp_path / "check.json")) == 0
    record = json.loads((tmp_path / "check.json").read_text(encoding="ascii"))
    assert [image["position"] for image in record["images"]] == [180, 120, 60, 0]


def test_an_existing_file_is_left_alone(inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "check.json"
    file.write_text("mine", encoding="utf-8")
    assert check(inputs[0], "-o", str(file)) == 1
    assert "--force overwrites it" in capsys.readouterr().err
    assert file.read_text(encoding="utf-8") == "mine"
    assert check(inputs[0], "-o", str(file), "--force") == 0
    assert check(inputs[0], "-o", inputs[0], "--force") == 1
    assert "is read in this run" in capsys.readouterr().err
    assert check(inputs[0], "-o", str(tmp_path), "--force") == 1
    assert "is a folder" in capsys.readouterr().err


def test_a_camera_alone_cannot_be_checked(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "camera.toml"
    save_rig(replace(example_rig(), beam=None), file)
    assert check(inputs[0], rig=file) == 1
    assert "camera alone" in capsys.readouterr().err
