"""Where the camera sits: the way from its frame to that of a robot's flange or tool."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.plane import Plane

FloatArray = NDArray[np.float64]

RIGID = 1e-6
"""How far a rotation written by hand may be from one, in any entry of R'R."""

_ROUNDING = 1e-14
_LONGEST_NAME = 64


@dataclass(frozen=True, eq=False)
class Mount:
    """The pose of the camera in another frame, taken as exact.

    Parameters
    ----------
    matrix : array_like, shape (4, 4)
        Takes coordinates of the camera frame to those of the other: X = R X_camera + t, mm. What is a rotation to 1e-6
        is made one to rounding.
    frame : str
        Name of the other frame.

    Raises
    ------
    InputError
        If the matrix is not a proper rotation and a translation, or the name is not one short line.
    """

    matrix: FloatArray
    frame: str = "mount"

    def __post_init__(self) -> None:
        if not self.frame or not self.frame.isprintable() or len(self.frame) > _LONGEST_NAME:
            raise InputError(
                f"mount.frame must be a name of 1 to {_LONGEST_NAME} printable characters, not {self.frame!r}"
            )
        matrix = _rigid(self.matrix)
        matrix.setflags(write=False)
        object.__setattr__(self, "matrix", matrix)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Mount):
            return NotImplemented
        return self.frame == other.frame and bool(np.array_equal(self.matrix, other.matrix))

    def __hash__(self) -> int:
        return hash((self.frame, self.matrix.tobytes()))

    def carry(self, plane: Plane) -> Plane:
        """Return a plane of the camera frame in this frame: the same normal and point, in its coordinates."""
        rotation, translation = self.matrix[:3, :3], self.matrix[:3, 3]
        return Plane(rotation @ plane.normal, rotation @ plane.point + translation)


def _rigid(values: object) -> FloatArray:
    """Return the checked matrix, its rotation orthonormal to rounding."""
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("mount.matrix must have 4 rows of 4 numbers") from error
    if matrix.shape != (4, 4):
        found = " x ".join(map(str, matrix.shape)) if matrix.size else "empty"
        raise InputError(f"mount.matrix must be 4 x 4, not {found}")
    if not np.all(np.isfinite(matrix)):
        raise InputError("mount.matrix must hold finite numbers")
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise InputError(f"the last row of mount.matrix must be [0, 0, 0, 1], not {matrix[3].tolist()}")
    rotation = matrix[:3, :3]
    off = float(np.max(np.abs(rotation.T @ rotation - np.eye(3))))
    if off > RIGID:
        raise InputError(
            f"the upper left 3 x 3 of mount.matrix must be a rotation, but R'R is off the identity by {off:.2g}; write "
            "it with 7 digits or more"
        )
    if np.linalg.det(rotation) < 0:
        raise InputError("the upper left 3 x 3 of mount.matrix is a reflection, not a rotation: its determinant is -1")
    # What is a rotation to rounding already stays as it is to the last bit, so that what was written reads back equal.
    if off > _ROUNDING:
        left, _, right = np.linalg.svd(rotation)
        matrix[:3, :3] = left @ right
    return matrix
