"""`planeopt reproduce`: compute, print, and where a folder is given draw and write."""

from pathlib import Path

from rich.console import Console

from planeopt.reproduction import tables
from planeopt.reproduction.results import Reproduction, compute


def reproduce(out: Path | None, console: Console) -> Reproduction:
    """Reproduce the paper.

    Parameters
    ----------
    out : Path or None
        Folder for ``figure4``, ``figure5`` and ``figure7`` (.png and .svg) and ``reproduce.json``; made where missing.
        None to print only.
    console : rich.console.Console
        Takes the tables.

    Returns
    -------
    Reproduction
        All that was printed, as numbers.
    """
    result = compute()
    for part in tables.all_parts(result):
        console.print(part)
    if out is not None:
        # matplotlib takes half a second to import; printing alone does not need it.
        from planeopt.reproduction import files

        for path in files.write(result, out):
            console.print(f"wrote {path.name}", highlight=False)
    return result
