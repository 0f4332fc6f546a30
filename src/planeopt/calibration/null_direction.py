"""Which mix of parameters a session determines worst, and what that is in words."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.per_view import linearised

Array = NDArray[np.float64]

_GROUPS = {
    "f": "the focal length",
    "fx": "the focal length",
    "fy": "the focal length",
    "cx": "the principal point",
    "cy": "the principal point",
    "k1": "the radial distortion",
    "k2": "the radial distortion",
    "k3": "the radial distortion",
    "p1": "the tangential distortion",
    "p2": "the tangential distortion",
    "warp_x": "the board's bow",
    "warp_y": "the board's bow",
    "e_x": "the beam's offset",
    "e_y": "the beam's offset",
    "radius": "the beam's radius",
    "direction_x": "the beam's direction",
    "direction_y": "the beam's direction",
    "divergence": "the beam's divergence",
}
_ALONE = {
    "the focal length": "the focal length against the distance of the board",
    "the principal point": "the principal point against the tilt of the board",
    "the radial distortion": "the coefficients of the radial distortion against each other",
    "the tangential distortion": "the tangential distortion against the tilt of the board",
    "the board's bow": "the board's bow against its tilt",
    "the beam's offset": "the beam's offset against the place of the board",
    "the beam's radius": "the beam's radius against the distance of the board",
    "the beam's direction": "the beam's direction against the tilt of the board",
    "the beam's divergence": "the beam's divergence against the distance of the board",
}
_CURES = {
    "the focal length": "tilt the board by 30 to 45 degrees, in several directions",
    "the principal point": "tilt the board to all four sides, and turn it in its plane",
    "the radial distortion": "bring the board's corners to the corners of the image",
    "the tangential distortion": "bring the board to all sides of the image, tilted",
    "the board's bow": "tilt the board more, and turn it in its plane",
    "the beam's offset": "tilt the board to all four sides",
    "the beam's direction": "put the board at more distances, from near to far",
    "the beam's radius": "take more views with the spot",
    "the beam's divergence": "put the board at more distances, from near to far",
}

_SHARE = 0.1
"""Of a unit vector's square: what a parameter needs to count as taking part."""


@dataclass(frozen=True, eq=False)
class NullDirection:
    """The mix of parameters that a session determines worst.

    Attributes
    ----------
    words : str
        What stands against what, as in "the beam's direction against its offset".
    cure : str
        What to shoot against it.
    vector : (g,) array
        The mix, in units of the parameters' columns: how far each moves if all move the image alike; of unit length.
    """

    words: str
    cure: str
    vector: Array


def null_direction(adjustment: Adjustment) -> NullDirection:
    """Return the mix of parameters that an adjustment determines worst.

    The eigenvector of the least eigenvalue of the information that `Adjustment.condition` is the condition of: the
    columns of what is shared scaled to unit length, the poses eliminated. What the poses can imitate stands alone in
    it: the focal length alone means that it is told from the distance of the board worst of all.
    """
    _, _, here = linearised(adjustment)
    scale = 1 / np.sqrt(np.diagonal(here.total.V))
    _, vectors = np.linalg.eigh(scale[:, None] * adjustment.information * scale)
    vector = vectors[:, 0] * np.sign(vectors[np.argmax(np.abs(vectors[:, 0])), 0])
    return NullDirection(*in_words(adjustment.names, vector), vector)


def in_words(names: tuple[str, ...], vector: Array) -> tuple[str, str]:
    """Return what stands against what in a mix of parameters, and what to shoot against it."""
    shares: dict[str, float] = {}
    for name, part in zip(names, np.square(vector).tolist(), strict=True):
        group = _GROUPS[name]
        shares[group] = shares.get(group, 0.0) + part
    taking_part = sorted((group for group in shares if shares[group] >= _SHARE), key=lambda group: -shares[group])
    first = taking_part[0]
    if len(taking_part) == 1:
        return _ALONE[first], _CURES[first]
    second = taking_part[1]
    beams = first.startswith("the beam's") and second.startswith("the beam's")
    other = second.replace("the beam's", "its") if beams else second
    # What can be done about the direction of a beam helps its offset too.
    cure = _CURES["the beam's direction"] if beams and "the beam's direction" in (first, second) else _CURES[first]
    return f"{first} against {other}", cure
