"""Each view's spot against the rig as calibrated: what its corners and the calibration lead one to expect of it."""

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.board_basis import Basis
from planeopt.calibration.equations import Equations, Task, Weights, free_values
from planeopt.calibration.noise import ELLIPSE
from planeopt.calibration.projection import Boundaries, Linear

Array = NDArray[np.float64]


def spots_against(task: Task, weights: Weights, here: Equations, basis: Basis) -> Array:
    """Return chi-squared (V,) of each view's spot, 5 numbers of an ellipse, given its corners and the calibration.

    It is by how much the least cost of corners and calibration grows when the spot is added.

    Parameters
    ----------
    task : Task
    weights : Weights
    here : Equations
        Where the observations are linearised.
    basis : Basis

    Returns
    -------
    ndarray, shape (V,)
        NaN where there is no spot, or it is not used.
    """
    found = np.full(len(task.packed), np.nan)
    for row, corners, both in _views(task, weights, here, basis, basis.sigma):
        if both is not None:
            prior = np.eye(corners.shape[1] - 1, corners.shape[1])
            found[row] = _least(np.vstack([prior, both])) - _least(np.vstack([prior, corners]))
    return found


def spots_together(task: Task, weights: Weights, here: Equations, basis: Basis) -> tuple[float, float]:
    """Return chi-squared of what no change of the rig explains of all spots, and its degrees of freedom.

    By how much the least cost of the corners grows when the spots are added, next to nothing being known of the rig;
    of five numbers a spot those count that do not go into the rig.
    """
    everything = _views(task, weights, here, basis, basis.loosened(basis.names))
    corners = np.vstack([alone for _, alone, _ in everything])
    both = np.vstack([alone if with_spot is None else with_spot for _, alone, with_spot in everything])
    prior = np.eye(corners.shape[1] - 1, corners.shape[1])
    chi2 = _least(np.vstack([prior, both])) - _least(np.vstack([prior, corners]))
    spots = sum(with_spot is not None for _, _, with_spot in everything)
    return max(chi2, 0.0), ELLIPSE * spots - (_paid(both) - _paid(corners))


def _views(
    task: Task, weights: Weights, here: Equations, basis: Basis, sigma: Array
) -> list[tuple[int, Array, Array | None]]:
    """Each view's number, and its equations by corners and, where it has a spot, by both, the pose eliminated."""
    factor = np.asarray(np.linalg.cholesky(sigma), dtype=np.float64)
    selection = task.model.selection
    moved = free_values(task.model, here.state) - basis.full
    corner_root = np.sqrt(np.repeat(weights.corners, 2, axis=1))[..., None]
    made: list[tuple[int, Array, Array | None]] = []
    for row in range(len(task.packed)):
        corners = _rows(here.corners, row, selection, basis, moved, factor) * corner_root[row]
        weight, both = weights.boundary[row], None
        if here.boundaries is not None and weight.any():
            across = _rows(here.boundaries.linear, row, selection, basis, moved, factor) * np.sqrt(weight)[:, None]
            spot = _ellipse(here.boundaries, weight, row).T @ across
            both = _without_pose(np.vstack([corners, spot]))
        made.append((row, _without_pose(corners), both))
    return made


def _rows(linear: Linear, row: int, selection: Array, basis: Basis, moved: Array, factor: Array) -> Array:
    """Derivatives by the pose and by the parameters, in units in which they are white; last the residual before."""
    shared = linear.shared[row] @ selection
    before = linear.residual[row] - shared @ moved
    return np.column_stack([linear.pose[row], shared @ basis.free @ factor, before])


def _without_pose(rows: Array) -> Array:
    size = np.linalg.norm(rows[:, :_POSE], axis=0)
    triangle = np.linalg.qr(rows / np.append(np.where(size > 0, size, 1.0), np.ones(rows.shape[1] - _POSE)))[1]
    return np.asarray(triangle[_POSE:, _POSE:], dtype=np.float64)


def _ellipse(boundaries: Boundaries, weight: Array, row: int) -> Array:
    """Orthonormal basis (M, 5) of the changes of a boundary, in standard deviations, that an ellipse can show."""
    angle, scale = boundaries.around[row], boundaries.scale[row]
    shapes = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    return np.linalg.svd(shapes * (np.sqrt(weight) / scale)[:, None], full_matrices=False)[0][:, :ELLIPSE]


def _least(rows: Array) -> float:
    """Least sum of squares of linear rows whose last column is the residual; the prior makes them of full rank."""
    inside = np.linalg.qr(rows[:, :-1])[0]
    left = rows[:, -1] - inside @ (inside.T @ rows[:, -1])
    return float(left @ left)


def _paid(rows: Array) -> float:
    """How many numbers observed go into the parameters, the prior, white, paying for the rest of them."""
    size = np.linalg.svd(rows[:, :-1], compute_uv=False) ** 2
    return float(np.sum(size / (1 + size)))


_POSE = 6
