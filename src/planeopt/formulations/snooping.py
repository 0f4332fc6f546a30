"""Which image equation is at fault: how an error in one coefficient of B shows (Baarda's data snooping)."""

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.formulations.identifiability import independent_jacobian
from planeopt.formulations.problem import Problem

Array = NDArray[np.float64]


def image_misfit(problem: Problem, plane: Array) -> Array:
    """Residuals (5,) of (17)-(21) at ``(z_L, p, q)``."""
    return np.array(eq.image_residuals_in_slopes(np, eq.SlopeVariables(None, *plane), problem.setup, problem.B))


def detectability(problem: Problem, plane: Array) -> Array:
    """How many standard deviations an error of one unit in each coefficient of B would show, once the plane is fitted.

    ``sqrt([W Q W]_ii)`` with ``W = Sigma_B^-1`` and ``Q`` the covariance of the fit's residuals (Baarda, *A testing
    procedure for use in geodetic networks*, 1968). Slacks weighted so cost the same for every coefficient that alone is
    wrong, which makes each of them an extreme point of the L1 ball in the space that the plane leaves over.

    Parameters
    ----------
    problem : Problem
    plane : (3,)
        ``(z_L, p, q)`` at which the image equations are linearised.

    Returns
    -------
    (5,)
        1 over the unit of B_1 ... B_5.
    """
    return np.linalg.norm(space_left_by_plane(problem, plane) @ np.linalg.inv(problem.B_factor), axis=0)


def explained_without(problem: Problem, plane: Array, level: float) -> tuple[eq.Equation, ...]:
    """Image equations whose data alone, if wrong, explain the whole misfit: the others then agree at this level.

    In the two directions left over, an error in one coefficient of B can point almost where an error in another does;
    then only a large one can be told from the other.
    """
    space = space_left_by_plane(problem, plane)
    statistic = space @ np.linalg.solve(problem.B_factor, image_misfit(problem, plane))
    directions = space @ np.linalg.inv(problem.B_factor)
    unit = directions / np.linalg.norm(directions, axis=0)
    rest = statistic @ statistic - (statistic @ unit) ** 2
    return tuple(e for e, chi2 in zip(eq.IMAGE_BLOCK, rest, strict=True) if scipy.stats.chi2.sf(chi2, 1) >= level)


def space_left_by_plane(problem: Problem, plane: Array) -> Array:
    """Orthonormal basis (2, 5) of the whitened misfits of B that no change of the plane makes: the self-test."""
    whitened = whitened_by_plane(problem, plane)
    basis = np.linalg.qr(whitened / np.linalg.norm(whitened, axis=0), mode="complete")[0]
    return basis[:, 3:].T


def whitened_by_plane(problem: Problem, plane: Array) -> Array:
    """Derivative (5, 3) of the image block, in standard deviations of B, by ``(z_L, p, q)``."""
    R = eq.long_axis(np, plane[1], plane[2], problem.setup.r)
    rows = independent_jacobian()(np.array([R, *plane]), np.concatenate([problem.setup, problem.B]))
    return np.asarray(np.linalg.solve(problem.B_factor, np.asarray(rows)[1:, 1:]), dtype=float)
