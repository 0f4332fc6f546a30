import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

import planeopt
from example_rig import RIG_FILE, TARGETS, points_file
from planeopt.cli import main
from planeopt.example import example_folder

RIG = ["--rig", str(RIG_FILE)]
HEAVY = ("numpy", "casadi", "scipy", "cv2", "matplotlib", "msgspec")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "planeopt", *arguments], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["pose", "--help"], ["compare", "--help"], []])
def test_help_loads_nothing_heavy(arguments: list[str]):
    script = (
        "import json, sys; from planeopt.cli import main; status = main(json.loads(sys.argv[1]));"
        "sys.stderr.write(json.dumps([status, [name for name in sys.argv[2:] if name in sys.modules]]))"
    )
    command = [sys.executable, "-c", script, json.dumps(arguments), *HEAVY]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(result.stderr) == [0, []]


def test_help_names_the_commands_and_version_is_the_packages():
    shown = run("--help")
    assert shown.returncode == 0
    assert all(command in shown.stdout for command in ("pose", "compare", "demo", "reproduce"))
    assert run("--version").stdout.strip() == planeopt.__version__


@pytest.mark.parametrize(
    "arguments",
    [["nonsense"], ["--nonsense"], ["pose"], ["pose", "a.png"], ["compare", *RIG], ["demo", "surplus"]],
    ids=" ".join,
)
def test_misuse_is_one_line_and_status_1(arguments: list[str], capsys: pytest.CaptureFixture[str]):
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("planeopt: ")


def test_misuse_in_a_process_of_its_own():
    result = run("pose", "nothing.png", "--rig", "nothing.toml")
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr == "planeopt: nothing.toml: there is no such file\n"


def test_public_names_are_all_there_and_none_is_loaded_before_it_is_used():
    script = f"import sys, planeopt; print([n for n in {HEAVY!r} if n in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", script], text=True) == "[]\n"
    assert [name for name in planeopt.__all__ if not hasattr(planeopt, name)] == []
    assert set(planeopt.__all__) <= set(dir(planeopt))
    with pytest.raises(AttributeError, match="nonsense"):
        planeopt.nonsense  # noqa: B018 - the access is the test


def test_existing_folder_is_refused_without_force_and_kept_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    compare = ["compare", str(points_file(tmp_path)), *RIG, "-o", str(out)]
    for command in (compare, ["demo", "-o", str(out)]):
        assert main(command) == 1
        assert capsys.readouterr().err.count("\n") == 1
        assert [path.name for path in out.iterdir()] == ["notes.txt"]
    assert main([*compare, "--force"]) == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert (out / "comparison.csv").exists()


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_output_folder_that_is_a_file(force: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "file"
    path.write_text("mine")
    assert main(["demo", "-o", str(path), *force]) == 1
    assert main(["demo", "-o", str(path / "below"), *force]) == 1
    assert capsys.readouterr().err.count("\n") == 2
    assert path.read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_output_folder_without_permission(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tmp_path.chmod(0o500)
    assert main(["demo", "-o", str(tmp_path / "below")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_compare_prints_every_method_and_writes_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "compared"
    assert main(["compare", str(TARGETS[3]), *RIG, "-o", str(out)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    for method in ("Constrained + Ipopt", "Constrained(paper) + Sqp", "Penalty + Swift", "ClosedForm", "AsPrinted"):
        assert method in captured.out
    assert "laser block rank 1" in captured.out
    (entry,) = json.loads((out / "comparison.json").read_text())
    assert entry["record"]["status"] == "ok"
    with (out / "comparison.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["formulation"] for row in rows] == [row["formulation"] for row in entry["rows"]]
    assert float(rows[0]["z_L_mm"]) == entry["rows"][0]["z_L_mm"]
    assert rows[-1]["z_L_mm"] == ""
    assert float(rows[0]["residual (15) mm^2"]) == entry["rows"][0]["residuals"]["(15) mm^2"]
    assert abs(float(rows[0]["z_L_error_mm"])) < 0.1


def test_compare_goes_on_after_a_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    good, bad = points_file(tmp_path), tmp_path / "none.csv"
    assert main(["compare", str(bad), str(good), *RIG]) == 1
    captured = capsys.readouterr()
    assert captured.err == f"planeopt: {bad}: there is no such file of boundary points\n"
    assert str(good) in captured.out.replace("\n", "")


def test_compare_without_a_spot_is_status_2_and_still_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    black, out = tmp_path / "black.png", tmp_path / "out"
    cv2.imwrite(str(black), 0 * cv2.imread(str(TARGETS[0]), cv2.IMREAD_GRAYSCALE))  # type: ignore[operator] - it is there
    assert main(["compare", str(black), *RIG, "-o", str(out)]) == 2
    assert "refused" in capsys.readouterr().err
    (entry,) = json.loads((out / "comparison.json").read_text())
    assert entry["rows"] == []


def test_example_comes_with_everything_the_demo_needs():
    folder = example_folder()
    assert (folder / "session" / "session.toml").is_file()
    assert (folder / "truth_rig.toml").is_file()
    assert len(TARGETS) == 6
    assert all(target.with_suffix(".json").is_file() for target in TARGETS)
