"""The spots put back on their boards: how the beam's section in each view lies beside the fitted axis."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.packed import Packed
from planeopt.calibration.projection import linear_boundaries

Array = NDArray[np.float64]

_UNKNOWN = 3  # centre and radius


@dataclass(frozen=True, eq=False)
class BeamSection:
    """The beam across its axis, as the spot of one view has it.

    Parameters
    ----------
    along : float
        Where on the axis, mm from z = 0.
    centre : (3,) array
        Of the section, camera frame, mm.
    axis : (3,) array
        Where the fitted axis is there.
    radius : float
        mm.
    sigma_centre : (2,) array
        Standard deviations of the centre's x and y from the boundary's noise alone, mm.
    sigma_radius : float
        Likewise.
    """

    along: float
    centre: Array
    axis: Array
    radius: float
    sigma_centre: Array
    sigma_radius: float


def beam_sections(adjustment: Adjustment) -> tuple[BeamSection | None, ...]:
    """Return the beam's section in each view; None where there is no spot.

    The boundary's points are put onto the board, and centre and radius fitted to their distances from the fitted
    beam, to first order in its misfit, with the weights of the adjustment.
    """
    packed = Packed.of(adjustment.observations)
    if adjustment.model.beam == "none" or not packed.boundary_seen.any():
        return (None,) * len(packed)
    state = adjustment.state
    found = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
    outside = found.linear.residual * found.scale
    weights = packed.boundary_seen / (packed.boundary_sigma * adjustment.noise.spots * found.scale) ** 2
    start = np.array([state.value("e_x"), state.value("e_y"), 0.0])
    direction = state.direction
    away = found.points - start
    along = away @ direction
    across = away - along[..., None] * direction
    basis = _across(direction)
    unit = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    rows = np.concatenate([unit @ basis.T, np.ones_like(along)[..., None]], axis=-1)
    made: list[BeamSection | None] = []
    for view, seen in enumerate(packed.boundary_seen):
        if np.count_nonzero(seen) < _UNKNOWN:
            made.append(None)
            continue
        left = rows[view, seen].T * weights[view, seen]
        covariance = np.linalg.inv(left @ rows[view, seen])
        *shift, wider = covariance @ (left @ outside[view, seen])
        middle = float(np.mean(along[view, seen]))
        axis = start + middle * direction
        radius = state.value("radius") + state.value("divergence") * middle + wider
        spread = np.sqrt(np.diagonal(basis.T @ covariance[:2, :2] @ basis))
        made.append(
            BeamSection(middle, axis + shift @ basis, axis, float(radius), spread[:2], float(covariance[2, 2]) ** 0.5)
        )
    return tuple(made)


def _across(direction: Array) -> Array:
    """Return two unit vectors (2, 3) across the beam, the first without a y."""
    first = np.cross(np.array([0.0, 1.0, 0.0]), direction)
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])
