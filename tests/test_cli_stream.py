"""`planeopt pose` over many inputs: what it holds, what it keeps when it ends early, and what it continues."""

import io
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import pytest

from example_rig import RIG_FILE, TARGETS, points_file, pose_at
from planeopt import batch as room
from planeopt.cli import main, record_files
from planeopt.cli.messages import report
from planeopt.executors import WorkerLost
from planeopt.record import PoseRecord, record_from_json
from planeopt.rig import load_rig, save_rig

RIG = ["--rig", str(RIG_FILE)]
QUICK = [*RIG, "--formulation", "closed-form"]


def one_complaint(captured: str, *words: str) -> None:
    assert captured.count("\n") == 1, captured
    for word in words:
        assert word in captured


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("points")
    return [str(points_file(folder, f"{i}.csv", pose_at(200.0 + 5 * i), seed=i)) for i in range(12)]


@pytest.fixture
def left(points: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[Path, bytes]:
    """An output file to be, whose first seven records an interrupted run left; and all twelve."""
    whole, out = tmp_path / "whole.jsonl", tmp_path / "poses.jsonl"
    main(["pose", *points, *QUICK, "-o", str(whole)])
    content = whole.read_bytes()
    Path(f"{out}.part").write_bytes(b"".join(content.splitlines(keepends=True)[:7]))
    capsys.readouterr()
    return out, content


def test_inputs_from_a_file_and_from_standard_input(
    points: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    assert main(["pose", *points, *QUICK]) == 0
    expected = capsys.readouterr().out
    listed = tmp_path / "inputs.txt"
    # As editors on any system write it, with an empty line at the end.
    listed.write_bytes("\r\n".join([*points[2:], "", ""]).encode())
    assert main(["pose", *points[:2], "--inputs-from", str(listed), *QUICK]) == 0
    assert capsys.readouterr().out == expected
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO("\n".join(points).encode())))
    assert main(["pose", "--inputs-from", "-", *QUICK]) == 0
    assert capsys.readouterr().out == expected


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "nothing to measure"),
        (["--inputs-from", "empty.txt"], "nothing to measure"),
        (["--inputs-from", "none.txt"], "none.txt: cannot be read"),
        (["--inputs-from", "list.txt", "-o", "list.txt", "--force"], "list.txt: is read in this run"),
        (["--dask", "tcp://127.0.0.1:1", "--jobs", "2", "a.csv"], "its own workers"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else value,
)
def test_lists_that_cannot_be_used(
    arguments: list[str],
    word: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(tmp_path)
    Path("empty.txt").write_text("\n\n")
    Path("list.txt").write_text("a.csv\n")
    assert main(["pose", *arguments, *RIG]) == 1
    one_complaint(capsys.readouterr().err, word)
    assert Path("list.txt").read_text() == "a.csv\n"


def test_records_are_written_and_let_go(points: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # A record cannot be referred to weakly, a subclass can.
    class Watched(PoseRecord, frozen=True, weakref=True): ...

    alive: weakref.WeakSet[PoseRecord] = weakref.WeakSet()
    most = 0

    def watched(path: str, **_: object) -> PoseRecord:
        nonlocal most
        record = Watched(input=path, status="ok", message="")
        alive.add(record)
        most = max(most, len(alive))
        return record

    monkeypatch.setattr(room, "_record", watched)
    out = tmp_path / "poses.jsonl"
    assert main(["pose", *points * 10, *RIG, "-o", str(out)]) == 0
    assert out.read_bytes().count(b"\n") == 120
    # One under way and the one before, which the loops that pass them on still name.
    assert most <= 3


def test_records_kept_are_gone_through_and_not_held(left: tuple[Path, bytes], points: list[str]):
    out, _ = left
    kept = record_files.kept_records(out, points, "ClosedForm")
    assert (kept.count, kept.size) == (7, Path(f"{out}.part").stat().st_size)
    assert [number for number, _ in kept.samples] == [7]
    records = kept.records()
    assert isinstance(records, Iterator)
    assert [record.input for record in records] == points[:7]


def rig_of_radius(radius: float, folder: Path) -> list[str]:
    rig = load_rig(RIG_FILE)
    path = folder / "other.toml"
    save_rig(replace(rig, beam=replace(rig.require_beam(), radius=radius)), path)
    return ["--rig", str(path), "--formulation", "closed-form"]


@pytest.mark.parametrize("where", [".part", ""])
def test_another_rig_is_noticed(
    where: str, left: tuple[Path, bytes], points: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out, _ = left
    before = Path(f"{out}.part").rename(f"{out}{where}")
    content = before.read_bytes()
    # A ten-thousandth of the radius: nobody would see it in the records.
    other = rig_of_radius(6.0006, tmp_path)
    assert main(["pose", *points, *other, "-o", str(out), "--resume"]) == 1
    one_complaint(capsys.readouterr().err, f"{before}, line 7", "another z_L_mm", "the rig", "--force")
    assert before.read_bytes() == content
    assert {path.name for path in tmp_path.iterdir()} == {"whole.jsonl", "other.toml", before.name}


def test_the_same_rig_in_another_file_is_the_same(left: tuple[Path, bytes], points: list[str], tmp_path: Path):
    out, content = left
    assert main(["pose", *points, *rig_of_radius(6.0, tmp_path), "-o", str(out), "--resume"]) == 0
    assert out.read_bytes() == content


@pytest.mark.parametrize("option", ["--solver", "--dark"])
def test_other_options_are_noticed(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out, dark = tmp_path / "poses.jsonl", tmp_path / "dark.png"
    image = cv2.imread(str(TARGETS[0]), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    cv2.imwrite(str(dark), cv2.blur(image, (301, 301)) // 8)
    assert main(["pose", str(TARGETS[0]), *RIG, "-o", str(out)]) == 0
    changed = [option, "sqp" if option == "--solver" else str(dark)]
    assert main(["pose", *map(str, TARGETS[:2]), *RIG, *changed, "-o", str(out), "--resume"]) == 1
    one_complaint(capsys.readouterr().err, "line 1", "another", "options")


def test_inputs_that_are_gone_cannot_tell_and_are_no_hindrance(
    left: tuple[Path, bytes], points: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out, content = left
    names = [str(tmp_path / Path(name).name) for name in points]
    for old, new in zip(points[7:], names[7:], strict=True):
        Path(new).write_bytes(Path(old).read_bytes())
    part = Path(f"{out}.part")
    part.write_text(part.read_text().replace(str(Path(points[0]).parent), str(tmp_path)))
    assert main(["pose", *names, *QUICK, "-o", str(out), "--resume"]) == 0
    one_complaint(capsys.readouterr().err, "its inputs are gone", "not checked")
    assert out.read_text() == content.decode().replace(str(Path(points[0]).parent), str(tmp_path))


def test_rounding_of_another_machine_is_no_other_rig():
    one = {"z_L_mm": 240.0, "sigma": {"p": 1e-4}, "normal": [0.1, 1e-18, 0.9], "flags": ["weak"], "chi2": None}
    other = {"z_L_mm": 240.0 + 1e-9, "sigma": {"p": 1e-4}, "normal": [0.1, 0.0, 0.9], "flags": ["weak"], "chi2": None}
    assert record_files._difference(one, other) is None
    assert record_files._difference(one, one | {"z_L_mm": 240.001}) == "z_L_mm"
    assert record_files._difference(one, one | {"sigma": {"p": 2e-4}}) == "p"
    assert record_files._difference(one, one | {"flags": []}) == "flags"
    assert record_files._difference(one, one | {"chi2": 1.0}) == "chi2"


def test_an_input_over_which_workers_die_is_an_error_that_names_it(points: list[str], monkeypatch: pytest.MonkeyPatch):
    def mapped(_work: object, paths: list[str], _executor: object, *, lost) -> Iterator[PoseRecord]:
        return (lost(path, WorkerLost("a worker process died over it 3 times")) for path in paths)

    monkeypatch.setattr(room, "ordered_map", mapped)
    (record,) = room.measure_many(points[:1], load_rig(RIG_FILE))
    assert (record.status, record.flags) == ("error", ("worker_lost",))
    assert record.message == f"{points[0]}: a worker process died over it 3 times"
    assert record_from_json(record.to_json()) == record


def wait_for(condition, seconds: float = 60) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)


def test_a_run_ended_twice_and_resumed_writes_the_same_bytes(points: list[str], tmp_path: Path):
    inputs, out, whole = points * 10, tmp_path / "poses.jsonl", tmp_path / "whole.jsonl"
    listed, part = tmp_path / "inputs.txt", tmp_path / "poses.jsonl.part"
    listed.write_text("\n".join(inputs))
    command = [sys.executable, "-m", "planeopt", "pose", "--inputs-from", str(listed), *QUICK, "-o", str(out)]
    # A test run started in the background of a shell inherits interrupts ignored; a user's command has them.
    listen = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    kept = [0]
    for end_by, options in ((signal.SIGINT, ["--jobs", "2"]), (signal.SIGKILL, ["--resume"])):
        running = [*command, *options]
        process = subprocess.Popen(running, stderr=subprocess.PIPE, text=True, preexec_fn=listen)
        wait_for(lambda: part.exists() and part.read_bytes().count(b"\n") > kept[-1])
        process.send_signal(end_by)
        _, complaint = process.communicate(timeout=60)
        if end_by == signal.SIGINT:
            assert (process.returncode, complaint) == (130, "planeopt: interrupted\n")
        kept.append(part.read_bytes().count(b"\n"))
    assert 0 < kept[1] < kept[2] < len(inputs)
    assert main([*command[3:], "--resume"]) == 0
    assert main(["pose", *points, *QUICK, "-o", str(whole)]) == 0
    assert out.read_bytes() == whole.read_bytes() * 10


def test_progress_says_what_how_many_how_fast_and_how_long(monkeypatch: pytest.MonkeyPatch):
    from rich import console

    shown = io.StringIO()
    monkeypatch.setattr(console.Console, "is_terminal", True)
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TERM", "xterm")
    records = [PoseRecord(input=str(i), status="ok", message="") for i in range(6)]

    def slowly() -> Iterator[PoseRecord]:
        for record in records[2:]:
            time.sleep(0.12)
            yield record

    assert report(slowly(), 6, "pose", kept=records[:2]) == 0
    text = shown.getvalue()
    assert "pose" in text
    assert "2/6" in text
    assert "5/6" in text
    assert "/s" in text
    assert "0:00:0" in text
