"""`planeopt pose` over thousands of images: rate, memory, and interruptions. Linux, for the memory.

    python benchmarks/stream.py [--images 2000] [--jobs 2] [--dask] [--folder DIR]

It simulates images of 1280 x 1024 px, each of another plane with noise of its own, in a folder that is kept for the
next time if it is named. Then the command runs over all of them, once left alone and once ended twice: by the
keyboard's interrupt after a third, and by SIGKILL of the parent after two thirds, each time continued by --resume.
"""

import argparse
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import msgspec

from planeopt.example import example_folder
from planeopt.executors import ordered_map, processes
from planeopt.rig import save_rig
from planeopt.simulation import Scene, frame, load_scene, render

SIZE = (1280, 1024)
SECONDS_BETWEEN = 0.2


@dataclass(frozen=True)
class Run:
    """What a run took: seconds by the clock and of all cores, and its processes' largest memory together, in MB."""

    seconds: float
    processor: float
    status: int
    resident: float
    proportional: float


def scene_of(images: int) -> Scene:
    """Return the example's scene, before its camera with a larger sensor."""
    scene = load_scene(example_folder() / "scene.toml")
    camera = scene.rig.camera
    shift = [(new - old) / 2 for new, old in zip(SIZE, camera.image_size, strict=True)]
    larger = replace(camera, image_size=SIZE, cx=camera.cx + shift[0], cy=camera.cy + shift[1])
    return msgspec.structs.replace(scene, rig=replace(scene.rig, camera=larger), frames=images)


def draw(index: int, scene: Scene, folder: Path) -> str:
    """Write an image, unless it is there."""
    path = folder / f"image_{index:05d}.png"
    if not path.exists():
        written = path.with_suffix(".part.png")
        cv2.imwrite(str(written), render(frame(scene, index)).image)
        written.replace(path)
    return str(path)


def simulate(folder: Path, images: int, jobs: int) -> tuple[Path, Path]:
    """Write images, their list and their rig; return the last two."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = scene_of(images)
    save_rig(scene.rig, folder / "rig.toml")
    with processes(jobs) as executor:
        names = list(ordered_map(partial(draw, scene=scene, folder=folder), range(images), executor))
    listed = folder / "images.txt"
    listed.write_text("".join(f"{name}\n" for name in names), encoding="utf-8")
    return listed, folder / "rig.toml"


def memory(pid: int) -> tuple[float, float]:
    """Return the memory of a process and all below it, MB: with what they share counted in each, and once."""
    resident = proportional = 0.0
    for process in _below(pid):
        try:
            lines = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()
        except OSError:
            continue  # It has just ended.
        sizes = {words[0]: float(words[1]) * 1.024e-3 for line in lines if len(words := line.split()) == 3}
        resident += sizes["Rss:"]
        proportional += sizes["Pss:"]
    return resident, proportional


def _below(pid: int) -> Iterator[int]:
    yield pid
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = task.read_text(encoding="ascii").split()
        except OSError:
            continue
        for child in children:
            yield from _below(int(child))


@contextmanager
def started(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Start a command that hears interrupts, whatever this process was told to ignore."""
    process = subprocess.Popen(command, preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL))
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def run(command: list[str], part: Path, until: int | None = None, end_by: signal.Signals | None = None) -> Run:
    """Run a command, to its end or until so many records are there; then end it."""
    begun, spent = time.perf_counter(), _spent()
    largest = (0.0, 0.0)
    with started(command) as process:
        while process.poll() is None:
            now = memory(process.pid)
            largest = (max(largest[0], now[0]), max(largest[1], now[1]))
            if until is not None and end_by is not None and part.exists() and part.read_bytes().count(b"\n") >= until:
                process.send_signal(end_by)
                until = None
            time.sleep(SECONDS_BETWEEN)
        return Run(time.perf_counter() - begun, _spent() - spent, process.returncode, *largest)


def _spent() -> float:
    """Return the seconds of processor time of all processes that were waited for, and of those that they waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Simulate, measure, print."""
    parser = argparse.ArgumentParser(description="planeopt pose over thousands of images")
    parser.add_argument("--images", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--dask", action="store_true", help="workers of a local Dask cluster")
    parser.add_argument("--folder", type=Path, help="of the images; those that are there are taken")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder: Path = given.folder or Path(temporary) / "images"
        listed, rig = simulate(folder, given.images, given.jobs)
        whole, broken = Path(temporary) / "whole.jsonl", Path(temporary) / "broken.jsonl"
        pose = [sys.executable, "-m", "planeopt", "pose", "--inputs-from", str(listed), "--rig", str(rig)]
        pose += ["--jobs", str(given.jobs), *(["--dask", "local"] if given.dask else []), "-o"]
        alone = run([*pose, str(whole)], whole)
        part = Path(f"{broken}.part")
        first = run([*pose, str(broken)], part, given.images // 3, signal.SIGINT)
        left = part.read_bytes().count(b"\n")
        second = run([*pose, str(broken), "--resume"], part, 2 * given.images // 3, signal.SIGKILL)
        more = part.read_bytes().count(b"\n")
        third = run([*pose, str(broken), "--resume"], part)
        same = whole.read_bytes() == broken.read_bytes()
        counts = Counter(json.loads(line)["status"] for line in whole.read_text(encoding="ascii").splitlines())
    told = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
    where = f"{given.jobs} workers of a local Dask cluster" if given.dask else f"{given.jobs} processes"
    sys.stdout.write(
        f"{given.images} images of {SIZE[0]} x {SIZE[1]} px, {where}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}: {told}\n"
        f"uninterrupted: {alone.seconds:.1f} s, {given.images / alone.seconds:.1f} images a second, start included; "
        f"{1e3 * alone.processor / given.images:.0f} ms of processor time an image\n"
        f"largest memory of all processes together {alone.proportional:.0f} MB, {alone.resident:.0f} MB if what they "
        "share is counted for each\n"
        f"interrupted: exit status {first.status} with {left} records kept; resumed, parent killed: exit status "
        f"{second.status} with {more} records kept; resumed: exit status {third.status}\n"
        f"the same file, byte for byte: {'yes' if same else 'NO'}\n"
    )


if __name__ == "__main__":
    main()
