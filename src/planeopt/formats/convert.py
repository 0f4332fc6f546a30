"""A rig's camera into another program's format, and a camera out of one."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from planeopt import __version__
from planeopt.errors import InputError
from planeopt.formats.imported import Imported
from planeopt.formats.kalibr import kalibr_text, largest_move, without_k3
from planeopt.formats.mrcal import mrcal_text
from planeopt.formats.opencv import from_opencv, opencv_text
from planeopt.formats.ros import from_ros, ros_text
from planeopt.rig import Camera, Rig
from planeopt.toml_files import read_text

ExportFormat = Literal["ros", "opencv", "kalibr", "mrcal"]
"""ROS's camera_info YAML, OpenCV's FileStorage (YAML 1.0), kalibr's camchain, mrcal's cameramodel."""

ImportFormat = Literal["ros", "opencv"]
"""ROS's camera_info YAML, OpenCV's FileStorage (YAML, JSON, XML)."""

_WRITERS: dict[str, tuple[str, Callable[[Camera, str, tuple[str, ...]], str]]] = {
    "ros": ("ROS's camera_info", ros_text),
    "opencv": ("OpenCV's FileStorage", opencv_text),
    "kalibr": ("kalibr's camchain", kalibr_text),
    "mrcal": ("mrcal's cameramodel", mrcal_text),
}
# What ROS takes for a name, and no reader for anything but a text.
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_./-]*")


@dataclass(frozen=True)
class Exported:
    """A camera in another program's format.

    Parameters
    ----------
    text : str
        The file's.
    notes : tuple of str
        What was left out or changed, a sentence each; they stand in the file's comment too.
    """

    text: str
    notes: tuple[str, ...] = ()


def export_camera(rig: Rig, to: ExportFormat, *, name: str = "camera", approximate: bool = False) -> Exported:
    """Write a rig's camera in another program's format; its numbers read back to the last bit.

    Parameters
    ----------
    rig : Rig
        These formats hold the camera alone; the notes say what is left out.
    to : {"ros", "opencv", "kalibr", "mrcal"}
    name : str
        Of the camera; what it is used for depends on the format.
    approximate : bool
        For kalibr, which has no k3: fit the other coefficients anew in its place, and note how far that is off.

    Raises
    ------
    InputError
        If the format is not known or cannot hold this camera, or the name is unsuitable.
    """
    if to not in _WRITERS:
        raise InputError(f"the format {to!r} is not known: it must be one of {', '.join(_WRITERS)}")
    if not _NAME.fullmatch(name):
        raise InputError(f"a camera's name begins with a letter and has letters, digits and _ . / - only, not {name!r}")
    program, write = _WRITERS[to]
    camera, notes = rig.camera, []
    if rig.refused is not None:
        notes.append(f"the calibration of this rig was refused: {' '.join(rig.refused.split())}")
    if missing := _left_out(rig):
        notes.append(f"left out, because this format holds the camera alone: {', '.join(missing)}; keep the rig file")
    if approximate and to == "kalibr" and camera.distortion[-1] != 0:
        camera = without_k3(camera)
        moved = largest_move(rig.camera, camera)
        notes.append(f"k1, k2, p1 and p2 were fitted anew in place of k3 too: pixels move by up to {moved:.3g} px")
    origin = f"{program}, written by planeopt {__version__}; px, pixel centres at integers"
    return Exported(write(camera, name, (origin, *notes)), tuple(notes))


def _left_out(rig: Rig) -> tuple[str, ...]:
    """Return, in words, what of a rig none of these formats can hold."""
    parts = (
        ("the laser beam", rig.beam),
        ("the spot's definition", rig.spot),
        ("the covariance", rig.covariance),
        ("the mount", rig.mount),
        ("the pixel pitch", rig.camera.pixel_pitch_mm),
    )
    return tuple(name for name, value in parts if value is not None)


def import_camera(
    path: str | os.PathLike[str],
    source: ImportFormat,
    *,
    pixel_pitch_mm: float | None = None,
    image_size: tuple[int, int] | None = None,
) -> Imported:
    """Read a camera from another program's file.

    Parameters
    ----------
    path : path-like
    source : {"ros", "opencv"}
        Whose format it is.
    pixel_pitch_mm : float, optional
        Size of a pixel on the sensor, mm, which no such file has.
    image_size : tuple of int, optional
        Width and height, px, where OpenCV's file does not have them.

    Returns
    -------
    Imported
        The camera, without a covariance: these formats have none.

    Raises
    ------
    InputError
        If the file cannot be read, or the camera is of another model: one line with the file and the key.
    """
    if source == "ros":
        if image_size is not None:
            raise InputError("ROS's file holds the image size itself: leave --image-size out")
        return from_ros(read_text(path, "camera's"), str(path), pixel_pitch_mm)
    if source == "opencv":
        return from_opencv(read_text(path, "camera's"), str(path), pixel_pitch_mm, image_size)
    raise InputError(f"the format {source!r} is not read: it must be ros or opencv")
