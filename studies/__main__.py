"""Run studies: `python -m studies [NAME...] [--quick | --redraw] [--jobs N] [--dask ADDRESS] [-o DIR]`."""

import argparse
import importlib
import sys
import time
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import cast

from planeopt.errors import InputError
from planeopt.executors import workers
from studies.study import Result, Study, put_headline, write, write_words

STUDIES = (
    "paper",
    "basins",
    "swift",
    "constraints",
    "efficiency",
    "coverage",
    "image",
    "calibration",
    "design",
    "scaling",
    "many_images",
    "rig_checks",
)
RESULTS = Path(__file__).parent / "results"
INDEXES = (RESULTS.parent / "README.md", RESULTS.parents[1] / "README.md")
"""Where headlines are shown: all of them, and some."""


def main(arguments: list[str] | None = None) -> None:
    """Run the studies that are named, all unless named, and write `DIR/NAME/`."""
    parser = argparse.ArgumentParser(prog="python -m studies", description="Run studies and write their results.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(STUDIES)}; all unless named")
    ways = parser.add_mutually_exclusive_group()
    ways.add_argument("--quick", action="store_true", help="what the tests run: few draws, seconds")
    ways.add_argument(
        "--redraw", action="store_true", help="make words and figures anew from the tables that are there"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes to work in; the results do not depend on it")
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="work on a Dask cluster; local: one of this machine, --jobs wide"
    )
    parser.add_argument("-o", "--output", type=Path, default=RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    unknown = [name for name in given.names if name not in STUDIES]
    if unknown:
        parser.error(f"there is no study {unknown[0]!r}; known are {', '.join(STUDIES)}")
    with ExitStack() as opened:
        try:
            executor = opened.enter_context(workers(given.jobs, given.dask))
        except InputError as error:
            parser.error(str(error))
        for name in given.names or STUDIES:
            begun = time.perf_counter()
            result = _answer(name, given, executor)
            if given.output == RESULTS and not given.quick:
                for index in INDEXES:
                    put_headline(index, name, result.headline)
            sys.stdout.write(f"{name}: {time.perf_counter() - begun:.0f} s, {given.output / name}\n")


def _answer(name: str, given: argparse.Namespace, executor: Executor | None) -> Result:
    """Run a study, or take its tables, and write what comes of it."""
    study, folder = cast(Study, importlib.import_module(f"studies.{name}")), given.output / name
    if given.redraw:
        result = study.from_tables(folder)
        write_words(result, folder)
    else:
        result = study.run("quick" if given.quick else "full", executor)
        write(result, folder)
    return result


if __name__ == "__main__":
    main()
