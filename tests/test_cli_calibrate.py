"""`planeopt calibrate`: its files, its exit status, what it refuses, and that nothing half-written is left."""

import contextlib
import io
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pytest

import planeopt as po
import planeopt.report.calibration_files
from planeopt.board import save_board
from planeopt.calibration import Calibration, calibrate
from planeopt.calibration.record import CalibrationFile, calibration_schema, load_record
from planeopt.cli import INTERRUPTED, TERMINATED, main
from planeopt.example import example_folder
from planeopt.report.calibration_words import FORCED, NOT_WRITTEN
from planeopt.simulation.board_faults import frontal_session
from planeopt.simulation.board_random import Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession
from report_page import PageReader, differing, undrawn
from session_folder import first_views, write_points_session

FILES = ["calibration.html", "calibration.json", "rig.toml"]


@dataclass(frozen=True)
class Made:
    """A session on disk, and its calibration."""

    truth: SimulatedSession
    session: Path
    folder: Path
    said: str
    found: Calibration

    @property
    def data(self) -> dict[str, Any]:
        return json.loads((self.folder / "calibration.json").read_bytes())


def run(*arguments: object) -> int:
    return main(["calibrate", *map(str, arguments)])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A good session of 14 views, calibrated."""
    folder = tmp_path_factory.mktemp("good")
    truth = random_session(3, shooting=Shooting(views=14))
    session = write_points_session(truth.observations, folder / "session")
    kept: list[Calibration] = []

    def keeping(*arguments: Any, **options: Any) -> Calibration:
        kept.append(calibrate(*arguments, **options))
        return kept[-1]

    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as said:
        patch.setattr("planeopt.calibration.routine.calibrate", keeping)
        assert run(session, "-o", folder / "out") == 0
    return Made(truth, session, folder / "out", said.getvalue(), kept[0])


@pytest.fixture
def ready(made: Made, monkeypatch: pytest.MonkeyPatch) -> Made:
    """The same; whatever is calibrated gives it again, in no time."""
    monkeypatch.setattr("planeopt.calibration.routine.calibrate", lambda *_, **__: made.found)
    return made


@pytest.fixture
def pageless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages are not drawn, which takes longer than all else."""
    monkeypatch.setattr("planeopt.report.calibration_files.calibration_html", lambda file: file.message)


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages are written with blank pictures."""
    undrawn(monkeypatch)


def test_the_rig_is_that_of_the_record_and_near_the_truth(made: Made):
    assert sorted(path.name for path in made.folder.iterdir()) == FILES
    rig, data = po.load_rig(made.folder / "rig.toml"), made.data
    assert rig.covariance is not None
    assert rig.refused is None
    for one in data["adjustment"]["parameters"]:
        if one["name"] in rig.covariance.parameters:
            assert rig.parameter(one["name"]) == one["value"]
            # Of 14 parameters one beyond 5 sigma is a chance of 1e-5.
            assert abs(one["value"] - made.truth.rig.parameter(one["name"])) < 5 * one["sigma"]
    validator = jsonschema.Draft202012Validator(calibration_schema())
    validator.validate(data)
    assert data["verdict"] == "ok"
    assert set(data["tests"]) == {"warp", "aspect", "parallel", "divergence"}
    assert [test["name"] for test in data["ladder"]] == ["k1", "k2", "tangential", "k3"]
    assert len(data["images"]) == 14
    assert data["held_out"]["folds"]
    assert data["cost"]


def test_the_page_shows_the_numbers_of_the_record(made: Made):
    page = PageReader((made.folder / "calibration.html").read_text(encoding="utf-8"))
    assert differing(page.cells, made.data) == []
    words = " ".join(page.words)
    assert made.data["message"] in words
    assert made.data["held_out"]["sentence"] in words
    for gate in made.data["gates"]:
        assert gate["sentence"] in words


def test_the_terminal_says_what_came_of_it(made: Made):
    for words in ("view_0014.png", "focal length f (px)", "95 % interval", "bow of the board", "OK: ", "written: "):
        assert words in made.said
    assert made.data["next_view"]["sentence"] in made.said


def test_two_runs_give_the_same_bytes(made: Made, tmp_path: Path):
    assert run(made.session, "-o", tmp_path / "elsewhere", "--jobs", "2") == 0
    for name in FILES:
        assert (tmp_path / "elsewhere" / name).read_bytes() == (made.folder / name).read_bytes()


@pytest.mark.usefixtures("pageless")
def test_the_record_alone_gives_the_rig_again(made: Made, tmp_path: Path):
    assert run(made.folder / "calibration.json", "-o", tmp_path / "again") == 0
    assert (tmp_path / "again" / "rig.toml").read_bytes() == (made.folder / "rig.toml").read_bytes()
    again = json.loads((tmp_path / "again" / "calibration.json").read_bytes())
    came = again.pop("provenance")
    assert again == {key: value for key, value in made.data.items() if key != "provenance"}
    assert came["session"].endswith("calibration.json")


@pytest.mark.usefixtures("pageless")
def test_options_reach_the_model_and_are_kept_for_the_next_time(made: Made, tmp_path: Path):
    asked = ["--distortion", "k2", "--beam", "parallel", "--no-warp", "--focal", "separate", "--seed", "3"]
    asked += ["--corner-weights", "equal", "--no-reject"]
    f_mm = made.truth.rig.focal_length
    session = write_points_session(first_views(made.truth.observations, 6), tmp_path / "session")
    run(session, "-o", tmp_path / "one", "--force", *asked, "--expect", f"f_mm={f_mm},1")
    first = load_record(tmp_path / "one" / "calibration.json")
    assert first.adjustment is not None
    model = first.adjustment.model
    assert (model.distortion, model.beam, model.warp, model.focal) == ("k2", "parallel", False, "separate")
    assert (first.options.corner_weights, first.options.reject) == ("equal", False)
    assert first.adjustment.noise.corners_left_out == 0
    assert first.options.expect == {"f_mm": (f_mm, 1.0)}
    assert all(word in first.provenance.command for word in asked)
    assert first.provenance.seed == 3
    # The record's own options hold, until others are asked for.
    run(tmp_path / "one" / "calibration.json", "-o", tmp_path / "two", "--force", "--beam", "none")
    second = load_record(tmp_path / "two" / "calibration.json")
    assert second.options.beam == "none"
    assert second.options.distortion == "k2"
    assert second.provenance.seed == 3
    assert po.load_rig(tmp_path / "two" / "rig.toml").beam is None


@pytest.mark.usefixtures("blank")
def test_the_time_is_the_environments_or_none(ready: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert ready.data["provenance"]["time"] is None
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    run(ready.folder / "calibration.json", "-o", tmp_path / "out")
    assert load_record(tmp_path / "out" / "calibration.json").provenance.time == "2023-11-14T22:13:20Z"
    assert "2023-11-14 22:13:20 UTC" in (tmp_path / "out" / "calibration.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def frontal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session in which the board was never tilted."""
    return write_points_session(frontal_session(1).observations, tmp_path_factory.mktemp("frontal") / "session")


