"""Read `scene.toml` where it describes a session of board views instead of a plane."""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from planeopt.board import Board, board_from_dict, load_board
from planeopt.errors import InputError
from planeopt.rig import Rig, load_rig, rig_from_dict
from planeopt.simulation.board_look import BoardSurface
from planeopt.simulation.board_random import Setting, Shooting, shot_poses
from planeopt.simulation.board_render import BoardScene
from planeopt.simulation.board_views import BoardPoses
from planeopt.simulation.tables import BeamProfile, Noise, Optics, Pair, Positive, Sensor, Share, Table
from planeopt.toml_files import FORMAT, as_tables, read_toml


class ShootingTable(Table, frozen=True):
    """How the session is shot; poses are drawn from the seed.

    Parameters
    ----------
    depths_mm : (float, float)
        Nearest and farthest depth at which the beam meets the board.
    views : int
        How many images.
    tilt_deg : (float, float)
        Least and largest tilt of the board against the image; every direction.
    turn_deg : float
        Largest turn of the board in its plane.
    spotless : float
        Share of the views in which the board is anywhere in the image, and the spot not in its window.
    """

    key: ClassVar[str] = "shooting"

    depths_mm: tuple[Positive, Positive]
    views: Annotated[int, Meta(ge=1, le=10_000)] = 15
    tilt_deg: tuple[Annotated[float, Meta(ge=0, lt=80)], Annotated[float, Meta(ge=0, lt=80)]] = (0.0, 40.0)
    turn_deg: Annotated[float, Meta(ge=0, le=180)] = 40.0
    spotless: Share = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("depths_mm", "tilt_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise InputError(f"shooting.{name} must be [lowest, highest], not {[low, high]}")


class BoardSceneFile(Table, frozen=True):
    """A session of board views on disk.

    Parameters
    ----------
    format : int
        Version of the file format.
    rig, board : str or table
        Path of a `rig.toml` and of a `board.toml`, relative to the scene; or their tables, here.
    shooting : ShootingTable
    warp_mm : (float, float)
        By how much the board's middle lies behind its edges along x and along y.
    divergence : float
        Growth of the beam's radius per length along its axis.
    laser_off : bool
        Whether to make an image without laser for each.
    seed : int
        Of all that is random, at most 2^53.
    surface, beam, optics, noise, sensor
        Tables, each of which may be left out.
    """

    rig: str | dict[str, Any]
    board: str | dict[str, Any]
    shooting: ShootingTable
    format: int = FORMAT
    warp_mm: Pair = (0.0, 0.0)
    divergence: Annotated[float, Meta(ge=-0.1, le=0.1)] = 0.0
    laser_off: bool = False
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 0
    surface: BoardSurface = BoardSurface()
    beam: BeamProfile = BeamProfile(height=0.45)
    optics: Optics = Optics()
    noise: Noise = Noise()
    sensor: Sensor = Sensor()


@dataclass(frozen=True, eq=False)
class BoardSession:
    """A session to render.

    Attributes
    ----------
    scene : BoardScene
    shooting : Shooting
    depth : float
        The middle of the depths, mm.
    laser_off : bool
    seed : int
    """

    scene: BoardScene
    shooting: Shooting
    depth: float
    laser_off: bool
    seed: int

    def poses(self) -> BoardPoses:
        """Return the poses that the seed draws.

        Raises
        ------
        InputError
            If the beam cannot meet the window at these depths and tilts within the image.
        """
        setting = Setting(self.scene.rig, self.scene.board, depth=self.depth)
        return shot_poses(setting, self.shooting, np.random.default_rng((self.seed, 0)))


def is_board_scene(path: str | os.PathLike[str]) -> bool:
    """Whether a `scene.toml` describes a session of board views.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    return "board" in read_toml(path, "scene")


def load_board_session(path: str | os.PathLike[str]) -> BoardSession:
    """Read a session of board views from a TOML file.

    Raises
    ------
    InputError
        If the file, the rig's or the board's is missing, unreadable or invalid: one line with the file, the key and
        what is wrong.
    """
    file = Path(path)
    tables = as_tables(read_toml(file, "scene"), BoardSceneFile, str(file))
    rig, board = _rig(tables.rig, file), _board(tables.board, file)
    try:
        rig.require_beam()
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    parts = {name: getattr(tables, name) for name in ("surface", "beam", "optics", "noise", "sensor", "divergence")}
    scene = BoardScene(rig, board, warp=tables.warp_mm, **parts)
    near, far = tables.shooting.depths_mm
    shooting = Shooting(
        tables.shooting.views,
        tables.shooting.tilt_deg,
        far / near,
        tables.shooting.spotless,
        tables.shooting.turn_deg,
    )
    return BoardSession(scene, shooting, math.sqrt(near * far), tables.laser_off, tables.seed)


def board_scene_sources(path: str | os.PathLike[str]) -> list[Path]:
    """Return the files that a session is read from: its own and, where it names them, the rig's and the board's."""
    file = Path(path)
    given = read_toml(file, "scene")
    named = [given.get(key) for key in ("rig", "board")]
    return [file, *(file.parent / name for name in named if isinstance(name, str))]


def _rig(given: str | dict[str, Any], file: Path) -> Rig:
    return load_rig(file.parent / given) if isinstance(given, str) else rig_from_dict(given, f"{file}: rig")


def _board(given: str | dict[str, Any], file: Path) -> Board:
    return load_board(file.parent / given) if isinstance(given, str) else board_from_dict(given, f"{file}: board")
