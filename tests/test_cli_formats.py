"""`planeopt export` and `planeopt import`: what they write, what they say, what they refuse."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from example_rig import RIG_FILE
from planeopt.cli import main
from planeopt.formats import ExportFormat, export_camera
from planeopt.rig import Rig, load_rig, save_rig

EXAMPLE = load_rig(RIG_FILE)
LEFT_OUT = (
    f"planeopt: {RIG_FILE}: left out, because this format holds the camera alone: the laser beam, the pixel pitch; "
    "keep the rig file\n"
)


@pytest.mark.parametrize("to", ["ros", "opencv", "kalibr", "mrcal"])
def test_export_to_standard_output_or_a_file(to: ExportFormat, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    text = export_camera(EXAMPLE, to).text
    assert main(["export", "--rig", str(RIG_FILE), "--to", to]) == 0
    assert capfd.readouterr() == (text, LEFT_OUT)
    file = tmp_path / "camera.yaml"
    assert main(["export", "--rig", str(RIG_FILE), "--to", to, "-o", str(file)]) == 0
    assert capfd.readouterr() == ("", LEFT_OUT)
    assert file.read_bytes() == text.encode()
    assert [path.name for path in tmp_path.iterdir()] == ["camera.yaml"]


@pytest.mark.parametrize("kind", ["ros", "opencv"])
def test_there_and_back_is_the_same_camera(kind: ExportFormat, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    file, rig = tmp_path / "camera.yaml", tmp_path / "rig.toml"
    assert main(["export", "--rig", str(RIG_FILE), "--to", kind, "-o", str(file)]) == 0
    capfd.readouterr()
    arguments = ["import", str(file), "--from", kind, "--pixel-pitch-mm", "0.0055"]
    assert main([*arguments, "-o", str(rig)]) == 0
    alone = f"planeopt: {file}: a camera alone: no beam, so it measures no plane, and no covariance\n"
    assert capfd.readouterr() == ("", alone)
    found = load_rig(rig)
    assert found.camera == EXAMPLE.camera
    assert found.beam is found.covariance is None
    assert main(arguments) == 0
    assert capfd.readouterr() == (rig.read_text(encoding="utf-8"), alone)
    # And such a rig measures no plane: the command that would says so.
    assert main(["pose", "nothing.png", "--rig", str(rig)]) == 1
    assert "this rig is a camera alone" in capfd.readouterr().err


def test_a_camera_alone_leaves_nothing_out(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    rig = tmp_path / "rig.toml"
    save_rig(Rig(replace(EXAMPLE.camera, pixel_pitch_mm=None)), rig)
    assert main(["export", "--rig", str(rig), "--to", "ros", "--name", "left"]) == 0
    captured = capfd.readouterr()
    assert captured.err == ""
    assert 'camera_name: "left"' in captured.out


def test_notes_of_an_import_are_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    file = tmp_path / "camera.json"
    matrix = {
        "type_id": "opencv-matrix",
        "rows": 3,
        "cols": 3,
        "dt": "d",
        "data": [900.0, 0, 640, 0, 900, 480, 0, 0, 1],
    }
    bent = {"type_id": "opencv-matrix", "rows": 4, "cols": 1, "dt": "d", "data": [-0.1, 1e-05, 0.0, 0.0]}
    file.write_text(json.dumps({"mtx": matrix, "dist": bent}), encoding="utf-8")
    assert main(["import", str(file), "--from", "opencv", "--image-size", "1280", "960"]) == 0
    captured = capfd.readouterr()
    assert "distortion = [-0.1, 1e-05, 0.0, 0.0, 0.0]" in captured.out
    first, second = captured.err.splitlines()
    assert first.startswith(f"planeopt: {file}: 4 distortion coefficients: those that are missing were taken for 0;")
    assert second.endswith("a camera alone: no beam, so it measures no plane, and no covariance")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "--rig", "{rig}", "--to", "colmap"], "colmap"),
        (["export", "--rig", "{rig}"], "--to"),
        (["export", "--rig", "none.toml", "--to", "ros"], "none.toml: there is no such file"),
        (["export", "--rig", "{rig}", "--to", "ros", "-o", "{there}"], "exists already; --force overwrites it"),
        (["export", "--rig", "{k3}", "--to", "ros", "-o", "{k3}", "--force"], "is read in this run"),
        (["export", "--rig", "{rig}", "--to", "ros", "-o", "{folder}"], "is a folder; name the file"),
        (["export", "--rig", "{rig}", "--to", "ros", "-o", "{folder}/a/b.yaml"], "cannot be written"),
        (["export", "--rig", "{rig}", "--to", "opencv", "-o", "{folder}/a.xml"], "what is written is not .xml"),
        (["export", "--rig", "{rig}", "--to", "ros", "--name", "ä"], "a camera's name begins with a letter"),
        (["export", "--rig", "{k3}", "--to", "kalibr"], "k3.toml: kalibr's radtan has k1, k2, p1 and p2 only"),
        (["import", "none.yaml", "--from", "ros"], "none.yaml: there is no such file"),
        (["import", "{there}", "--from", "kalibr"], "kalibr"),
        (["import", "{there}"], "--from"),
        (["import", "{there}", "--from", "ros", "-o", "{there}"], "is read in this run"),
        (["import", "{rig}", "--from", "ros"], "truth_rig.toml"),
        (["import", "{there}", "--from", "ros", "--image-size", "1", "1"], "leave --image-size out"),
        (["import", "{there}", "--from", "opencv", "--image-size", "1"], "--image-size"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    arguments: list[str], message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    there, k3 = tmp_path / "there.yaml", tmp_path / "k3.toml"
    there.write_text(export_camera(EXAMPLE, "ros").text, encoding="utf-8")
    k3.write_text(RIG_FILE.read_text(encoding="utf-8").replace("0.0004, 0.0]", "0.0004, 0.1]"), encoding="utf-8")
    places = {"rig": RIG_FILE, "there": there, "folder": tmp_path, "k3": k3}
    before = there.read_bytes()
    assert main([argument.format_map(places) for argument in arguments]) == 1
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert there.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["k3.toml", "there.yaml"]


def test_approximating_is_asked_for_and_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    k3 = tmp_path / "k3.toml"
    k3.write_text(RIG_FILE.read_text(encoding="utf-8").replace("0.0004, 0.0]", "0.0004, 0.1]"), encoding="utf-8")
    assert main(["export", "--rig", str(k3), "--to", "kalibr", "--approximate"]) == 0
    captured = capfd.readouterr()
    assert captured.out == export_camera(load_rig(k3), "kalibr", approximate=True).text
    assert "k1, k2, p1 and p2 were fitted anew in place of k3 too: pixels move by up to" in captured.err


def test_force_overwrites(tmp_path: Path):
    file = tmp_path / "camera.yaml"
    file.write_text("old", encoding="utf-8")
    assert main(["export", "--rig", str(RIG_FILE), "--to", "opencv", "-o", str(file), "--force"]) == 0
    assert file.read_text(encoding="utf-8").startswith("%YAML:1.0\n---\n")


def test_the_documents_show_what_is_written():
    text = (Path(__file__).parents[1] / "docs" / "formats.md").read_text(encoding="utf-8")
    shown = re.findall(r"^```(?:yaml|text)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    formats: tuple[ExportFormat, ...] = ("ros", "opencv", "kalibr", "mrcal")
    for to, block in zip(formats, shown, strict=True):
        # All but the comment at the head.
        assert re.sub(r"^#.*\n", "", export_camera(EXAMPLE, to).text, flags=re.MULTILINE) == block
