"""Read and write `scene.toml`: strict in what it accepts, exact in what it writes."""

import math
import os
import re
import tomllib
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

FORMAT = 1
"""Version of the file format that this reads and writes."""


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
    mapping = _read(file)
    version = mapping.get("format", FORMAT)
    if isinstance(version, int) and not isinstance(version, bool) and version != FORMAT:
        raise InputError(f"{file}: format {version} is not known; this version of planeopt reads format {FORMAT}")
    try:
        tables = msgspec.convert(mapping, SceneFile)
    except msgspec.ValidationError as error:
        raise InputError(f"{file}: {_in_words(str(error))}") from error
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
    rig = _read(file).get("rig")
    return [file, file.parent / rig] if isinstance(rig, str) else [file]


_SHARED = ("optics", "surface", "noise", "sensor", "clutter", "sweep", "frames", "laser_off", "seed")


def _rig(given: str | dict[str, Any], file: Path) -> Rig:
    if isinstance(given, str):
        return load_rig(file.parent / given)
    return rig_from_dict(given, f"{file}: rig")


def _read(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError as error:
        raise InputError(f"{file}: there is no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{file}: this is a folder; name the scene file in it") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text file in UTF-8 (byte {error.start})") from error
    except ValueError as error:
        raise InputError(f"{file}: not valid TOML: {error}") from error


_TYPES = {
    "float": "a number",
    "int": "a whole number",
    "array": "a list",
    "object": "a table",
    "str": "a text",
    "bool": "true or false",
    "date": "a date",
    "datetime": "a date and time",
    "null": "nothing",
}
_LIMITS = {">=": "at least", ">": "above", "<=": "at most", "<": "below"}


def _in_words(message: str) -> str:
    """Turn msgspec's message ("Expected `float`, got `str` - at `$.beam.height`") into the words of the file."""
    what, _, where = message.partition(" - at ")
    key = where.strip("`").removeprefix("$").removeprefix(".").replace("[...]", "")
    place = f"[{key}]" if key else "the file"
    if found := re.fullmatch(r"Object missing required field `(.+)`", what):
        return f"{place} lacks the key {found[1]!r}"
    if found := re.fullmatch(r"Object contains unknown field `(.+)`", what):
        return f"{place} has the unknown key {found[1]!r}: check its spelling, or remove it"
    if found := re.fullmatch(r"Expected `(.+)`, got `(.+)`", what):
        wanted = " or ".join(_TYPES.get(name, name) for name in found[1].split(" | ") if name != "null")
        return f"{key or 'the file'} must be {wanted}, not {_TYPES.get(found[2], found[2])}"
    if found := re.fullmatch(r"Expected `array` of length (\d+), got (\d+)", what):
        return f"{key} must be a list of {found[1]}, not of {found[2]}"
    if found := re.fullmatch(r"Expected `\w+` (>=|>|<=|<) (.+)", what):
        return f"{key} must be {_LIMITS[found[1]]} {found[2]}"
    if what.startswith("Invalid enum value"):
        return f"{key} cannot be {what.removeprefix('Invalid enum value ')}"
    # What the tables themselves say names its key already.
    return what if what.startswith(key.split(".")[0]) else f"{key or 'the file'}: {what}"


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
    file = Path(path)
    beside = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        beside.write_text(tomli_w.dumps(_mapping(scene, rig_file)), encoding="utf-8")
        beside.replace(file)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InputError(f"{file}: cannot be written: {error.strerror}") from error


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
