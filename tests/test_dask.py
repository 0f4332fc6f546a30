"""A local Dask cluster of two workers, some of which are ended in the middle of the work."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dying import array_of, die_always, die_once, fail, square, threads_of
from example_rig import RIG_FILE, points_file, pose_at
from planeopt.cli import main
from planeopt.errors import InputError
from planeopt.executors import LOCAL, dask_cluster, ordered_map, workers
from studies import paper
from studies.study import write

pytest.importorskip("distributed")

RIG = ["--rig", str(RIG_FILE)]


@pytest.fixture(scope="module")
def pair() -> Iterator[Executor]:
    with workers(2, LOCAL) as executor:
        assert executor is not None
        yield executor


@pytest.fixture(scope="module")
def address(pair: Executor) -> str:
    """What a user reads off `dask scheduler`."""
    return pair._client.scheduler.address  # type: ignore[attr-defined]


def worker_processes() -> set[int]:
    return {child.pid for child in multiprocessing.active_children() if child.pid is not None}


class Ending(Executor):
    """Passes work on, and kills one of the workers when the first result comes."""

    def __init__(self, executor: Executor):
        self.executor = executor
        self.killed: list[int] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = self.executor.submit(fn, *args, **kwargs)
        future.add_done_callback(self.kill)
        return future

    def kill(self, _: Future[Any]) -> None:
        if not self.killed:
            self.killed.append(min(worker_processes()))
            os.kill(self.killed[0], signal.SIGKILL)


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_study_gives_the_same_files_with_a_worker_killed_in_the_middle(pair: Executor, tmp_path: Path):
    ending = Ending(pair)
    write(paper.run("quick", None), tmp_path / "serial")
    write(paper.run("quick", ending), tmp_path / "dask")
    assert len(ending.killed) == 1
    assert files_of(tmp_path / "serial") == files_of(tmp_path / "dask")


def test_pose_writes_the_same_bytes_with_a_worker_killed_in_the_middle(
    address: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    inputs = [str(points_file(tmp_path, f"{i}.csv", pose_at(200.0 + 5 * i), seed=i)) for i in range(20)] * 3
    one, two = tmp_path / "serial.jsonl", tmp_path / "dask.jsonl"
    part, killed = Path(f"{two}.part"), []

    def kill_one() -> None:
        while not (part.exists() and part.read_bytes().count(b"\n") >= 2):
            time.sleep(0.002)
        killed.append(min(worker_processes()))
        os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    assert main(["pose", *inputs, *RIG, "-o", str(two), "--dask", address]) == 0
    killer.join(5)
    assert len(killed) == 1
    assert main(["pose", *inputs, *RIG, "-o", str(one)]) == 0
    assert two.read_bytes() == one.read_bytes()
    # Neither a port nor a warning of Dask's, nor what it has to say of the worker that died.
    assert capfd.readouterr() == ("", "")


def test_order_and_results_are_those_of_one_process(pair: Executor, tmp_path: Path):
    assert list(ordered_map(square, range(40), pair)) == [x * x for x in range(40)]
    work = partial(die_once, marks=tmp_path, worst=5)
    assert list(ordered_map(work, range(12), pair)) == [x * x for x in range(12)]
    assert [path.name for path in tmp_path.iterdir()] == ["5"]


def test_an_item_over_which_workers_die_costs_none_of_the_others(pair: Executor):
    work = partial(die_always, worst=3)
    assert list(ordered_map(work, range(8), pair, lost=lambda x, _: -x)) == [0, 1, 4, -3, 16, 25, 36, 49]


def test_what_comes_back_is_as_here(pair: Executor):
    (array,) = ordered_map(array_of, [3], pair)
    # Dask's own way with arrays makes them read-only.
    assert array.flags.writeable
    assert np.array_equal(array, array_of(3))
    assert set(ordered_map(threads_of, range(4), pair)) == {"1"}
    results = ordered_map(fail, range(9), pair)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ArithmeticError, match="two"):
        next(results)


def test_what_a_running_cluster_is_refused_for(address: str, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(InputError, match="its own workers"), workers(2, address):
        pass
    monkeypatch.setattr(dask_cluster, "_version", lambda _: "0.1")
    with pytest.raises(InputError, match=r"numpy .* for 0\.1 here"), workers(dask=address):
        pass


def test_an_interrupt_at_a_terminal_is_a_line_and_leaves_nothing_behind(tmp_path: Path):
    inputs = [str(points_file(tmp_path))] * 2000
    listed, out = tmp_path / "inputs.txt", tmp_path / "poses.jsonl"
    listed.write_text("\n".join(inputs))
    command = [sys.executable, "-m", "planeopt", "pose", "--inputs-from", str(listed), *RIG, "-o", str(out)]
    listen = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen(
        [*command, "--dask", "local"], stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=listen
    )
    part = Path(f"{out}.part")
    while not (part.exists() and part.stat().st_size) and process.poll() is None:
        time.sleep(0.01)
    # A terminal sends it to all processes: Dask's must leave it to the one that asked for them.
    os.killpg(process.pid, signal.SIGINT)
    # Its workers share the pipe: it is at its end only when the last of them is gone.
    _, complaint = process.communicate(timeout=60)
    assert (process.returncode, complaint) == (130, "planeopt: interrupted\n")
    assert 0 < part.read_bytes().count(b"\n") < len(inputs)


def test_without_dask_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, "dask", None)
    assert main(["pose", str(points_file(tmp_path)), *RIG, "--dask", "local"]) == 1
    captured = capsys.readouterr()
    assert captured == ("", 'planeopt: a Dask cluster needs Dask: pip install "planeopt[dask]"\n')


def test_where_nobody_answers_one_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.2)
    assert main(["pose", str(points_file(tmp_path)), *RIG, "--dask", "tcp://127.0.0.1:1"]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("planeopt: --dask tcp://127.0.0.1:1: no Dask scheduler answers there")
    assert captured.err.count("\n") == 1
