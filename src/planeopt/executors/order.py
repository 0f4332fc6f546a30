"""The ordered `map`."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import TypeVar

from planeopt.executors.worker import WorkerLost

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 32
"""How many results may be under way or waiting at once: enough to keep many workers busy, few enough to hold."""


def ordered_map(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    executor: Executor | None = None,
    *,
    ahead: int | None = None,
    lost: Callable[[Item, WorkerLost], Result] | None = None,
) -> Iterator[Result]:
    """Apply a function to items and yield the results in the items' order.

    Unlike `Executor.map` this takes items only as results are taken, so that endless or huge inputs need little memory.

    Parameters
    ----------
    function : callable
        Of one item. For processes it must be picklable: a module's function, or a `functools.partial` of one. The
        executors of this room send it to each worker once, so whatever is large and the same for all items belongs in
        the partial.
    items : iterable
    executor : Executor, optional
        Left out: each item is computed here when its result is asked for. It is used, never shut down.
    ahead : int, optional
        Largest number of results under way or waiting; `AHEAD`, or two for each worker of the executor where these are
        more, unless given.
    lost : callable, optional
        Gives the result of an item over which workers died again and again, so that it costs none of the others.

    Yields
    ------
    The results. What the function raises for an item is raised at that item's turn; then, or when the generator is
    closed, work that has not begun is cancelled.

    Raises
    ------
    ValueError
        If `ahead` is below 1.
    WorkerLost
        At the turn of an item over which workers died, where `lost` is left out.
    """
    most = max(AHEAD, 2 * getattr(executor, "workers", 1)) if ahead is None else ahead
    if most < 1:
        raise ValueError(f"ahead must be at least 1, not {most}")
    return map(function, items) if executor is None else _through(executor, function, items, most, lost)


def _through(
    executor: Executor,
    function: Callable[[Item], Result],
    items: Iterable[Item],
    ahead: int,
    lost: Callable[[Item, WorkerLost], Result] | None,
) -> Iterator[Result]:
    waiting: deque[tuple[Item, Future[Result]]] = deque()

    def first() -> Result:
        item, future = waiting.popleft()
        try:
            return future.result()
        except WorkerLost as error:
            if lost is None:
                raise
            return lost(item, error)

    try:
        for item in items:
            waiting.append((item, executor.submit(function, item)))
            if len(waiting) >= ahead:
                yield first()
        while waiting:
            yield first()
    finally:
        for _, future in waiting:
            future.cancel()
