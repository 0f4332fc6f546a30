"""A Dask cluster as an executor: one that runs somewhere, or one of this machine for the time being."""

import asyncio
import logging
import math
import pickle
import platform
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from typing import TYPE_CHECKING, Any, cast

from planeopt.errors import InputError
from planeopt.executors.worker import WorkerLost, answer, outcome

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as DaskFuture

LOCAL = "local"
"""The address that means a cluster of this machine, started for the run and ended with it."""

CONNECT_S = 5.0
"""How long to wait for a scheduler to answer, and for its first worker, in seconds."""

NUMERICAL = ("planeopt", "numpy", "scipy", "casadi", "opencv-contrib-python-headless", "distributed")
"""What has to be of the same version everywhere for a cluster to give the numbers that one process gives."""

_one_at_a_time = threading.Lock()
"""Of a worker process: its libraries were not made for two items at once, however many threads the worker has."""


@contextmanager
def cluster(address: str, jobs: int = 1) -> Iterator[Executor]:
    """Open a Dask cluster as an executor.

    An item whose worker died is done again by another, as often as the scheduler's `allowed-failures` says, and then
    with no other beside it; after that the item's future raises `WorkerLost`. Workers read files themselves: the paths
    must mean the same there.

    Parameters
    ----------
    address : str
        Of a scheduler, ``tcp://HOST:PORT``; or `LOCAL`: a cluster of this machine, with no dashboard.
    jobs : int
        Workers of a local cluster, each a process with one thread.

    Raises
    ------
    InputError
        If Dask is not installed, nobody answers at the address, the cluster has no workers, or they have other
        versions than this process.
    ValueError
        If `jobs` is below 1.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, not {jobs}")
    distributed = _distributed()
    with ExitStack() as opened:
        if address == LOCAL:
            where = opened.enter_context(
                distributed.LocalCluster(
                    n_workers=jobs,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    dashboard_address=None,
                    # Without a dashboard the scheduler still speaks HTTP: at any free port, to this machine alone.
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0", "allowed_failures": 1},
                    preload=["planeopt.executors.dask_worker"],
                )
            )
        else:
            _knock(address)
            where = address
        with warnings.catch_warnings():
            # Of other versions Dask warns with a table; what matters is looked at below.
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            client = opened.enter_context(distributed.Client(where, timeout=CONNECT_S, set_as_default=False))
        if address != LOCAL:
            _check_workers(client, address)
        executor = DaskExecutor(client, address)
        opened.callback(executor.close)
        yield executor


def _distributed() -> Any:
    """Import Dask's distributed, its log left to `logging`: nobody asked for it on standard error."""
    try:
        import dask.config
    except ImportError as error:
        raise InputError('a Dask cluster needs Dask: pip install "planeopt[dask]"') from error
    if "distributed" not in sys.modules:
        # An empty change to what logging does, in place of the handlers that distributed would install.
        dask.config.set({"logging": {"version": 1, "incremental": True}})
        logging.getLogger("distributed").addHandler(logging.NullHandler())
    try:
        import distributed
    except ImportError as error:
        raise InputError('a Dask cluster needs distributed: pip install "planeopt[dask]"') from error
    return distributed


def _knock(address: str) -> None:
    """Make sure that a scheduler answers: a client that finds none takes long to give up, and says so twice."""
    from distributed.comm.core import connect

    async def knock() -> None:
        comm = await connect(address, timeout=CONNECT_S)
        await comm.close()

    try:
        # In a thread of its own: there may be an event loop in this one.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, knock()).result()
    except Exception as error:
        # Whatever answers, if anything does, it is no scheduler.
        raise InputError(
            f"--dask {address}: no Dask scheduler answers there; start one with `dask scheduler`, or use --dask {LOCAL}"
        ) from error


def _check_workers(client: "Client", address: str) -> None:
    """Refuse a cluster without workers, or with other versions than here."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        raise InputError(
            f"--dask {address}: the cluster has no workers; start some with `dask worker {address} --nthreads 1`"
        ) from error
    here = versions()
    found: dict[str, Any] = cast(dict[str, Any], client.run(versions, on_error="return"))
    for worker, there in found.items():
        if isinstance(there, Exception):
            raise InputError(
                f"--dask {address}: the worker {worker} cannot import planeopt ({there}); install planeopt "
                f"{here['planeopt']} where it runs"
            )
        other = [
            f"{name} {there.get(name)} for {version}" for name, version in here.items() if there.get(name) != version
        ]
        if other:
            raise InputError(
                f"--dask {address}: the worker {worker} has {', '.join(other)} here; the same numbers need the same "
                "versions"
            )


def versions() -> dict[str, str]:
    """Return the versions, in this process, of what the numbers depend on."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python} | {name: _version(name) for name in NUMERICAL}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "none"


@dataclass(frozen=True, eq=False)
class _Task:
    function: Callable[..., Any]
    arguments: bytes
    future: Future[Any]


