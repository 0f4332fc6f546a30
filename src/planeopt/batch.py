"""From a file to a pose record: one input that cannot be used costs that input and no other."""

import logging
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.executors import ordered_map
from planeopt.formulations import Formulation
from planeopt.record import PoseRecord, from_solution, input_error, refused, spot_not_found
from planeopt.rig import Rig
from planeopt.solution import Solution
from planeopt.solvers import Solver
from planeopt.spot import Spot, SpotNotFound, find_spot, read_image, read_points

_log = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one input gave, with all that led to it.

    Attributes
    ----------
    record : PoseRecord
        Always there; `error` where the input cannot be used.
    spot : Spot or None
        None where there is none.
    solution : Solution or None
        None where nothing was solved.
    """

    record: PoseRecord
    spot: Spot | None = None
    solution: Solution | None = None


def load_spot(path: StrPath, rig: Rig) -> Spot:
    """Return the spot of a file: measured in an image, read from a `.csv` of boundary points.

    Raises
    ------
    InputError
        If the file cannot be read or used.
    SpotNotFound
        If the image has no spot that can be measured.
    """
    if Path(path).suffix.lower() == ".csv":
        return read_points(path)
    image = read_image(path)
    try:
        return find_spot(image, rig, source=str(path))
    except InputError as error:
        raise InputError(_naming(path, str(error))) from error


def measure(
    path: StrPath, rig: Rig, *, formulation: Formulation | None = None, solver: Solver | None = None
) -> Measurement:
    """Find the plane that one file shows; never raises for what is wrong with the file.

    Parameters
    ----------
    path : path-like
        An image, or a `.csv` of boundary points.
    rig : Rig
        With a beam.
    formulation, solver : optional
        As in `planeopt.solve`.

    Returns
    -------
    Measurement
        Its record is `error` for a file that cannot be used, and `refused` where there is no spot, where the points lie
        outside the image, or where no plane is defensible.
    """
    name = str(path)
    try:
        spot = load_spot(path, rig)
        outside = _outside(spot, rig)
        if outside is not None:
            return Measurement(refused(name, outside, "outside_image"), spot)
        solution = solve(spot, rig, formulation=formulation, solver=solver)
    except SpotNotFound as reason:
        return Measurement(spot_not_found(name, reason))
    except InputError as error:
        return Measurement(input_error(name, _naming(path, str(error))))
    except (ArithmeticError, ValueError, np.linalg.LinAlgError, RuntimeError) as error:
        # What numerical libraries raise where nobody foresaw it. In a batch it must not cost the other inputs.
        _log.debug("%s failed", name, exc_info=True)
        return Measurement(input_error(name, _naming(path, f"the computation broke down ({_one_line(error)})")))
    return Measurement(from_solution(name, solution), spot, solution)


def measure_many(
    paths: Iterable[StrPath],
    rig: Rig,
    *,
    formulation: Formulation | None = None,
    solver: Solver | None = None,
    executor: Executor | None = None,
) -> Iterator[PoseRecord]:
    """Yield the record of each file, in the files' order, as they become ready.

    Parameters
    ----------
    paths : iterable of path-like
    rig, formulation, solver
        As in `measure`.
    executor : Executor, optional
        Where the work is done; in this process unless given.
    """
    work = partial(_record, rig=rig, formulation=formulation, solver=solver)
    return ordered_map(work, paths, executor)


def _record(path: StrPath, *, rig: Rig, formulation: Formulation | None, solver: Solver | None) -> PoseRecord:
    return measure(path, rig, formulation=formulation, solver=solver).record


def _outside(spot: Spot, rig: Rig) -> str | None:
    """Say which boundary point lies outside the camera's image, where one does: no camera can have measured it."""
    width, height = rig.camera.image_size
    # A pixel reaches half a pixel to either side of its centre, which is at an integer.
    inside = np.all((spot.points >= -0.5) & (spot.points <= np.array([width, height]) - 0.5), axis=1)
    if np.all(inside):
        return None
    worst = int(np.argmin(inside))
    x, y = spot.points[worst].tolist()
    return (
        f"The spot is not within the image: {int(np.sum(~inside))} of {len(spot)} boundary points, the first of them "
        f"({x:.6g}, {y:.6g}) px, lie outside its {width} x {height} px."
    )


def _naming(path: StrPath, message: str) -> str:
    return message if message.startswith(str(path)) else f"{path}: {message}"


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
