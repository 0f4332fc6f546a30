"""Functions for workers, some of which end the worker that they run in: for tests only."""

import os
import signal
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def square(x: int) -> int:
    return x * x


def process_of(_: int) -> int:
    return os.getpid()


def die_once(x: int, marks: Path, worst: int) -> int:
    """Kill the worker at the worst item, the first time; the mark says that it was done."""
    time.sleep(0.01)
    mark = marks / str(x)
    if x == worst and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x * x


def die_always(x: int, worst: int) -> int:
    if x == worst:
        os.kill(os.getpid(), signal.SIGKILL)
    return x * x


def fail(x: int) -> int:
    if x == 2:
        raise ArithmeticError("two")
    return x


def array_of(x: int) -> NDArray[np.float64]:
    return np.arange(100_000.0) * x


def threads_of(_: int) -> str | None:
    return os.environ.get("OMP_NUM_THREADS")
