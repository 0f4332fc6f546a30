"""Gates on how well one rig explains what was seen: mixed cameras, misfits, the board's shape, residuals, outliers."""

from collections.abc import Mapping

import numpy as np
from scipy.stats import f as fisher

from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.board_shape import Misplaced
from planeopt.calibration.gate import Gate, at_most
from planeopt.calibration.gates_seen import names
from planeopt.calibration.ladder import Tested
from planeopt.calibration.mixture import Mixture, misfitting_views, mixture
from planeopt.calibration.noise import MOST_CORNERS, REJECT
from planeopt.errors import InputError

_OTHER_CAMERA = 0.5, 0.01
"""Share of the misfit explained, relative change of f: from either on, the views are of two cameras."""

_STRETCH = 0.001, 0.005
"""Relative: what a ruler with half millimetres sees over the length of a board, and what moves f by as much as the
least that is refused of its uncertainty is worth."""
_STRETCH_SIGMAS = 5.0

_BOW_MM = 0.25
_BOW_SHARE = 0.0025
_CHANCE = 1e-3

_SHAPE = 0.2
"""Of the corners' sum of squares: what the board's shape explains at most of a good session."""
_UNLIKELY = 1e-6

_SPOT_FACTOR = 3.0
"""Times their sigmas: what ellipses miss one beam by at most, where it is a clean cylinder that did not move."""

_CORNERS_PX = 0.5, 1.0
_BOUNDARY_PX = 0.5, 1.5

_LENGTHS = ("radius", "e_x", "e_y")
_SIGMAS = 3.0


def shape_gate(found: Misplaced | None) -> Gate | None:
    """Judge whether the board's corners are where they are stated to be."""
    if found is None:
        return None
    limits = (_SHAPE, None)
    if found.p_value > _UNLIKELY or found.share <= _SHAPE:
        told = "The board's corners are in their places, but for a bow."
        return Gate("board shape", "ok", found.share, limits, told)
    return Gate(
        "board shape",
        "warn",
        found.share,
        limits,
        f"The board's corners lie off their places, alike in every view: by {found.across_mm:.2g} mm in its plane and "
        f"{found.out_mm:.2g} mm out of it (RMS), which is {100 * found.share:.0f} % of the residuals. It is twisted or "
        "wavy, or not printed as stated; the standard deviations know nothing of that. Mount it on glass or a thick "
        "plate, or take a better print.",
    )


def camera_gate(adjustment: Adjustment, by_board: float = 0.0) -> Gate:
    """Judge whether all views were taken by one camera.

    Parameters
    ----------
    adjustment : Adjustment
    by_board : float
        Share of the misfit that the board's shape explains: two cameras must explain more.
    """
    found = mixture(adjustment)
    limits = (0.0, _OTHER_CAMERA[1])
    if found is None or found.explained < by_board:
        return Gate("one camera", "ok", 0.0, limits, "All views agree on one camera.")
    change = found.focal[1] / found.focal[0] - 1
    certain = found.explained > _OTHER_CAMERA[0] or abs(change) > _OTHER_CAMERA[1]
    return Gate("one camera", "refuse" if certain else "warn", abs(change), limits, _two_cameras(adjustment, found))


def _two_cameras(adjustment: Adjustment, found: Mixture) -> str:
    views = [view.name for view in adjustment.observations.views]
    first = [name for name, other in zip(views, found.second, strict=True) if not other]
    second = [name for name, other in zip(views, found.second, strict=True) if other]
    (x, y), (u, v) = found.centre
    return (
        f"The views are of two cameras, or focus or zoom was changed in between: {names(first, 6)} have a focal length "
        f"of {found.focal[0]:.1f} px and the principal point ({x:.0f}, {y:.0f}) px, {names(second, 6)} have "
        f"{found.focal[1]:.1f} px and ({u:.0f}, {v:.0f}) px. Calibrate each camera from its own views, with focus and "
        "zoom locked."
    )