class DaskExecutor(Executor):
    """An executor over a Dask client, which it leaves open.

    Of its calls only as many are at the cluster at once as this has workers: of a worker that dies Dask suspects all
    that was sent to it. A call that it gave up as the killer of workers is sent once more with no other beside it: it
    may have been its neighbour's fault. A function is sent to the cluster once, and again only when another one was
    sent between.

    Parameters
    ----------
    client : distributed.Client
    address : str
        How the user named the cluster.
    """

    def __init__(self, client: "Client", address: str):
        self._client = client
        self._address = address
        self._lock = threading.Lock()
        self._waiting: deque[_Task] = deque()
        self._suspects: deque[_Task] = deque()
        self._under_way = 0
        self._closed = False
        self._function: Callable[..., Any] | None = None
        self._sent: DaskFuture | None = None
        self._workers = 1
        self._counted = -math.inf

    @property
    def workers(self) -> int:
        """How many workers the cluster has, or had a second ago; 1 while it has none."""
        if time.monotonic() > self._counted + 1.0:
            self._workers = max(1, len(cast(dict[str, int], self._client.ncores())))
            self._counted = time.monotonic()
        return self._workers

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Queue a call; see `concurrent.futures.Executor`."""
        task = _Task(fn, pickle.dumps((args, kwargs)), Future())
        with self._lock:
            if self._closed:
                raise RuntimeError("cannot take new work after shutdown")
            self._waiting.append(task)
        self._fill()
        return task.future

    def close(self) -> None:
        """Take no new work, and cancel what waits."""
        with self._lock:
            self._closed = True
            for task in self._waiting:
                task.future.cancel()
                task.future.set_running_or_notify_cancel()
            self._waiting.clear()

    def _fill(self) -> None:
        """Send waiting calls to the cluster, one for each worker; a suspect alone."""
        try:
            room = self.workers
            with self._lock:
                if self._suspects:
                    if not self._under_way:
                        self._send(self._suspects.popleft(), alone=True)
                    return
                while self._waiting and self._under_way < room:
                    task = self._waiting.popleft()
                    if task.future.set_running_or_notify_cancel():
                        self._send(task, alone=False)
        except Exception as error:  # noqa: BLE001 - whatever Dask raises here, nothing can be sent any more
            self._give_up(_gone(self._address, error))

    def _give_up(self, reason: BrokenExecutor) -> None:
        with self._lock:
            rest = [task for task in self._waiting if task.future.set_running_or_notify_cancel()]
            for task in (*self._suspects, *rest):
                task.future.set_exception(reason)
            self._suspects.clear()
            self._waiting.clear()

    def _send(self, task: _Task, *, alone: bool) -> None:
        try:
            if task.function is not self._function:
                # The result of a task, unlike data that was scattered, is made again where its worker dies.
                self._sent = self._client.submit(pickle.loads, pickle.dumps(task.function), pure=False)
                self._function = task.function
            there = self._client.submit(_answer_alone, self._sent, task.arguments, pure=False)
        except Exception as error:  # noqa: BLE001 - it is raised again where the result is asked for
            task.future.set_exception(error)
            return
        self._under_way += 1
        there.add_done_callback(partial(self._done, task=task, alone=alone))

    def _done(self, there: "DaskFuture", task: _Task, *, alone: bool) -> None:
        """Hand over what came of a call, and send the next; Dask calls this in a thread of its own."""
        told = _told(there, self._address)
        with self._lock:
            self._under_way -= 1
            closed = self._closed
            again = isinstance(told, WorkerLost) and not alone and not closed
            if again:
                self._suspects.append(task)
        if not again:
            try:
                if isinstance(told, BrokenExecutor):
                    raise told
                task.future.set_result(outcome(told))
            except Exception as error:  # noqa: BLE001 - it is raised again where the result is asked for
                task.future.set_exception(error)
        if not closed:
            self._fill()


def _told(there: "DaskFuture", address: str) -> bytes | BrokenExecutor:
    """Return what a worker told, or why none did."""
    from distributed import KilledWorker

    try:
        return there.result()
    except KilledWorker as error:
        last = error.last_worker.address
        return WorkerLost(f"workers died over it again and again, {last} the last: for lack of memory?")
    except (asyncio.CancelledError, Exception) as error:  # noqa: BLE001 - no function's, which is a result: Dask's own
        return _gone(address, error)


def _gone(address: str, error: BaseException) -> BrokenExecutor:
    if isinstance(error, asyncio.CancelledError):
        return BrokenExecutor(f"the Dask cluster {address} is gone")
    brief = f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]
    return BrokenExecutor(f"the Dask cluster {address} is gone, or cannot do the work ({brief})")


def _answer_alone(function: Callable[..., Any], arguments: bytes) -> bytes:
    """Call the function, on a worker: one item at a time, numerical warnings unsaid as in any worker."""
    with _one_at_a_time, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return answer(function, arguments)
