"""What a calibration leaves free: the parameters of camera, board and beam, and how they map to the full set."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError

FloatArray = NDArray[np.float64]

Focal = Literal["shared", "separate"]
Rung = Literal["none", "k1", "k2", "tangential", "k3"]
"""How far up the ladder of distortions: nothing; k1; k1, k2; k1, k2, p1, p2; all five."""
BeamModel = Literal["none", "parallel", "free"]

RUNGS: tuple[Rung, ...] = ("none", "k1", "k2", "tangential", "k3")

FULL = (
    *("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    *("warp_x", "warp_y"),
    *("e_x", "e_y", "radius", "direction_x", "direction_y", "divergence"),
)
"""Every parameter that all views share: px and 1 (camera), mm (the board's bow), mm, 1 and mm per mm (the beam)."""

CAMERA = slice(0, 9)
WARP = slice(9, 11)
BEAM = slice(11, 17)

_DISTORTION: dict[Rung, tuple[str, ...]] = {
    "none": (),
    "k1": ("k1",),
    "k2": ("k1", "k2"),
    "tangential": ("k1", "k2", "p1", "p2"),
    "k3": ("k1", "k2", "p1", "p2", "k3"),
}
_BEAM: dict[BeamModel, tuple[str, ...]] = {
    "none": (),
    "parallel": ("e_x", "e_y", "radius"),
    "free": ("e_x", "e_y", "radius", "direction_x", "direction_y"),
}


@dataclass(frozen=True)
class Model:
    """Which parameters are free; the others keep the values that they start from.

    Parameters
    ----------
    focal : {"shared", "separate"}
        One focal length, or one along each axis of the image.
    distortion : {"none", "k1", "k2", "tangential", "k3"}
        The rung of the ladder.
    warp : bool
        Two numbers for a bowed board (`planeopt.board.Board.bow`).
    beam : {"none", "parallel", "free"}
        Camera alone; a beam parallel to the optical axis, the paper's; or of free direction.
    divergence : bool
        Whether the beam's radius may change along it.
    camera : bool
        False: the camera is held as it is.

    Raises
    ------
    InputError
        If a choice is not known.
    """

    focal: Focal = "shared"
    distortion: Rung = "tangential"
    warp: bool = True
    beam: BeamModel = "free"
    divergence: bool = False
    camera: bool = True

    def __post_init__(self) -> None:
        for name, value, known in (
            ("focal", self.focal, ("shared", "separate")),
            ("distortion", self.distortion, RUNGS),
            ("beam", self.beam, tuple(_BEAM)),
        ):
            if value not in known:
                raise InputError(f"{name} must be one of {', '.join(known)}, not {value!r}")
        if self.divergence and self.beam == "none":
            raise InputError("a divergence needs a beam: it cannot be free without one")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in order; `f` stands for fx and fy in one."""
        focal = ("f",) if self.focal == "shared" else ("fx", "fy")
        camera = (*focal, "cx", "cy", *_DISTORTION[self.distortion]) if self.camera else ()
        warp = ("warp_x", "warp_y") if self.warp else ()
        return (*camera, *warp, *_BEAM[self.beam], *(("divergence",) if self.divergence else ()))

    @property
    def selection(self) -> FloatArray:
        """Matrix (17, g): d full set / d free parameters."""
        matrix = np.zeros((len(FULL), len(self.names)))
        for column, name in enumerate(self.names):
            for full in ("fx", "fy") if name == "f" else (name,):
                matrix[FULL.index(full), column] = 1.0
        return matrix

    @property
    def freedom(self) -> tuple[str, ...]:
        """Names of the free parameters that a rig file holds, in its order: without the board's and the divergence."""
        return tuple(name for name in self.names if name not in ("warp_x", "warp_y", "divergence"))
