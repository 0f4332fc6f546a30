"""`planeopt design` at the command line: the same numbers as Python's, in tables and files, and what it refuses."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planeopt.cli import main
from planeopt.design import Pixels, Points, plane_at, planned_rig, predict
from planeopt.rig import RigCovariance, load_rig, save_rig
from test_readme import blocks, missing_piece

BUILT = ["--offset-mm", "20", "16", "--radius-mm", "6", "--f-mm", "12", "--pitch-um", "5.5", "--image", "960", "720"]
RIG = planned_rig(offset_mm=(20, 16), radius_mm=6, f_mm=12, pitch_um=5.5, image=(960, 720))


def run(*arguments: str, status: int = 0) -> None:
    assert main(["design", *BUILT, *arguments]) == status


def test_table_and_files_hold_the_prediction(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    run("--distance-mm", "150", "400", "--tilt-deg", "0", "60", "--noise", "3", "-o", str(folder))
    said = capsys.readouterr()
    assert not said.err
    with (folder / "design.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * (1 + 3)
    planes = [[float(row[name]) for row in rows] for name in ("distance_mm", "tilt_deg", "toward_deg")]
    found = predict(RIG, plane_at(RIG, *planes), Pixels(120, 3))
    np.testing.assert_allclose([float(row["sigma_z_L_mm"]) for row in rows], found.z_L_mm)
    np.testing.assert_allclose([float(row["sigma_normal_deg"]) for row in rows], found.normal_deg)
    assert {row["view"] for row in rows} == {"ok"}
    for row in rows:
        # All lengths times k: z_L's sigma times k, whatever the numbers (difference quotients, to 1e-5).
        exact = sum(float(row[f"z_L_by_{lever}"]) for lever in ("offset", "radius", "distance"))
        assert exact == pytest.approx(1, abs=1e-4)
    content = json.loads((folder / "design.json").read_text(encoding="utf-8"))
    assert content["quality"]["noise"] == 3
    assert len(content["planes"]) == len(rows)
    assert (folder / "design.png").read_bytes()[1:4] == b"PNG"
    assert f"{1000 * float(rows[-1]['sigma_z_L_mm']):.3g}" in said.out
    assert "what would help, at 400 mm, tilt 60" in said.out


def test_what_cannot_be_measured_or_reached_ends_in_two(capsys: pytest.CaptureFixture[str]) -> None:
    run("--distance-mm", "80", "--tilt-deg", "0", status=2)
    assert "1 of 1 planes: the spot is not wholly in the image" in capsys.readouterr().out
    run("--distance-mm", "300", "--tilt-deg", "0", "--want-depth-um", "1e-3", status=2)
    assert "larger ones cannot be used" in " ".join(capsys.readouterr().out.split())
    # Half of what it does: offset, radius or focal length by themselves.
    present = 1000 * float(predict(RIG, plane_at(RIG, 300.0, 0.0), Pixels(120, 2)).z_L_mm)
    run("--distance-mm", "300", "--tilt-deg", "0", "--want-depth-um", f"{2 * present}")
    assert "what is wanted is just reached" in capsys.readouterr().out


def test_an_existing_rig_with_its_covariance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = replace(RIG, covariance=RigCovariance(("f", "radius"), np.diag([0.25, 1e-6])))
    save_rig(rig, tmp_path / "rig.toml")
    arguments = ["--distance-mm", "200", "--tilt-deg", "40", "--sigma-px", "0.1", "--points", "300"]
    assert main(["design", "--rig", str(tmp_path / "rig.toml"), *arguments, "--toward-deg", "0"]) == 0
    found = predict(load_rig(tmp_path / "rig.toml"), plane_at(rig, 200.0, 40.0), Points(0.1, 300))
    both = (
        f"{1000 * found.z_L_mm:.3g} {1000 * found.z_L_spot_mm:.3g} {found.normal_deg:.3g} {found.normal_spot_deg:.3g}"
    )
    assert f"200 40 0 {both}" in " ".join(capsys.readouterr().out.split())


def test_stated_sigmas_are_a_calibration(capsys: pytest.CaptureFixture[str]) -> None:
    stated = ["--sigma-f-px", "0.5", "--sigma-centre-px", "0.4", "--sigma-offset-mm", "0.01"]
    stated += ["--sigma-radius-mm", "0.002", "--sigma-direction-deg", "0.01"]
    run("--distance-mm", "200", "--tilt-deg", "40", "--toward-deg", "70", *stated)
    turn = math.radians(0.01)
    sigmas = {"f": 0.5, "cx": 0.4, "cy": 0.4, "e_x": 0.01, "e_y": 0.01, "radius": 0.002}
    sigmas |= {"direction_x": turn, "direction_y": turn}
    rig = planned_rig(offset_mm=(20, 16), radius_mm=6, f_mm=12, pitch_um=5.5, image=(960, 720), sigmas=sigmas)
    found = predict(rig, plane_at(rig, 200.0, 40.0, 70.0), Pixels(120, 2))
    assert found.normal_rig > found.normal_spot
    both = (
        f"{1000 * found.z_L_mm:.3g} {1000 * found.z_L_spot_mm:.3g} {found.normal_deg:.3g} {found.normal_spot_deg:.3g}"
    )
    assert f"200 40 70 {both}" in " ".join(capsys.readouterr().out.split())


def test_the_page_shows_what_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[1] / "docs" / "design.md").read_text(encoding="utf-8")
    console, python = (text for language, text in blocks(page) if language in ("console", "python"))
    prompt, shown = console.split("\n", 1)
    assert main(prompt.removeprefix("$ planeopt ").split()) == 0
    assert missing_piece(shown, capsys.readouterr().out) is None
    names: dict[str, Any] = {}
    exec(compile(python, "design.md", "exec"), names)
    assert list(names["found"].views) == ["ok", "ok"]
    assert 1000 * names["found"].z_L_mm[1] == pytest.approx(10.4, abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([*BUILT], "--distance-mm is needed"),
        ([*BUILT[:-3], "--distance-mm", "200"], "--image is needed where no existing rig is given by --rig"),
        ([*BUILT, "--rig", "rig.toml", "--distance-mm", "200"], "--offset-mm is a number of a planned rig"),
        (["--rig", "nowhere.toml", "--distance-mm", "200"], "nowhere.toml"),
        ([*BUILT, "--distance-mm", "-3"], "distances must be positive numbers of mm, not -3"),
        ([*BUILT, "--distance-mm", "200", "--tilt-deg", "90"], "below 90 degrees"),
        ([*BUILT, "--distance-mm", "200", "--sigma-px", "0.1", "--blur-px", "1"], "--blur-px is of pixels"),
        ([*BUILT, "--distance-mm", "200", "--points", "9"], "--points goes with --sigma-px"),
        ([*BUILT, "--distance-mm", "200", "--kind", "ring"], "--line-mm is needed for a ring"),
        ([*BUILT, "--distance-mm", "200", "--line-mm", "0.3"], "goes with kind ring"),
        ([*BUILT, "--distance-mm", "200", "--noise", "-1"], "noise must be"),
        ([*BUILT, "--distance-mm", "200", "--arc", "0"], "arc must be a fraction"),
        ([*BUILT, "--distance-mm", "200", "--sigma-f-px", "0"], "standard deviation of f must be"),
        ([*BUILT, "--distance-mm", "200", "--want-depth-um", "0"], "must be positive standard deviations"),
        ([*BUILT, "--distance-mm", "200", "--direction", "0", "1", "0"], "must point forward"),
        ([*BUILT, "--distance-mm", "far"], "far"),
    ],
)
def test_refusals_are_one_line(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", *arguments]) == 1
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert not captured.out
