"""Comparisons of what files show."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

from planeopt.accuracy import Truth, truth_beside
from planeopt.batch import UNFORESEEN, measure
from planeopt.comparison.compare import Comparison, compare
from planeopt.comparison.problem import broken_down
from planeopt.errors import InputError
from planeopt.estimation.starts import StartLike
from planeopt.executors import ordered_map
from planeopt.methods import EVERY, Method
from planeopt.record import PoseRecord, input_error
from planeopt.rig import Rig


@dataclass(frozen=True, eq=False)
class FileComparison:
    """A comparison for one file.

    Attributes
    ----------
    record : PoseRecord
        Of the default method; its status and message say why there is no comparison, where there is none.
    truth : Truth or None
        Of the JSON file beside the image.
    comparison : Comparison or None
        Of one case.
    """

    record: PoseRecord
    truth: Truth | None = None
    comparison: Comparison | None = None


def compare_file(
    path: str,
    rig: Rig,
    *,
    start: StartLike | None = None,
    methods: Sequence[Method] = EVERY,
    repeats: int = 1,
) -> FileComparison:
    """Compare methods on an image or a `.csv` of boundary points; never raises for what is wrong with the file."""
    measured = measure(path, rig)
    if measured.spot is None or measured.solution is None:
        return FileComparison(measured.record)
    try:
        truth = truth_beside(path)
        compared = compare(
            measured.spot, rig, truth=truth, start=start, methods=methods, repeats=repeats, names=[str(path)]
        )
    except InputError as error:
        return FileComparison(input_error(path, str(error)))
    except UNFORESEEN as error:
        return FileComparison(input_error(path, f"{path}: {broken_down(error)}"))
    return FileComparison(measured.record, truth, compared)


def compare_files(
    paths: Iterable[str],
    rig: Rig,
    *,
    start: StartLike | None = None,
    methods: Sequence[Method] = EVERY,
    repeats: int = 1,
    executor: Executor | None = None,
) -> Iterator[FileComparison]:
    """Yield the comparison of each file, in the files' order; what is wrong with one costs that one.

    Parameters
    ----------
    paths : iterable of str
    rig : Rig
        With a beam.
    start, methods, repeats
        As in `compare`.
    executor : Executor, optional
        Where the files are worked on; in this process unless given.
    """
    work = partial(compare_file, rig=rig, start=start, methods=tuple(methods), repeats=repeats)
    return ordered_map(work, paths, executor)
