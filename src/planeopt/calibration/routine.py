"""From a folder of board images to a rig that can be trusted, or to the reason why not."""

import logging
import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from planeopt.board import Board, Observations, View
from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.detection import Detected, ImageStatus, detect
from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.gate import Gate, Verdict, verdict
from planeopt.calibration.gates import hopelessly_frontal, judge, judge_unadjusted
from planeopt.calibration.held_out import HeldOut, held_out
from planeopt.calibration.ladder import Tested, climb, compare_terms
from planeopt.calibration.model import FULL, RUNGS, BeamModel, Focal, Model, Rung
from planeopt.calibration.next_view import NextView, next_view
from planeopt.calibration.pose_cost import PoseCost, pose_cost, working_planes
from planeopt.calibration.sections import beam_sections
from planeopt.calibration.session import Session, load_session
from planeopt.calibration.start import LEAST_CORNERS
from planeopt.errors import InputError
from planeopt.rig import Rig

_log = logging.getLogger(__name__)

Progress = Callable[[str, int, int], object]
"""Called with a stage's name, and how many of how many of its parts are done."""

_EXPECTABLE = ("f", *FULL)

_FEW_VIEWS = 100
"""Up to so many are looked at for being all frontal, in which case an adjustment would wander for long."""

_IN_LINE = 1e-6
"""Of the corners' extent: what is narrower is a line, but for rounding."""

_SQUARE_PIXELS = 1e-3
"""Chance of taking fx and fy apart where the pixels are square: nearly all cameras' are."""


