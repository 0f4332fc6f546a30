"""The command line: parses, calls, prints.

A command's heavy imports happen inside it, so that help answers at once. Whatever is wrong with what the user gave ends
as one line on standard error and exit status 1.
"""

import os
import signal
import sys
import warnings
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor

from cyclopts import App, CycloptsError

from planeopt import __version__
from planeopt.cli.board import board
from planeopt.cli.calibrate import calibrate
from planeopt.cli.check import check
from planeopt.cli.clock import now
from planeopt.cli.compare import compare
from planeopt.cli.demo import demo
from planeopt.cli.design import design
from planeopt.cli.export import export
from planeopt.cli.import_ import import_
from planeopt.cli.messages import complain
from planeopt.cli.pose import pose
from planeopt.cli.recalibrate import recalibrate
from planeopt.cli.report import report
from planeopt.cli.reproduce import reproduce
from planeopt.cli.simulate import simulate
from planeopt.cli.spot import spot
from planeopt.errors import InputError

INTERRUPTED = 130
"""What shells report for a process ended by the keyboard's interrupt: 128 and the number of SIGINT."""

TERMINATED = 143
"""The same for SIGTERM, with which systems, containers and time limits end a process."""


class Termination:
    """A handler of SIGTERM: the same as an interrupt, so that everything tidies up, but known to be none."""

    asked = False

    def __call__(self, *_: object) -> None:
        """Note that the process is to end, and interrupt it."""
        self.asked = True
        raise KeyboardInterrupt


def build_app() -> App:
    """Return the application with all its commands."""
    app = App(
        name="planeopt",
        help="Measure a plane with one camera and one cylindrical laser beam.",
        version=__version__,
        suppress_keyboard_interrupt=False,
    )
    for command in (demo, board, calibrate, check, recalibrate, spot, pose, report, compare, design):
        app.command(command)
    for command in (reproduce, simulate, export):
        app.command(command)
    app.command(import_, name="import")
    return app


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; `sys.argv` unless given.

    Returns
    -------
    int
        Exit status: 0 ok; 1 something given cannot be used; 2 a pose is degraded or refused; 130 interrupted;
        143 terminated.
    """
    termination = Termination()
    if arguments is None:
        # As a program: an overflow in an absurd input ends in a refusal, and a line of NumPy's source would not help.
        warnings.simplefilter("ignore", RuntimeWarning)
        # Who calls this from a program of their own keeps their handlers, and who started this one may have ignored it.
        if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, termination)
    try:
        now()  # NumPy looks at the environment's time too when it is imported, and breaks down over a bad one.
        status = build_app()(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        return complain(f"{error} See planeopt --help.")
    except InputError as error:
        return complain(str(error))
    except BrokenExecutor as error:
        return complain(str(error))
    except BrokenPipeError:
        # Whoever read the output has gone. Python would fail again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return complain(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        complain("terminated" if termination.asked else "interrupted")
        return TERMINATED if termination.asked else INTERRUPTED
    return status or 0
