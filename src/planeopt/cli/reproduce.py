"""`planeopt reproduce`: the paper."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from planeopt.cli.files import output_folder
from planeopt.cli.messages import tables


def reproduce(
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Reproduce the paper: its Tables 1 and 2, its result, its figures and its misprints.

    Parameters
    ----------
    output
        Folder for the figures.
    force
        Write into an existing folder.
    """
    from planeopt.reproduction import reproduce as reproduce_paper

    if output is None:
        reproduce_paper(None, tables())
    else:
        with output_folder(output, force=force) as folder:
            reproduce_paper(folder, tables())
    return 0
