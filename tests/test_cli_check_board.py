"""`planeopt check` with images of a board: the verdict, its record, its exit status, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from example_rig import RIG_FILE, example_rig
from planeopt.cli import main
from planeopt.example import example_folder
from planeopt.rig import save_rig

SESSION = example_folder() / "session"
BOARD = SESSION / "board.toml"
VIEWS = [str(SESSION / f"view{number:02d}.png") for number in (0, 5, 10)]
KEYS = [
    *("rig", "status", "message", "untested", "chi2", "dof", "p_value", "tests", "causes", "instead", "groups"),
    *("parameters", "corner_sigma_px", "images"),
]


def check(*arguments: str, rig: Path = RIG_FILE) -> int:
    return main(["check", *arguments, "--rig", str(rig)])


def test_a_rig_as_it_is_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The true rig, which claims to be exact, against three of the rendered views."""
    file = tmp_path / "check.json"
    assert check(*VIEWS, "--board", str(BOARD), "-o", str(file)) == 0
    printed, complained = capsys.readouterr()
    assert complained == ""
    record = json.loads(file.read_text(encoding="ascii"))
    assert list(record) == KEYS
    assert record["status"] == "ok"
    assert record["message"] in " ".join(printed.split("\n"))
    assert record["untested"] in " ".join(printed.split("\n"))
    assert [test["part"] for test in record["tests"]] == ["pooled", "shift", "rest", "spots"]
    assert [image["spot"] for image in record["images"]] == ["ok"] * 3
    assert all(image["p_value"] > 0 and image["spot_p_value"] > 0 for image in record["images"])
    assert record["corner_sigma_px"] < 0.1


def test_a_camera_that_changed_is_degraded_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, file = example_rig(), tmp_path / "check.json"
    changed = tmp_path / "changed.toml"
    save_rig(rig.with_parameters({"f": rig.parameter("f") * 1.01}), changed)
    assert check(*VIEWS, "--board", str(BOARD), "-o", str(file), rig=changed) == 2
    record = json.loads(file.read_text(encoding="ascii"))
    assert record["status"] == "degraded"
    assert record["causes"][0]["group"] == "the focal length"
    assert record["causes"][0]["changes"][0]["value"] == pytest.approx(-0.01 * rig.parameter("f"), rel=0.1)
    assert "What explains it: the focal length" in capsys.readouterr().out


def test_an_image_without_a_board_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    target = str(next((example_folder() / "targets").glob("*.png")))
    assert check(VIEWS[0], target, "--board", str(BOARD)) == 2
    printed, complained = capsys.readouterr()
    assert Path(target).name in complained
    assert "Not in this: 1 image" in printed


def test_a_camera_alone_can_be_checked(tmp_path: Path) -> None:
    camera = tmp_path / "camera.toml"
    save_rig(replace(example_rig(), beam=None), camera)
    assert check(*VIEWS, "--board", str(BOARD), rig=camera) == 0


def test_options_that_do_not_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    times = tmp_path / "times.csv"
    times.write_text("image,time_s\n", encoding="utf-8")
    assert check(VIEWS[0], "--board", str(BOARD), "--times", str(times)) == 1
    assert "--times goes with images of planes" in capsys.readouterr().err
    assert check(VIEWS[0], "--spot", "ring") == 1
    assert "--board board.toml" in capsys.readouterr().err
    assert check(str(SESSION), "--board", str(BOARD)) == 1
    assert "a session says itself" in capsys.readouterr().err
