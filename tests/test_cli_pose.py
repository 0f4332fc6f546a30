import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from example_rig import RIG_FILE, TARGETS, points_file, pose_at
from planeopt.cli import main

RIG = ["--rig", str(RIG_FILE)]
HEADER = "x_px,y_px,sigma_px\n"


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def one_complaint(captured: str, *words: str) -> None:
    """Exactly one line on standard error, with these words, and no traceback."""
    assert captured.count("\n") == 1, captured
    assert captured.startswith("planeopt: ")
    assert "Traceback" not in captured
    for word in words:
        assert word in captured


def table(points: np.ndarray, header: str = HEADER, sigma: str = ",0.1") -> str:
    return header + "".join(f"{x},{y}{sigma}\n" for x, y in points.tolist())


def ellipse(n: int = 30) -> np.ndarray:
    t = 2 * np.pi * np.arange(n) / n
    return np.stack([500 + 60 * np.cos(t), 400 + 50 * np.sin(t)], axis=1)


def straight() -> np.ndarray:
    x = np.linspace(300, 600, 20)
    return np.stack([x, 0.5 * x + 100], axis=1)


def hyperbola() -> np.ndarray:
    t = np.linspace(-1.5, 1.5, 20)
    branch = np.stack([60 * np.cosh(t), 40 * np.sinh(t)], axis=1)
    return np.concatenate([branch, -branch]) + np.array([480, 360])


