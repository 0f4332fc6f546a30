"""Poses of images by several workers."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import msgspec

from planeopt.batch import measure_many
from planeopt.errors import InputError
from planeopt.example import example_folder
from planeopt.executors import LOCAL, workers
from planeopt.rig import Rig
from planeopt.simulation import frame, load_scene, render
from studies.study import Mode

IMAGES: dict[Mode, int] = {"full": 120, "quick": 4}
DISTINCT: dict[Mode, int] = {"full": 24, "quick": 2}
"""Planes among the images; the rest are the same files again."""

PROCESSES: dict[Mode, tuple[int, ...]] = {"full": (2, 4), "quick": (2,)}
CLUSTERS: dict[Mode, tuple[int, ...]] = {"full": (2,), "quick": ()}


@dataclass(frozen=True)
class WorkerRow:
    """How fast some workers are.

    Attributes
    ----------
    place : str
        In process, processes or Dask.
    workers, images : int
    start_seconds : float
        Until every worker has done its first image; zero in process.
    seconds : float
        For the images after that.
    images_per_second : float
    speed_up : float
        Over one process, without the start.
    failed : str
        Why there is no time, where there is none.
    """

    place: str
    workers: int
    images: int
    start_seconds: float
    seconds: float
    images_per_second: float
    speed_up: float
    failed: str = ""


def run_workers(mode: Mode) -> list[WorkerRow]:
    """Time one process, several processes and a Dask cluster of as many; images go to a folder of their own."""
    with tempfile.TemporaryDirectory() as folder:
        rig, paths = _images(mode, Path(folder))
        rows: list[WorkerRow] = []
        places: list[tuple[str, int, str | None]] = [("in process", 1, None)]
        places += [("processes", count, None) for count in PROCESSES[mode]]
        places += [("Dask", count, LOCAL) for count in CLUSTERS[mode]]
        for place, count, dask in places:
            try:
                rows.append(_timed(place, count, dask, paths, rig, rows))
            except InputError as reason:
                nan = float("nan")
                rows.append(WorkerRow(place, count, len(paths), nan, nan, nan, nan, str(reason)))
    return rows


def _images(mode: Mode, folder: Path) -> tuple[Rig, list[str]]:
    scene = msgspec.structs.replace(load_scene(example_folder() / "scene.toml"), frames=DISTINCT[mode])
    names = []
    for index in range(DISTINCT[mode]):
        path = folder / f"image_{index:03d}.png"
        cv2.imwrite(str(path), render(frame(scene, index)).image)
        names.append(str(path))
    return scene.rig, (names * (IMAGES[mode] // len(names) + 1))[: IMAGES[mode]]


def _timed(
    place: str, count: int, dask: str | None, paths: Sequence[str], rig: Rig, before: Sequence[WorkerRow]
) -> WorkerRow:
    begun = time.perf_counter()
    with workers(count, dask) as executor:
        # The first images build what every worker builds once.
        list(measure_many(paths[: 2 * count], rig, executor=executor))
        ready = time.perf_counter()
        records = list(measure_many(paths, rig, executor=executor))
        ended = time.perf_counter()
    refused = sum(record.status != "ok" for record in records)
    seconds = ended - ready
    rate = len(paths) / seconds
    return WorkerRow(
        place=place,
        workers=count,
        images=len(paths),
        start_seconds=0.0 if executor is None else ready - begun,
        seconds=seconds,
        images_per_second=rate,
        speed_up=rate / before[0].images_per_second if before else 1.0,
        failed=f"{refused} images have no plane" if refused else "",
    )
