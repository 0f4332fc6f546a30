"""`planeopt compare`: its tables, files and figure, and what it refuses."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pytest
from PIL import Image

import planeopt.comparison
from example_rig import RIG_FILE, TARGETS, example_rig, points_file
from planeopt.accuracy import Truth
from planeopt.cli import main
from planeopt.comparison import Comparison, compare
from planeopt.comparison.record import comparison_schema
from planeopt.comparison.simulated import simulated_spot, worked_example
from planeopt.example import example_folder
from planeopt.formulations import AsPrinted, ClosedForm, Constrained
from planeopt.methods import EVERY, METHODS, Method
from planeopt.report.comparison_figure import comparison_figure, words
from planeopt.solvers import Sqp

RIG = ["--rig", str(RIG_FILE)]
QUICK = ["--method", "constrained+sqp", "--method", "penalty+ipopt", "--method", "closed form"]
FILES = ["comparison.csv", "comparison.json", "comparison.png", "summary.csv"]


@dataclass(frozen=True)
class Made:
    """What a run left and said."""

    folder: Path
    out: str
    err: str

    @property
    def data(self) -> dict[str, Any]:
        return json.loads((self.folder / "comparison.json").read_text())

    def rows(self, name: str = "comparison.csv") -> list[dict[str, str]]:
        with (self.folder / name).open(newline="") as file:
            return list(csv.DictReader(file))


def run(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str, status: int = 0) -> Made:
    assert main(["compare", *arguments, "-o", str(folder)]) == status
    said = capsys.readouterr()
    return Made(folder, said.out, said.err)


def test_an_image_gives_every_pair_in_all_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    # All but the slow ones, a simplex of nine unknowns.
    every = tuple(method for method in EVERY if method.name[:11] != "Constrained" or method in METHODS)
    monkeypatch.setattr("planeopt.methods.EVERY", every)
    made = run(capsys, tmp_path / "compared", str(TARGETS[3]), *RIG)
    assert made.err == ""
    for formulation in dict.fromkeys(method.formulation.name for method in every):
        assert f"\n {formulation} " in made.out, formulation
    assert "laser block rank 1" in made.out
    assert max(map(len, made.out.split("\n")[:40])) <= 150
    assert sorted(path.name for path in made.folder.iterdir()) == FILES
    (entry,) = made.data["inputs"]
    assert entry["status"] == "ok"
    assert [row["method"] for row in entry["rows"]] == [method.name for method in every]
    rows = made.rows()
    assert [row["method"] for row in rows] == [row["method"] for row in entry["rows"]]
    assert float(rows[0]["z_L_mm"]) == entry["rows"][0]["z_L_mm"]
    assert rows[-1]["z_L_mm"] == ""
    assert float(rows[0]["residual (15) mm^2"]) == entry["rows"][0]["residuals"]["(15) mm^2"]
    assert float(rows[0]["error_in_bound_sigmas_p"]) == entry["rows"][0]["error_in_bound_sigmas"]["p"]
    assert abs(float(rows[0]["z_L_error_mm"])) < 0.1
    shipped = json.loads(Path(planeopt.comparison.__file__).with_name("comparison.schema.json").read_text())
    assert shipped == json.loads(json.dumps(comparison_schema()))
    validator = jsonschema.Draft202012Validator(shipped)
    validator.check_schema(shipped)
    validator.validate(made.data)
    assert not validator.is_valid(made.data | {"format": 2})
    with Image.open(made.folder / "comparison.png") as picture:
        assert picture.size[0] > 1000


def test_simulated_spots_are_summarised_and_repeat(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    asked = ["--simulate", "3", "--points", "40", "--noise-px", "0.2", "--seed", "5", *QUICK]
    made = run(capsys, tmp_path / "a", *asked)
    again = run(capsys, tmp_path / "b", *asked, "--start", "closed-form", "--repeats", "2")
    assert "3 inputs" in made.out
    assert made.out.count("10 hard equations") == 1
    assert made.data["settings"] == {
        "start": "closed-form",
        "repeats": 1,
        "simulate": 3,
        "points": 40,
        "noise_px": 0.2,
        "seed": 5,
    }
    summary = made.rows("summary.csv")
    assert [row["method"] for row in summary] == ["Constrained + Sqp", "Penalty + Ipopt", "ClosedForm"]
    assert [row["statuses_ok"] for row in summary] == ["3", "0", "3"]
    assert float(summary[0]["error_over_bound_rms"]) > 0
    assert {summary[1][key] for key in ("error_over_bound_rms", "evaluations", "solve_ms")} == {""}
    timeless = [
        [{key: value for key, value in row.items() if key[-3:] != "_ms"} for row in one.rows()] for one in (made, again)
    ]
    assert timeless[0] == timeless[1]
    assert len(timeless[0]) == 9


def test_a_scene_gives_its_own_rig_and_its_sweep_s_planes(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scene = str(example_folder() / "scene.toml")
    made = run(capsys, tmp_path / "a", scene, "--simulate", "2", "--method", "closed form", "--start", "paper")
    planes = [entry["truth"] for entry in made.data["inputs"]]
    assert planes[0]["p"] != planes[1]["p"]
    for entry, row in zip(made.data["inputs"], made.rows(), strict=True):
        assert row["root"] == "visible"
        assert abs(float(row["z_L_mm"]) - entry["truth"]["z_L_mm"]) < 1


def test_compare_goes_on_after_a_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    good, bad = points_file(tmp_path), tmp_path / "none.csv"
    made = run(capsys, tmp_path / "out", str(bad), str(good), *RIG, *QUICK, "--start", "10,250,20,20", status=1)
    assert made.err == f"planeopt: {bad}: there is no such file of boundary points\n"
    assert str(good) in made.out.replace("\n", "")
    assert [len(entry["rows"]) for entry in made.data["inputs"]] == [0, 3]
    assert made.data["inputs"][0]["message"].startswith(str(bad))
    first, second = made.rows()[:2]
    assert {key: value for key, value in first.items() if value} == {
        "input": str(bad),
        "status": "error",
        "message": made.data["inputs"][0]["message"],
    }
    assert list(second)[:3] == ["input", "method", "formulation"]
    start = {"R_mm": 10, "z_L_mm": 250, "alpha_deg": 20, "beta_deg": 20}
    shift = example_rig().axial_shift  # of the rig's tilted beam: the equations' z_L is the spot centre's
    assert made.data["inputs"][1]["start"] == pytest.approx(start | {"z_L_mm": 250 + shift}, rel=1e-9)


def test_compare_without_a_spot_is_status_2_and_still_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    black, out = tmp_path / "black.png", tmp_path / "out"
    cv2.imwrite(str(black), np.zeros((720, 960), np.uint8))
    made = run(capsys, out, str(black), *RIG, status=2)
    assert "refused" in made.err
    (entry,) = made.data["inputs"]
    assert entry["rows"] == []
    assert sorted(path.name for path in out.iterdir()) == [name for name in FILES if name != "comparison.png"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (RIG, "nothing to compare"),
        (["a.csv"], "--rig"),
        (["a.csv", *RIG, "--seed", "1"], "--seed goes with --simulate"),
        (["a.csv", *RIG, "--noise-px", "1"], "--noise-px goes with --simulate"),
        (["--simulate", "2", *RIG], "--rig goes with files"),
        (["--simulate", "0"], "at least 1"),
        (["--simulate", "1", "--seed", "-1"], "negative"),
        (["--simulate", "1", "--points", "3"], "at least 5 points"),
        (["--simulate", "1", "--noise-px", "nan"], "positive"),
        (["--simulate", "1", "--start", "nowhere"], "--start"),
        (["--simulate", "1", "--start", "10,250,95,20"], "alpha below 90 degrees, not '10,250,95,20'"),
        (["--simulate", "1", "--start", "10,nan,1,1"], "not '10,nan,1,1'"),
        (["--simulate", "1", "--noise-px", "500", "--points", "9"], "simulated 1: the 9 points lie on"),
        (["--simulate", "1", "--method", "ClosedForm + Ipopt"], "ClosedForm needs no solver: leave Ipopt out"),
        (["--simulate", "1", "--method", "Newton"], "no formulation 'Newton'"),
        (["--simulate", "1", "--repeats", "0"], "--repeats"),
        (["--simulate", "1", "--jobs", "0"], "--jobs"),
        (["a.toml", "b.toml", "--simulate", "1"], "one scene"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]):
    assert main(["compare", *arguments]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said


def test_the_figure_says_what_the_numbers_say():
    rig, pose = worked_example()
    methods = [Method(Constrained(), Sqp()), Method(ClosedForm()), Method(AsPrinted())]
    truth = Truth(pose, rig.plane_from_pose(pose))
    spots = [simulated_spot(rig, pose, n=20, noise_px=0.3, seed=i) for i in range(2)]
    compared = compare(spots, rig, truth=truth, methods=methods)
    rms = [s.error.rms for s in compared.summary if s.error is not None]
    said = words(compared, "two spots")
    size = " to ".join(dict.fromkeys(f"{value:.2f}" for value in sorted(rms)))
    assert said.heading.startswith(f"two spots: errors are {size} times the bound's RMS: 2 draws")
    often = words(Comparison(20 * compared.cases), "forty").heading
    assert all(f"{value:.2f}" in often for value in rms)
    assert "the bound" in often
    assert "1 of 3 pairs were refused before any search" in said.caption
    assert "one draw" in words(Comparison(compared.cases[:1]), "one").heading
    blind = compare(spots, rig, methods=methods)
    assert "from the closed form's" in words(blind, "two").heading
    figure = comparison_figure(blind, "two")
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["Constrained + Sqp", "ClosedForm"]
    assert all("(" in axes.get_xlabel() or axes.get_xlabel() == "ms" for axes in figure.axes)
    nothing = compare(spots, rig, methods=methods[-1:])
    assert "no plane was found" in words(nothing, "two").heading
    comparison_figure(nothing, "two")
