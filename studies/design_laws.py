"""What goes with which power, and what an offset is worth against none."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt.design import Points, plane_at, predict, sensitivities
from studies.design_cells import DIRECTIONS_DEG, PIXELS, RADIUS_MM, TILTS_DEG, Spec

Array = NDArray[np.float64]

LAWS = {
    "z_L": {"offset": -1.0, "radius": -0.5, "f": -1.5, "distance": 2.5, "all lengths": 1.0},
    "normal": {"offset": -1.0, "radius": -1.5, "f": -1.5, "distance": 2.5, "all lengths": 0.0},
}
"""Powers of sigma, by the pixels' noise, for offsets that are large against the radius; those of all lengths together
(offset, radius and distance) always."""

LENGTHS = ("offset", "radius", "distance")
DISTANCES_MM = (150.0, 250.0, 400.0, 650.0, 1000.0)

RATIOS = np.geomspace(0.1, 20.0, 24)
FAR_MM = 2000.0
"""So far that perspective hardly matters: offsets are compared by their ratio to the radius alone."""


@dataclass(frozen=True)
class LawRow:
    """A power of sigma over the planes of the reference rig.

    Attributes
    ----------
    quantity : str
        Whose sigma: z_L or normal.
    lever : str
        What it goes with; "all lengths": offset, radius and distance together.
    law : float
        Power that the closed form has for offsets that are large against the radius.
    least, most : float
        Of the local powers over all planes.
    """

    quantity: str
    lever: str
    law: float
    least: float
    most: float


@dataclass(frozen=True)
class OffsetRow:
    """Sigma over that of a coaxial beam, with as many points of the same noise, far away.

    Attributes
    ----------
    offset_over_radius, tilt_deg : float
    z_L_over, normal_over : float
        Worst direction of tilt.
    """

    offset_over_radius: float
    tilt_deg: float
    z_L_over: float
    normal_over: float


@dataclass(frozen=True)
class HumpRow:
    """Offsets that are worse than none, from the closed form of a frontal plane.

    Attributes
    ----------
    quantity : str
        Whose sigma: z_L or normal.
    worst_offset_over_radius, worst_over_coaxial : float
        Where it is largest, and how large.
    even_offset_over_radius : float
        From here on it is less than with a coaxial beam.
    """

    quantity: str
    worst_offset_over_radius: float
    worst_over_coaxial: float
    even_offset_over_radius: float


def laws() -> list[LawRow]:
    """Differentiate the prediction at the reference rig."""
    spec = Spec("reference", 0.0)
    planes = np.array(
        [plane_at(spec.rig, *values) for values in product(DISTANCES_MM, TILTS_DEG, DIRECTIONS_DEG)], dtype=float
    )
    found = {each.lever: {"z_L": each.z_L, "normal": each.normal} for each in sensitivities(spec.rig, planes, PIXELS)}
    made = []
    for quantity, powers in LAWS.items():
        for lever, law in powers.items():
            together = LENGTHS if lever == "all lengths" else (lever,)
            # Difference quotients are good to 1e-6; without a negative zero.
            local = np.round(np.sum([found[name][quantity] for name in together], axis=0), 6) + 0.0
            made.append(LawRow(quantity, lever, law, float(np.min(local)), float(np.max(local))))
    return made


def offsets() -> list[OffsetRow]:
    """Compare offsets with none."""
    made = []
    for tilt in TILTS_DEG:
        none = _worst(0.0, tilt)
        for ratio in RATIOS.tolist():
            z_L, normal = _worst(ratio, tilt) / none
            made.append(OffsetRow(ratio, tilt, float(z_L), float(normal)))
    return made


def _worst(ratio: float, tilt: float) -> Array:
    """Largest sigma of z_L and of the normal over the directions of tilt."""
    spec = Spec("offset", ratio, offset_mm=ratio * RADIUS_MM, distance_mm=FAR_MM)
    planes = plane_at(spec.rig, FAR_MM, tilt, np.arange(0.0, 360.0, 15.0))
    found = predict(spec.rig, planes, Points(1e-3, 200), criterion=False)
    return np.array([np.max(found.z_L_mm), np.max(found.normal_deg)])


def frontal(ratio: float) -> tuple[float, float]:
    """Closed form of a frontal plane's sigma of z_L and of the normal over those of a coaxial beam."""
    square = ratio**2
    hump = 2 - 1.5 * square + 0.75 * square**2
    z_L = (1 + 0.75 * square) / hump / 0.5
    normal = ((2 + square) / hump + 1 / (1 + square / 4)) / 2
    return math.sqrt(z_L), math.sqrt(normal)


def humps() -> list[HumpRow]:
    """Find where a frontal plane's sigma is largest, and from which offset on it is less than with none."""
    made = []
    for place, quantity in enumerate(LAWS):

        def log_sigma(ratio: float, place: int = place) -> float:
            return math.log(frontal(ratio)[place])

        top: Any = scipy.optimize.minimize_scalar(lambda x, f=log_sigma: -f(x), bounds=(0.1, 2.0), method="bounded")
        even: Any = scipy.optimize.brentq(log_sigma, top.x, 10.0)
        made.append(HumpRow(quantity, float(top.x), math.exp(-top.fun), float(even)))
    return made


def law_of(rows: Sequence[LawRow], quantity: str, lever: str) -> LawRow:
    """Return one of the rows."""
    return next(row for row in rows if (row.quantity, row.lever) == (quantity, lever))
