"""Where an adjustment stands: the shared parameters, and the pose of the board in each view."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.model import BEAM, CAMERA, FULL, WARP
from planeopt.errors import InputError
from planeopt.rig import Beam, Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """Values of `planeopt.calibration.model.FULL`, and poses.

    Parameters
    ----------
    values : (17,) array
        px, mm, 1.
    rotations : (V, 3, 3) array
        Board to camera.
    translations : (V, 3) array
        The board's origin in the camera frame, mm.
    image_size : tuple of int
        px.
    """

    values: Array
    rotations: Array
    translations: Array
    image_size: tuple[int, int]

    def value(self, name: str) -> float:
        """Return one of the shared parameters; `f` is fx."""
        return float(self.values[FULL.index("fx" if name == "f" else name)])

    @cached_property
    def camera(self) -> Camera:
        """The camera.

        Raises
        ------
        InputError
            If the values are not those of one.
        """
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = self.values[CAMERA].tolist()
        return Camera(self.image_size, fx, fy, cx, cy, (k1, k2, p1, p2, k3))

    @property
    def warp(self) -> Array:
        """Bow (2,) of the board along x and y, mm."""
        return self.values[WARP]

    @cached_property
    def beam(self) -> Beam:
        """The beam, without its divergence.

        Raises
        ------
        InputError
            If the values are not those of one.
        """
        e_x, e_y, radius, *_ = self.values[BEAM].tolist()
        x, y, z = self.direction.tolist()
        return Beam(radius, (e_x, e_y), (x, y, z))

    @cached_property
    def direction(self) -> Array:
        """Unit vector (3,) along the beam.

        Raises
        ------
        InputError
            If its x and y leave no forward direction.
        """
        x, y = self.values[BEAM][3:5].tolist()
        room = 1 - x * x - y * y
        if not room > 0:
            raise InputError("the beam does not point forward")
        return np.array([x, y, np.sqrt(room)])

    def some(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "State":
        """Return the state with some of its poses."""
        return replace(self, rotations=self.rotations[rows], translations=self.translations[rows])

    def moved(self, shared: Array, turns: Array, shifts: Array) -> "State":
        """Return the state after a step.

        Parameters
        ----------
        shared : (17,) array
            Added to the values.
        turns : (V, 3) array
            Rotation vectors, applied after the rotations, about the board's origin.
        shifts : (V, 3) array
            Added to the translations, mm.
        """
        return replace(
            self,
            values=self.values + shared,
            rotations=rotation_matrices(turns) @ self.rotations,
            translations=self.translations + shifts,
        )


def rotation_matrices(vectors: Array) -> Array:
    """Return the rotations (..., 3, 3) by vectors (..., 3), Rodrigues' formula, good at the smallest angles too."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    K = cross_matrices(vectors)
    # sin(a)/a and (1 - cos(a))/a^2 without cancellation; np.sinc(x) is sin(pi x)/(pi x).
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.eye(3) + first * K + second * (K @ K)


def cross_matrices(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) that take w to vector x w."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
