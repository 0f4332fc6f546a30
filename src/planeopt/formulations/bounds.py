"""Bounds and sizes of the pose's unknowns, the same for every formulation, so that comparisons are fair."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.errors import InputError

Array = NDArray[np.float64]
Variables = Literal["slopes", "paper"]

# A plane seen more edge-on than this shows no ellipse that a camera could measure; without finite bounds a search can
# run to infinity along directions that the image hardly sees.
STEEPEST = np.radians(89.9)
FARTHEST = 1e6
"""Depth bound in beam radii."""
TURNS = 20 * np.pi
"""The paper's beta is periodic: room for a search that turns, folded back to canonical angles afterwards."""


VISIBLE = (eq.in_front, eq.lit_side)
"""Inequalities of every programme in the paper's variables."""


@eq.equation("1", "the search's bound on depth, a million beam radii", "1", eq.Block.GEOMETRY)
def nearer(m: eq.Namespace, v: eq.SlopeVariables, k: eq.Setup) -> Any:
    """The upper bound of ``z_L`` in `pose_bounds`, as a row, over itself."""
    del m
    return 1 - v.z_L / (FARTHEST * k.r)


@eq.equation("1", "the search's bound on the tilt, 89.9 deg", "1", eq.Block.GEOMETRY)
def less_steep(m: eq.Namespace, v: eq.SlopeVariables, k: eq.Setup) -> Any:
    """The upper bound of ``R`` in `pose_bounds` where the spot lies on the beam, squared, as a row over itself."""
    del m, k
    return 1 - (1 + v.p**2 + v.q**2) * np.cos(STEEPEST) ** 2


def unit_size(unit: str, r: float) -> float:
    """What one beam radius is in the unit of an equation: 1, mm or mm^2."""
    return {"1": 1.0, "mm": r, "mm^2": r**2}[unit]


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuse an option that is none of its choices.

    Raises
    ------
    InputError
        If ``value`` is not among ``choices``.
    """
    if value not in choices:
        raise InputError(f"{name} must be one of {', '.join(map(repr, choices))}, not {value!r}")


def pose_bounds(variables: Variables, r: float) -> tuple[Array, Array]:
    """Lower and upper bounds of ``(R, z_L, p, q)`` or ``(R, z_L, alpha, beta)``; mm, rad.

    Either way the same planes: in front, nearer than `FARTHEST`, tilted less than `STEEPEST`.
    """
    longest, slope = r / np.cos(STEEPEST), np.tan(STEEPEST)
    if variables == "slopes":
        return np.array([0.0, 0.0, -slope, -slope]), np.array([longest, FARTHEST * r, slope, slope])
    return np.array([0.0, 0.0, -STEEPEST, -TURNS]), np.array([longest, FARTHEST * r, STEEPEST, TURNS])


def pose_scale(r: float, z_L: float) -> Array:
    """Typical sizes of the four unknowns in either set, for checks that compare with 1."""
    return np.array([r, abs(z_L), 1.0, 1.0])
