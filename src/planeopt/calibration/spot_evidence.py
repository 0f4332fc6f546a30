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
    boundaries = here.boundaries
    if boundaries is None:
        return found
    selection = task.model.selection
    moved = free_values(task.model, here.state) - basis.full
    factor = np.asarray(np.linalg.cholesky(basis.sigma), dtype=np.float64)
    corner_weight = np.repeat(weights.corners, 2, axis=1)
    for row in np.flatnonzero(weights.boundary.any(axis=1)).tolist():
        corner_root = np.sqrt(corner_weight[row])
        corners = _rows(here.corners, row, selection, basis, moved, factor) * corner_root[:, None]
        spot = _ellipse(boundaries, weights.boundary[row], row)
        spots = spot.T @ (
            _rows(boundaries.linear, row, selection, basis, moved, factor) * np.sqrt(weights.boundary[row])[:, None]
        )
        prior = np.eye(basis.free.shape[1], corners.shape[1])
        without = np.vstack([prior, corners])
        found[row] = _least(np.vstack([without, spots])) - _least(without)
    return found


def _rows(linear: Linear, row: int, selection: Array, basis: Basis, moved: Array, factor: Array) -> Array:
    """Derivatives by the parameters, in units in which they are white, and by the pose; last the residual before."""
    shared = linear.shared[row] @ selection
    before = linear.residual[row] - shared @ moved
    return np.column_stack([shared @ basis.free @ factor, linear.pose[row], before])


def _ellipse(boundaries: Boundaries, weight: Array, row: int) -> Array:
    """Orthonormal basis (M, 5) of the changes of a boundary, in standard deviations, that an ellipse can show."""
    angle, scale = boundaries.around[row], boundaries.scale[row]
    shapes = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    return np.linalg.svd(shapes * (np.sqrt(weight) / scale)[:, None], full_matrices=False)[0][:, :ELLIPSE]


def _least(rows: Array) -> float:
    """Least sum of squares of linear rows whose last column is the residual."""
    size = np.linalg.norm(rows[:, :-1], axis=0)
    left = rows[:, -1]
    inside = np.linalg.qr(rows[:, :-1] / np.where(size > 0, size, 1.0))[0]
    left = left - inside @ (inside.T @ left)
    return float(left @ left)