BAD_FILES: dict[str, tuple[str, str, str]] = {
    # name of the case: file name, content, a word of the complaint
    "not an image": ("a.png", "these are words", "not an image"),
    "empty image": ("a.png", "", "empty"),
    "empty csv": ("a.csv", "", "empty"),
    "header only": ("a.csv", HEADER, "at least 5"),
    "no header": ("a.csv", table(ellipse(), ""), "line 1"),
    "three points": ("a.csv", table(ellipse(3)), "at least 5"),
    "nan": ("a.csv", table(ellipse()) + "nan,3,0.1\n", "line 32"),
    "infinite": ("a.csv", table(ellipse()) + "1,inf,0.1\n", "line 32"),
    "words": ("a.csv", table(ellipse()) + "left,right,0.1\n", "line 32"),
    "missing cell": ("a.csv", table(ellipse()) + "5,0.1\n", "line 32"),
    "negative sigma": ("a.csv", table(ellipse(), sigma=",-0.1"), "sigma_px must be positive"),
    "zero sigma": ("a.csv", table(ellipse(), sigma=",0"), "sigma_px must be positive"),
    "on a line": ("a.csv", table(straight()), "line"),
    "on a hyperbola": ("a.csv", table(hyperbola()), "hyperbola"),
    "one point many times": ("a.csv", table(np.full((20, 2), 300.0)), "a.csv"),
    "no such suffix": ("a", "", "empty"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file_is_one_line_and_status_1(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    name, content, word = BAD_FILES[case]
    path = tmp_path / name
    path.write_text(content)
    assert main(["pose", str(path), *RIG]) == 1
    captured = capsys.readouterr()
    one_complaint(captured.err, str(path), word)
    (record,) = lines(captured.out)
    assert record["status"] == "error"
    assert f"planeopt: {record['message']}\n" == captured.err


@pytest.mark.parametrize(("name", "word"), [("nothing.png", "no such"), ("nothing.csv", "no such"), (".", "folder")])
def test_missing_file_and_folder(name: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["pose", str(tmp_path / name), *RIG]) == 1
    one_complaint(capsys.readouterr().err, word)


def test_image_of_another_size_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "small.png"
    cv2.imwrite(str(path), np.zeros((100, 100), np.uint8))
    assert main(["pose", str(path), *RIG]) == 1
    one_complaint(capsys.readouterr().err, str(path), "960")


GOOD_RIG = RIG_FILE.read_text()
COVARIANCE = '[covariance]\nparameters = ["e_x", "e_y"]\nmatrix = '
BAD_RIGS: dict[str, tuple[str, str]] = {
    "not toml": ("[camera", "TOML"),
    "empty": ("", "camera"),
    "missing key": (GOOD_RIG.replace("fx = 2181.8\n", ""), "'fx'"),
    "unknown key": (GOOD_RIG.replace("[laser]", "[laser]\ncolour = 1"), "'colour'"),
    "wrong type": (GOOD_RIG.replace("cx = 481.2", 'cx = "left"'), "camera.cx"),
    "not finite": (GOOD_RIG.replace("cy = 357.6", "cy = nan"), "camera.cy"),
    "negative focal length": (GOOD_RIG.replace("fy = 2181.8", "fy = -2181.8"), "camera.fy"),
    "no radius": (GOOD_RIG.replace("radius_mm = 6.0", "radius_mm = 0.0"), "radius"),
    "four distortions": (GOOD_RIG.replace("0.0004, 0.0]", "0.0004]"), "distortion"),
    "direction not unit": (GOOD_RIG.replace("0.9999813755203198", "0.5"), "direction"),
    "covariance not positive definite": (f"{GOOD_RIG}\n{COVARIANCE}[[1.0, 2.0], [2.0, 1.0]]", "positive definite"),
    "covariance of another size": (f"{GOOD_RIG}\n{COVARIANCE}[[1.0]]", "covariance"),
    "format of the future": (GOOD_RIG.replace("format = 1", "format = 2"), "format 2"),
    "camera alone": (GOOD_RIG[: GOOD_RIG.index("[laser]")], "camera alone"),
}


@pytest.mark.parametrize("case", BAD_RIGS)
@pytest.mark.parametrize("command", ["pose", "compare"])
def test_broken_rig_is_one_line_and_no_record(
    case: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    content, word = BAD_RIGS[case]
    path = tmp_path / "rig.toml"
    path.write_text(content)
    assert main([command, str(TARGETS[0]), "--rig", str(path)]) == 1
    captured = capsys.readouterr()
    one_complaint(captured.err, str(path), word)
    assert captured.out == ""


@pytest.mark.parametrize(("name", "word"), [("none.toml", "no such"), (".", "folder")])
def test_missing_rig(name: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["pose", str(TARGETS[0]), "--rig", str(tmp_path / name)]) == 1
    one_complaint(capsys.readouterr().err, word)


def spot_at(path: Path, x: int, y: int) -> Path:
    image = np.full((720, 960), 10, np.uint8)
    cv2.imwrite(str(path), cv2.GaussianBlur(cv2.circle(image, (x, y), 60, 220, -1), (0, 0), 1.2))
    return path


@pytest.mark.parametrize("case", ["black", "cut by the border", "beyond the border", "points beyond the border"])
def test_no_spot_and_spot_outside_the_image_are_refused(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "a.png"
    if case == "black":
        cv2.imwrite(str(path), np.zeros((720, 960), np.uint8))
    elif case == "points beyond the border":
        path = tmp_path / "a.csv"
        path.write_text(table(ellipse() + np.array([500.0, 0.0])))
    else:
        spot_at(path, 0 if case == "cut by the border" else -200, 300)
    assert main(["pose", str(path), *RIG]) == 2
    captured = capsys.readouterr()
    (record,) = lines(captured.out)
    assert record["status"] == "refused"
    assert record["z_L_mm"] is None
    assert record["flags"]
    one_complaint(captured.err, "refused", record["message"])


def test_one_good_input_is_status_0_and_silent(capsys: pytest.CaptureFixture[str]):
    assert main(["pose", str(TARGETS[2]), *RIG]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    (record,) = lines(captured.out)
    assert record["input"] == str(TARGETS[2])
    assert (record["formulation"], record["solver"]) == ("Constrained", "Ipopt")


def batch(tmp_path: Path) -> list[str]:
    """Ten inputs, the third and the eighth of no use."""
    good = [str(points_file(tmp_path, f"{i}.csv", pose_at(200.0 + 5 * i), seed=i)) for i in range(10)]
    (tmp_path / "bad.csv").write_text("x_px,y_px\n1,two\n")
    return [*good[:2], str(tmp_path / "bad.csv"), *good[3:7], str(tmp_path / "none.png"), *good[8:]]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ten_inputs_with_two_bad_give_eight_good_records(jobs: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    inputs = batch(tmp_path)
    assert main(["pose", *inputs, *RIG, "--jobs", jobs]) == 1
    captured = capsys.readouterr()
    records = lines(captured.out)
    assert [record["input"] for record in records] == inputs
    assert [i for i, record in enumerate(records) if record["status"] == "error"] == [2, 7]
    assert sum(record["status"] == "ok" for record in records) == 8
    assert [line.split(": ")[1].split(",")[0] for line in captured.err.splitlines()] == [inputs[2], inputs[7]]


def test_refused_among_good_is_status_2_with_a_tally(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((720, 960), np.uint8))
    assert main(["pose", str(points_file(tmp_path)), str(black), *RIG]) == 2
    one_complaint(capsys.readouterr().err, "2 inputs: 1 ok, 1 refused")


def test_formulation_and_solver_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = str(points_file(tmp_path))
    assert main(["pose", path, *RIG, "--formulation", "reprojection", "--solver", "SQP"]) == 0
    assert main(["pose", path, *RIG, "--formulation", "as-printed"]) == 2
    chosen, refused = lines(capsys.readouterr().out)
    assert (chosen["formulation"], chosen["solver"]) == ("Reprojection", "Sqp")
    assert refused["flags"][0] == "overdetermined"


def test_output_file_holds_what_standard_output_would(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    inputs, out = batch(tmp_path), tmp_path / "poses.jsonl"
    main(["pose", *inputs, *RIG])
    expected = capsys.readouterr().out
    assert main(["pose", *inputs, *RIG, "-o", str(out)]) == 1
    assert capsys.readouterr().out == ""
    assert out.read_text() == expected
    assert not list(tmp_path.glob("*.part"))


def test_existing_output_is_refused_without_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out, path = tmp_path / "poses.jsonl", str(points_file(tmp_path))
    out.write_text("precious\n")
    assert main(["pose", path, *RIG, "-o", str(out)]) == 1
    one_complaint(capsys.readouterr().err, "--force")
    assert out.read_text() == "precious\n"
    assert main(["pose", path, *RIG, "-o", str(out), "--force"]) == 0
    assert lines(out.read_text())[0]["status"] == "ok"


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["-o", "missing/poses.jsonl"], "cannot be written"),
        (["-o", "."], "folder"),
        (["-o", "poses.csv/poses.jsonl"], "cannot be written"),
        (["--resume"], "-o"),
        (["--resume", "--force", "-o", "x.jsonl"], "one of them"),
        (["--jobs", "0"], "at least 1"),
        (["--jobs", "many"], "many"),
        (["--formulation", "magic"], "Reprojection"),
        (["--solver", "magic"], "Swift"),
        (["--nonsense"], "--nonsense"),
    ],
    ids=" ".join,
)
def test_options_that_cannot_be_used(
    options: list[str],
    word: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(tmp_path)
    points_file(tmp_path, "poses.csv")
    assert main(["pose", "poses.csv", *RIG, *options]) == 1
    captured = capsys.readouterr()
    one_complaint(captured.err, word)
    assert captured.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["poses.csv"]


@pytest.fixture
def finished(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[list[str], Path, bytes]:
    """Inputs, an output file, and what an uninterrupted run writes into it."""
    inputs, out = batch(tmp_path), tmp_path / "poses.jsonl"
    main(["pose", *inputs, *RIG, "-o", str(out)])
    capsys.readouterr()
    content = out.read_bytes()
    out.unlink()
    return inputs, out, content


@pytest.mark.parametrize("kept", ["none", "some", "half a line", "all"])
@pytest.mark.parametrize("where", [".part", ""])
def test_resumed_run_is_byte_identical(
    kept: str, where: str, finished: tuple[list[str], Path, bytes], monkeypatch: pytest.MonkeyPatch
):
    from planeopt import batch as room

    inputs, out, content = finished
    complete = content.splitlines(keepends=True)
    left = {"none": b"", "some": b"".join(complete[:4]), "half a line": b"".join(complete[:4])[:-9], "all": content}
    Path(f"{out}{where}").write_bytes(left[kept])
    measured = []
    measure = room.measure
    monkeypatch.setattr(room, "measure", lambda path, *args, **kw: measured.append(path) or measure(path, *args, **kw))
    assert main(["pose", *inputs, *RIG, "-o", str(out), "--resume"]) == 1
    assert out.read_bytes() == content
    count = {"none": 0, "some": 4, "half a line": 3, "all": 10}[kept]
    # Before it goes on it looks whether rig and options are the same: at the last file of each status that is there.
    again, new = measured[: len(measured) - len(inputs) + count], measured[len(measured) - len(inputs) + count :]
    assert new == inputs[count:]
    assert again == {0: [], 3: [inputs[1], inputs[2]], 4: [inputs[2], inputs[3]], 10: [inputs[2], inputs[9]]}[count]
    assert not Path(f"{out}.part").exists()


def test_resume_adds_inputs_to_a_finished_file(finished: tuple[list[str], Path, bytes]):
    inputs, out, content = finished
    main(["pose", *inputs[:5], *RIG, "-o", str(out)])
    assert main(["pose", *inputs, *RIG, "-o", str(out), "--resume"]) == 1
    assert out.read_bytes() == content


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda rows: rows[1:], "line 1"),
        (lambda rows: [rows[0], b"broken\n", *rows[2:]], "line 2: not a pose record"),
        (lambda rows: [*rows, rows[0]], "holds 11 records"),
    ],
    ids=["other inputs", "a broken line within", "too many"],
)
def test_resume_refuses_what_it_cannot_continue(
    change, word: str, finished: tuple[list[str], Path, bytes], capsys: pytest.CaptureFixture[str]
):
    inputs, out, content = finished
    spoilt = b"".join(change(content.splitlines(keepends=True)))
    out.write_bytes(spoilt)
    assert main(["pose", *inputs, *RIG, "-o", str(out), "--resume"]) == 1
    one_complaint(capsys.readouterr().err, word)
    assert out.read_bytes() == spoilt


def test_remains_of_an_interrupted_run_are_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "poses.jsonl"
    part = tmp_path / "poses.jsonl.part"
    part.write_bytes(b"hours of work\n")
    assert main(["pose", str(points_file(tmp_path)), *RIG, "-o", str(out)]) == 1
    one_complaint(capsys.readouterr().err, "--resume")
    assert part.read_bytes() == b"hours of work\n"


def test_reader_that_goes_away_is_no_traceback(tmp_path: Path):
    points = points_file(tmp_path)
    command = [sys.executable, "-m", "planeopt", "pose", *[str(points)] * 50, *RIG]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    assert json.loads(process.stdout.readline())["status"] == "ok"
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 1
    assert complaint == b""


def test_result_can_be_read_under_a_plain_locale(tmp_path: Path):
    path = tmp_path / "größe.csv"
    points_file(tmp_path).rename(path)
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-m", "planeopt", "pose", str(path), *RIG]
    result = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["status"] == "ok"


def test_what_is_read_is_never_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    points = points_file(tmp_path)
    content = points.read_bytes()
    assert main(["pose", str(points), *RIG, "-o", str(points), "--force"]) == 1
    one_complaint(capsys.readouterr().err, "is read in this run")
    assert points.read_bytes() == content


def test_records_of_another_formulation_are_not_continued(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    points, out = str(points_file(tmp_path)), tmp_path / "poses.jsonl"
    assert main(["pose", points, points, *RIG, "-o", str(out)]) == 0
    content = out.read_bytes()
    capsys.readouterr()
    assert main(["pose", points, points, *RIG, "-o", str(out), "--resume", "--formulation", "closed-form"]) == 1
    one_complaint(capsys.readouterr().err, "Constrained, but ClosedForm was asked for")
    assert out.read_bytes() == content
    assert not (tmp_path / "poses.jsonl.part").exists()
