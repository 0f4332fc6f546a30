"""Worker processes on this machine, replaced when they die."""

import logging
import multiprocessing
import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from typing import Any

from planeopt.executors.worker import ATTEMPTS, WorkerLost, answer, outcome, start_worker

_log = logging.getLogger(__name__)

IN_A_ROW = 5
"""How many items may be lost one after the other, with none done between, before no worker is believed in any more."""


@contextmanager
def processes(jobs: int) -> Iterator[Executor | None]:
    """Open a pool of worker processes; one job means none: `None`, for work in this process.

    Workers start afresh (spawned, not forked): CasADi and OpenCV hold threads and locks that a fork would copy half.
    They ignore the keyboard's interrupt, so that the process that started them alone decides; and end when that process
    is gone, however it ended. A worker that dies is replaced and its item done again, `ATTEMPTS` times in all; then the
    item's future raises `WorkerLost`. When the block is left by an exception, work under way is ended at once.

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
    pool = Pool(jobs)
    try:
        yield pool
    except BaseException:
        pool.abandon()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True, eq=False)
class _Task:
    function: Callable[..., Any]
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    future: Future[Any]


class _WorkerDied(Exception):  # noqa: N818 - said between two functions of this file
    """The worker's end of the pipe is closed."""


class Pool(Executor):
    """An executor over worker processes, each served by a thread: so it is known which item a worker died over.

    A function is sent to a worker once, and again only when another one was sent between.

    Parameters
    ----------
    workers : int
        Number of processes; each starts with its first item.
    """

    def __init__(self, workers: int):
        self.workers = workers
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._closed = False
        self._abandoned = False
        self._lost_in_a_row = 0
        self._alive: set[_Worker] = set()
        self._threads = [threading.Thread(target=self._serve, daemon=True) for _ in range(workers)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Queue a call; see `concurrent.futures.Executor`."""
        with self._lock:
            if self._closed:
                raise RuntimeError("cannot take new work after shutdown")
            future: Future[Any] = Future()
            self._tasks.put(_Task(fn, args, kwargs, future))
            return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no new work; see `concurrent.futures.Executor`."""
        with self._lock:
            first, self._closed = not self._closed, True
        if cancel_futures:
            self._cancel()
        if first:
            for _ in self._threads:
                self._tasks.put(None)
        if wait:
            for thread in self._threads:
                thread.join()

    def abandon(self) -> None:
        """End all workers at once, and the work under way with them."""
        with self._lock:
            self._abandoned = True
            for worker in self._alive:
                worker.kill()
        self.shutdown(wait=False, cancel_futures=True)

    def _cancel(self) -> None:
        """Cancel what waits; the orders to stop stay in the queue."""
        stops = 0
        try:
            while True:
                task = self._tasks.get_nowait()
                if task is None:
                    stops += 1
                else:
                    task.future.cancel()
                    task.future.set_running_or_notify_cancel()
        except Empty:
            for _ in range(stops):
                self._tasks.put(None)

    def _serve(self) -> None:
        """Do one task after the other with a worker of one's own, until told to stop."""
        worker: _Worker | None = None
        while (task := self._tasks.get()) is not None:
            if task.future.set_running_or_notify_cancel():
                worker = self._do(task, worker)
        if worker is not None:
            self._dismiss(worker)

    def _do(self, task: _Task, worker: "_Worker | None") -> "_Worker | None":
        """Do a task, with new workers where they die; return the worker to go on with."""
        for attempt in range(1, ATTEMPTS + 1):
            try:
                worker = worker or self._hire()
                result = worker.call(task)
            except _WorkerDied as death:
                if worker is not None:
                    worker.kill()
                    self._dismiss(worker)
                    worker = None
                _log.info("a worker died (%s), time %d for its item", death, attempt)
            except Exception as error:  # noqa: BLE001 - it is raised again where the result is asked for
                self._lost_in_a_row = 0
                task.future.set_exception(error)
                return worker
            else:
                self._lost_in_a_row = 0
                task.future.set_result(result)
                return worker
            if self._abandoned or self._lost_in_a_row >= IN_A_ROW:
                task.future.set_exception(
                    BrokenExecutor(
                        "worker processes die one after the other, for lack of memory perhaps: try fewer --jobs"
                    )
                )
                return None
        self._lost_in_a_row += 1
        task.future.set_exception(WorkerLost(f"a worker process died over it {ATTEMPTS} times: for lack of memory?"))
        return None

    def _hire(self) -> "_Worker":
        with self._lock:
            if self._abandoned:
                raise _WorkerDied("abandoned")
            worker = _Worker()
            self._alive.add(worker)
            return worker

    def _dismiss(self, worker: "_Worker") -> None:
        with self._lock:
            self._alive.discard(worker)
        worker.close()


class _Worker:
    """A worker process as its parent sees it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._function: Callable[..., Any] | None = None

    def call(self, task: _Task) -> Any:
        """Return what the task's function returns there; raise what it raises, or `_WorkerDied`."""
        new = task.function is not self._function
        function = pickle.dumps(task.function) if new else None
        message = pickle.dumps((function, pickle.dumps((task.args, task.kwargs))))
        # Held only once it is known to be there, and held at all so that no other function takes its identity.
        self._function = None
        try:
            self._pipe.send_bytes(message)
            told = self._pipe.recv_bytes()
        except (EOFError, OSError) as error:
            self._process.join(1.0)
            raise _WorkerDied(f"exit status {self._process.exitcode}") from error
        self._function = task.function
        return outcome(told)

    def kill(self) -> None:
        self._process.kill()

    def close(self) -> None:
        """Let the worker end: it waits for work alone, or is dead."""
        self._pipe.close()
        self._process.join()
        self._process.close()


def _work(pipe: Connection) -> None:
    """Answer calls until the pipe's other end is closed; the process's main function."""
    start_worker()
    kept: Callable[..., Any] | None = None
    try:
        while True:
            function, arguments = pickle.loads(pipe.recv_bytes())
            try:
                kept = kept if function is None else pickle.loads(function)
            except Exception as error:  # noqa: BLE001 - it is told, as what the call raised
                kept = partial(_refuse, error)
            assert kept is not None, "a worker's first call comes with its function"
            pipe.send_bytes(answer(kept, arguments))
    except (EOFError, OSError):
        return


def _refuse(error: Exception, *_: object, **__: object) -> None:
    raise error