def view_gate(adjustment: Adjustment) -> Gate:
    """Judge whether some views fit much worse than the others."""
    found = misfitting_views(adjustment)
    if not found:
        return Gate("single views", "ok", 0.0, (0.0, None), "Every view fits as well as the others.")
    views = adjustment.observations.views
    worst = f"{views[found[0][0]].name} by {found[0][1]:.1f} times"
    others = f", then {names([views[row].name for row, _ in found[1:]])}" if len(found) > 1 else ""
    return Gate(
        "single views",
        "warn",
        found[0][1],
        (0.0, None),
        f"{len(found)} view{' does' if len(found) == 1 else 's do'} not fit the others: the corners' residuals of "
        f"{worst} those of the others{others}. The board or the camera moved during the exposure, the board was bent, "
        f"or the focus was changed: look at the image, and shoot it again.",
    )


def spot_fit_gate(adjustment: Adjustment) -> Gate | None:
    """Judge how well one beam explains the spots."""
    kept = [residual for residual, used in zip(adjustment.spot_residuals, adjustment.spot_used, strict=True) if used]
    if not kept:
        return None
    rms = float(np.sqrt(np.mean(np.concatenate(kept) ** 2)))
    state = at_most(rms, *_BOUNDARY_PX)
    told = f"The spots' boundaries lie {rms:.2g} px (RMS) from those of one straight beam of constant radius"
    left_out = [
        view.name
        for view, used in zip(adjustment.observations.views, adjustment.spot_used, strict=True)
        if view.spot is not None and not used
    ]
    if left_out:
        told += f", {names(left_out)} left out"
    tail = (
        ""
        if state == "ok"
        else (
            f"; up to {_BOUNDARY_PX[0]:g} px is good. The beam is not a clean cylinder, the laser moved against the "
            "camera, or the spots are over-exposed: look at the overlays."
        )
    )
    return Gate("spot residuals", state, rms, _BOUNDARY_PX, told + (tail or "."), symptom=True)


def beam_gate(adjustment: Adjustment) -> Gate | None:
    """Judge whether the spots are those of one beam, by their sigmas: it moved, or is no cylinder, if they are not."""
    if not np.any(adjustment.spot_used):
        return None
    factor, limits = adjustment.noise.spots, (_SPOT_FACTOR, None)
    if factor <= _SPOT_FACTOR:
        told = f"The spots miss one straight beam by {factor:.2g} times what their boundaries' sigmas say, or less."
        return Gate("one beam", "ok", factor, limits, told)
    worst = np.argsort(-np.where(adjustment.spot_used, adjustment.spot_chi2, 0.0), kind="stable")[:3]
    return Gate(
        "one beam",
        "warn",
        factor,
        limits,
        f"The spots miss one straight beam by {factor:.2g} times what their boundaries' sigmas say, most of all "
        f"{names([adjustment.observations.views[row].name for row in worst])}. The laser moved against the camera in "
        "the session, or its beam is no clean cylinder: check how it is held, and shoot again.",
    )


def size_gates(
    adjustment: Adjustment, expect: Mapping[str, tuple[float, float]], stretch: tuple[float, float]
) -> tuple[Gate, ...]:
    """Judge the squares' size: their proportion by the images, their size by what is known otherwise.

    Parameters
    ----------
    adjustment : Adjustment
    expect : mapping of str to (float, float)
        Stated values with their tolerances: names of parameters, with `_mm` or `_px` if liked, or `f_mm`.
    stretch : tuple of float
        From `board_stretch`.

    Raises
    ------
    InputError
        If a name is not known, or needs a beam or a pixel pitch that is not there.
    """
    stated = tuple(_expected_gate(adjustment, name, *pair) for name, pair in expect.items())
    return (*stated, _proportion_gate(adjustment, *stretch)) if adjustment.model.camera else stated


