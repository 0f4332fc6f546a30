"""The spot's boundary in the image of any rig, and how it moves: exact, by complex steps.

At the angle ``phi`` round the beam the mantle meets the plane at ``(e'_x + r cos phi, e'_y + r sin phi, z)`` of the
laser-parallel frame, ``z = z_L + (Q e)_z + r (p cos phi + q sin phi)``. A change of the plane therefore moves each of
them along the beam only, and the boundary along its normal by ``m(phi) (1, r cos phi, r sin phi)`` per unit of
``(z_L, p, q)``: one number ``m``, what a millimetre along the beam moves the image across the boundary.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planeopt.design.rigs import NUMBERS
from planeopt.rig import distort, rotation_to_axis

Array = NDArray[np.float64]
Analytic = NDArray[np.inexact]
"""Real, or complex for a derivative by a complex step."""

SMALLEST = 1e-30
"""Of complex steps: its square is nothing beside any number here."""

_RADII = 32  # at which the lens is asked whether it folds over


@dataclass(frozen=True)
class _Frame:
    """Rotation to the laser-parallel frame, as rows, and the turned offset; entries (..., 1)."""

    Q: tuple[tuple[Any, ...], ...]
    offset: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Outlines:
    """Boundaries of M spots at N angles.

    Attributes
    ----------
    pixels : (M, N, 2)
        Raw pixels.
    laser_plane : (M, N, 2)
        ``(X'/Z', Y'/Z')`` in the laser-parallel frame.
    length : (M, N)
        px of boundary per radian round the beam.
    normals : (M, N, 2)
        Unit, all inwards or all outwards.
    by_plane : (M, N, 3)
        px along the normal per unit of ``(z_L, p, q)``.
    by_radius : (M, N)
        px along the normal per mm of the beam's radius.
    depth : (M, N)
        Of the boundary in the camera, mm.
    unfolded : (M,)
        Whether the lens's distortion grows outward as far as the boundary goes.
    """

    pixels: Array
    laser_plane: Array
    length: Array
    normals: Array
    by_plane: Array
    by_radius: Array
    depth: Array
    unfolded: NDArray[np.bool_]


def outlines(numbers: Array, planes: Array, angles: Array) -> Outlines:
    """Return the boundaries of planes before rigs.

    Parameters
    ----------
    numbers : (M, 14)
        `planeopt.design.rigs.NUMBERS` of each rig.
    planes : (M, 3)
        ``(z_L, p, q)``, ``z_L`` along the beam.
    angles : (M, N)
        Round the beam, in the laser-parallel frame, rad.
    """
    radius = numbers[:, NUMBERS.index("radius"), None]
    lever = np.stack([np.ones_like(angles), radius * np.cos(angles), radius * np.sin(angles)], axis=-1)
    pixels, ratio, depth, straight = _project(numbers, planes, angles)
    tangent = _project(numbers, planes, angles + 1j * SMALLEST)[0].imag / SMALLEST
    length = np.hypot(tangent[..., 0], tangent[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        normals = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1) / length[..., None]
    along = np.array([1j * SMALLEST, 0.0, 0.0])
    moved = _across(_project(numbers, planes + along, angles)[0].imag / SMALLEST, normals)
    wider = by_numbers(numbers, planes, angles, normals, ("radius",))[..., 0]
    return Outlines(
        pixels.real,
        ratio.real,
        length,
        normals,
        moved[..., None] * lever,
        wider,
        depth.real,
        _unfolded(numbers, np.max(np.hypot(straight[..., 0].real, straight[..., 1].real), axis=-1)),
    )


def by_numbers(numbers: Array, planes: Array, angles: Array, normals: Array, names: tuple[str, ...]) -> Array:
    """Movement (M, N, n) of the boundary along its normals per unit of some of a rig's numbers; ``f`` is fx and fy."""
    made = np.empty((*angles.shape, len(names)))
    for column, name in enumerate(names):
        step = np.zeros(len(NUMBERS), dtype=complex)
        step[[NUMBERS.index(each) for each in (("fx", "fy") if name == "f" else (name,))]] = 1j * SMALLEST
        made[..., column] = _across(_project(numbers + step, planes, angles)[0].imag / SMALLEST, normals)
    return made


