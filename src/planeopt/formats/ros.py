"""ROS's camera_info YAML, as `camera_calibration` writes it and `camera_calibration_parsers` reads it.

Its keys: `image_width`, `image_height`, `camera_name`, `camera_matrix` (3 x 3), `distortion_model`,
`distortion_coefficients` (1 x 5: k1, k2, p1, p2, k3 of `plumb_bob`, which is OpenCV's model), `rectification_matrix`
(3 x 3) and `projection_matrix` (3 x 4); each matrix is a table of `rows`, `cols` and `data`. ROS reads them with
yaml-cpp and takes the shapes on trust: sensor_msgs/CameraInfo, image_common/camera_calibration_parsers.
"""

from planeopt.errors import InputError
from planeopt.formats.digits import comment, listed
from planeopt.formats.documents import Document, parse_yaml
from planeopt.formats.fields import five, matrix, numbers, pinhole, shown, text, whole
from planeopt.formats.imported import Imported
from planeopt.rig import Camera

# The first is ROS's key; the second stood in its place in the files of image_pipeline 1.15.0.
_MODEL_KEYS = ("distortion_model", "camera_model")
_PLUMB_BOB, _RATIONAL = "plumb_bob", "rational_polynomial"
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def ros_text(camera: Camera, name: str, remarks: tuple[str, ...] = ()) -> str:
    """Return the text of a camera_info file: no rectification, and the projection of the camera itself.

    Parameters
    ----------
    camera : Camera
    name : str
        By which ROS's camera_info_manager knows the camera.
    remarks : tuple of str
        Sentences for the comment at its head.
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    lines = [
        *comment(remarks),
        f"image_width: {camera.image_size[0]}",
        f"image_height: {camera.image_size[1]}",
        f'camera_name: "{name}"',
        *_matrix("camera_matrix", 3, (fx, 0, cx, 0, fy, cy, 0, 0, 1)),
        f"distortion_model: {_PLUMB_BOB}",
        *_matrix("distortion_coefficients", 1, camera.distortion),
        *_matrix("rectification_matrix", 3, _IDENTITY),
        *_matrix("projection_matrix", 3, (fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0)),
    ]
    return "\n".join(lines) + "\n"


def _matrix(key: str, rows: int, values: tuple[float, ...]) -> list[str]:
    return [f"{key}:", f"  rows: {rows}", f"  cols: {len(values) // rows}", f"  data: {listed(values)}"]


def from_ros(content: str, source: str, pixel_pitch_mm: float | None = None) -> Imported:
    """Return the camera of a camera_info file.

    Raises
    ------
    InputError
        If the file is invalid, or the camera is not of OpenCV's model with five coefficients.
    """
    document = parse_yaml(content, source)
    _refuse_message(document, source)
    notes = []
    model = next((found for key in _MODEL_KEYS if (found := text(document, key, source))), None)
    if model is None:
        notes.append("distortion_model is missing: taken for plumb_bob, as ROS does")
    elif model not in (_PLUMB_BOB, _RATIONAL):
        raise InputError(f"{source}: distortion_model {shown(model)} is not supported: it must be {_PLUMB_BOB}")
    size = whole(document, "image_width", source), whole(document, "image_height", source)
    fx, fy, cx, cy = pinhole(document, "camera_matrix", source)
    _, coefficients = matrix(document, "distortion_coefficients", source)
    where = f"{source}: distortion_coefficients"
    distortion = five(coefficients, where, f"{_RATIONAL} is not supported, calibrate with five")
    if len(coefficients) < 5:
        notes.append(f"{len(coefficients)} distortion coefficients: those that are missing were taken for 0")
    if _rectifies(document, source, (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)):
        notes.append("rectification_matrix and projection_matrix describe the rectified image and were left out")
    return Imported.checked(source, size, (fx, fy, cx, cy), distortion, pixel_pitch_mm, notes)


def _rectifies(document: Document, source: str, projection: tuple[float, ...]) -> bool:
    """Whether the file's rectified image is another one than the undistorted."""
    for key, plain in (("rectification_matrix", _IDENTITY), ("projection_matrix", projection)):
        table = document.get(key)
        if isinstance(table, dict) and "data" in table and numbers(table["data"], f"{source}: {key}.data") != plain:
            return True
    return False


def _refuse_message(document: Document, source: str) -> None:
    if "camera_matrix" not in document and {"K", "k"} & set(document):
        raise InputError(
            f"{source}: this is a camera_info message, not a calibration file: save it with ROS's "
            "camera_calibration_parsers, or give the file that the calibration wrote"
        )
