"""`planeopt recalibrate`: the new rig file, its record, its exit status, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from example_rig import RIG_FILE, example_rig, points_file, pose_at
from planeopt.cli import main
from planeopt.rig import RigCovariance, load_rig, save_rig
from planeopt.rig.model import Rig

POSES = [(180, 0.3, 0.8), (240, 0.6, -2.0), (300, 0.9, 2.5), (220, 0.5, -0.4), (260, 0.3, 1.7), (200, 0.4, -1.0)]
SIGMAS = {"f": 1.0, "cx": 0.3, "cy": 0.3, "e_x": 0.02, "e_y": 0.02, "radius": 0.004, "direction_x": 2e-4}
STATED = [word for text in ("f=1", "cx=0.3", "cy=0.3", "radius=0.004") for word in ("--sigma", text)]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("points")
    return [
        str(points_file(folder, f"view_{number:03d}.csv", pose_at(*pose), seed=number))
        for number, pose in enumerate(POSES, start=1)
    ]


def calibrated(folder: Path, **off: float) -> Path:
    """A rig file with a covariance, whose beam is that far from where the images have it."""
    rig: Rig = example_rig()
    rig = rig.with_parameters({name: rig.parameter(name) + change for name, change in off.items()})
    covariance = RigCovariance(tuple(SIGMAS), np.diag([sigma**2 for sigma in SIGMAS.values()]))
    file = folder / "rig.toml"
    save_rig(Rig(rig.camera, rig.beam, rig.spot, covariance), file)
    return file


def recalibrate(*arguments: str, rig: Path = RIG_FILE) -> int:
    return main(["recalibrate", *arguments, "--rig", str(rig)])


def test_a_moved_beam_is_put_right(inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By 0.3 mm; the example's rig is the truth, which the update has within 4.5 of its standard deviations."""
    rig, new, file = calibrated(tmp_path, e_x=0.3), tmp_path / "new.toml", tmp_path / "record.json"
    assert recalibrate(*inputs, "-o", str(new), "--record", str(file), rig=rig) == 0
    printed = capsys.readouterr().out
    assert "UPDATED: " in printed
    assert "Not updated: the focal length" in printed
    assert "degrees of freedom" in printed
    updated, truth = load_rig(new), example_rig()
    assert updated.covariance is not None
    place = updated.covariance.parameters.index("e_x")
    assert abs(updated.parameter("e_x") - truth.parameter("e_x")) < 4.5 * updated.covariance.sigmas[place]
    record = json.loads(file.read_text(encoding="ascii"))
    assert (record["status"], record["outcome"], record["dof"]) == ("ok", "updated", 12)
    assert [row["name"] for row in record["parameters"]] == [*SIGMAS, "direction_y"]
    assert len(record["seen"]) == 4
    assert record["chi2_after"] < record["chi2_before"]
    assert all(image["used"] for image in record["images"])
    np.testing.assert_array_equal(record["covariance"], updated.covariance.matrix)
    assert main(["check", *inputs, "--rig", str(new)]) == 0


def test_a_refusal_writes_no_rig(inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, file = tmp_path / "new.toml", tmp_path / "record.json"
    rig = calibrated(tmp_path)
    assert recalibrate(*inputs[:3], "-o", str(new), "--record", str(file), rig=rig) == 2
    assert not new.exists()
    record = json.loads(file.read_text(encoding="ascii"))
    assert (record["status"], record["outcome"], record["tests"]) == ("refused", "too_few", [])
    assert "REFUSED: " in capsys.readouterr().out
    far = calibrated(tmp_path, e_x=0.3)
    assert recalibrate(*inputs, "-o", str(new), "--moved-mm", "0", "--turned-mrad", "0", rig=far) == 2
    assert not new.exists()


def test_a_rig_without_a_covariance_asks_for_sigmas(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = tmp_path / "new.toml"
    assert recalibrate(*inputs, "-o", str(new)) == 1
    assert "--sigma f=2" in capsys.readouterr().err
    assert recalibrate(*inputs, "-o", str(new), *STATED) == 0
    assert load_rig(new).covariance is not None
    assert recalibrate(*inputs, "-o", str(new), "--force", "--sigma", "f") == 1
    assert "NAME=VALUE" in capsys.readouterr().err


def test_an_unreadable_input_is_an_error_and_files_are_left_alone(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, rig = tmp_path / "new.toml", calibrated(tmp_path)
    missing = str(tmp_path / "view_007.csv")
    assert recalibrate(*inputs, missing, "-o", str(new), rig=rig) == 1
    assert "view_007.csv" in capsys.readouterr().err
    assert new.exists()
    assert recalibrate(*inputs, "-o", str(new), rig=rig) == 1
    assert "--force overwrites it" in capsys.readouterr().err
    assert recalibrate(*inputs, "-o", str(rig), "--force", rig=rig) == 1
    assert "is read in this run" in capsys.readouterr().err
    assert recalibrate(*inputs, "-o", str(new), "--record", str(new), "--force", rig=rig) == 1
