"""Which view to shoot next: of many that could be shot, the one after which planes would be known best."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.candidate_views import candidates, depths
from planeopt.calibration.expected import Observer
from planeopt.calibration.pose_cost import plane_sensitivity, working_planes
from planeopt.calibration.state import State

Array = NDArray[np.float64]

_SIDES = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")
"""Of the image, by eighths of a turn from x towards y, which is down."""

_FLAT = math.radians(5)
_MIDDLE = 0.06
"""Of the image's size: within this of its middle a board is in the middle."""


@dataclass(frozen=True, eq=False)
class NextView:
    """The view to shoot next.

    Attributes
    ----------
    sentence : str
        Where to hold the board.
    R : (3, 3) array
        Board to camera.
    t : (3,) array
        mm.
    gain : float
        By what share the standard deviations would shrink, in the root mean square over the working planes: of z_L and
        of the normal as far as they come from the calibration; without a beam, of f, cx and cy.
    """

    sentence: str
    R: Array
    t: Array
    gain: float


def next_view(adjustment: Adjustment, working: ArrayLike | None = None) -> NextView | None:
    """Return the view that would help most; None where no view of this board can be imagined.

    Of candidates in which the board is seen and its spot lies in the window, each adds to the information what its
    linearised model alone says, its pose being unknown. The one that leaves the least sum of variances, each over what
    it is now, is taken.

    Parameters
    ----------
    adjustment : Adjustment
    working : array_like, shape (M, 3), optional
        Planes (z_L, alpha, beta) that matter, mm and rad; those at the distances of the session unless given.

    Raises
    ------
    InputError
        If the camera cannot see a working plane's spot.
    """
    observer = Observer.of(adjustment)
    state, added = candidates(observer)
    if not len(added):
        return None
    goal = _goal(adjustment, observer, working)
    now = _variances(adjustment.information[None], goal)
    score = np.mean(_variances(adjustment.information + added, goal) / now, axis=1)
    row = int(np.argmin(score))
    rotation, translation = state.rotations[row], state.translations[row]
    words = in_words(observer, rotation, translation)
    return NextView(words, rotation, translation, 1 - math.sqrt(float(score[row])))


def in_words(observer: Observer, rotation: Array, translation: Array) -> str:
    """Return where to hold a board, for a person before the rig.

    Parameters
    ----------
    observer : Observer
    rotation : (3, 3) array
        Board to camera.
    translation : (3,) array
        mm.
    """
    state = replace(observer.state, rotations=rotation[None], translations=translation[None])
    distance = float(depths(replace(observer, state=state))[0])
    parts = [f"Next, shoot a view with the board at about {_rounded(distance):g} mm"]
    normal = rotation[:, 2]
    tilt = math.acos(min(1.0, float(normal[2])))
    if tilt < _FLAT:
        parts.append("facing the camera")
    else:
        # z falls along (n_x, n_y): what lies the other way is farther.
        side = _SIDES[_eighth(-normal[0], -normal[1])]
        parts.append(f"its {_edge(side)} tilted away by {round(math.degrees(tilt) / 5) * 5} degrees")
    parts.extend(_turn(rotation))
    parts.append(f"in {_place(observer, state)}")
    return ", ".join(parts) + "."


def _goal(adjustment: Adjustment, observer: Observer, working: ArrayLike | None) -> list[Array]:
    """Return what is to be known: rows of derivatives by the free parameters, a quantity an array (k, g)."""
    if not observer.with_beam:
        wanted = [name for name in adjustment.names if name in ("f", "fx", "fy", "cx", "cy")]
        return [np.eye(len(adjustment.names))[[adjustment.names.index(name)]] for name in wanted]
    known = depths(observer)[adjustment.spot_used]
    planes = working_planes(np.unique(np.quantile(known, [0.0, 0.5, 1.0]))) if working is None else np.asarray(working)
    by_plane, by_normal = plane_sensitivity(adjustment.rig, planes)
    spread = np.zeros((len(adjustment.model.freedom), len(adjustment.names)))
    for row, name in enumerate(adjustment.model.freedom):
        spread[row, adjustment.names.index(name)] = 1.0
    return [rows @ spread for rows in (*by_plane[:, :1], *by_normal)]


def _variances(information: Array, goal: list[Array]) -> Array:
    """Return the variances (C, quantities) under informations (C, g, g)."""
    scale = 1 / np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    scaled = scale[..., :, None] * information * scale[..., None, :]
    # What a session does not determine at all must not stop the comparison.
    values, vectors = np.linalg.eigh(scaled)
    floor = values[..., -1:] * np.finfo(np.float64).eps
    root = scale[..., :, None] * vectors / np.sqrt(np.maximum(values, floor))[..., None, :]
    return np.stack([np.sum((rows @ root) ** 2, axis=(-2, -1)) for rows in goal], axis=-1)


def _rounded(distance: float) -> float:
    """Return a distance to two digits, or to 5 mm where that is finer than anybody can hold a board."""
    step = max(5.0, 10.0 ** (math.floor(math.log10(distance)) - 1))
    return round(distance / step) * step


def _eighth(x: float, y: float) -> int:
    return round(math.atan2(y, x) / (math.pi / 4)) % 8


def _edge(side: str) -> str:
    """Return the part of the board on a side of the image."""
    names = {"upper": "upper edge", "lower": "lower edge", "left": "left side", "right": "right side"}
    return names.get(side, f"{side} corner")


def _turn(rotation: Array) -> list[str]:
    angle = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))
    return ["turned in its plane by a quarter"] if 45 < abs(angle) < 135 else []


def _place(observer: Observer, state: State) -> str:
    seen = observer.seen(state)
    size = np.array(state.image_size)
    middle = seen.corners[0][seen.corner_seen[0]].mean(axis=0)
    x, y = ((middle - (size - 1) / 2) / size).tolist()
    if math.hypot(x, y) < _MIDDLE:
        return "the middle of the image"
    side = _SIDES[_eighth(x, y)]
    return (
        f"the {side} part of the image"
        if side in ("left", "right")
        else f"the {side} of the image".replace("upper of", "upper part of").replace("lower of", "lower part of")
    )
