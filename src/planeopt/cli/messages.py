"""What the command line says beside its results: one line a message, on standard error."""

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID

PLAIN_WIDTH = 150
"""Width of tables, in characters, where nobody's terminal says how wide it is: into a file or a pipe."""


class Record(Protocol):
    """What a command writes for each input."""

    @property
    def input(self) -> str: ...

    @property
    def status(self) -> str: ...

    @property
    def message(self) -> str: ...


def complain(message: str) -> int:
    """Write one line to standard error and return exit status 1."""
    remark(message)
    return 1


def remark(message: str) -> None:
    """Write one line to standard error."""
    print(one_line(message), file=sys.stderr)  # noqa: T201 - this is where the program speaks


def one_line(message: str) -> str:
    """Return the program's name and the message on one line, whatever a file's name or a library put into it."""
    return f"planeopt: {' '.join(message.splitlines())}"


def exit_status(statuses: Iterable[str]) -> int:
    """Return 1 if any record is an error, else 2 if any is degraded or refused, else 0."""
    found = set(statuses)
    if "error" in found:
        return 1
    return 2 if found & {"degraded", "refused"} else 0


def tables() -> "Console":
    """Return the console for tables: standard output, wide enough where it is no terminal."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def report(
    records: Iterable[Record], total: int, task: str, *, kept: Iterable[Record] = (), quiet: bool = False
) -> int:
    """Go through records as they come: progress where someone watches, what is wrong with which input, exit status.

    Parameters
    ----------
    records : iterable of Record
    total : int
        How many there will be.
    task : str
        What the progress bar is called.
    kept : iterable of Record
        Those that an earlier run left: counted and told of like the others, before them, but no part of the pace.
    quiet : bool
        No progress bar, even at a terminal.
    """
    from rich.console import Console

    console = Console(stderr=True)
    counts: Counter[str] = Counter()
    last = None

    def tell(record: Record) -> None:
        counts[record.status] += 1
        if record.status == "error":
            _say(console, record.message)

    for last in kept:
        tell(last)
    with _bar(console, task, total, done=counts.total(), quiet=quiet) as advance:
        for last in records:
            tell(last)
            advance()
    if last is not None and (counts["degraded"] or counts["refused"]):
        tally = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
        alone = f"{last.input}: {last.status}: {last.message}"
        _say(console, alone if total == 1 else f"{total} inputs: {tally}; each record's message says why")
    return exit_status(counts)


@contextmanager
def _bar(console: "Console", task: str, total: int, *, done: int, quiet: bool) -> Iterator[Callable[[], None]]:
    """Yield what to call after each step: it moves a bar where someone watches, and does nothing elsewhere."""
    from planeopt.cli.progress import bar

    if quiet or not console.is_terminal:
        # A bar that is disabled leaves an empty line behind where there is no terminal, in rich's older versions.
        yield lambda: None
        return
    with bar(console) as progress:
        # What was done before counts as done, but says nothing of the pace.
        number = progress.add_task(task, total=total, completed=done)
        yield lambda: progress.advance(number)


@contextmanager
def doing(what: str) -> Iterator[None]:
    """Say what is being done, where someone watches, until it is done."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(what):
        yield


@contextmanager
def stages() -> Iterator[Callable[[str, int, int], None]]:
    """Yield what to call with a stage's name and how many of how many of its parts are done.

    It moves a bar for each stage where someone watches, and does nothing elsewhere.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda *_: None
        return
    with Progress(console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as progress:
        bars: dict[str, TaskID] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=total)
            progress.update(bars[stage], completed=done, total=total)

        yield tell


def _say(console: "Console", message: str) -> None:
    console.print(one_line(message), markup=False, emoji=False, highlight=False, soft_wrap=True)
