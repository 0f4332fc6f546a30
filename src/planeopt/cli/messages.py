"""What the command line says beside its results: one line a message, on standard error."""

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PLAIN_WIDTH = 150
"""Width of tables, in characters, where nobody's terminal says how wide it is: into a file or a pipe."""


def complain(message: str) -> int:
    """Write one line to standard error and return exit status 1."""
    print(one_line(message), file=sys.stderr)  # noqa: T201 - this is where the program speaks
    return 1


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
