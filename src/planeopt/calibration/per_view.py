"""What each view alone says about the parameters that all views share, its own pose being unknown."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.adjustment import Adjustment, weights_kept
from planeopt.calibration.equations import Equations, Task, Weights, equations
from planeopt.calibration.packed import Packed
from planeopt.calibration.projection import Linear

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PerView:
    """Normal equations of the shared parameters, view by view.

    Parameters
    ----------
    information : (V, n, n) array
        About the parameters, the view's pose eliminated.
    pull : (V, n) array
        The view alone would move the parameters by x with ``information x = pull``.
    """

    information: Array
    pull: Array

    def __add__(self, other: "PerView") -> "PerView":
        """Return what both say."""
        return PerView(self.information + other.information, self.pull + other.pull)


def task_of(adjustment: Adjustment) -> Task:
    """Return what was adjusted, without its prior."""
    packed = Packed.of(adjustment.observations)
    return Task(packed, adjustment.model, bool(np.any(adjustment.spot_used)))


def weights_of(adjustment: Adjustment, packed: Packed) -> Weights:
    """Return the weights at the end of an adjustment: with the noise's factors, and 0 for what was left out."""
    return adjustment.noise.weights(weights_kept(adjustment, packed))


def linearised(adjustment: Adjustment) -> tuple[Task, Weights, Equations]:
    """Return an adjustment's equations where it ended, without its prior."""
    task = task_of(adjustment)
    weights = weights_of(adjustment, task.packed)
    return task, weights, equations(task, adjustment.state, weights)


def eliminated(linear: Linear, weight: Array, selection: Array) -> PerView:
    """Return what residuals say of shared parameters once each view's pose is eliminated.

    Parameters
    ----------
    linear : Linear
        Of V views with N numbers each.
    weight : (V, N) array
        Each view needs enough that weighs something to fix its pose.
    selection : (17, n) array
        Which shared parameters: `planeopt.calibration.model.Model.selection`.
    """
    return joined([(linear, weight)], selection)


def joined(parts: Sequence[tuple[Linear, Array]], selection: Array) -> PerView:
    """Return what several kinds of residuals of the same views say together; as `eliminated`."""
    rows = [
        (linear.shared @ selection, linear.pose, linear.residual, np.sqrt(weight)[..., None])
        for linear, weight in parts
    ]
    shared = np.concatenate([by_shared * root for by_shared, _, _, root in rows], axis=1)
    pose = np.concatenate([by_pose * root for _, by_pose, _, root in rows], axis=1)
    residual = np.concatenate([residual[..., None] * root for _, _, residual, root in rows], axis=1)
    # QR, not the normal equations of the pose: a distant board's turn and shift are nearly the same.
    basis = np.linalg.qr(pose / _lengths(pose))[0]
    across = np.swapaxes(basis, -1, -2)
    left = shared - basis @ (across @ shared)
    turned = np.swapaxes(left, -1, -2)
    return PerView(turned @ left, -(turned @ residual)[..., 0])


def _lengths(columns: Array) -> Array:
    found = np.linalg.norm(columns, axis=1, keepdims=True)
    return np.where(found > 0, found, 1.0)
