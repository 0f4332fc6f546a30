"""First-order effect of the rig's uncertainty on many planes, and on what each spot says about the rig."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation.descent import at_planes
from planeopt.estimation.feet import Boundary
from planeopt.estimation.rig_part import PARAMETERS, SEEN, axial_shift_by_rig, free_parameters, point_derivatives
from planeopt.rig import Rig

Array = NDArray[np.float64]

CHUNK = 1 << 14
"""Points worked on at once."""


@dataclass(frozen=True, eq=False)
class RigEffect:
    """Derivatives at M solutions, as `planeopt.estimation.rig_part.Sensitivity` and `planeopt.solution.RigTest` hold.

    Attributes
    ----------
    plane_by_rig : (M, 3, n)
        ``(z_L, p, q)``, ``z_L`` along the beam, by the free parameters of the rig's covariance.
    misfit : (M, 2)
        The part of the points' distances that another ellipse would explain and no plane does; white.
    misfit_by_rig : (M, 2, n)
    misfit_by_beam : (M, 2, 4)
        By e_x, e_y, direction_x and direction_y.
    """

    plane_by_rig: Array
    misfit: Array
    misfit_by_rig: Array
    misfit_by_beam: Array


def rig_effect(
    rig: Rig, setup: eq.Setup, planes: Array, points: Array, noise: Array, rays: Array, counts: NDArray[np.int64]
) -> RigEffect:
    """Differentiate M maximum-likelihood planes by the rig's parameters, the raw pixels held fixed.

    Parameters
    ----------
    rig : Rig
    setup : Setup
        Of the rig.
    planes : (M, 3)
        ``(z_L, p, q)`` in the equations' sense; finite.
    points : (M, N, 2)
        On the laser-parallel image plane, mm.
    noise : (M, N, 2, 2)
        Their covariances, mm^2.
    rays : (M, N, 2)
        Normalised coordinates of the points in the camera frame.
    counts : (M,)
        Points of each row; the others are padding, and finite.
    """
    m, n = len(planes), points.shape[1]
    size = max(1, CHUNK // max(n, 1))
    n_free = free_parameters(rig).shape[1]
    made = RigEffect(np.empty((m, 3, n_free)), np.empty((m, 2)), np.empty((m, 2, n_free)), np.empty((m, 2, len(SEEN))))
    for begin in range(0, m, size):
        rows = slice(begin, begin + size)
        longest = int(np.max(counts[rows]))
        part = _piece(
            rig, setup, planes[rows], points[rows, :longest], noise[rows, :longest], rays[rows, :longest], counts[rows]
        )
        made.plane_by_rig[rows], made.misfit[rows] = part.plane_by_rig, part.misfit
        made.misfit_by_rig[rows], made.misfit_by_beam[rows] = part.misfit_by_rig, part.misfit_by_beam
    return made


def _piece(
    rig: Rig, setup: eq.Setup, planes: Array, points: Array, noise: Array, rays: Array, counts: NDArray[np.int64]
) -> RigEffect:
    m, n = points.shape[:2]
    used = np.arange(n) < counts[:, None]
    row = np.nonzero(used)[0]
    by_all = np.zeros((m, n, len(PARAMETERS)))
    by_all[used] = point_derivatives(rig, rays[used], noise[used], planes[row])[1]
    boundary = Boundary.of(points, noise, used)
    conics, found, monomials = at_planes(planes, boundary, setup)
    by_plane = np.swapaxes((conics.by_plane @ monomials) * found.rate[:, None, :], -1, -2)
    by_ellipse = np.swapaxes(monomials[:, 1:] * found.rate[:, None, :], -1, -2)
    # QR, not normal equations: short arcs hardly tell the coefficients of an ellipse apart.
    basis = np.linalg.qr(by_ellipse)[0]
    inside = np.swapaxes(basis, -1, -2) @ by_plane
    turned, triangle = np.linalg.qr(inside, mode="complete")
    rotated = np.swapaxes(basis @ turned, -1, -2)
    step = -np.linalg.solve(triangle[:, :3], rotated[:, :3] @ by_all)
    left_over = rotated[:, 3:]
    misfit_by_all = left_over @ by_all
    free = free_parameters(rig)
    plane_by_rig = step @ free
    plane_by_rig[:, 0] -= axial_shift_by_rig(rig)
    seen = np.array([PARAMETERS.index(name) for name in SEEN])
    return RigEffect(
        plane_by_rig, (left_over @ found.distance[..., None])[..., 0], misfit_by_all @ free, misfit_by_all[:, :, seen]
    )
