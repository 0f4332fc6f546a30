import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from planeopt.executors import ordered_map, processes


def square(x: int) -> int:
    return x * x


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
