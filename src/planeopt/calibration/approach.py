"""From nothing, or a rig that is held, to the neighbourhood of the least cost."""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.equations import AdjustmentError, Equations, Task, Weights, descend, equations
from planeopt.calibration.model import RUNGS, Model, Rung
from planeopt.calibration.noise import corner_norms, robust_noise, weights_given
from planeopt.calibration.packed import Packed
from planeopt.calibration.start import likely_camera, other_poses, pose_views, start_beam
from planeopt.calibration.state import State
from planeopt.errors import InputError
from planeopt.rig import Camera, Rig

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)

_ENOUGH = 40  # views that tell a camera well enough to start from
_A_FEW = 8  # steps after which the better of two poses is the better one
_STAIRS: tuple[Rung, ...] = ("none", "k1")
_TURNED: Rung = "k1"
"""The rung on which the boards' other poses are tried: without k1 the better one may be the wrong one."""


def approach(task: Task, held: Rig | None, near: Camera | None = None) -> State:
    """Return a state near the least cost or, where a rig is held, with its values.

    Parameters
    ----------
    task : Task
    held : Rig, optional
    near : Camera, optional
        Where to look for the camera; found from the views unless given.

    Raises
    ------
    AdjustmentError
        If the corners alone lead nowhere.
    InputError
        If a view has too few corners, or no spot is an ellipse.
    """
    packed, model = task.packed, task.model
    if held is not None:
        state = pose_views(packed, held.camera, _rest(held))
    elif model.camera:
        state = _camera(packed, model, near)
    else:
        state = pose_views(packed, likely_camera(packed) if near is None else near)
    if model.beam != "none" and (held is None or held.beam is None):
        state = start_beam(packed, state, free=model.beam == "free")
    return state


def _camera(packed: Packed, model: Model, near: Camera | None) -> State:
    """Return camera and poses, from no more views than it takes: the others follow from the camera."""
    rows = np.unique(np.linspace(0, len(packed) - 1, _ENOUGH).round().astype(np.intp))
    some = packed.some(rows)
    state = pose_views(some, likely_camera(some) if near is None else near)
    # By rungs: what a rung finds is a good start for the next, and from afar k2 or k3 may fold the image.
    target = RUNGS.index(model.distortion)
    stairs: list[Rung] = [rung for rung in _STAIRS if RUNGS.index(rung) < target]
    for rung in (*stairs, model.distortion):
        simple = Task(some, Model(distortion=rung, warp=False, beam="none"), with_spots=False)
        state = _climbed(simple, state)
        if rung == _TURNED or rung == model.distortion == "none":
            state = _climbed(simple, _turned(simple, state))
    if len(rows) == len(packed):
        return state
    every = Task(packed, Model(camera=False, warp=False, beam="none"), with_spots=False)
    return _turned(every, _climbed(every, pose_views(packed, state.camera, state.values[9:])))


def _climbed(task: Task, state: State) -> State:
    """Return the state near the least of Huber's loss of the corners."""
    given = weights_given(task.packed)
    noise = robust_noise(task, equations(task, state, given))
    return descend(task, state, noise.weights(given), huber=True).here.state


def _turned(task: Task, state: State) -> State:
    """Return the state with each board in the better of the two poses that a plane seen from far has."""
    given = weights_given(task.packed)
    here = equations(task, state, given)
    weights = robust_noise(task, here).weights(given)
    poses = Task(task.packed, Model(camera=False, warp=False, beam="none"), with_spots=False)
    try:
        other = descend(poses, other_poses(task.packed, state), weights, huber=True, most_steps=_A_FEW).here
    except (AdjustmentError, InputError) as error:
        _log.debug("the boards' other poses lead nowhere: %s", error)
        return state
    better = _misfits(other, given) < _misfits(here, given)
    if not np.any(better):
        return state
    _log.debug("%d boards turned to their other pose", np.count_nonzero(better))
    return replace(
        state,
        rotations=np.where(better[:, None, None], other.state.rotations, state.rotations),
        translations=np.where(better[:, None], other.state.translations, state.translations),
    )


def _misfits(found: Equations, weights: Weights) -> Array:
    return np.sum(weights.corners * corner_norms(found) ** 2, axis=1)


def _rest(rig: Rig) -> Array:
    if rig.beam is None:
        return np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    beam = rig.beam
    return np.array([0.0, 0.0, *beam.offset, beam.radius, *beam.direction[:2], 0.0])
