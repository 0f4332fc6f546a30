"""`planeopt demo` and `calibration/charuco.py`: the bundled session calibrated, the targets measured with that rig."""

import csv
import io
import json
import re
import runpy
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import pytest
from scipy.stats import chi2

import planeopt.calibration
from example_rig import RIG_FILE, TARGETS
from planeopt.accuracy import rig_chi2, rig_scores
from planeopt.calibration import Detected, Session, detect
from planeopt.cli import main
from planeopt.errors import InputError
from planeopt.example import example_folder
from planeopt.record import record_from_json
from planeopt.rig import load_rig

SCRIPT = Path(__file__).parents[1] / "calibration" / "charuco.py"
SESSION = example_folder() / "session"


@dataclass(frozen=True)
class Run:
    """What the demo wrote and said, and what it found in the images of its session."""

    folder: Path
    out: str
    err: str
    session: Session
    detected: Detected


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The demo, once; without posteriors, with which `planeopt report` is tested."""
    folder = tmp_path_factory.mktemp("demo") / "deep" / "out"
    kept: list[tuple[Session, Detected]] = []

    def keeping(session: Session, **options: Any) -> Detected:
        kept.append((session, detect(session, **options)))
        return kept[-1][1]

    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(io.StringIO()) as out,
        redirect_stderr(io.StringIO()) as err,
    ):
        patch.setattr("planeopt.calibration.routine.detect", keeping)
        assert main(["demo", "-o", str(folder), "--no-posterior"]) == 0
    (found,) = kept
    return Run(folder, out.getvalue(), err.getvalue(), *found)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_rig_and_poses_are_shown_beside_the_truth(run: Run):
    assert run.err == ""
    assert all(run.out.count(target.stem) == 2 for target in TARGETS)
    for target in TARGETS:
        truth = json.loads(target.with_suffix(".json").read_text())
        assert f"{truth['z_L_mm']:.3f}" in run.out
    assert re.search(r"^OK: ", run.out, re.MULTILINE)
    for row in rows_of(run.folder / "parameters.csv"):
        sigmas = re.escape(f"{float(row['error_sigmas']):+.2f}")
        assert re.search(rf"^ *{row['parameter']} .* {sigmas} *$", run.out, re.MULTILINE)


def test_every_file_is_written(run: Run):
    files = {path.relative_to(run.folder).as_posix() for path in run.folder.rglob("*") if path.is_file()}
    calibration = {f"calibration/{name}" for name in ("rig.toml", "calibration.json", "calibration.html")}
    report = {f"report/{name}" for name in ("poses.json", "report.html", "report.pdf")}
    assert files == calibration | report | {"poses.jsonl", "poses.csv", "parameters.csv", "accuracy.png"}
    image = cv2.imread(str(run.folder / "accuracy.png"))
    assert image is not None
    assert image.shape[1] >= 1200
    assert all(name.split("/")[0] in run.out for name in files)


def test_no_file_knows_where_the_package_lies(run: Run):
    for path in run.folder.rglob("*"):
        if path.is_file() and path.suffix in (".json", ".jsonl", ".csv", ".toml", ".html"):
            assert str(example_folder()) not in path.read_text()
            assert f"/.{run.folder.name}." not in path.read_text()


def test_the_calibrated_rig_is_the_true_one_within_what_it_claims(run: Run):
    rig, truth = load_rig(run.folder / "calibration" / "rig.toml"), load_rig(RIG_FILE)
    scores = rig_scores(rig, truth)
    assert {score.name for score in scores} >= {"f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y"}
    assert max(abs(score.sigmas) for score in scores) < 3.5
    errors = {score.name: score.error for score in scores}
    assert abs(errors["f"]) < 1e-3 * truth.focal_length
    assert abs(errors["radius"]) < 0.01
    together, count = rig_chi2(rig, truth)
    # Once in a thousand sessions it would lie outside, if the covariance is right.
    low, high = chi2.ppf([5e-4, 1 - 5e-4], count)
    assert low < together < high
    rows = rows_of(run.folder / "parameters.csv")
    assert [row["parameter"] for row in rows] == [score.name for score in scores]
    assert [float(row["error"]) for row in rows] == [score.error for score in scores]


def test_the_offset_goes_with_the_direction_and_poses_hardly_suffer(run: Run):
    costs = json.loads((run.folder / "calibration" / "calibration.json").read_text())["cost"]
    assert costs
    for cost in costs:
        # What the parameters' own sigmas would seem to cost, were camera and beam independent, is far more.
        assert cost["sigma_z_L_mm"] < 0.5 * cost["independent_z_L_mm"]
        assert cost["sigma_normal_deg"] < 0.5 * cost["independent_normal_deg"]


def test_poses_with_the_calibrated_rig_are_true_within_what_they_claim(run: Run):
    records = [record_from_json(line) for line in (run.folder / "poses.jsonl").read_text().splitlines()]
    assert [record.input for record in records] == [target.name for target in TARGETS]
    depths, normals = [], []
    for row, record, target in zip(rows_of(run.folder / "poses.csv"), records, TARGETS, strict=True):
        truth = json.loads(target.with_suffix(".json").read_text())
        assert row["target"] == target.stem
        assert record.status == "ok"
        assert float(row["z_L_mm"]) == record.z_L_mm
        assert float(row["z_L_error_mm"]) == pytest.approx((record.z_L_mm or 0) - truth["z_L_mm"], abs=1e-12)
        assert float(row["sigma_z_L_mm"]) == record.sigma.z_L_mm
        assert float(row["sigma_spot_z_L_mm"]) == record.sigma_spot.z_L_mm
        assert float(row["sigma_spot_z_L_mm"]) < float(row["sigma_z_L_mm"])
        assert abs(float(row["z_L_error_sigmas"])) < 3.5
        assert abs(float(row["normal_error_sigmas"])) < 3.5
        depths.append(abs(float(row["z_L_error_mm"])) / truth["z_L_mm"])
        normals.append(float(row["normal_error_deg"]))
    assert sorted(depths)[3] < 1e-4
    assert sorted(normals)[3] < 0.08


def test_the_report_has_the_calibrated_rig_and_names_the_targets(run: Run):
    report = json.loads((run.folder / "report" / "poses.json").read_text())
    assert [record["input"] for record in report["records"]] == [target.name for target in TARGETS]
    assert report["provenance"]["rig_file"] == str(run.folder / "calibration" / "rig.toml")
    records = [json.loads(line) for line in (run.folder / "poses.jsonl").read_text().splitlines()]
    assert [r["z_L_mm"] for r in report["records"]] == [r["z_L_mm"] for r in records]


def test_the_script_writes_what_the_demo_does(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def again(session: Session, **_: object) -> Detected:
        assert session == run.session
        return run.detected

    # The same images of the same session are not looked at again.
    monkeypatch.setattr(planeopt.calibration, "detect", again)
    script = runpy.run_path(str(SCRIPT))
    assert script["main"](SESSION, tmp_path / "deep" / "out") == 0
    said = capsys.readouterr().out
    assert said.count(": ok, ") == 12
    assert "\nok: " in said
    for name in ("rig.toml", "calibration.json", "calibration.html"):
        written = (tmp_path / "deep" / "out" / name).read_text()
        # What differs is where the session lies.
        written = written.replace(str(SESSION), "calibration/example/session")
        assert name == "rig.toml" or "python calibration/charuco.py calibration/example/session" in written
        written = written.replace("python calibration/charuco.py ", "planeopt calibrate ")
        assert written == (run.folder / "calibration" / name).read_text()


def test_the_script_says_what_is_wrong(tmp_path: Path):
    script = runpy.run_path(str(SCRIPT))
    with pytest.raises(InputError, match=r"session\.toml"):
        script["main"](tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_the_script_writes_over_nothing_and_says_so_at_once(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "out").touch() if kind == "file" else (tmp_path / "out").mkdir()
    monkeypatch.setattr("sys.argv", [str(SCRIPT), str(tmp_path / "no session"), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(SCRIPT), run_name="__main__")
    # Before the session is even looked for; Python prints a text that it ends with, and its status is then 1.
    assert ended.value.code == f"{tmp_path / 'out'}: exists already; name another folder"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_rig_without_covariance_has_no_scores():
    truth = load_rig(RIG_FILE)
    with pytest.raises(InputError, match="no covariance"):
        rig_scores(truth, truth)
