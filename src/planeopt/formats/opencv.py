"""OpenCV's FileStorage: written as its YAML 1.0, read as YAML (1.0, and 1.2 of OpenCV 5), JSON or XML.

The names are those of OpenCV's own calibration programs: `image_width`, `image_height`, `camera_matrix` and
`distortion_coefficients`. Programs differ in them, so other spellings are read too. Every version of OpenCV since 2.4
reads the header `%YAML:1.0`; OpenCV 5 writes `%YAML 1.2` unless asked for the older one.
"""

from collections.abc import Iterable
from typing import Any

from planeopt.errors import InputError
from planeopt.formats.digits import comment, listed
from planeopt.formats.documents import Document, parse_xml, parse_yaml
from planeopt.formats.fields import five, matrix, numbers, pinhole, whole
from planeopt.formats.imported import Imported
from planeopt.rig import Camera

# In small letters, without underscores.
_CAMERA_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsics", "k", "mtx")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "distortioncoeffs", "distcoefs", "distortion", "dist", "d")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_SIZE = ("imagesize", "cameraresolution", "resolution", "framesize", "size")
_FISHEYE = ("fisheyemodel", "fisheye")


def opencv_text(camera: Camera, name: str, remarks: tuple[str, ...] = ()) -> str:
    """Return the text of a FileStorage file in YAML 1.0.

    Parameters
    ----------
    camera : Camera
    name : str
        Of the camera, as `camera_name`.
    remarks : tuple of str
        Sentences for the comment below its header.
    """
    lines = [
        "%YAML:1.0",
        "---",
        *comment(remarks),
        f"image_width: {camera.image_size[0]}",
        f"image_height: {camera.image_size[1]}",
        f'camera_name: "{name}"',
        *_matrix("camera_matrix", 3, camera.matrix.ravel().tolist()),
        *_matrix("distortion_coefficients", 1, camera.distortion),
    ]
    return "\n".join(lines) + "\n"


def _matrix(key: str, rows: int, values: Iterable[float]) -> list[str]:
    data = tuple(values)
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {len(data) // rows}",
        "   dt: d",
        f"   data: {listed(data)}",
    ]


def from_opencv(
    content: str, source: str, pixel_pitch_mm: float | None = None, image_size: tuple[int, int] | None = None
) -> Imported:
    """Return the camera of a FileStorage file.

    Parameters
    ----------
    content, source : str
    pixel_pitch_mm : float, optional
    image_size : tuple of int, optional
        Width and height, px, where the file does not have them.

    Raises
    ------
    InputError
        If the file is invalid, or the camera is not of OpenCV's model with five coefficients.
    """
    document = (parse_xml if content.lstrip().startswith("<") else parse_yaml)(content, source)
    fisheye = _find(document, _FISHEYE, source)
    if fisheye is not None and document[fisheye] not in ("0", "false"):
        raise InputError(f"{source}: {fisheye} is set: OpenCV's fisheye model is not supported")
    size = _size(document, source, image_size)
    fx, fy, cx, cy = pinhole(document, _named(document, _CAMERA_MATRIX, "camera_matrix", source), source)
    key = _named(document, _DISTORTION, "distortion_coefficients", source)
    shape, coefficients = matrix(document, key, source)
    if 1 not in shape:
        raise InputError(f"{source}: {key} must be one row or one column, not {shape[0]} x {shape[1]}")
    distortion = five(coefficients, f"{source}: {key}", "the rational, thin prism and tilted models are not supported")
    notes = []
    if len(coefficients) < 5:
        notes.append(
            f"{len(coefficients)} distortion coefficients: those that are missing were taken for 0; if they are of "
            "cv2.fisheye, this is another model, and the camera is wrong"
        )
    return Imported.checked(source, size, (fx, fy, cx, cy), distortion, pixel_pitch_mm, notes)


def _size(document: Document, source: str, given: tuple[int, int] | None) -> tuple[int, int]:
    """Return width and height, from the file or as given."""
    width, height = _find(document, _WIDTH, source), _find(document, _HEIGHT, source)
    both = _find(document, _SIZE, source)
    if width is not None and height is not None:
        found = whole(document, width, source), whole(document, height, source)
    elif both is not None:
        found = _pair(document[both], f"{source}: {both}")
    elif given is not None:
        return given
    else:
        raise InputError(f"{source}: image_width and image_height are missing: give --image-size WIDTH HEIGHT")
    if given is not None and given != found:
        raise InputError(f"{source}: the image size is {list(found)} there, but {list(given)} was given")
    return found


def _pair(value: Any, where: str) -> tuple[int, int]:
    found = numbers(list(value.values()) if isinstance(value, dict) else value, where)
    if len(found) != 2 or not all(number.is_integer() for number in found):
        raise InputError(f"{where} must be two whole numbers, width and height")
    return int(found[0]), int(found[1])


def _named(document: Document, names: tuple[str, ...], usual: str, source: str) -> str:
    key = _find(document, names, source)
    if key is None:
        raise InputError(
            f"{source}: the key {usual!r} is missing; there are {', '.join(map(repr, document)) or 'none'}"
        )
    return key


def _find(document: Document, names: tuple[str, ...], source: str) -> str | None:
    """Return the key that is one of these names, whatever its capitals and underscores."""
    found = [key for key in document if key.lower().replace("_", "") in names]
    if len(found) > 1:
        raise InputError(f"{source}: holds {' and '.join(map(repr, found))}: which is meant? Leave one of them")
    return found[0] if found else None