def normals_by_numbers(numbers: Array, planes: Array, names: tuple[str, ...]) -> Array:
    """Derivative (M, 3, n) of unit normals in the camera frame by a rig's numbers, the slopes held fixed."""
    made = np.zeros((len(planes), 3, len(names)))
    for column, name in enumerate(names):
        if name in ("direction_x", "direction_y"):
            step = np.zeros(len(NUMBERS), dtype=complex)
            step[NUMBERS.index(name)] = 1j * SMALLEST
            made[:, :, column] = camera_normals(numbers + step, planes).imag / SMALLEST
    return made


def camera_normals(numbers: Analytic, planes: Analytic) -> Analytic:
    """Unit normals (M, 3) in the camera frame, positive along the beam."""
    Q = _frame(numbers).Q
    p, q = planes[:, 1], planes[:, 2]
    length = np.sqrt(1 + p * p + q * q)
    upward = (-p / length, -q / length, 1 / length)
    return np.stack([sum(Q[i][j][:, 0] * upward[i] for i in range(3)) for j in range(3)], axis=-1)


def laser_offsets(numbers: Array) -> Array:
    """``(Q e)`` (M, 3): offset in the laser-parallel frame, and what the spot's z is more than ``z_L``, mm."""
    return np.concatenate(_frame(numbers).offset, axis=-1)


def _across(movement: Array, normals: Array) -> Array:
    return np.sum(movement * normals, axis=-1)


def _frame(numbers: Analytic) -> _Frame:
    e_x, e_y, _, l_x, l_y = (numbers[..., place, None] for place in range(9, 14))
    Q = rotation_to_axis(l_x, l_y, np.sqrt(1 - l_x * l_x - l_y * l_y))
    return _Frame(Q, tuple(row[0] * e_x + row[1] * e_y for row in Q))


def _project(numbers: Analytic, planes: Analytic, angles: Analytic) -> tuple[Analytic, Analytic, Analytic, Analytic]:
    """Pixels (M, N, 2), ratios in the laser-parallel frame (M, N, 2), depth (M, N), undistorted ratios (M, N, 2)."""
    fx, fy, cx, cy, *distortion = (numbers[..., place, None] for place in range(9))
    frame, radius = _frame(numbers), numbers[..., 11, None]
    dx, dy = radius * np.cos(angles), radius * np.sin(angles)
    z_L, p, q = (planes[..., place, None] for place in range(3))
    space = (frame.offset[0] + dx, frame.offset[1] + dy, z_L + frame.offset[2] + p * dx + q * dy)
    x, y, z = (sum(frame.Q[i][j] * space[i] for i in range(3)) for j in range(3))
    # What lies beside or behind the camera is told by its depth, whatever comes out here.
    with np.errstate(all="ignore"):
        straight = np.stack([x / z, y / z], axis=-1)
        xd, yd = distort(straight[..., 0], straight[..., 1], *distortion)
        pixels = np.stack([fx * xd + cx, fy * yd + cy], axis=-1)
        ratio = np.stack([space[0] / space[2], space[1] / space[2]], axis=-1)
    return pixels, ratio, np.asarray(z), straight


def _unfolded(numbers: Array, radius: Array) -> NDArray[np.bool_]:
    """Whether the distorted radius grows with the radius, (M,), up to that of the boundary."""
    k1, k2, k3 = (numbers[:, place, None] for place in (4, 5, 8))
    square = (radius[:, None] * np.linspace(0, 1, _RADII)) ** 2
    with np.errstate(all="ignore"):
        return np.all(1 + square * (3 * k1 + square * (5 * k2 + square * 7 * k3)) > 0, axis=-1)
