import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest

from dying import die_always, die_once, fail, square, threads_of
from planeopt.executors import WorkerLost, ordered_map, pool, processes


def slow_first(x: int) -> int:
    time.sleep(0.05 if x == 0 else 0.0)
    return x


def test_order_is_kept_when_the_first_is_slowest():
    with ThreadPoolExecutor(4) as pool:
        assert list(ordered_map(slow_first, range(40), pool, ahead=8)) == list(range(40))


def test_in_process_and_processes_agree():
    with processes(1) as here, processes(2) as there:
        assert here is None
        assert list(ordered_map(square, range(9), here)) == list(ordered_map(square, range(9), there))


@pytest.mark.parametrize("ahead", [1, 3])
def test_items_are_taken_only_a_bounded_number_ahead(ahead: int):
    taken: list[int] = []

    def endless() -> Iterator[int]:
        x = 0
        while True:
            taken.append(x)
            yield x
            x += 1

    with ThreadPoolExecutor(2) as pool:
        results = ordered_map(square, endless(), pool, ahead=ahead)
        assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
        assert len(taken) <= 5 + ahead


def test_what_one_item_raises_comes_at_its_turn_and_cancels_the_rest():
    begun: list[int] = []
    gate = threading.Event()

    def fail_at_two(x: int) -> int:
        begun.append(x)
        if x == 2:
            raise ArithmeticError("two")
        if x > 2:
            gate.wait(5)
        return x

    with ThreadPoolExecutor(1) as pool:
        results = ordered_map(fail_at_two, range(100), pool, ahead=20)
        assert [next(results), next(results)] == [0, 1]
        with pytest.raises(ArithmeticError):
            next(results)
        gate.set()
    # Item 3 may have been begun before the failure was seen; nothing after it.
    assert max(begun) <= 3


def test_closing_early_cancels_what_has_not_begun():
    gate, begun = threading.Event(), []

    def wait(x: int) -> int:
        begun.append(x)
        if x:
            gate.wait(5)
        return x

    with ThreadPoolExecutor(1) as pool:
        results = ordered_map(wait, range(50), pool, ahead=10)
        assert next(results) == 0
        results.close()  # type: ignore[attr-defined] - a generator, where there is an executor
        gate.set()
    assert max(begun) <= 1


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="the system has no signal that nobody can handle")
def test_workers_end_with_a_parent_that_was_killed():
    program = (
        "import os, time\n"
        "from planeopt.executors import processes\n"
        "with processes(2) as pool:\n"
        "    print(pool.submit(os.getpid).result(), flush=True)\n"
        "    time.sleep(60)\n"
    )
    # Python's tracker of semaphores remarks that some were left: by a process that was killed they have to be.
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    assert int(process.stdout.readline()) != process.pid
    process.kill()
    # Workers share the pipe: it is at its end only when the last of them is gone.
    rest, _ = process.communicate(timeout=30)
    assert rest == ""


def test_nonsense_is_refused_at_once():
    with pytest.raises(ValueError, match="ahead"):
        ordered_map(square, [1], ahead=0)
    with pytest.raises(ValueError, match="jobs"), processes(0):
        pass


class Counted:
    """A function that counts how often it is sent."""

    sent = 0

    def __call__(self, x: int) -> int:
        return x + 1

    def __reduce__(self):
        Counted.sent += 1
        return Counted, ()


@pytest.fixture(scope="module")
def pair() -> Iterator[Executor]:
    with processes(2) as pool:
        assert pool is not None
        yield pool


def test_a_worker_that_dies_costs_a_retry(pair: Executor, tmp_path: Path):
    work = partial(die_once, marks=tmp_path, worst=5)
    assert list(ordered_map(work, range(12), pair)) == [x * x for x in range(12)]
    assert [path.name for path in tmp_path.iterdir()] == ["5"]


def test_an_item_over_which_workers_die_costs_none_of_the_others(pair: Executor):
    work = partial(die_always, worst=3)
    assert list(ordered_map(work, range(8), pair, lost=lambda x, _: -x)) == [0, 1, 4, -3, 16, 25, 36, 49]
    results = ordered_map(work, range(2, 5), pair)
    assert next(results) == 4
    with pytest.raises(WorkerLost, match="3 times"):
        next(results)


def test_where_every_item_kills_workers_none_is_believed_in(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pool, "IN_A_ROW", 1)
    monkeypatch.setattr(pool, "ATTEMPTS", 1)
    lost: list[int] = []
    with pytest.raises(BrokenExecutor, match="one after the other"), processes(2) as dying:
        for _ in ordered_map(partial(die_always, worst=1), [1] * 20, dying, lost=lambda x, _: lost.append(x)):
            pass
    # Two workers had begun an item each before the first loss was known.
    assert len(lost) <= 2


def test_a_function_is_sent_to_each_worker_once(pair: Executor):
    Counted.sent = 0
    work = Counted()
    assert list(ordered_map(work, range(30), pair)) == list(range(1, 31))
    assert 1 <= Counted.sent <= 2


def test_what_a_worker_raises_says_where(pair: Executor):
    results = ordered_map(fail, range(9), pair)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ArithmeticError, match="two") as raised:
        next(results)
    assert "in fail" in raised.value.__notes__[0]


def test_what_cannot_be_sent_is_told_at_its_turn(pair: Executor, monkeypatch: pytest.MonkeyPatch):
    results = ordered_map(repr, [1, threading.Lock(), 3], pair)
    assert next(results) == "1"
    with pytest.raises(TypeError, match="lock"):
        next(results)
    module = ModuleType("only_here")
    exec("def double(x): return 2 * x", module.__dict__)
    monkeypatch.setitem(sys.modules, "only_here", module)
    with pytest.raises(ModuleNotFoundError, match="only_here"):
        next(ordered_map(module.double, [4], pair))
    assert list(ordered_map(square, [4], pair)) == [16]


def interrupted_at_work(under_way: list[Future]) -> None:
    with processes(2) as workers:
        assert workers is not None
        under_way.append(workers.submit(time.sleep, 60))
        under_way.extend(workers.submit(time.sleep, 60) for _ in range(40))
        while not under_way[0].running():
            time.sleep(0.001)
        raise KeyboardInterrupt


def test_an_exception_ends_what_is_under_way():
    begun, under_way = time.monotonic(), list[Future]()
    with pytest.raises(KeyboardInterrupt):
        interrupted_at_work(under_way)
    assert time.monotonic() - begun < 30
    assert isinstance(under_way[0].exception(10), BrokenExecutor)
    assert under_way[-1].cancelled()


def test_workers_take_one_thread_each(pair: Executor):
    assert list(ordered_map(threads_of, [0, 1], pair)) == ["1", "1"]


def test_many_workers_are_all_kept_busy():
    class Wide(ThreadPoolExecutor):
        workers = 50

    taken: list[int] = []
    with Wide(1) as pool:
        next(ordered_map(square, iter(lambda: taken.append(1) or 0, None), pool))
    assert len(taken) == 100
