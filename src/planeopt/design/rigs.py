"""Rigs that need not exist, many at once, as arrays of their numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.rig import PARAMETERS, Beam, Camera, Rig, RigCovariance

Array = NDArray[np.float64]

NUMBERS = tuple(name for name in PARAMETERS if name != "f")
"""fx, fy, cx, cy, k1, k2, p1, p2, k3 (px and 1), e_x, e_y, radius (mm), direction_x, direction_y (1)."""

_PLACE = {name: (place,) for place, name in enumerate(NUMBERS)}
_PLACES = _PLACE | {
    "f": (*_PLACE["fx"], *_PLACE["fy"]),
    "offset": (*_PLACE["e_x"], *_PLACE["e_y"]),
}


def planned_rig(
    *,
    offset_mm: Sequence[float],
    radius_mm: float,
    f_mm: float,
    pitch_um: float,
    image: Sequence[int],
    direction: Sequence[float] = (0.0, 0.0, 1.0),
    centre_px: Sequence[float] | None = None,
    sigmas: Mapping[str, float] | None = None,
) -> Rig:
    """Return a rig from what a data sheet and a drawing say: no distortion, square pixels.

    Parameters
    ----------
    offset_mm : (float, float)
        Where the beam's axis crosses the plane z = 0 of the camera.
    radius_mm : float
        Of the beam.
    f_mm : float
        Focal length (the camera's constant, a little longer than the lens's where it is focused near).
    pitch_um : float
        Of the pixels.
    image : (int, int)
        Width and height, px.
    direction : (float, float, float)
        Unit, of the beam.
    centre_px : (float, float), optional
        Principal point; the middle of the image unless given. A shifted lens has it elsewhere.
    sigmas : mapping of str to float, optional
        Standard deviations that the calibration will have, by the names of `planeopt.rig.PARAMETERS`, px, mm and 1;
        as if independent.

    Raises
    ------
    InputError
        If a number is impossible.
    """
    for name, value in (("f_mm", f_mm), ("pitch_um", pitch_um)):
        if not 0 < value < np.inf:
            raise InputError(f"{name} must be a positive number, not {value}")
    width, height = image
    cx, cy = ((width - 1) / 2, (height - 1) / 2) if centre_px is None else centre_px
    fx = f_mm / (pitch_um / 1000)
    camera = Camera((width, height), fx, fx, cx, cy, (0.0, 0.0, 0.0, 0.0, 0.0), pitch_um / 1000)
    beam = Beam(radius_mm, (offset_mm[0], offset_mm[1]), (direction[0], direction[1], direction[2]))
    covariance = None
    if sigmas:
        wrong = next((name for name, sigma in sigmas.items() if not 0 < sigma < np.inf), None)
        if wrong is not None:
            raise InputError(f"the standard deviation of {wrong} must be a positive number, not {sigmas[wrong]}")
        covariance = RigCovariance(tuple(sigmas), np.diag(np.square(list(sigmas.values()))))
    return Rig(camera, beam, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Rigs:
    """Rigs of any leading shape, which broadcasts with that of the planes.

    Attributes
    ----------
    numbers : (..., 14)
        In the order of `NUMBERS`.
    image_size : (2,)
        Width and height, px.
    pitch_mm : float
        Of the pixels; f in mm is fx times this.
    covariance : RigCovariance or None
        What the calibration leaves uncertain, the same for all of them.
    """

    numbers: Array
    image_size: Array
    pitch_mm: float
    covariance: RigCovariance | None = None

    @classmethod
    def of(cls, rig: Rig) -> "Rigs":
        """Return a single rig, of shape ().

        Raises
        ------
        InputError
            If it is a camera alone.
        """
        rig.require_beam()
        numbers = np.array([rig.parameter(name) for name in NUMBERS])
        return cls(
            numbers, np.array(rig.camera.image_size, dtype=float), rig.focal_length / rig.camera.fx, rig.covariance
        )

    def number(self, name: str) -> Array:
        """Return one of `NUMBERS`, (...)."""
        return self.numbers[..., _PLACE[name][0]]

    def scaled(self, what: str, factor: ArrayLike) -> "Rigs":
        """Return rigs one of whose numbers is multiplied: one of `NUMBERS`, ``f`` (fx and fy), ``offset`` (both).

        Parameters
        ----------
        what : str
        factor : (...)
            Broadcasts with the rigs.
        """
        factor = np.asarray(factor, dtype=float)
        shape = np.broadcast_shapes(factor.shape, self.numbers.shape[:-1])
        numbers = np.broadcast_to(self.numbers, (*shape, len(NUMBERS))).copy()
        for place in _PLACES[what]:
            numbers[..., place] *= factor
        return replace(self, numbers=numbers)

    def changed(self, **values: ArrayLike) -> "Rigs":
        """Return rigs with some of `NUMBERS` (or ``f``) given anew, each of a shape that broadcasts with the rigs'."""
        arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        shape = np.broadcast_shapes(self.numbers.shape[:-1], *(array.shape for array in arrays.values()))
        numbers = np.broadcast_to(self.numbers, (*shape, len(NUMBERS))).copy()
        for name, array in arrays.items():
            for place in _PLACES[name]:
                numbers[..., place] = array
        return replace(self, numbers=numbers)
