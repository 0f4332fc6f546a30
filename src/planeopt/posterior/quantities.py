"""From draws of plane and rig to everything that is reported."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.formulations.problem import Problem
from planeopt.rig import BEAM_PARAMETERS, rotation_to_axis

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Beams:
    """The beam of each draw; arrays (S,) or (S, 3).

    Attributes
    ----------
    offset : (S, 2)
        ``(e_x, e_y)`` in the camera frame, mm.
    radius : (S,)
    rows : (S, 3, 3)
        Rotation Q from the camera frame to the laser-parallel frame.
    """

    offset: Array
    radius: Array
    rows: Array

    @property
    def axial_shift(self) -> Array:
        """``(Q e)_z`` (S,), mm: what the spot centre's z has over the distance along the beam."""
        return np.sum(self.rows[:, 2, :2] * self.offset, axis=1)


def beams(problem: Problem, names: tuple[str, ...], parameters: Array) -> Beams:
    """The beam of each draw (S, k) of the rig's parameters; without a rig the laser-parallel frame is the camera's."""
    n = len(parameters)
    if problem.rig is None:
        offset = np.broadcast_to([problem.setup.e_x, problem.setup.e_y], (n, 2))
        return Beams(offset, np.full(n, problem.setup.r), np.broadcast_to(np.eye(3), (n, 3, 3)))
    rig = problem.rig
    e_x, e_y, radius, l_x, l_y = (
        parameters[:, names.index(name)] if name in names else np.full(n, rig.parameter(name))
        for name in BEAM_PARAMETERS
    )
    rows = rotation_to_axis(l_x, l_y, np.sqrt(1 - l_x**2 - l_y**2))
    turn = np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=1)
    return Beams(np.stack([e_x, e_y], axis=1), radius, turn)


NAMES = ("z_L", "p", "q", "alpha", "beta", "R", "normal_x", "normal_y", "normal_z", "a", "b", "c")
"""What `quantities` gives: mm, rad and 1."""


def quantities(planes: Array, beam: Beams) -> dict[str, Array]:
    """Every reported quantity of each draw, by name as in `NAMES`, (S,) each.

    Parameters
    ----------
    planes : (S, 3)
        ``(z_L, p, q)`` as in the equations.
    beam : Beams

    Returns
    -------
    dict of str to (S,)
        ``z_L`` along the beam; ``alpha`` and ``beta`` in (-pi, pi] by `SpotPose`'s convention; the unit normal in the
        camera frame; the intercepts of (1) there, infinite where the plane is parallel to an axis.
    """
    p, q = planes[:, 1], planes[:, 2]
    slope = np.hypot(p, q)
    length = np.hypot(1.0, slope)
    upward = np.stack([-p, -q, np.ones_like(p)], axis=1) / length[:, None]
    normal = np.einsum("si,sij->sj", upward, beam.rows)
    along = planes[:, 0] - beam.axial_shift
    point = along[:, None] * beam.rows[:, 2]
    point[:, :2] += beam.offset
    distance = np.sum(normal * point, axis=1)
    with np.errstate(divide="ignore"):
        intercepts = distance[:, None] / normal
    values = (
        *(along, p, q, np.arctan(slope), np.arctan2(-p, q), beam.radius * length),
        *normal.T,
        *intercepts.T,
    )
    return dict(zip(NAMES, values, strict=True))
