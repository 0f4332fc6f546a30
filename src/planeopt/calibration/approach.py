"""From nothing, or a rig that is held, to the neighbourhood of the least cost."""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.equations import AdjustmentError, Equations, Task, Weights, descend, equations
from planeopt.calibration.model import RUNGS, Model
from planeopt.calibration.noise import corner_norms, robust_noise, weights_given
from planeopt.calibration.start import other_poses, pose_views, start_beam, start_camera
from planeopt.calibration.state import State
from planeopt.errors import InputError
from planeopt.rig import Rig

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)


def approach(task: Task, held: Rig | None) -> State:
    """Return a state near the least cost or, where a rig is held, with its values.

    Parameters
    ----------
    task : Task
    held : Rig, optional

    Raises
    ------
    AdjustmentError
        If the corners alone lead nowhere.
    InputError
        If a view has too few corners, or no spot is an ellipse.
    """
    packed, model = task.packed, task.model
    state = start_camera(packed) if held is None else pose_views(packed, held.camera, _rest(held))
    if held is None and model.camera:
        # Rung by rung: what a rung finds is a good start for the next, and from afar k2 or k3 may fold the image.
        for rung in RUNGS[: RUNGS.index(model.distortion) + 1]:
            state = _climb(Task(packed, Model(distortion=rung, warp=False, beam="none"), with_spots=False), state)
    if model.beam != "none" and (held is None or held.beam is None):
        state = start_beam(packed, state, free=model.beam == "free")
    return state


def _climb(task: Task, state: State) -> State:
    """Return the state at the least of Huber's loss of the corners, each board in the better of its two poses."""
    given = weights_given(task.packed)
    noise = robust_noise(task, equations(task, state, given))
    here, _ = descend(task, state, noise.weights(given), huber=True)
    poses = Task(task.packed, Model(camera=False, warp=False, beam="none"), with_spots=False)
    try:
        other, _ = descend(poses, other_poses(task.packed, here.state), noise.weights(given), huber=True)
    except (AdjustmentError, InputError) as error:
        _log.debug("the boards' other poses lead nowhere: %s", error)
        return here.state
    better = _misfits(other, given) < _misfits(here, given)
    if np.any(better):
        _log.debug("%d boards turned to their other pose", np.count_nonzero(better))
    return replace(
        here.state,
        rotations=np.where(better[:, None, None], other.state.rotations, here.state.rotations),
        translations=np.where(better[:, None], other.state.translations, here.state.translations),
    )


def _misfits(found: Equations, weights: Weights) -> Array:
    return np.sum(weights.corners * corner_norms(found) ** 2, axis=1)


def _rest(rig: Rig) -> Array:
    if rig.beam is None:
        return np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    beam = rig.beam
    return np.array([0.0, 0.0, *beam.offset, beam.radius, *beam.direction[:2], 0.0])
