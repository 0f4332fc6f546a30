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
    names : tuple of str
        The parameters that were looked at.
    condition : float
        Condition number of their Jacobian: its columns scaled to unit length, then the poses eliminated.
    words : str
        What stands against what, as in "the beam's direction against its offset".
    cure : str
        What to shoot against it.
    vector : (n,) array
        The mix, of unit length: how far each moves, in units in which all move the image alike.
    """

    names: tuple[str, ...]
    condition: float
    words: str
    cure: str
    vector: Array


def null_direction(adjustment: Adjustment) -> NullDirection:
    """Return the worse of the camera's and the beam's null direction.

    What the poses can imitate stands alone in it: the focal length alone means that it can hardly be told from the
    distance of the board.
    """
    return max(null_directions(adjustment), key=lambda found: found.condition)


def null_directions(adjustment: Adjustment) -> tuple[NullDirection, ...]:
    """Return the mixes of the camera's and of the beam's parameters that an adjustment determines worst.

    The two are looked at apart: the camera whatever the beam, and the beam seen by this camera. Together they always
    have one mix that is poorly determined, the principal point against the beam's direction, which turns rays and beam
    together and costs a plane next to nothing (`planeopt.calibration.pose_cost`).
    """
    _, _, here = linearised(adjustment)
    beam = np.array([name.startswith(("e_", "radius", "d")) for name in adjustment.names], dtype=np.bool_)
    lengths = np.diagonal(here.total.V)
    scale = 1 / np.sqrt(np.where(lengths > 0, lengths, 1.0))
    scaled = scale[:, None] * adjustment.information * scale
    found = []
    if not np.all(beam):
        camera = scaled[np.ix_(~beam, ~beam)]
        if np.any(beam):
            between = scaled[np.ix_(beam, ~beam)]
            camera = camera - between.T @ np.linalg.pinv(scaled[np.ix_(beam, beam)], hermitian=True) @ between
        found.append(_worst(adjustment, ~beam, camera))
    if np.any(beam):
        found.append(_worst(adjustment, beam, scaled[np.ix_(beam, beam)]))
    return tuple(found)


def _worst(adjustment: Adjustment, rows: NDArray[np.bool_], information: Array) -> NullDirection:
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    names = tuple(name for name, taken in zip(adjustment.names, rows, strict=True) if taken)
    vector = vectors[:, 0] * np.sign(vectors[np.argmax(np.abs(vectors[:, 0])), 0])
    condition = float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")
    return NullDirection(names, condition, *in_words(names, vector), vector)


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