def test_a_refused_calibration_gives_no_rig(frontal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run(frontal, "-o", tmp_path / "out") == 2
    said = capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES[:2]
    file = load_record(tmp_path / "out" / "calibration.json")
    assert (file.verdict, file.forced, file.has_rig) == ("refused", False, False)
    assert f"REFUSED: {file.message}" in said
    assert "rig.toml" not in said
    assert any(gate.state == "refuse" and "tilt" in gate.sentence.lower() for gate in file.gates)
    assert NOT_WRITTEN in (tmp_path / "out" / "calibration.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("blank")
def test_force_writes_a_refused_rig_marked_so(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    session = write_points_session(first_views(made.truth.observations, 4), tmp_path / "session")
    assert run(session, "-o", tmp_path / "out", "--force") == 2
    assert FORCED in capsys.readouterr().out
    file = load_record(tmp_path / "out" / "calibration.json")
    assert (file.verdict, file.forced, file.has_rig) == ("refused", True, True)
    assert po.load_rig(tmp_path / "out" / "rig.toml").refused == file.message
    assert FORCED in (tmp_path / "out" / "calibration.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("pageless")
def test_two_views_cannot_be_forced_and_an_earlier_rig_stays(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    session = write_points_session(first_views(made.truth.observations, 1), tmp_path / "session")
    (tmp_path / "out").mkdir()
    shutil.copy(made.folder / "rig.toml", tmp_path / "out" / "rig.toml")
    assert run(session, "-o", tmp_path / "out", "--force") == 2
    said = capsys.readouterr()
    file = load_record(tmp_path / "out" / "calibration.json")
    if not file.has_rig:
        assert "of an earlier run" in said.err
        assert (tmp_path / "out" / "rig.toml").read_bytes() == (made.folder / "rig.toml").read_bytes()
    assert file.verdict == "refused"


def test_images_without_a_board_each_say_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    truth = random_session(3, shooting=Shooting(views=14))
    session = tmp_path / "session"
    session.mkdir()
    save_board(truth.board, session / "board.toml")
    for i in range(3):
        cv2.imwrite(str(session / f"view{i}.png"), np.full((120, 160), 128, np.uint8))
    (session / "view3.png").write_text("no image", encoding="utf-8")
    (session / "session.toml").write_text(
        'board = "board.toml"\nimages = ["view*.png"]\nspot = "disc"\n', encoding="utf-8"
    )
    assert run(session, "-o", tmp_path / "out") == 2
    said = capsys.readouterr().out
    file = load_record(tmp_path / "out" / "calibration.json")
    assert file.verdict == "refused"
    assert file.adjustment is None
    assert len(file.images) == 4
    page = " ".join(PageReader((tmp_path / "out" / "calibration.html").read_text(encoding="utf-8")).words)
    flat = " ".join(said.split())
    for image in file.images:
        assert image.status == "refused"
        assert image.reason
        assert image.reason in page
        assert image.reason.split()[0] in flat
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES[:2]


@pytest.mark.usefixtures("pageless")
def test_detections_can_be_saved_and_given_back(made: Made, tmp_path: Path):
    saved = tmp_path / "corners.csv"
    assert run(made.session, "-o", tmp_path / "out", "--save-detections", saved) == 0
    assert saved.read_text(encoding="utf-8").startswith("image,id,x_px,y_px,sigma_px\n")
    assert run(made.session, "-o", tmp_path / "again", "--detections", saved) == 0
    for folder in (tmp_path / "out", tmp_path / "again"):
        assert (folder / "rig.toml").read_bytes() == (made.folder / "rig.toml").read_bytes()
    assert "--detections" in load_record(tmp_path / "again" / "calibration.json").provenance.command
    assert run(made.session, "-o", tmp_path / "third", "--save-detections", saved) == 1
    assert not (tmp_path / "third").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["none"], "none"),
        (["SESSION", "--expect", "radius"], "NAME=VALUE,TOLERANCE"),
        (["SESSION", "--expect", "radius=6,-1"], "NAME=VALUE,TOLERANCE"),
        (["SESSION", "--distortion", "k9"], "distortion"),
        (["SESSION", "--detections", "none.csv"], "none.csv"),
        (["RECORD", "--detections", "none.csv"], "--detections"),
        (["SESSION", "--jobs", "0"], "jobs"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    made: Made, arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    places = {"SESSION": made.session, "RECORD": made.folder / "calibration.json"}
    assert run(*(places.get(word, word) for word in arguments), "-o", tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert said in error
    assert not (tmp_path / "out").exists()


def test_an_existing_folder_and_what_is_read_are_left_alone(made: Made, capsys: pytest.CaptureFixture[str]):
    before = {name: (made.folder / name).read_bytes() for name in FILES}
    assert run(made.session, "-o", made.folder) == 1
    assert "--force" in capsys.readouterr().err
    assert run(made.folder / "calibration.json", "-o", made.folder, "--force") == 1
    assert "would be written over" in capsys.readouterr().err
    assert {name: (made.folder / name).read_bytes() for name in FILES} == before


@pytest.mark.usefixtures("blank")
@pytest.mark.parametrize("stage", ["write_text", "calibration_html", "save_rig"])
def test_a_run_that_is_cut_short_leaves_nothing(
    ready: Made, stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(planeopt.report.calibration_files, stage, interrupted)
    arguments = [ready.folder / "calibration.json", "-o", tmp_path / "out"]
    assert run(*arguments) == INTERRUPTED
    assert not list(tmp_path.iterdir())
    shutil.copytree(ready.folder, tmp_path / "out")
    assert run(*arguments, "--force") == INTERRUPTED
    assert (tmp_path / "out" / "rig.toml").read_bytes() == (ready.folder / "rig.toml").read_bytes()


def test_ended_by_the_system_nothing_is_left(tmp_path: Path):
    session = str(example_folder() / "session")
    command = [sys.executable, "-m", "planeopt", "calibrate", session, "-o", str(tmp_path / "out"), "--jobs", "2"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(1)  # by now workers are there; the whole run takes many seconds
    process.terminate()
    # Workers share the pipes: they are at their end only when the last of them is gone.
    said, complaint = process.communicate(timeout=60)
    assert (process.returncode, said, complaint) == (TERMINATED, "", "planeopt: terminated\n")
    assert not list(tmp_path.iterdir())


def test_called_from_a_program_no_handler_is_set():
    before = signal.getsignal(signal.SIGTERM)
    assert main(["--version"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.usefixtures("blank")
def test_a_camera_alone(made: Made, tmp_path: Path):
    views = tuple(replace(view, spot=None) for view in made.truth.observations.views)
    alone = replace(made.truth.observations, views=views, spot="none")
    assert run(write_points_session(alone, tmp_path / "session"), "-o", tmp_path / "out") == 0
    file: CalibrationFile = load_record(tmp_path / "out" / "calibration.json")
    assert file.adjustment is not None
    assert file.adjustment.model.beam == "none"
    assert po.load_rig(tmp_path / "out" / "rig.toml").beam is None
    page = PageReader((tmp_path / "out" / "calibration.html").read_text(encoding="utf-8"))
    assert differing(page.cells, json.loads(file.to_json())) == []
    assert not {"beam", "cost"} & {figure.key for figure in page.figures}


def test_help_says_what_the_options_are(capsys: pytest.CaptureFixture[str]):
    assert main(["calibrate", "--help"]) == 0
    said = capsys.readouterr().out
    for option in ("--focal", "--distortion", "--no-warp", "--beam", "--expect", "--save-detections", "--force"):
        assert option in said
    assert "SOURCE_DATE_EPOCH" in said
