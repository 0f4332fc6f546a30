"""One ordered `map` over any `concurrent.futures.Executor`: in process, over processes, over a cluster."""

import multiprocessing
import os
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 32
"""How many results may be under way or waiting at once: enough to keep many workers busy, few enough to hold."""


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], executor: Executor | None = None, *, ahead: int = AHEAD
) -> Iterator[Result]:
    """Apply a function to items and yield the results in the items' order.

    Unlike `Executor.map` this takes items only as results are taken, so that endless or huge inputs need little memory.

    Parameters
    ----------
    function : callable
        Of one item. For processes it must be picklable: a module's function, or a `functools.partial` of one.
    items : iterable
    executor : Executor, optional
        Left out: each item is computed here when its result is asked for. It is used, never shut down.
    ahead : int
        Largest number of results under way or waiting.

    Yields
    ------
    The results. What the function raises for an item is raised at that item's turn; then, or when the generator is
    closed, work that has not begun is cancelled.

    Raises
    ------
    ValueError
        If `ahead` is below 1.
    """
    if ahead < 1:
        raise ValueError(f"ahead must be at least 1, not {ahead}")
    return map(function, items) if executor is None else _through(executor, function, items, ahead)


def _through(
    executor: Executor, function: Callable[[Item], Result], items: Iterable[Item], ahead: int
) -> Iterator[Result]:
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(executor.submit(function, item))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


@contextmanager
def processes(jobs: int) -> Iterator[Executor | None]:
    """Open a pool of worker processes; one job means none: `None`, for work in this process.

    Workers start afresh (spawned, not forked): CasADi and OpenCV hold threads and locks that a fork would copy half.
    They ignore the keyboard's interrupt, so that the process that started them alone decides; and end when that process
    is gone, however it ended.

    Parameters
    ----------
    jobs : int
        Number of processes, at least 1.

    Raises
    ------
    ValueError
        If `jobs` is below 1.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, not {jobs}")
    if jobs == 1:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), initializer=_start_worker)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Leave the keyboard's interrupt to the parent, and numerical warnings unsaid: the result says what they did."""
    warnings.simplefilter("ignore", RuntimeWarning)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    """Wait for the parent's end and end at once: a worker that waits for work would never notice."""
    parent.join()
    os._exit(1)
