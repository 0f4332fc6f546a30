"""`planeopt simulate`: images of a scene, with the truth beside each."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.types import PositiveInt

from planeopt.cli.files import output_folder
from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.simulation import Scene

RIG, SCENE = "rig.toml", "scene.toml"


def simulate(
    scene: Path,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    seed: Annotated[int | None, Parameter()] = None,
    frames: PositiveInt | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Render a scene: images of the spot (image_0001.png ...), each with its true pose (image_0001.json).

    The rig is written beside them (rig.toml), and the scene with all its keys (scene.toml), which gives the same images
    again. With laser_off in the scene there is an image without laser for each (dark_0001.png ...).

    A scene with a [board] in place of a [plane] gives a session for `planeopt calibrate`: views of the board with the
    spot on it (view_01.png ...), session.toml, board.toml, and the truth (truth_rig.toml, truth_board_poses.json).

    Parameters
    ----------
    scene
        The scene file (scene.toml).
    output
        Folder for the images.
    seed
        Of all that is random, instead of the scene's.
    frames
        How many images, instead of the scene's number.
    force
        Write into an existing folder.
    """
    import msgspec

    from planeopt.simulation import is_board_scene, load_scene, scene_sources

    if seed is not None and seed < 0:
        raise InputError(f"--seed must not be negative, but is {seed}")
    if is_board_scene(scene):
        _session(scene, output, seed, frames, force=force)
        return 0
    loaded = load_scene(scene)
    changes = {name: value for name, value in (("seed", seed), ("frames", frames)) if value is not None}
    loaded = msgspec.structs.replace(loaded, **changes)
    _keep(scene_sources(scene), output, (RIG, SCENE))
    with output_folder(output, force=force) as folder:
        try:
            _write(loaded, folder)
        except InputError as error:
            raise InputError(f"{scene}: {error}") from error
    return 0


def _keep(sources: list[Path], output: Path, names: tuple[str, ...]) -> None:
    """Refuse to write over what is read."""
    written = {(output / name).resolve() for name in names}
    for source in sources:
        if source.resolve() in written:
            raise InputError(
                f"{source}: is read in this run and would be written over; name another folder than {output}"
            )


def _session(scene: Path, output: Path, seed: int | None, views: int | None, *, force: bool) -> None:
    """Render a session of board views."""
    from dataclasses import replace

    from planeopt.simulation import board_scene_sources, load_board_session
    from planeopt.simulation.board_files import BOARD, SESSION, TRUE_POSES, TRUE_RIG, write_session

    loaded = load_board_session(scene)
    if seed is not None:
        loaded = replace(loaded, seed=seed)
    if views is not None:
        loaded = replace(loaded, shooting=replace(loaded.shooting, views=views))
    _keep(board_scene_sources(scene), output, (SESSION, BOARD, TRUE_RIG, TRUE_POSES))
    with output_folder(output, force=force) as folder:
        try:
            write_session(loaded.scene, loaded.poses(), folder, seed=loaded.seed, laser_off=loaded.laser_off)
        except InputError as error:
            raise InputError(f"{scene}: {error}") from error


def _write(scene: "Scene", folder: Path) -> None:
    import cv2
    from rich.console import Console
    from rich.progress import track

    from planeopt.rig import save_rig
    from planeopt.simulation import frame, render, save_scene

    digits = max(4, len(str(scene.frames)))
    frames = range(scene.frames)
    # Only where someone watches: a bar that is disabled leaves an empty line behind, in rich's older versions.
    watched = track(frames, "images", console=Console(stderr=True), transient=True) if sys.stderr.isatty() else frames
    for index in watched:
        single = frame(scene, index)
        number = f"{index + 1:0{digits}d}"
        shot = render(single, name=f"image_{number}.png")
        images = {f"image_{number}.png": shot.image}
        if scene.laser_off:
            images[f"dark_{number}.png"] = render(single, laser=False).image
        for name, image in images.items():
            _, encoded = cv2.imencode(".png", image)
            (folder / name).write_bytes(encoded.tobytes())
        (folder / f"image_{number}.json").write_text(f"{shot.truth.to_json()}\n", encoding="ascii")
    save_rig(scene.rig, folder / RIG)
    save_scene(scene, folder / SCENE, RIG)
