import json
import os
import subprocess
import sys
from pathlib import Path

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


def test_example_comes_with_everything_the_demo_needs():
    folder = example_folder()
    assert (folder / "session" / "session.toml").is_file()
    assert (folder / "truth_rig.toml").is_file()
    assert len(TARGETS) == 6
    assert all(target.with_suffix(".json").is_file() for target in TARGETS)
