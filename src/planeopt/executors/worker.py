"""What goes on in a worker process, wherever it runs, and what is said of one that died."""

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
import warnings
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from multiprocessing.process import BaseProcess
from typing import Any

ATTEMPTS = 3
"""How many worker processes may die over an item before it is given up."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Variables that say how many threads libraries take: in a worker one, as the work is spread over processes."""


class WorkerLost(BrokenExecutor):
    """Workers died over an item again and again: it takes more memory than there is, or it crashes a library."""


def answer(function: Callable[..., Any], arguments: bytes) -> bytes:
    """Call a function with what was pickled; return, pickled, whether it went well and what it returned or raised.

    Both ways are bytes, so that no executor's own idea of how to send arrays or text makes a difference.
    """
    try:
        args, kwargs = pickle.loads(arguments)
        return pickle.dumps((True, function(*args, **kwargs)))
    except Exception as error:  # noqa: BLE001 - it is raised again where the result is asked for
        return failure(error)


def failure(error: Exception) -> bytes:
    """Return what `answer` does for an exception; its traceback goes along as a note."""
    error.add_note("in a worker:\n" + "".join(traceback.format_exception(error)).rstrip())
    try:
        told = pickle.dumps((False, error))
        pickle.loads(told)
    except Exception:  # noqa: BLE001 - whatever an exception's own pickling does, the reason must arrive
        return pickle.dumps((False, RuntimeError("\n".join(traceback.format_exception(error)))))
    return told


def outcome(told: bytes) -> Any:
    """Return what the function returned, from what `answer` told; raise what it raised."""
    well, value = pickle.loads(told)
    if well:
        return value
    raise value


def start_worker() -> None:
    """Make this process a worker of the one that started it.

    The keyboard's interrupt is left to the parent, numerical warnings stay unsaid (the result says what they did),
    libraries take one thread each, and the process ends with its parent, however that ended.
    """
    settle()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def settle() -> None:
    """Leave interrupts to the parent, warnings unsaid, and one thread to each library that is not loaded yet."""
    for name in THREADS:
        os.environ.setdefault(name, "1")
    warnings.simplefilter("ignore", RuntimeWarning)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _end_with(parent: BaseProcess) -> None:
    """Wait for the parent's end and end at once: a worker that waits for work would never notice."""
    parent.join()
    os._exit(1)
