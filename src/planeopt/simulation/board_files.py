"""A simulated session as a folder, as a camera would leave it, with the truth beside it."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from planeopt.board import SpotOnBoard, save_board
from planeopt.rig import save_rig
from planeopt.simulation.board_render import BoardScene, render_board
from planeopt.simulation.board_views import BoardPoses
from planeopt.toml_files import FORMAT
from planeopt.whole_files import write_text, write_whole

SESSION, BOARD, TRUE_RIG, TRUE_POSES = "session.toml", "board.toml", "truth_rig.toml", "truth_board_poses.json"


def view_name(index: int, count: int) -> str:
    """Return the name of a view's image, without its suffix; index from 0."""
    return f"view_{index + 1:0{max(2, len(str(count)))}d}"


def write_session(
    scene: BoardScene, poses: BoardPoses, folder: str | os.PathLike[str], *, seed: int = 0, laser_off: bool = False
) -> Path:
    """Render a session into a folder: its images, `session.toml`, `board.toml` and the truth.

    The truth is `truth_rig.toml`, and in `truth_board_poses.json` each view's `rvec` (rad) and `tvec` (mm), from the
    board frame to the camera frame, and the board's `warp_mm`.

    Parameters
    ----------
    scene : BoardScene
    poses : BoardPoses
    folder : path-like
        Made if it is not there; files of the same names are written over.
    seed : int
        Of all that is random; the same seed gives the same bytes.
    laser_off : bool
        Whether each view has a twin without laser, `dark_01.png` for `view_01.png`.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If a view cannot be rendered, or a file cannot be written.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    truth = {}
    for index, (rotation, translation) in enumerate(zip(poses.rotations, poses.translations, strict=True)):
        own = int(np.random.SeedSequence((seed, index)).generate_state(1, np.uint32)[0])
        name = view_name(index, len(poses))
        _write_png(target / f"{name}.png", render_board(scene, rotation, translation, seed=own))
        if laser_off:
            dark = render_board(scene, rotation, translation, laser=False, seed=own)
            _write_png(target / f"{name.replace('view', 'dark')}.png", dark)
        rvec = Rotation.from_matrix(rotation).as_rotvec()
        truth[name] = {"rvec": rvec.tolist(), "tvec": translation.tolist()}
    save_board(scene.board, target / BOARD)
    save_rig(scene.rig, target / TRUE_RIG)
    write_text(target / TRUE_POSES, json.dumps({"warp_mm": list(scene.warp), "views": truth}, indent=1) + "\n")
    spot: SpotOnBoard = "none" if scene.rig.beam is None else "ring" if scene.beam.kind == "ring" else "disc"
    session: dict[str, object] = {"format": FORMAT, "board": BOARD, "images": ["view_*.png"], "spot": spot}
    if laser_off:
        session["dark_images"] = ["dark_*.png"]
    if scene.rig.camera.pixel_pitch_mm is not None:
        session["pixel_pitch_mm"] = scene.rig.camera.pixel_pitch_mm
    write_text(target / SESSION, tomli_w.dumps(session))
    return target


def _write_png(path: Path, image: np.ndarray) -> None:
    _, encoded = cv2.imencode(".png", image)
    content = encoded.tobytes()
    write_whole(path, lambda beside: beside.write_bytes(content))
