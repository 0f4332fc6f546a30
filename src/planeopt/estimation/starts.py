"""Where a search begins: the closed form unless the caller says otherwise."""

from collections.abc import Sequence

import numpy as np

from planeopt import equations as eq
from planeopt.closed_form import solve_both
from planeopt.errors import InputError
from planeopt.formulations.base import Start
from planeopt.formulations.problem import Problem
from planeopt.plane import SpotPose

StartLike = SpotPose | Sequence[float]
"""A `SpotPose`, or ``(R, z_L, alpha, beta)`` in mm and rad."""


def given(start: StartLike, problem: Problem) -> Start:
    """A caller's start, taken as it is: ``R`` need not fit the beam.

    Raises
    ------
    InputError
        If it is not four finite numbers with positive lengths, or ``|alpha|`` reaches 90 deg.
    """
    if isinstance(start, SpotPose):
        R, z_L, alpha, beta = start.R, start.z_L, start.alpha, start.beta or 0.0
    else:
        wanted = f"start must be four finite numbers (R mm, z_L mm, alpha rad, beta rad), not {start!r}"
        try:
            values = np.asarray(start, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(wanted) from error
        if values.shape != (4,) or not np.isfinite(values).all():
            raise InputError(wanted)
        R, z_L, alpha, beta = (float(value) for value in values)
    if R <= 0 or z_L <= 0 or abs(alpha) >= np.pi / 2:
        raise InputError(f"start needs R > 0, z_L > 0 and |alpha| < pi/2, not R={R:g}, z_L={z_L:g}, alpha={alpha:g}")
    p, q = (float(value) for value in eq.slopes(np, eq.PaperVariables(R, z_L, alpha, beta)))
    return Start(R, (z_L + problem.axial_shift, p, q), beta, cold=True)


def from_closed_form(problem: Problem) -> Start:
    """The visible plane of the closed form.

    Where it has none, the untilted plane whose spot is as wide as the ellipse.
    """
    planes = solve_both(problem.B, problem.setup)
    if planes.ok:
        z_L, p, q = (float(value) for value in planes.visible)
        return Start(float(eq.long_axis(np, p, q, problem.setup.r)), (z_L, p, q), float(np.arctan2(-p, q)))
    z_L = problem.setup.f * problem.setup.r / problem.minor_axis
    return Start(problem.setup.r, (z_L, 0.0, 0.0), 0.0, cold=True)
