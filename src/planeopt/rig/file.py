"""Read and write `rig.toml`: strict in what it accepts, exact in what it writes.

The shape of the file (keys and types) is checked here, what the values may be by the classes that hold them; either way
the user gets one line that names the file and the key.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from planeopt.errors import InputError
from planeopt.rig.beam import Beam
from planeopt.rig.camera import Camera
from planeopt.rig.covariance import RigCovariance
from planeopt.rig.model import Rig, SpotDefinition
from planeopt.rig.mount import Mount
from planeopt.toml_files import FORMAT, as_tables, read_toml
from planeopt.whole_files import write_text


class _CameraTable(msgspec.Struct, forbid_unknown_fields=True):
    image_size: list[int]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: list[float]
    pixel_pitch_mm: float | None = None


class _LaserTable(msgspec.Struct, forbid_unknown_fields=True):
    radius_mm: float
    offset_mm: list[float]
    direction: list[float]


class _SpotTable(msgspec.Struct, forbid_unknown_fields=True):
    kind: str = "disc"
    level: float = 0.5
    channel: str = "gray"
    gamma: float = 1.0


class _CovarianceTable(msgspec.Struct, forbid_unknown_fields=True):
    parameters: list[str]
    matrix: list[list[float]]


class _MountTable(msgspec.Struct, forbid_unknown_fields=True):
    matrix: list[list[float]]
    frame: str = "mount"


class _CalibrationTable(msgspec.Struct, forbid_unknown_fields=True):
    refused: str


class _File(msgspec.Struct, forbid_unknown_fields=True):
    camera: _CameraTable
    format: int = FORMAT
    laser: _LaserTable | None = None
    spot: _SpotTable | None = None
    covariance: _CovarianceTable | None = None
    mount: _MountTable | None = None
    calibration: _CalibrationTable | None = None


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Read a rig from a TOML file.

    Parameters
    ----------
    path : path-like
        A `rig.toml`. Without `[laser]` it is a camera alone: see `Rig.require_beam`.

    Raises
    ------
    InputError
        If the file is missing, unreadable or invalid: one line with the file, the key and what is wrong.
    """
    return rig_from_dict(read_toml(path, "rig"), str(path))


def rig_from_dict(mapping: Mapping[str, Any], source: str) -> Rig:
    """Return the rig described by a mapping with the keys of `rig.toml`.

    Parameters
    ----------
    mapping : mapping
        As read from the file.
    source : str
        Where it came from; messages begin with it.

    Raises
    ------
    InputError
        If a key is missing, unknown or has an impossible value, or the format is not known.
    """
    tables = as_tables(mapping, _File, source)
    try:
        return _assemble(tables)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error


def _assemble(tables: _File) -> Rig:
    # Lengths are left to the classes, whose messages say what the numbers are.
    camera: dict[str, Any] = msgspec.structs.asdict(tables.camera)
    camera["image_size"] = tuple(camera["image_size"])
    camera["distortion"] = tuple(camera["distortion"])
    laser: Any = tables.laser
    covariance: Any = tables.covariance
    mount: Any = tables.mount
    return Rig(
        camera=Camera(**camera),
        beam=None if laser is None else Beam(laser.radius_mm, tuple(laser.offset_mm), tuple(laser.direction)),
        spot=None if tables.spot is None else SpotDefinition(**msgspec.structs.asdict(tables.spot)),
        covariance=None if covariance is None else RigCovariance(tuple(covariance.parameters), covariance.matrix),
        mount=None if mount is None else Mount(mount.matrix, mount.frame),
        refused=None if tables.calibration is None else tables.calibration.refused,
    )


def save_rig(rig: Rig, path: str | os.PathLike[str]) -> None:
    """Write a rig to a TOML file that reads back equal, to the last bit.

    The file is written beside its place and then renamed, so that a reader never sees half of it.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{file}: this is a folder; name the rig file to write in it")
    write_text(file, rig_as_toml(rig))


def rig_as_toml(rig: Rig) -> str:
    """Return the text of `rig.toml`."""
    camera = rig.camera
    lines = [
        f"format = {FORMAT}",
        "",
        "[camera]",
        f"image_size = [{camera.image_size[0]}, {camera.image_size[1]}]",
        *(f"{name} = {getattr(camera, name)!r}" for name in ("fx", "fy", "cx", "cy")),
        f"distortion = {_list(camera.distortion)}  # k1, k2, p1, p2, k3 of OpenCV",
    ]
    if camera.pixel_pitch_mm is not None:
        lines.append(f"pixel_pitch_mm = {camera.pixel_pitch_mm!r}")
    if rig.refused is not None:
        lines[1:1] = [
            "",
            "[calibration]  # it was refused and written all the same: nothing measured with it can be defended",
            f"refused = {_text(rig.refused)}",
        ]
    if rig.beam is not None:
        lines += [
            "",
            "[laser]",
            f"radius_mm = {rig.beam.radius!r}",
            f"offset_mm = {_list(rig.beam.offset)}  # where the axis crosses z = 0",
            f"direction = {_list(rig.beam.direction)}",
        ]
    if rig.spot is not None:
        lines += [
            "",
            "[spot]",
            f'kind = "{rig.spot.kind}"',
            f"level = {rig.spot.level!r}",
            f'channel = "{rig.spot.channel}"',
            f"gamma = {rig.spot.gamma!r}",
        ]
    if rig.covariance is not None:
        lines += [
            "",
            "[covariance]  # of these parameters, jointly, in this order: px, mm, 1",
            "parameters = [" + ", ".join(f'"{name}"' for name in rig.covariance.parameters) + "]",
            "matrix = [",
            *(f"    {_list(row)}," for row in rig.covariance.matrix.tolist()),
            "]",
        ]
    if rig.mount is not None:
        lines += [
            "",
            "[mount]  # takes the camera's coordinates to this frame's, mm",
            f"frame = {_text(rig.mount.frame)}",
            "matrix = [",
            *(f"    {_list(row)}," for row in rig.mount.matrix.tolist()),
            "]",
        ]
    return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    # TOML's basic strings are escaped as JSON's are.
    return json.dumps(value, ensure_ascii=False)


def _list(values: tuple[float, ...] | list[float]) -> str:
    # `repr` gives the fewest digits, 17 at most, that read back as the same number.
    return "[" + ", ".join(map(repr, values)) + "]"
