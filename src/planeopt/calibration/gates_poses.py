"""Gates on where the board was: tilts and their directions, distances of the board and of the spot."""

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Observations
from planeopt.calibration.gate import Gate, at_least
from planeopt.calibration.state import State

Array = NDArray[np.float64]

TILTED = 20.0
"""Degrees: the least tilt of a view that tells the focal length well (sigma_f/f goes as one over the tilt's square)."""
FRONTAL = 10.0
"""Degrees: where no view is tilted by as much, all are taken as facing the camera."""
_TILTED_WANTED = 5
_DIRECTIONS_WANTED = 4
_APART = 45.0
_TILTED_AT_ALL = 10.0

RATIO_WANTED = 1.5
_RATIO_WARNED = 1.3
"""Direction and offset are told apart as the spread of the logarithm of the distance: ln q / sqrt(12) where it is even
over a ratio q. At 1.3 the direction is known 1.5 times worse than at 1.5, as badly as in the worst of 200 good sessions
with more; at 1.1 four times."""
_RATIO_NEEDED = 1.1
_DEPTHS_WANTED = 3
_BOARD_RATIO = 1.25


def tilts(state: State) -> Array:
    """Return the angles (V,) between the boards and the image, degrees."""
    return np.degrees(np.arccos(np.clip(np.abs(state.rotations[:, 2, 2]), 0.0, 1.0)))


def tilt_gates(state: State) -> tuple[Gate, ...]:
    """Judge how far, and in how many directions, the board was tilted."""
    angles = tilts(state)
    largest, count = float(angles.max()), int(np.count_nonzero(angles > TILTED))
    ask = "Tilt the board by 30 to 45 degrees, to the left, the right, up and down."
    limits = (float(_TILTED_WANTED), None)
    if largest < FRONTAL:
        return (
            Gate(
                "tilt",
                "refuse",
                largest,
                (TILTED, FRONTAL),
                f"All views are frontal: none is tilted by {FRONTAL:.0f} degrees or more. Focal length and distance "
                f"cannot be told apart from views that face the camera. {ask}",
            ),
        )
    state_of = at_least(count, _TILTED_WANTED, None)
    told = f"{_views(count)} tilted by more than {TILTED:.0f} degrees, the largest tilt is {largest:.0f} degrees"
    first = Gate(
        "tilt",
        state_of,
        float(count),
        limits,
        f"{told}."
        if state_of == "ok"
        else f"{told}: {_TILTED_WANTED} such views are asked for, since they tell the focal length. {ask}",
    )
    return first, _direction_gate(state)


def spot_depth_gate(state: State, lit: NDArray[np.bool_]) -> Gate | None:
    """Judge at how many distances along the beam the spot was seen, and over what range.

    Parameters
    ----------
    state : State
    lit : (V,) array of bool
        Which views have a spot.
    """
    if np.count_nonzero(lit) == 0:
        return None
    distances = np.sort(spot_distances(state)[lit])
    if distances[0] <= 0:
        return None
    ratio, count = float(distances[-1] / distances[0]), _different(distances)
    limits = (_RATIO_WARNED, _RATIO_NEEDED)
    told = (
        f"The spot was seen from {distances[0]:.0f} to {distances[-1]:.0f} mm along the beam, a ratio of {ratio:.2f}, "
        f"at {count} different distance{'' if count == 1 else 's'}"
    )
    ask = (
        f"Put the board at {_DEPTHS_WANTED} distances or more, the farthest {RATIO_WANTED:g} times the nearest or more."
    )
    if ratio < _RATIO_NEEDED:
        return Gate(
            "spot distances",
            "refuse",
            ratio,
            limits,
            f"{told}: one depth only. The beam's direction cannot be told from its offset at one distance. {ask}",
        )
    if ratio < _RATIO_WARNED or count < _DEPTHS_WANTED:
        return Gate(
            "spot distances",
            "warn",
            ratio,
            limits,
            f"{told}, which tells the beam's direction poorly; away from there the calibration is extrapolated. {ask}",
        )
    more = f"; {RATIO_WANTED:g} would tell the beam's direction better" if ratio < RATIO_WANTED else ""
    return Gate("spot distances", "ok", ratio, limits, f"{told}{more}.")


def board_depth_gate(observations: Observations, state: State) -> Gate:
    """Judge over what range of distances the board's corners were seen."""
    nearest, farthest = np.inf, 0.0
    for view, rotation, shift in zip(observations.views, state.rotations, state.translations, strict=True):
        depth = observations.board.corners[view.ids] @ rotation[2, :2] + shift[2]
        nearest, farthest = min(nearest, float(depth.min())), max(farthest, float(depth.max()))
    ratio = farthest / nearest
    told = f"The board's corners were {nearest:.0f} to {farthest:.0f} mm before the camera, a ratio of {ratio:.2f}"
    if ratio >= _BOARD_RATIO:
        return Gate("board distances", "ok", ratio, (_BOARD_RATIO, None), f"{told}.")
    return Gate(
        "board distances",
        "warn",
        ratio,
        (_BOARD_RATIO, None),
        f"{told}; {_BOARD_RATIO:g} or more is asked for. Bring the board nearer in some views and farther in others.",
    )


def spot_distances(state: State) -> Array:
    """Return the distances (V,) along the beam at which it meets the boards, mm."""
    normals = state.rotations[..., 2]
    start = np.array([state.value("e_x"), state.value("e_y"), 0.0])
    return np.sum(normals * (state.translations - start), axis=-1) / (normals @ state.direction)


def tilt_directions(state: State) -> int:
    """Return how many views were tilted in directions of which each is 45 degrees from every other."""
    tilted = state.rotations[tilts(state) > _TILTED_AT_ALL]
    angles = np.sort(np.degrees(np.arctan2(tilted[:, 1, 2], tilted[:, 0, 2])) % 360)
    best = 0
    for first in range(len(angles)):
        turned = (angles[first:] if first == 0 else np.roll(angles, -first)) - angles[first]
        turned = np.sort(turned % 360)
        count, last = 0, -np.inf
        for angle in turned.tolist():
            if angle - last >= _APART and angle <= 360 - _APART:
                count, last = count + 1, angle
        best = max(best, count)
    return best


def _direction_gate(state: State) -> Gate:
    count = tilt_directions(state)
    state_of = at_least(count, _DIRECTIONS_WANTED, None)
    told = (
        f"The board was tilted in {count} directions at least {_APART:.0f} degrees apart"
        if count > 1
        else "The board was always tilted in the same direction"
        if count
        else "The board was not tilted"
    )
    limits = (float(_DIRECTIONS_WANTED), None)
    if state_of == "ok":
        return Gate("tilt directions", "ok", float(count), limits, f"{told}.")
    return Gate(
        "tilt directions",
        state_of,
        float(count),
        limits,
        f"{told}; {_DIRECTIONS_WANTED} are asked for, since one direction tells the principal point along it only. "
        "Tilt the board to the left, the right, up and down in turn.",
    )


def _different(distances: Array) -> int:
    """Return how many of sorted distances are each a tenth farther than the one before."""
    count, last = 0, 0.0
    for distance in distances.tolist():
        if distance >= _RATIO_NEEDED * last:
            count, last = count + 1, distance
    return count


def _views(count: int) -> str:
    return {0: "No view is", 1: "1 view is"}.get(count, f"{count} views are")
