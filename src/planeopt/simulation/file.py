"""Read and write `scene.toml`: strict in what it accepts, exact in what it writes."""

import math
import os
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
import tomli_w
from msgspec import Meta

from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig, load_rig, rig_from_dict
from planeopt.simulation.scene import Scene
from planeopt.simulation.tables import (
    BeamProfile,
    Clutter,
    Noise,
    Occlusion,
    Optics,
    Positive,
    Sensor,
    Surface,
    Sweep,
    Table,
    Triple,
)
from planeopt.toml_files import FORMAT, as_tables, read_toml
from planeopt.whole_files import write_text


class PlaneTable(Table, frozen=True):
    """The plane: in the paper's variables, or by a normal and a point in the camera frame.

    Parameters
    ----------
    z_L_mm : float, optional
        Distance along the beam from (e_x, e_y, 0) to the plane, mm.
    alpha_deg : float
        Tilt of the plane against the beam's cross-section.
    beta_deg : float
        Direction of the tilt.
    normal : (float, float, float), optional
        Of any length, camera frame.
    point_mm : (float, float, float), optional
        On the plane, camera frame.
    """

    key: ClassVar[str] = "plane"

    z_L_mm: Positive | None = None
    alpha_deg: Annotated[float, Meta(ge=0, lt=90)] | None = None
    beta_deg: float | None = None
    normal: Triple | None = None
    point_mm: Triple | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        paper = (self.z_L_mm, self.alpha_deg, self.beta_deg)
        vectors = (self.normal, self.point_mm)
        as_paper = self.z_L_mm is not None and vectors == (None, None)
        as_vectors = None not in vectors and paper == (None, None, None)
        if not as_paper and not as_vectors:
            raise InputError(
                "plane: give z_L_mm (with alpha_deg and beta_deg where it is tilted), or normal and point_mm; not both"
            )

    def plane(self, rig: Rig) -> Plane | SpotPose:
        """Return the plane as it was given."""
        if self.z_L_mm is None:
            return Plane(np.array(self.normal), np.array(self.point_mm))
        slopes = SpotPose.canonical(
            1.0, self.z_L_mm, math.radians(self.alpha_deg or 0.0), math.radians(self.beta_deg or 0.0)
        )
        radius = rig.require_beam().radius
        return SpotPose(radius / math.cos(slopes.alpha), slopes.z_L, slopes.alpha, slopes.beta)


class SceneFile(Table, frozen=True):
    """A scene on disk.

    Parameters
    ----------
    format : int
        Version of the file format.
    rig : str or table
        Path of a `rig.toml`, relative to the scene; or its tables, here.
    plane : PlaneTable
    frames : int
        How many images to make.
    laser_off : bool
        Whether to make an image without laser for each.
    seed : int
        Of all that is random, at most 2^53.
    beam, optics, surface, noise, sensor, clutter, sweep
        Tables, each of which may be left out.
    occlusion : list of tables
        What lies between the camera and the spot.
    """

    rig: str | dict[str, Any]
    plane: PlaneTable
    format: int = FORMAT
    frames: Annotated[int, Meta(ge=1, le=1_000_000)] = 1
    laser_off: bool = False
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 0
    beam: BeamProfile | None = None
    optics: Optics = Optics()
    surface: Surface = Surface()
    noise: Noise = Noise()
    sensor: Sensor = Sensor()
    occlusion: tuple[Occlusion, ...] = ()
    clutter: Clutter = Clutter()
    sweep: Sweep | None = None


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene from a TOML file.

    Parameters
    ----------
    path : path-like
        A `scene.toml`.

    Raises
    ------
    InputError
        If the file, or the rig's, is missing, unreadable or invalid: one line with the file, the key and what is wrong.
    """
    file = Path(path)
    tables = as_tables(read_toml(file, "scene"), SceneFile, str(file))
    rig = _rig(tables.rig, file)
    shared = {name: getattr(tables, name) for name in _SHARED} | {"occlusions": tables.occlusion}
    if tables.beam is not None:
        shared["beam"] = tables.beam
    try:
        rig.require_beam()
        scene = Scene.of(rig, tables.plane.plane(rig), **shared)
        _ = scene.pose  # that there is one
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    return scene


def scene_sources(path: str | os.PathLike[str]) -> list[Path]:
    """Return the files that a scene is read from: its own and, where it names one, the rig's.

    Raises
    ------
    InputError
        If the scene cannot be read.
    """
    file = Path(path)
    rig = read_toml(file, "scene").get("rig")
    return [file, file.parent / rig] if isinstance(rig, str) else [file]


_SHARED = ("optics", "surface", "noise", "sensor", "clutter", "sweep", "frames", "laser_off", "seed")


def _rig(given: str | dict[str, Any], file: Path) -> Rig:
    if isinstance(given, str):
        return load_rig(file.parent / given)
    return rig_from_dict(given, f"{file}: rig")


def save_scene(scene: Scene, path: str | os.PathLike[str], rig_file: str) -> None:
    """Write a scene to a TOML file, with all its keys; it reads back equal but for the rounding of angles.

    Parameters
    ----------
    scene : Scene
    path : path-like
    rig_file : str
        What to name as its rig, relative to the file: see `planeopt.rig.save_rig`.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_text(path, tomli_w.dumps(_mapping(scene, rig_file)))


def _mapping(scene: Scene, rig_file: str) -> dict[str, Any]:
    tables = SceneFile(
        rig=rig_file,
        plane=_plane_table(scene),
        beam=scene.beam,
        occlusion=scene.occlusions,
        **{name: getattr(scene, name) for name in _SHARED},
    )
    mapping = _without_none(msgspec.to_builtins(tables))
    mapping["noise"].setdefault("full_well_electrons", 0.0)
    return mapping


def _plane_table(scene: Scene) -> PlaneTable:
    plane = scene.plane
    if isinstance(plane, Plane):
        normal, point = (tuple(vector.tolist()) for vector in (plane.normal, plane.point))
        return msgspec.convert({"normal": normal, "point_mm": point}, PlaneTable)
    beta = 0.0 if plane.beta is None else math.degrees(plane.beta)
    return PlaneTable(z_L_mm=plane.z_L, alpha_deg=math.degrees(plane.alpha), beta_deg=beta)


def _without_none(value: Any) -> Any:
    """TOML has no null: what is not given is left out."""
    if isinstance(value, dict):
        return {name: _without_none(part) for name, part in value.items() if part is not None}
    return [_without_none(part) for part in value] if isinstance(value, list | tuple) else value