def _proportion_gate(adjustment: Adjustment, stretch: float, sigma: float) -> Gate:
    x, y = adjustment.observations.board.square_mm
    certain = abs(stretch) > _STRETCH_SIGMAS * sigma
    state = at_most(abs(stretch), *_STRETCH) if certain else "ok"
    if state == "ok":
        return Gate(
            "square proportion",
            "ok",
            abs(stretch),
            _STRETCH,
            f"The squares' height over their width is {_percent(stretch, sigma)} off what is stated.",
        )
    return Gate(
        "square proportion",
        state,
        abs(stretch),
        _STRETCH,
        f"The board's squares are not {x:g} x {y:g} mm as stated: their height over their width is "
        f"{_percent(stretch, sigma)} off that. Printers stretch one direction: measure many squares along x and along "
        f"y with a ruler or calliper and give square_mm = [x, y].",
    )


def _percent(share: float, sigma: float) -> str:
    return f"{100 * share:+.2g} +- {100 * sigma:.2g} %"


def _expected_gate(adjustment: Adjustment, name: str, stated: float, tolerance: float) -> Gate:
    in_mm = name == "f_mm"
    parameter = name if in_mm else name.removesuffix("_mm").removesuffix("_px")
    pitch = adjustment.observations.pixel_pitch_mm
    if in_mm:
        if pitch is None:
            raise InputError("expect: f_mm needs the session's pixel_pitch_mm")
        parameter, scale = "f" if "f" in adjustment.names else "fx", pitch
    else:
        scale = 1.0
    known = {*adjustment.names, "fx", "fy"}
    if parameter not in known:
        raise InputError(f"expect: {name!r} is not one of {', '.join([*adjustment.names, 'f_mm'])}")
    found, sigma = scale * adjustment.value(parameter), scale * adjustment.sigma(parameter)
    off = abs(found - stated)
    allowed = tolerance + _SIGMAS * sigma
    unit = (
        "mm"
        if in_mm or parameter in _LENGTHS or parameter.startswith("warp")
        else ("px" if parameter in ("f", "fx", "fy", "cx", "cy") else "")
    )
    told = f"{name} is {found:.6g} +- {sigma:.2g} {unit}".rstrip() + f", {stated:.6g} +- {tolerance:.2g} is stated"
    if off <= allowed:
        return Gate(f"stated {name}", "ok", off, (allowed, allowed), f"{told}.")
    return Gate(
        f"stated {name}", "refuse", off, (allowed, allowed), f"{told}{_why_off(adjustment, name, found, stated)}"
    )


def _why_off(adjustment: Adjustment, name: str, found: float, stated: float) -> str:
    if name.removesuffix("_mm") in _LENGTHS and stated * found > 0:
        ratio = stated / found
        x, y = adjustment.observations.board.square_mm
        return (
            ": the size of the squares is wrong. All lengths follow square_mm, and would fit what is stated if it "
            f"were [{x * ratio:.5g}, {y * ratio:.5g}] instead of [{x:.5g}, {y:.5g}] mm ({ratio:.4f} of it). Measure "
            "the squares."
        )
    if name == "f_mm":
        return (
            ": pixel_pitch_mm or the lens is another one, or the image was resized (the size of the squares has no "
            "part in the focal length)."
        )
    return ": look at which of the two is right before this calibration is used."


def bow_gate(adjustment: Adjustment, tests: Mapping[str, Tested]) -> Gate | None:
    """Judge whether the board was flat; a bow is compensated, but warned of."""
    if not adjustment.model.warp:
        return None
    along_x, along_y = adjustment.value("warp_x"), adjustment.value("warp_y")
    bow = max(abs(along_x), abs(along_y))
    limit = min(_BOW_MM, _BOW_SHARE * max(adjustment.observations.board.size_mm))
    test = tests.get("warp")
    chance = test.p_value if test is not None else _bow_chance(adjustment)
    told = f"The board is bowed by {along_x:+.2f} mm along x and {along_y:+.2f} mm along y (F-test: {_chance(chance)})"
    if chance > _CHANCE:
        told = f"No bow of the board is seen: {along_x:+.2g} mm along x, {along_y:+.2g} mm along y ({_chance(chance)})"
        return Gate("board bow", "ok", bow, (limit, None), f"{told}.")
    if bow <= limit:
        return Gate("board bow", "ok", bow, (limit, None), f"{told}; that is compensated.")
    return Gate(
        "board bow",
        "warn",
        bow,
        (limit, None),
        f"{told}. That is compensated as far as it is a plain bow; without, the focal length would be wrong by up to a "
        "percent. Mount the board on glass or an aluminium plate, and do not bend it between views.",
    )


