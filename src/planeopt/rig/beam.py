"""The laser: a collimated cylinder, and the rotation that looks along it."""

import math
from dataclasses import dataclass
from typing import Any

from planeopt.errors import InputError
from planeopt.rig.checks import finite, positive

Row = tuple[Any, Any, Any]

_UNIT_TOLERANCE = 1e-6
_ROUNDING = 1e-15
# The beam is described by where it crosses z = 0. The error of that point grows as 1/cos of the angle to the optical
# axis; beyond 60 degrees it has doubled, and the rig is better described in another frame.
_STEEPEST_DEG = 60.0


def rotation_to_axis(lx: Any, ly: Any, lz: Any) -> tuple[Row, Row, Row]:
    """Return the smallest rotation Q that takes the unit vector (lx, ly, lz) to +z, as rows.

    Plain arithmetic only, so that it serves floats, NumPy arrays and CasADi expressions alike (hence `Any`). Any other
    rotation to the axis would shift `beta`.

    Parameters
    ----------
    lx, ly, lz : float, array or expression
        A unit vector with lz > -1.

    Returns
    -------
    tuple of three rows
        Q, so that X' = Q X goes from the camera frame to the laser-parallel frame.
    """
    share = 1 / (1 + lz)
    across = -lx * ly * share
    return (1 - lx * lx * share, across, -lx), (across, 1 - ly * ly * share, -ly), (lx, ly, lz)


@dataclass(frozen=True)
class Beam:
    """A collimated laser beam in the camera frame.

    Parameters
    ----------
    radius : float
        Radius of the cylinder, mm.
    offset : tuple of float
        (e_x, e_y): where the axis crosses the plane z = 0 of the camera, mm.
    direction : tuple of float
        Unit vector (l_x, l_y, l_z) in which the light travels; (0, 0, 1) is the paper's parallel beam. What is unit to
        1e-6 is made unit to rounding.

    Raises
    ------
    InputError
        If a value is not finite, the radius is not positive, or the direction is not unit, does not point forward, or
        is more than 60 degrees off the optical axis, where (e_x, e_y) describes the axis badly.
    """

    radius: float
    offset: tuple[float, float]
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive("laser.radius_mm", self.radius, "mm"))
        if len(self.offset) != 2:
            raise InputError(f"laser.offset_mm must be two numbers [e_x, e_y], not {len(self.offset)}")
        object.__setattr__(self, "offset", tuple(finite("laser.offset_mm", e) for e in self.offset))
        if len(self.direction) != 3:
            raise InputError(f"laser.direction must be three numbers [l_x, l_y, l_z], not {len(self.direction)}")
        object.__setattr__(
            self, "direction", _forward_unit([finite("laser.direction", part) for part in self.direction])
        )


def _forward_unit(direction: list[float]) -> tuple[float, float, float]:
    x, y, z = direction
    length = math.hypot(x, y, z)
    if abs(length - 1) > _UNIT_TOLERANCE:
        raise InputError(f"laser.direction must be a unit vector, but its length is {length:.9g}: divide it by that")
    # What is unit already to rounding stays as it is to the last bit, so that what was written reads back equal.
    if abs(length - 1) > _ROUNDING:
        x, y, z = x / length, y / length, z / length
    if z <= 0:
        raise InputError(f"laser.direction must point forward, away from the camera (l_z > 0), but l_z is {z:.6g}")
    angle = math.degrees(math.atan2(math.hypot(x, y), z))
    if angle > _STEEPEST_DEG:
        raise InputError(
            f"laser.direction is {angle:.4g} degrees off the optical axis; at most {_STEEPEST_DEG:.0f} are accepted"
        )
    return x, y, z
