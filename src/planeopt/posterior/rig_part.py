"""The rig's uncertain parameters: one normal law, integrated out for each plane, drawn back afterwards."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.formulations.problem import Problem
from planeopt.posterior.kernel import moved_distances
from planeopt.rig import Rig

Array = NDArray[np.float64]

# A secant over a fifth of a standard deviation is the derivative to first order, and far above the rounding of the
# lens's inverse.
_STEP = 0.1


@dataclass(frozen=True, eq=False)
class RigPart:
    """The rig's free parameters ``eta = nominal + root z``, ``z`` standard normal.

    Where the points lie on the laser-parallel image plane, and ``e_x, e_y, r`` there, are taken as linear in ``z``. The
    points' distances from an ellipse are not: a principal point off by a pixel moves the points by a pixel, and where
    the spot is small the square of that over its radius is more than the noise. They are evaluated where the points
    have moved to.

    Attributes
    ----------
    parameters : tuple of str
        Their names.
    nominal : (k,)
    root : (k, k)
        ``root root'`` is their covariance.
    points : (2, N)
        Of the nominal rig, mm.
    beam : (3,)
        ``e_x, e_y, r`` of the nominal rig, laser-parallel frame.
    by_rig : (N, 5, k)
        Of each point's x and y, its raw pixel held fixed, and of ``e_x, e_y, r``, by ``z``.
    f : float
    roots : (3, N)
        Of the points' noise, as in `Kernel`.
    """

    parameters: tuple[str, ...]
    nominal: Array
    root: Array
    points: Array
    beam: Array
    by_rig: Array
    f: float
    roots: Array

    @classmethod
    def of(cls, problem: Problem, rig: Rig, roots: Array) -> "RigPart":
        """Differentiate where the points lie, and the beam's numbers, by the rig's parameters.

        Parameters
        ----------
        problem : Problem
            Made from a spot, so that its raw pixels are there.
        rig : Rig
            With a covariance.
        roots : (3, N)
            Of the points' noise, as in `Kernel`.

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
        setup, moved = problem.setup, np.stack(points, axis=-1)
        return cls(
            names,
            nominal,
            root,
            np.ascontiguousarray(problem.points.T),
            np.array([setup.e_x, setup.e_y, setup.r]),
            np.concatenate([moved, np.broadcast_to(np.stack(beams, axis=-1), (len(moved), 3, len(names)))], axis=1),
            float(setup.f),
            roots,
        )

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.parameters)

    def distances(self, planes: Array, z: Array) -> tuple[Array, Array]:
        """Distances of the points where a rig puts them, and their derivatives by the rig.

        Parameters
        ----------
        planes : (W, 3)
        z : (W, k)
            Whitened parameters.

        Returns
        -------
        distances : (W, N)
            In standard deviations.
        derivatives : (W, N, k)
            By ``z``.
        """
        points = np.stack([self.points[i] + z @ self.by_rig[:, i].T for i in (0, 1)])
        found = moved_distances(planes, self.f, points, self.beam + z @ self.by_rig[0, 2:].T, self.roots)
        # Point by point, which keeps the large array in an order that the products after it can use as it lies.
        derivatives = np.ascontiguousarray(found.derivatives.T) @ self.by_rig
        return found.distance, derivatives.transpose(1, 0, 2)

    def parameters_at(self, z: Array) -> Array:
        """The rig's parameters (..., k) at whitened ones (..., k)."""
        return self.nominal + z @ self.root.T


def _seen(problem: Problem, rig: Rig, names: tuple[str, ...], values: Array) -> tuple[Array, Array]:
    """Where the same raw pixels lie for another rig, at the problem's own ``f``, and ``e_x, e_y, r`` there."""
    other = rig.with_parameters(dict(zip(names, values.tolist(), strict=True)))
    points, _ = other.to_laser_plane(problem.pixels if problem.pixels is not None else [])
    return points * (problem.setup.f / other.focal_length), np.array([*other.laser_offset, other.require_beam().radius])
