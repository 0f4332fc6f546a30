"""The rig's uncertain parameters: one normal law, integrated out where it acts linearly, drawn back afterwards."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.formulations.problem import Problem
from planeopt.posterior.kernel import monomials, rig_forms
from planeopt.rig import Rig

Array = NDArray[np.float64]

# A secant over a fifth of a standard deviation is the derivative to first order, and far above the rounding of the
# lens's inverse.
_STEP = 0.1


@dataclass(frozen=True, eq=False)
class RigPart:
    """The rig's free parameters ``eta = nominal + root z``, ``z`` standard normal.

    Attributes
    ----------
    parameters : tuple of str
        Their names.
    nominal : (k,)
    root : (k, k)
        ``root root'`` is their covariance.
    forms : (10, N k)
        Derivatives of (16) at the points by ``z``, by monomial of the plane.
    """

    parameters: tuple[str, ...]
    nominal: Array
    root: Array
    forms: Array

    @classmethod
    def of(cls, problem: Problem, rig: Rig) -> "RigPart":
        """Differentiate where the points lie, and the beam's numbers, by the rig's parameters.

        Parameters
        ----------
        problem : Problem
            Made from a spot, so that its raw pixels are there.
        rig : Rig
            With a covariance.

        Raises
        ------
        InputError
            If a pixel's ray is lost within a tenth of a standard deviation of the rig's parameters.
        ValueError
            If the problem has no pixels or the rig no covariance.
        """
        if problem.pixels is None or problem.points is None or rig.covariance is None:
            raise ValueError("the rig's part needs boundary points in pixels and a rig with a covariance")
        names, sigmas = rig.covariance.parameters, rig.covariance.sigmas
        root = np.asarray(sigmas[:, None] * np.linalg.cholesky(rig.covariance.correlation), dtype=float)
        nominal = np.array([rig.parameter(name) for name in names])
        points, beams = [], []
        for column in root.T:
            ahead, behind = (_seen(problem, rig, names, nominal + step * column) for step in (_STEP, -_STEP))
            points.append((ahead[0] - behind[0]) / (2 * _STEP))
            beams.append((ahead[1] - behind[1]) / (2 * _STEP))
        forms = rig_forms(problem.points, problem.setup, np.stack(points, axis=-1), np.stack(beams, axis=-1))
        return cls(names, nominal, root, forms.reshape(len(forms), -1))

    @property
    def size(self) -> int:
        return len(self.parameters)

    def effect(self, planes: Array, height: Array) -> Array:
        """Derivatives (W, N, k) of the whitened distances by ``z``; ``height`` (W, N) is the noise of (16)."""
        values = monomials(planes) @ self.forms
        return values.reshape(*height.shape, -1) / height[:, :, None]

    def parameters_at(self, z: Array) -> Array:
        """The rig's parameters (..., k) at whitened ones (..., k)."""
        return self.nominal + z @ self.root.T


def _seen(problem: Problem, rig: Rig, names: tuple[str, ...], values: Array) -> tuple[Array, Array]:
    """Where the same raw pixels lie for another rig, at the problem's own ``f``, and ``e_x, e_y, r`` there."""
    other = rig.with_parameters(dict(zip(names, values.tolist(), strict=True)))
    points, _ = other.to_laser_plane(problem.pixels if problem.pixels is not None else [])
    return points * (problem.setup.f / other.focal_length), np.array([*other.laser_offset, other.require_beam().radius])
