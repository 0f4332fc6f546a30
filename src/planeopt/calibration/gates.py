"""Whether a calibration can be trusted: every condition of a good session, causes before what they cause."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planeopt.board import Observations
from planeopt.calibration import gates_fit, gates_poses, gates_seen
from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.board_shape import misplaced_corners
from planeopt.calibration.board_stretch import board_stretch, in_proportion
from planeopt.calibration.equations import AdjustmentError, Prior
from planeopt.calibration.gate import Gate, at_most
from planeopt.calibration.gates_seen import Image
from planeopt.calibration.ladder import Tested
from planeopt.calibration.model import Model
from planeopt.calibration.null_direction import NullDirection, null_directions
from planeopt.calibration.packed import Packed
from planeopt.calibration.start import LEAST_CORNERS, pose_views
from planeopt.errors import InputError
from planeopt.rig import Camera

_log = logging.getLogger(__name__)

CAMERA_CONDITION = 3000.0, 1e4
"""200 good sessions had 80 to 2000, half of them under 310, more the longer the lens; frontal ones have over 1e4."""
BEAM_CONDITION = 50.0, 1e3
"""About twice the distance over its spread: 200 good sessions had 8 to 24, sessions at one depth have 100 to 250."""

_ORDINARY = 1.5
_LOOSE = 0.15, 0.1, 0.1
"""Of a camera that is only to tell the tilts: f over the image's larger side; sigma of f over f, of cx and cy over the
image's width, of the distortion at the image's corner over its radius. Tilted views overrule it; without them f must
not run off to where there is no perspective."""
_HOPELESS_DEG = 3.0
_A_FEW = 10


def judge(
    adjustment: Adjustment,
    images: Sequence[Image] = (),
    *,
    tests: Mapping[str, Tested] | None = None,
    expect: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Gate, ...]:
    """Judge a calibration.

    Parameters
    ----------
    adjustment : Adjustment
    images : sequence of ImageStatus
        What became of each image of the session.
    tests : mapping of str to Tested
        Of `compare_terms`; "warp" is used.
    expect : mapping of str to (float, float)
        What is known otherwise, with its tolerance: `radius_mm`, `f_mm` and so on.

    Returns
    -------
    tuple of Gate
        Causes before what they cause; `planeopt.calibration.gate.verdict` sums them up.

    Raises
    ------
    InputError
        If `expect` names what is not there.
    """
    observations, state = adjustment.observations, adjustment.state
    tests, expect = tests or {}, expect or {}
    lit = adjustment.spot_used
    fits, sizes = _fit_gates(adjustment, expect)
    return _present(
        *_seen(observations, images, lit.tolist()),
        *gates_poses.tilt_gates(state),
        *fits,
        gates_poses.spot_depth_gate(state, lit) if adjustment.model.beam == "free" else None,
        gates_poses.board_depth_gate(observations, state),
        *sizes,
        gates_fit.view_gate(adjustment),
        gates_fit.bow_gate(adjustment, tests),
        gates_fit.residual_gate(adjustment),
        gates_fit.beam_gate(adjustment),
        gates_fit.spot_fit_gate(adjustment),
        gates_fit.outlier_gate(adjustment),
        *(_condition_gate(found) for found in null_directions(adjustment)),
        gates_fit.focal_gate(adjustment),
    )


def judge_unadjusted(
    observations: Observations, images: Sequence[Image] = (), *, reason: str = "The adjustment failed."
) -> tuple[Gate, ...]:
    """Judge a session that gave no calibration: what was seen, and the tilts, which a loosely known camera tells.

    Parameters
    ----------
    observations : Observations
    images : sequence of ImageStatus
    reason : str
        Why there is no calibration; of the last gate, which refuses.
    """
    observations = replace(observations, views=tuple(view for view in observations.views if len(view) >= LEAST_CORNERS))
    loose = _loosely_adjusted(observations)
    tilts = () if loose is None else gates_poses.tilt_gates(loose.state)
    camera = None if loose is None else _camera_gate(loose)
    sentence = f"{reason.rstrip('.')}."
    return _present(
        *_seen(observations, images, None),
        *tilts,
        camera,
        Gate("adjustment", "refuse", None, (None, None), sentence[0].upper() + sentence[1:], symptom=True),
    )


def hopelessly_frontal(observations: Observations) -> bool:
    """Whether no view is tilted by as much as 3 degrees: an adjustment would run off with the focal length, slowly."""
    # One tilted view is enough to know: a few are looked at first, all only where none of them is.
    few = observations.views[:: max(1, len(observations.views) // _A_FEW)]
    for views in (few, observations.views):
        loose = _loosely_adjusted(replace(observations, views=views))
        if loose is None or float(gates_poses.tilts(loose.state).max()) >= _HOPELESS_DEG:
            return False
    return True


def _seen(observations: Observations, images: Sequence[Image], used: Sequence[bool] | None) -> tuple[Gate | None, ...]:
    return (
        gates_seen.image_gate(images),
        gates_seen.marker_gate(images, observations.board),
        gates_seen.mirror_gate(observations),
        gates_seen.view_gate(observations),
        gates_seen.spot_gate(observations, used),
        *gates_seen.coverage_gates(observations),
    )


def _camera_gate(adjustment: Adjustment, by_board: float = 0.0) -> Gate | None:
    """Judge whether there is one camera, where the tilts tell a camera at all."""
    frontal = gates_poses.tilts(adjustment.state).max() < gates_poses.FRONTAL
    return None if frontal else gates_fit.camera_gate(adjustment, by_board)


def _fit_gates(
    adjustment: Adjustment, expect: Mapping[str, tuple[float, float]]
) -> tuple[tuple[Gate | None, ...], tuple[Gate, ...]]:
    """Judge the board's shape, the camera and the squares.

    Squares of a wrong proportion look like two cameras, or a board that is not flat: they are put right first.
    """
    first = _shape_and_camera(adjustment)
    if adjustment.model.camera and any(gate is not None and gate.state != "ok" for gate in first):
        try:
            found, share = in_proportion(adjustment)
        except AdjustmentError as error:
            _log.debug("no adjustment in proportion: %s", error)
        else:
            again = _shape_and_camera(found)
            if all(gate is None or gate.state == "ok" for gate in again):
                return again, gates_fit.size_gates(adjustment, expect, (share, board_stretch(found)[1]))
    return first, gates_fit.size_gates(adjustment, expect, board_stretch(adjustment))


def _shape_and_camera(adjustment: Adjustment) -> tuple[Gate | None, Gate | None]:
    shape = misplaced_corners(adjustment)
    gate = gates_fit.shape_gate(shape)
    explained = 0.0 if shape is None or gate is None or gate.state == "ok" else shape.share
    return gate, _camera_gate(adjustment, explained)


def _loosely_adjusted(observations: Observations) -> Adjustment | None:
    """Return poses under a camera that is held near an ordinary one."""
    if not observations.views:
        return None
    width, height = observations.image_size
    f = _ORDINARY * max(width, height)
    ordinary = np.array([f, (width - 1) / 2, (height - 1) / 2, 0.0])
    corner = np.hypot(width, height) / 2 / f
    spread = np.array([_LOOSE[0] * f, _LOOSE[1] * width, _LOOSE[1] * width, _LOOSE[2] / corner**2])
    prior = Prior(("f", "cx", "cy", "k1"), ordinary, np.diag(spread**-2))
    camera = Camera(observations.image_size, f, f, (width - 1) / 2, (height - 1) / 2, (0.0, 0.0, 0.0, 0.0, 0.0))
    beamless = Model(distortion="k1", warp=False, beam="none")
    try:
        # From an ordinary camera: what is looked for without the prior may have run off already.
        start = pose_views(Packed.of(observations), camera)
        return adjust(replace(observations, spot="none"), beamless, prior=prior, start=start)
    except (AdjustmentError, InputError) as error:
        _log.debug("no poses either with a camera that is known loosely: %s", error)
        return None


def _condition_gate(found: NullDirection) -> Gate:
    of_camera = "cx" in found.names
    limits = CAMERA_CONDITION if of_camera else BEAM_CONDITION
    what = "camera" if of_camera else "beam"
    state = at_most(found.condition, *limits)
    told = f"The {what}'s parameters are told apart with a condition number of {found.condition:.0f}"
    if state == "ok":
        sentence = f"{told} (up to {limits[0]:g} is good); told worst is {found.words}."
    else:
        sentence = f"{told}, up to {limits[0]:g} is good: what is not told is {found.words}. Shoot more: {found.cure}."
    value = found.condition if np.isfinite(found.condition) else None
    return Gate(f"{what} conditioning", state, value, limits, sentence, symptom=True)


def _present(*gates: Gate | None) -> tuple[Gate, ...]:
    return tuple(gate for gate in gates if gate is not None)