def _bow_chance(adjustment: Adjustment) -> float:
    rows = [adjustment.names.index(name) for name in ("warp_x", "warp_y")]
    values = adjustment.values[rows]
    statistic = float(values @ np.linalg.solve(adjustment.covariance[np.ix_(rows, rows)], values)) / 2
    return float(fisher.sf(statistic, 2, adjustment.dof_corners))


def _chance(value: float) -> str:
    return "p < 1e-6" if value < 1e-6 else f"p = {value:.2g}"


def residual_gate(adjustment: Adjustment) -> Gate:
    """Judge how far the corners lie from where the calibration puts them."""
    sigma = adjustment.corner_sigma
    state = at_most(sigma, *_CORNERS_PX)
    rms = np.sqrt(2) * sigma
    told = f"Corners scatter by {sigma:.2g} px in x and in y (other programs would call it an RMS of {rms:.2g} px)"
    if state == "ok":
        return Gate(
            "residuals",
            "ok",
            sigma,
            _CORNERS_PX,
            f"{told}; up to {_CORNERS_PX[0]:g} px is accepted.",
            symptom=True,
        )
    return Gate(
        "residuals",
        state,
        sigma,
        _CORNERS_PX,
        f"{told}: more than corners can be mislocated; up to {_CORNERS_PX[0]:g} px is accepted. The images are "
        "blurred, board or camera moved, the board's file is not this board's, or the board is not flat. Do not drop "
        "views until it looks fine: find which of these it is.",
        symptom=True,
    )


def outlier_gate(adjustment: Adjustment) -> Gate:
    """Judge how many corners were left out, and what that changed."""
    used = np.concatenate(adjustment.corner_used)
    count = int(np.count_nonzero(~used))
    share = count / max(len(used), 1)
    limits = (0.95 * MOST_CORNERS, None)
    rule = f"(beyond {REJECT:g} standard deviations, at most {100 * MOST_CORNERS:g} %)"
    if adjustment.before is None or not adjustment.model.camera:
        return Gate(
            "outliers", "ok", share, limits, f"{count} of {len(used)} corners were left out {rule}.", symptom=True
        )
    name = "f" if "f" in adjustment.names else "fx"
    before = adjustment.before
    told = (
        f"{count} of {len(used)} corners ({100 * share:.2g} %) were left out {rule}: {name} is "
        f"{before.value(name):.2f} +- {before.sigma(name):.2f} px with all, {adjustment.value(name):.2f} +- "
        f"{adjustment.sigma(name):.2f} px without them"
    )
    if share <= limits[0]:
        return Gate("outliers", "ok", share, limits, f"{told}.", symptom=True)
    return Gate(
        "outliers",
        "warn",
        share,
        limits,
        f"{told}. So many are no chance: corners are covered, glossy or blurred, or the model does not fit.",
        symptom=True,
    )


def focal_gate(adjustment: Adjustment) -> Gate | None:
    """Judge how well the focal length is known."""
    known = [name for name in ("f", "fx", "fy") if name in adjustment.names]
    if not known:
        return None
    share = max(adjustment.sigma(name) / adjustment.value(name) for name in known)
    limits = (0.003, 0.01)
    state = at_most(share, *limits)
    told = f"The focal length is known to {100 * share:.2g} % (one standard deviation)"
    tail = (
        ""
        if state == "ok"
        else (
            f"; {100 * limits[0]:g} % or less is good, and more than {100 * limits[1]:g} % is refused. Shoot more "
            "views with the board tilted by 30 to 45 degrees, in several directions."
        )
    )
    return Gate("focal length", state, share, limits, told + (tail or "."), symptom=True)
