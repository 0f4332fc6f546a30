"""The weighted normal equations of a state, and the way down to where they vanish."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.arrow import Arrow
from planeopt.calibration.model import Model
from planeopt.calibration.packed import Packed
from planeopt.calibration.projection import Boundaries, Linear, linear_boundaries, linear_corners
from planeopt.calibration.state import State
from planeopt.errors import InputError

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)

_STEPS = 100
_CONVERGED = 1e-7
"""Of a standard deviation: how long the step that is left may be."""
_ROUGH = 0.02
"""The same, where only the neighbourhood is wanted."""
_ROUGH_STEPS = 40
_LEVEL, _LEVEL_STEPS = 1e-7, 8
"""The way is level where the cost falls by no more than this share of it in so many steps on end."""
_NEAR = 0.3
"""The same, where the way down is nearly straight."""
_DAMPING = 1e-15, 1e12  # least, most
_FIRST_DAMPING = 1e-3, 1e-8  # from afar, from nearby
_HUBER = 2.0  # standard deviations


class AdjustmentError(Exception):
    """The observations do not determine what is asked for, or do not go together; the message is a sentence."""


@dataclass(frozen=True, eq=False)
class Weights:
    """One over the variance of each number observed, 1/px^2; 0 for what is not there or left out.

    Parameters
    ----------
    corners : (V, K) array
        Of u and of v each.
    boundary : (V, M) array
    """

    corners: Array
    boundary: Array

    def some(self, rows: NDArray[np.intp]) -> "Weights":
        """Return those of some of the views."""
        return Weights(self.corners[rows], self.boundary[rows])


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of some parameters beforehand.

    Parameters
    ----------
    names : tuple of str
        As in `Model.names`.
    values : (n,) array
    information : (n, n) array
        Inverse of their covariance.
    """

    names: tuple[str, ...]
    values: Array
    information: Array

    def of(self, model: Model) -> tuple[Array, Array]:
        """Return values (g,) and information (g, g) for a model's free parameters; what is not free is left out."""
        known = [row for row, name in enumerate(self.names) if name in model.names]
        rows = [model.names.index(self.names[row]) for row in known]
        values, information = np.zeros(len(model.names)), np.zeros((len(model.names), len(model.names)))
        values[rows] = self.values[known]
        information[np.ix_(rows, rows)] = self.information[np.ix_(known, known)]
        return values, information


@dataclass(frozen=True, eq=False)
class Task:
    """What is adjusted.

    Parameters
    ----------
    packed : Packed
    model : Model
    with_spots : bool
        Whether the spots' boundaries are used.
    prior : Prior, optional
    """

    packed: Packed
    model: Model
    with_spots: bool
    prior: Prior | None = None


@dataclass(frozen=True, eq=False)
class Equations:
    """A state with its residuals and the normal equations of its linearisation.

    Parameters
    ----------
    state : State
    corners : Linear
        u and v of each corner in turn.
    boundaries : Boundaries, optional
    by_corners, by_boundary : Arrow
        The two parts of the equations; `by_boundary` is zero without spots.
    total : Arrow
        Their sum, with the prior.
    cost : float
        Sum of squared weighted residuals (Huber's loss where that is asked for) and of the prior.
    """

    state: State
    corners: Linear
    boundaries: Boundaries | None
    by_corners: Arrow
    by_boundary: Arrow
    total: Arrow
    cost: float


def equations(task: Task, state: State, weights: Weights, *, huber: bool = False) -> Equations:
    """Linearise at a state.

    Parameters
    ----------
    task : Task
    state : State
    weights : Weights
    huber : bool
        Whether what lies beyond two standard deviations counts by its distance, not by its square.

    Raises
    ------
    InputError
        If the state is no rig, or a point cannot be seen from it.
    """
    packed, selection = task.packed, task.model.selection
    linear = linear_corners(packed.board, packed.corners, state)
    u, v = linear.residual[:, 0::2], linear.residual[:, 1::2]
    weight, loss = _loss(np.hypot(u, v), weights.corners, huber)
    by_corners = Arrow.of(linear.residual, linear.shared @ selection, linear.pose, np.repeat(weight, 2, axis=1))
    boundaries, by_boundary = None, _nothing(len(packed), selection.shape[1])
    if task.with_spots:
        boundaries = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, state)
        at = boundaries.linear
        weight, more = _loss(np.abs(at.residual), weights.boundary, huber)
        by_boundary = Arrow.of(at.residual, at.shared @ selection, at.pose, weight)
        loss += more
    total = by_corners + by_boundary
    if task.prior is not None:
        expected, information = task.prior.of(task.model)
        away = free_values(task.model, state) - expected
        pull = information @ away
        total = total.with_prior(information, pull)
        loss += float(away @ pull)
    return Equations(state, linear, boundaries, by_corners, by_boundary, total, loss)


