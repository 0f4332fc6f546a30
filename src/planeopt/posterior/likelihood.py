"""How well planes explain the boundary points: vectorised over planes."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from planeopt.equations import Setup
from planeopt.errors import InputError
from planeopt.formulations.problem import Problem
from planeopt.posterior.kernel import Kernel
from planeopt.posterior.rig_part import RigPart
from planeopt.solution import Flag

Array = NDArray[np.float64]

_CHUNK_NUMBERS = 2**19
"""Largest array of a step, in numbers: what is larger is no faster and takes memory."""

_ROBUST_STEPS = 6
"""To the likeliest rig of a plane with Student-t noise: with one point in ten an outlier of 50 sigma the normal law's
step is bad, and these bring it back to 1e-4 of the log likelihood. Without outliers that one step is enough."""


class Scale(Enum):
    """What is known of the noise's scale; the value says it."""

    GIVEN = "The points' sigma is taken as given."
    INTEGRATED = (
        "The noise's scale is not known: it is integrated out with the prior 1/sigma, which makes Student's t of the "
        "normal law."
    )
    SAMPLED = "The noise's scale is not known: it is sampled with the plane, with the prior 1/sigma."


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Log likelihood of planes, and of the noise's scale where it is sampled.

    The whitened distances ``r`` of the points from a plane's image ellipse are standard normal, or Student-t. A rig's
    parameters move them to ``r(z)``, ``z`` standard normal, which is integrated out as a normal law about the likeliest
    ``z`` of the plane: ``-1/2 [r'r + z'z + log det(I + G'G)]`` there, ``G`` the derivative of ``r``.

    Attributes
    ----------
    setup : Setup
    kernel : Kernel
    scale : Scale
    robust : float or None
        Degrees of freedom of Student's t; None for normal noise.
    rig : RigPart or None
        What of the rig is uncertain; None where it is taken as it stands.
    """

    setup: Setup
    kernel: Kernel
    scale: Scale
    robust: float | None = None
    rig: RigPart | None = None

    @classmethod
    def of(cls, problem: Problem, *, robust: float | None = None, condition_on_rig: bool = False) -> "Likelihood":
        """For the points of a problem.

        Raises
        ------
        InputError
            If there are no points, five without a sigma, or ``robust`` is not positive.
        """
        if problem.points is None or problem.noise is None:
            raise InputError("a posterior needs the boundary points; only the ellipse (16) was given")
        if problem.scale_dof == 0:
            raise InputError("five points leave nothing to estimate their noise from: give sigma_px, or more points")
        if robust is not None and not (math.isfinite(robust) and robust > 0):
            raise InputError(f"robust must be the degrees of freedom of Student's t, above 0, not {robust}")
        uncertain = problem.rig is not None and problem.rig.covariance is not None and not condition_on_rig
        kernel = Kernel.of(problem.points, problem.noise, problem.setup)
        rig = RigPart.of(problem, problem.rig, kernel.roots) if problem.rig is not None and uncertain else None
        if problem.scale_dof is None or Flag.SCALE_AT_FLOOR in problem.flags:
            scale = Scale.GIVEN
        else:
            scale = Scale.INTEGRATED if robust is None and rig is None else Scale.SAMPLED
        return cls(problem.setup, kernel, scale, None if robust is None else float(robust), rig)

    def __call__(self, planes: Array, log_scale: Array | None = None) -> Array:
        """Log likelihood (W,) of planes (W, 3), up to a constant; not finite where a plane has no image.

        Parameters
        ----------
        planes : (W, 3)
            ``(z_L, p, q)`` as in the equations.
        log_scale : (W,), optional
            Log of the noise's scale over the estimated one, where it is sampled.
        """
        columns = self.kernel.n * (3 if self.rig is None else self.rig.size)
        rows = max(1, _CHUNK_NUMBERS // columns)
        if len(planes) <= rows:
            return self._block(planes, log_scale)
        cuts = range(0, len(planes), rows)
        scales = [None if log_scale is None else log_scale[at : at + rows] for at in cuts]
        return np.concatenate([self._block(planes[at : at + rows], s) for at, s in zip(cuts, scales, strict=True)])

    def _block(self, planes: Array, log_scale: Array | None) -> Array:
        lost = 0.0 if log_scale is None else self.kernel.n * log_scale
        if self.rig is not None:
            return self._with_rig(self.rig, planes, log_scale)[0] - lost
        r, _ = self.kernel.distances(planes)
        if log_scale is not None:
            r = r * np.exp(-log_scale)[:, None]
        if self.robust is not None:
            return _student(r, self.robust) - lost
        total = np.einsum("wn,wn->w", r, r)
        return -0.5 * self.kernel.n * np.log(total) if self.scale is Scale.INTEGRATED else -0.5 * total - lost

    def _with_rig(self, rig: RigPart, planes: Array, log_scale: Array | None) -> tuple[Array, Array, Array]:
        """Log likelihood (W,) with the rig integrated out, and the mean (W, k) and information (W, k, k) of its ``z``.

        Gauss and Newton's steps to the likeliest ``z``, or Fisher's with Student-t noise; the last one is not taken but
        counted in, so that what is left of it is of fourth order. The integral is Laplace's approximation with the
        expected information.
        """
        z = np.zeros((len(planes), rig.size))
        # With Student-t noise too the first step is the normal law's: far from the nominal rig's plane there are
        # nothing but outliers at z = 0.
        for dof in (None,) if self.robust is None else (None, *(_ROBUST_STEPS * (self.robust,))):
            z = z + _step(rig, planes, z, log_scale, dof)[3]
        r, score, information, step = _step(rig, planes, z, log_scale, self.robust)
        here = -0.5 * np.einsum("wn,wn->w", r, r) if self.robust is None else _student(r, self.robust)
        _, log_det = np.linalg.slogdet(information)
        value = here - 0.5 * np.einsum("wk,wk->w", z, z) - 0.5 * np.einsum("wk,wk->w", score, step) - 0.5 * log_det
        return value, z + step, information

    def rig_given(self, planes: Array, log_scale: Array | None = None) -> tuple[Array, Array]:
        """Mean (W, k) and information (W, k, k) of the rig's whitened parameters, given the planes and the points."""
        if self.rig is None:
            return np.empty((len(planes), 0)), np.empty((len(planes), 0, 0))
        _, mean, information = self._with_rig(self.rig, planes, log_scale)
        return mean, information

    def draw_rig(self, rng: np.random.Generator, planes: Array, log_scale: Array | None = None) -> Array:
        """Draw the rig's parameters (W, k), one set for each plane, given the plane and the points; (W, 0) without."""
        if self.rig is None:
            return np.empty((len(planes), 0))
        noise = rng.standard_normal((len(planes), self.rig.size, 1))
        rows = max(1, _CHUNK_NUMBERS // (self.kernel.n * self.rig.size))
        drawn = []
        for at in range(0, len(planes), rows):
            part = slice(at, at + rows)
            mean, information = self.rig_given(planes[part], None if log_scale is None else log_scale[part])
            upper = np.swapaxes(np.linalg.cholesky(information), 1, 2)
            drawn.append(mean + np.linalg.solve(upper, noise[part])[:, :, 0])
        return self.rig.parameters_at(np.concatenate(drawn))


def _step(
    rig: RigPart, planes: Array, z: Array, log_scale: Array | None, dof: float | None
) -> tuple[Array, Array, Array, Array]:
    """Towards the likeliest ``z``: distances (W, N), slope (W, k) and curvature (W, k, k) here, and the step (W, k).

    Slope and expected curvature are those of minus the log density.
    """
    r, G = rig.distances(planes, z)
    if log_scale is not None:
        precision = np.exp(-log_scale)[:, None]
        r, G = r * precision, G * precision[:, :, None]
    weight, pull = (1.0, r) if dof is None else ((dof + 1) / (dof + 3), r * (dof + 1) / (dof + r * r))
    information = weight * (np.swapaxes(G, 1, 2) @ G) + np.eye(rig.size)
    score = (pull[:, None, :] @ G)[:, 0, :] + z
    step = -np.asarray(np.linalg.solve(information, score[:, :, None]), dtype=float)[:, :, 0]
    return r, score, information, step


def _student(r: Array, dof: float) -> Array:
    """Sum over the points of the log density of Student's t, up to a constant."""
    return -0.5 * (dof + 1) * np.sum(np.log1p(r * r / dof), axis=1)
