"""From a file to a spot or a pose, and their records: one input that cannot be used costs that input and no other."""

import logging
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.executors import WorkerLost, ordered_map
from planeopt.formulations import Formulation
from planeopt.record import PoseRecord, from_solution, input_error, refused, spot_not_found
from planeopt.rig import Rig
from planeopt.solution import Solution
from planeopt.solvers import Solver
from planeopt.spot import Kind, Spot, SpotFlag, SpotNotFound, find_spot, read_points
from planeopt.spot.files import StoredImage, load_image
from planeopt.spot.grey import to_grey
from planeopt.spot.record import SpotRecord, no_spot, spot_record, unusable

_log = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]

UNFORESEEN = (ArithmeticError, ValueError, np.linalg.LinAlgError, RuntimeError, MemoryError, cv2.error)
"""What numerical libraries raise where nobody foresaw it. In a batch it must not cost the other inputs."""


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


@dataclass(frozen=True, eq=False)
class SpotMeasurement:
    """What one image gave.

    Attributes
    ----------
    record : SpotRecord
        Always there; `error` where the image cannot be used.
    image : StoredImage or None
        None where it cannot be read.
    spot : Spot or None
        None where there is none.
    """

    record: SpotRecord
    image: StoredImage | None = None
    spot: Spot | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """How to look for a spot, beside the rig: keywords of `planeopt.find_spot`; what is None is left to it."""

    kind: Kind | None = None
    region: tuple[float, float, float, float] | None = None
    dark: NDArray[Any] | None = None
    camera_blur: float | None = None
    level: float | None = None
    channel: str | None = None
    gamma: float | None = None

    def find(self, image: StoredImage, rig: Rig | None, source: str) -> Spot:
        """Return the spot, with `SpotFlag.ENCODED` where the values are coded and no gamma says how.

        Raises
        ------
        InputError, SpotNotFound
            As `planeopt.find_spot`.
        """
        given = {field.name: value for field in fields(self) if (value := getattr(self, field.name)) is not None}
        spot = find_spot(image.pixels, rig, source=source, **given)
        linear = self.gamma in (None, 1.0) and (rig is None or rig.spot is None or rig.spot.gamma == 1.0)
        return replace(spot, flags=(*spot.flags, SpotFlag.ENCODED)) if image.encoded and linear else spot


_ANYHOW = Search()


def load_spot(path: StrPath, rig: Rig, search: Search = _ANYHOW) -> Spot:
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
    image = load_image(path)
    try:
        return search.find(image, rig, str(path))
    except InputError as error:
        raise InputError(_naming(path, str(error))) from error


def measure_spot(path: StrPath, rig: Rig | None = None, search: Search = _ANYHOW) -> SpotMeasurement:
    """Find and measure the spot in one image; never raises for what is wrong with the image.

    Parameters
    ----------
    path : path-like
        An image.
    rig : Rig, optional
        A camera alone will do.
    search : Search

    Returns
    -------
    SpotMeasurement
        Its record is `error` for an image that cannot be used and `refused` where there is no spot to measure.
    """
    name = str(path)
    image = None
    full_scale = None
    try:
        image = load_image(path)
        full_scale = to_grey(image.pixels).scale
        spot = search.find(image, rig, name)
        return SpotMeasurement(spot_record(name, spot, full_scale), image, spot)
    except SpotNotFound as reason:
        return SpotMeasurement(no_spot(name, reason, full_scale), image)
    except InputError as error:
        return SpotMeasurement(unusable(name, _naming(path, str(error))), image)
    except UNFORESEEN as error:
        return SpotMeasurement(unusable(name, _broken_down(path, error)), image)


def measure(
    path: StrPath,
    rig: Rig,
    *,
    formulation: Formulation | None = None,
    solver: Solver | None = None,
    search: Search = _ANYHOW,
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
    search : Search
        How to look for the spot in an image.

    Returns
    -------
    Measurement
        Its record is `error` for a file that cannot be used, and `refused` where there is no spot, where the points lie
        outside the image, or where no plane is defensible.
    """
    name = str(path)
    try:
        spot = load_spot(path, rig, search)
        outside = _outside(spot, rig)
        if outside is not None:
            return Measurement(refused(name, outside, "outside_image"), spot)
        solution = solve(spot, rig, formulation=formulation, solver=solver)
    except SpotNotFound as reason:
        return Measurement(spot_not_found(name, reason))
    except InputError as error:
        return Measurement(input_error(name, _naming(path, str(error))))
    except UNFORESEEN as error:
        return Measurement(input_error(name, _broken_down(path, error)))
    return Measurement(from_solution(name, solution, rig), spot, solution)


def measure_many(
    paths: Iterable[StrPath],
    rig: Rig,
    *,
    formulation: Formulation | None = None,
    solver: Solver | None = None,
    search: Search = _ANYHOW,
    executor: Executor | None = None,
) -> Iterator[PoseRecord]:
    """Yield the record of each file, in the files' order, as they become ready.

    Parameters
    ----------
    paths : iterable of path-like
    rig, formulation, solver, search
        As in `measure`.
    executor : Executor, optional
        Where the work is done; in this process unless given. A file over which its workers die again and again gives
        an `error` record with the flag `worker_lost`.
    """
    work = partial(_record, rig=rig, formulation=formulation, solver=solver, search=search)
    return ordered_map(work, paths, executor, lost=worker_lost)


def worker_lost(path: StrPath, reason: WorkerLost) -> PoseRecord:
    """Return the `error` record of a file over which workers died."""
    return PoseRecord(input=str(path), status="error", message=_naming(path, str(reason)), flags=("worker_lost",))


def _record(
    path: StrPath, *, rig: Rig, formulation: Formulation | None, solver: Solver | None, search: Search
) -> PoseRecord:
    return measure(path, rig, formulation=formulation, solver=solver, search=search).record


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


def _broken_down(path: StrPath, error: Exception) -> str:
    _log.debug("%s failed", path, exc_info=error)
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
    return _naming(path, f"the computation broke down ({said})")