def free_values(model: Model, state: State) -> Array:
    """Return the values (g,) of a model's free parameters."""
    return np.array([state.value(name) for name in model.names])


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended.

    Parameters
    ----------
    here : Equations
    steps : int
    left : float
        Length of the full step that is left, in standard deviations: what the least cost may be away.
    """

    here: Equations
    steps: int
    left: float


def descend(
    task: Task, state: State, weights: Weights, *, huber: bool = False, most_steps: int | None = None
) -> Descent:
    """Go down to the least cost, by Levenberg's and Marquardt's method.

    With Huber's loss this only leads into the neighbourhood: to a small part of a standard deviation, or as far as a
    few dozen steps go.

    Parameters
    ----------
    task : Task
    state : State
        To start from.
    weights : Weights
    huber : bool
        As in `equations`.
    most_steps : int, optional
        Where it is enough to see what becomes of it.

    Returns
    -------
    Descent
        `left` says how near the least cost is; it stays large where the observations contradict each other so much that
        there is no least cost nearby, or leave a direction open.

    Raises
    ------
    AdjustmentError
        If the start is no rig.
    """
    try:
        here = equations(task, state, weights, huber=huber)
    except InputError as error:
        raise AdjustmentError(f"The adjustment cannot start: {error}.") from error
    least, most = _DAMPING
    left = _left(here)
    steps, close = (_ROUGH_STEPS, _ROUGH) if huber else (_STEPS, _CONVERGED)
    damping = _FIRST_DAMPING[not huber]
    steps = steps if most_steps is None else most_steps
    count = level = 0
    while count < steps and left >= close and damping <= most and level < _LEVEL_STEPS:
        count += 1
        trial = _try(task, here, damping, weights, huber)
        after = np.inf if trial is None else _left(trial)
        # A spot's distances are to first order in their own length: where they no longer move, their cost still slopes
        # by the second, and the shorter step is the better sign.
        if trial is not None and (trial.cost < here.cost or (left < _NEAR and after < left)):
            level = level + 1 if here.cost - trial.cost < _LEVEL * here.cost else 0
            here, damping, left = trial, max(damping / 10, least), after
        else:
            damping *= 10
    _log.debug("%d steps to cost %.6g, %.2g standard deviations left", count, here.cost, left)
    return Descent(here, count, left)


def _left(here: Equations) -> float:
    """Return the length of the full step that is left, in standard deviations."""
    try:
        return here.total.decrement(*here.total.step())
    except np.linalg.LinAlgError:
        return np.inf


def _try(task: Task, here: Equations, damping: float, weights: Weights, huber: bool) -> Equations | None:
    """Return the equations after a damped step; nothing where there is none, or it leads to no rig."""
    try:
        shared, pose = here.total.damped(damping).step()
        moved = here.state.moved(task.model.selection @ shared, pose[:, :3], pose[:, 3:])
        return equations(task, moved, weights, huber=huber)
    except (InputError, np.linalg.LinAlgError):
        return None


def _loss(distance: Array, weight: Array, huber: bool) -> tuple[Array, float]:
    """Return the weights to use and the loss of distances, px, whose weights are given."""
    if not huber:
        return weight, float(np.sum(weight * distance**2))
    sigmas = distance * np.sqrt(weight)
    beyond = sigmas > _HUBER
    share = np.where(beyond, _HUBER / np.where(beyond, sigmas, 1.0), 1.0)
    loss = np.where(beyond, _HUBER * (2 * sigmas - _HUBER), sigmas**2)
    return weight * share, float(np.sum(loss))


def _nothing(views: int, count: int) -> Arrow:
    return Arrow(
        np.zeros((count, count)),
        np.zeros((views, 6, count)),
        np.zeros((views, 6, 6)),
        np.zeros(count),
        np.zeros((views, 6)),
    )