@dataclass(frozen=True)
class Options:
    """What is asked of a calibration.

    Parameters
    ----------
    focal : {"auto", "shared", "separate"}
        One focal length or two; "auto" takes two where the test of squareness asks for it.
    distortion : {"auto", "none", "k1", "k2", "tangential", "k3"}
        The rung of the ladder; "auto" frees all five, kept to what lenses do (`planeopt.calibration.ladder.climb`).
    warp : bool
        Whether the board may be bowed. It costs little, and a bow that is left out is invisible.
    beam : {"free", "parallel", "none"}
        Of free direction; parallel to the optical axis, as the paper has it; camera alone.
    corner_weights : {"measured", "equal"}
        Whether each corner counts by its own sigma, or all the same, as in other programs.
    reject : bool
        Whether outliers are left out, by rule; other programs leave none out.
    expect : mapping of str to (float, float)
        What is known otherwise, and its tolerance (`radius_mm`, `f_mm` ...): the only way in which images can show that
        the board's squares have another size than stated.

    Raises
    ------
    InputError
        If a choice is not known.
    """

    focal: Literal["auto"] | Focal = "auto"
    distortion: Literal["auto"] | Rung = "auto"
    warp: bool = True
    beam: BeamModel = "free"
    corner_weights: Literal["measured", "equal"] = "measured"
    reject: bool = True
    expect: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value, known in (
            ("focal", self.focal, ("auto", "shared", "separate")),
            ("distortion", self.distortion, ("auto", *RUNGS)),
            ("beam", self.beam, ("free", "parallel", "none")),
            ("corner_weights", self.corner_weights, ("measured", "equal")),
        ):
            if value not in known:
                raise InputError(f"{name} must be one of {', '.join(known)}, not {value!r}")
        for name, (value, tolerance) in self.expect.items():
            if name.removesuffix("_mm").removesuffix("_px") not in _EXPECTABLE:
                raise InputError(f"expect: {name!r} is not one of {', '.join(_EXPECTABLE)}, with _mm or _px if liked")
            if not (math.isfinite(value) and 0 < tolerance < math.inf):
                raise InputError(f"expect: {name} must be a number and a positive tolerance, not {value}, {tolerance}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration and all that speaks for it or against it.

    Attributes
    ----------
    observations : Observations
        Of the views that were used.
    images : tuple of ImageStatus
        What became of each image; empty where the observations were given.
    options : Options
    seed : int
    adjustment : Adjustment or None
        None where the observations do not determine a rig.
    ladder : tuple of Tested
        Each rung of distortions against the one below.
    tests : mapping of str to Tested
        `warp`, `aspect`, `parallel`, `divergence`.
    gates : tuple of Gate
        Causes before what they cause.
    next_view : NextView or None
        The view that would help most.
    held_out : HeldOut or None
        How well parts of the observations predict others.
    cost : tuple of PoseCost
        What the calibration alone costs planes at the session's distances.
    verdict : {"ok", "degraded", "refused"}
    message : str
        The reason, in a sentence or a few.
    """

    observations: Observations
    images: tuple[ImageStatus, ...]
    options: Options
    seed: int
    adjustment: Adjustment | None
    ladder: tuple[Tested, ...]
    tests: Mapping[str, Tested]
    gates: tuple[Gate, ...]
    next_view: NextView | None
    held_out: HeldOut | None
    cost: tuple[PoseCost, ...]
    verdict: Verdict
    message: str

    @property
    def rig(self) -> Rig:
        """The rig with its joint covariance, whatever the verdict.

        Raises
        ------
        InputError
            If there is none.
        """
        if self.adjustment is None:
            raise InputError(f"there is no rig: {self.message}")
        return self.adjustment.rig


def calibrate(
    session: str | os.PathLike[str] | Session | Detected | Observations,
    options: Options | None = None,
    *,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a rig from views of a ChArUco board with the laser's spot on it.

    Parameters
    ----------
    session : path-like, Session, Detected or Observations
        A folder with `session.toml`, what `load_session` or `detect` made of one, or observations of any origin.
    options : Options, optional
    seed : int
        For the held-out checks.
    executor : Executor, optional
        The images are worked on in it.
    progress : callable, optional
        ``progress(stage, done, total)``; stages are "detecting", "adjusting" and "judging".

    Raises
    ------
    InputError
        If the session cannot be read. A session that can be read and gives no rig has the verdict "refused".
    """
    options = Options() if options is None else options
    tell: Progress = progress if progress is not None else lambda *_: None
    if isinstance(session, Observations):
        observations, images = session, ()
    else:
        if not isinstance(session, Detected):
            loaded = session if isinstance(session, Session) else load_session(session)
            session = detect(loaded, executor=executor, progress=lambda done, total: tell("detecting", done, total))
        observations, images = session.observations, session.images
    observations, images = _usable(observations, images)
    if options.corner_weights == "equal":
        observations = _evened(observations)
    tell("adjusting", 0, 1)
    try:
        if not observations.views:
            raise AdjustmentError("No view shows the board.")
        if len(observations.views) <= _FEW_VIEWS and hopelessly_frontal(observations):
            raise AdjustmentError("All views are frontal.")
        adjustment, ladder, tests = _adjusted(observations, options)
    except AdjustmentError as error:
        _log.debug("no adjustment: %s", error)
        gates = judge_unadjusted(observations, images, reason=str(error))
        status, message = verdict(gates)
        return Calibration(observations, images, options, seed, None, (), {}, gates, None, None, (), status, message)
    tell("adjusting", 1, 1)
    tell("judging", 0, 1)
    gates = judge(adjustment, images, tests=tests, expect=options.expect)
    status, message = verdict(gates)
    found = Calibration(
        observations=observations,
        images=images,
        options=options,
        seed=seed,
        adjustment=adjustment,
        ladder=ladder,
        tests=tests,
        gates=gates,
        next_view=next_view(adjustment),
        held_out=held_out(adjustment, seed=seed),
        cost=_cost(adjustment),
        verdict=status,
        message=message,
    )
    tell("judging", 1, 1)
    return found


def _usable(
    observations: Observations, images: tuple[ImageStatus, ...]
) -> tuple[Observations, tuple[ImageStatus, ...]]:
    """Leave out views whose corners determine no pose, and say so of their images."""
    reasons = {view.name: reason for view in observations.views if (reason := _no_pose(view, observations.board))}
    reasons |= _copies(observations.views)
    for name, reason in reasons.items():
        _log.info("%s: %s", name, reason)
    views = tuple(view for view in observations.views if view.name not in reasons)
    told = tuple(
        replace(image, status="refused", reason=reasons[image.name]) if image.name in reasons else image
        for image in images
    )
    return replace(observations, views=views), told


def _copies(views: tuple[View, ...]) -> dict[str, str]:
    """Return which views are copies of others: the same corners to the last bit, as no camera sees them twice."""
    first: dict[bytes, str] = {}
    found = {}
    for view in views:
        original = first.setdefault(view.ids.tobytes() + view.corners.tobytes(), view.name)
        if original != view.name:
            found[view.name] = f"It is a copy of {original}: its corners are the same to the last digit."
    return found


def _evened(observations: Observations) -> Observations:
    """Give all corners the root mean square of the sigmas."""
    even = observations.corner_sigma
    views = tuple(replace(view, sigma=np.full(len(view), even)) for view in observations.views)
    return replace(observations, views=views)


def _no_pose(view: View, board: Board) -> str:
    if len(view) < LEAST_CORNERS:
        return f"Only {len(view)} corners were measured; a view needs {LEAST_CORNERS}."
    places = board.corners[view.ids]
    widths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if widths[1] < _IN_LINE * widths[0]:
        return "Its corners are all in one row of the board, which determines no pose."
    return ""


def _adjusted(observations: Observations, options: Options) -> tuple[Adjustment, tuple[Tested, ...], dict[str, Tested]]:
    """Return the adjustment, the rungs of its ladder, and the tests of its terms."""
    spots = sum(view.spot is not None for view in observations.views)
    beam: BeamModel = options.beam if observations.spot != "none" and spots else "none"
    focal: Focal = "separate" if options.focal == "separate" else "shared"
    model = Model(focal=focal, warp=options.warp, beam=beam)
    rung = None if options.distortion == "auto" else options.distortion
    adjustment, ladder = climb(observations, model, rung, reject=options.reject)
    tests = compare_terms(adjustment)
    if options.focal == "auto" and "aspect" in tests and tests["aspect"].p_value < _SQUARE_PIXELS:
        separate = replace(adjustment.model, focal="separate")
        adjustment = adjust(
            observations, separate, prior=adjustment.prior, start=adjustment.state, reject=options.reject
        )
        tests = compare_terms(adjustment)
    return adjustment, ladder, tests


def _cost(adjustment: Adjustment) -> tuple[PoseCost, ...]:
    """Return the cost at the nearest, the middle and the farthest spot of the session."""
    rig = adjustment.rig
    if rig.beam is None or not np.any(adjustment.spot_used):
        return ()
    along = [section.along for section in beam_sections(adjustment) if section is not None]
    distances = np.quantile(along, [0.0, 0.5, 1.0])
    try:
        return pose_cost(rig, working_planes(distances))
    except InputError as error:
        _log.debug("no cost at the session's distances: %s", error)
        return ()
