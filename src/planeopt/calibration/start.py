"""Where an adjustment starts: camera and poses by OpenCV's plane pose, and a beam through the spots' centres."""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.model import BEAM, FULL
from planeopt.calibration.packed import Packed
from planeopt.calibration.projection import linear_boundaries
from planeopt.calibration.state import State, rotation_matrices
from planeopt.conic import fit_conic
from planeopt.errors import InputError
from planeopt.rig import Camera

Array = NDArray[np.float64]
Pose = tuple[Array, Array]

LEAST_CORNERS = 6
"""Of a view: its pose has six unknowns, and fewer than six corners would hardly test it."""

_FOCAL_LADDER = np.geomspace(0.35, 30.0, 19)  # of the image's larger side: from a wide angle to a long lens
_LADDER_VIEWS = 12
_REST = len(FULL) - 9  # values that are not the camera's
_PAIRS = 60  # views from which all pairs are taken: enough for a median, few enough for any session


def likely_camera(packed: Packed) -> Camera:
    """Return a camera without distortion, its principal point in the middle, near the one that took the views.

    The focal length is the one of a geometric ladder at which OpenCV's poses of a dozen views fit best: this has no
    degenerate case, unlike the closed form from homographies.

    Raises
    ------
    InputError
        If a view has too few corners for a pose.
    AdjustmentError
        If the boards are behind the camera whatever its focal length.
    """
    width, height = packed.image_size
    some = np.unique(np.linspace(0, len(packed) - 1, _LADDER_VIEWS).round().astype(int))
    best: tuple[float, Camera] | None = None
    for focal in _FOCAL_LADDER * max(width, height):
        camera = Camera(packed.image_size, focal, focal, (width - 1) / 2, (height - 1) / 2, (0.0, 0.0, 0.0, 0.0, 0.0))
        error = sum(min((misfit for misfit, _ in _poses(packed, row, camera)), default=np.inf) for row in some)
        if best is None or error < best[0]:
            best = error, camera
    if best is None or not np.isfinite(best[0]):
        raise AdjustmentError("No focal length puts the boards before the camera.")
    return best[1]


def pose_views(packed: Packed, camera: Camera, rest: Array | None = None) -> State:
    """Return the state of a camera whose boards stand where OpenCV's plane pose puts them.

    Parameters
    ----------
    packed : Packed
    camera : Camera
    rest : (8,) array, optional
        The other values of `FULL`: warp and beam; zero unless given.

    Raises
    ------
    InputError
        If a view has too few corners for a pose.
    AdjustmentError
        If they are nearly in line.
    """
    poses = [_best(packed, row, camera) for row in range(len(packed))]
    values = np.array(
        [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion, *(np.zeros(_REST) if rest is None else rest)]
    )
    rotations = np.stack([rotation for rotation, _ in poses]) if poses else np.empty((0, 3, 3))
    shifts = np.stack([shift for _, shift in poses]) if poses else np.empty((0, 3))
    return State(values, rotations, shifts, packed.image_size)


def other_poses(packed: Packed, state: State) -> State:
    """Return the state with each board in the other pose that a plane seen from far has, where OpenCV finds one."""
    rotations, shifts = state.rotations.copy(), state.translations.copy()
    for row in range(len(packed)):
        found = _poses(packed, row, state.camera)
        if found:
            # The one that faces away most from where the board stands now.
            turned = [float(np.trace(rotation @ state.rotations[row].T)) for _, (rotation, _) in found]
            rotations[row], shifts[row] = found[int(np.argmin(turned))][1]
    return replace(state, rotations=rotations, translations=shifts)


def _poses(packed: Packed, row: int, camera: Camera) -> list[tuple[float, Pose]]:
    """Return the poses of one view that OpenCV finds before the camera, with their mean square misfit, px^2."""
    seen = packed.corner_seen[row]
    if np.count_nonzero(seen) < LEAST_CORNERS:
        raise InputError(f"view {row}: {np.count_nonzero(seen)} corners; a pose needs {LEAST_CORNERS}")
    board = np.column_stack([packed.board.corners[seen], np.zeros(np.count_nonzero(seen))])
    normalised, _ = camera.normalise(packed.corners[row][seen])
    # About the middle of what is seen: OpenCV's normalisation is poor far from the origin.
    middle = board.mean(axis=0)
    _, turns, shifts, errors = cv2.solvePnPGeneric(
        board - middle, normalised[:, None], np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    found: list[tuple[float, Pose]] = []
    misfits = np.ravel(np.asarray(errors, dtype=np.float64))
    for turn, shift, error in zip(turns, shifts, misfits, strict=True):
        rotation = rotation_matrices(np.asarray(turn, dtype=np.float64).reshape(3))
        place = np.asarray(shift, dtype=np.float64).reshape(3) - rotation @ middle
        if np.all(np.isfinite(rotation)) and np.isfinite(error) and np.all((board @ rotation.T + place)[:, 2] > 0):
            found.append((float(error) ** 2 * camera.fx**2, (rotation, place)))
    return found


def _best(packed: Packed, row: int, camera: Camera) -> Pose:
    found = _poses(packed, row, camera)
    if not found:
        raise AdjustmentError(f"View {row + 1}: its corners are nearly in line, or too close together, for a pose.")
    return min(found, key=lambda one: one[0])[1]


def start_beam(packed: Packed, state: State, *, free: bool) -> State:
    """Return the state with a beam through the spots' centres; robust against a minority of wrong spots.

    The section of a cylinder by a plane is an ellipse about its axis: the centres lie on the axis. Its slopes are the
    medians over pairs of views (after Theil and Sen), its radius the median distance of the boundary from it.

    Parameters
    ----------
    packed : Packed
    state : State
        With the poses.
    free : bool
        Whether the beam's direction is free; else it is parallel to the optical axis.

    Raises
    ------
    AdjustmentError
        If no view has a spot whose boundary lies on the board as an ellipse.
    """
    # Any beam tells where the boundary lies on the boards.
    anywhere = state.values.copy()
    anywhere[BEAM] = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    blank = replace(state, values=anywhere)
    boundaries = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, blank)
    centres = []
    for row in np.flatnonzero(packed.with_spot):
        points = boundaries.points[row][packed.boundary_seen[row]]
        on_board = (points - state.translations[row]) @ state.rotations[row]
        fit = fit_conic(on_board[:, :2], method="taubin", check=False)
        if bool(np.all(fit.ok)):
            centre = np.append(np.asarray(fit.ellipse.centre, dtype=np.float64), 0.0)
            centres.append(state.rotations[row] @ centre + state.translations[row])
    if not centres:
        raise AdjustmentError("No view has a spot that is an ellipse on the board.")
    places = np.array(centres)
    slope = _median_slope(places) if free else np.zeros(2)
    offset = np.median(places[:, :2] - places[:, 2:] * slope, axis=0)
    direction = np.append(slope, 1.0)
    direction /= np.linalg.norm(direction)
    values = state.values.copy()
    values[BEAM] = [*offset, 1.0, *direction[:2], 0.0]
    aimed = replace(state, values=values)
    away = linear_boundaries(packed.board, packed.boundary, packed.boundary_seen, aimed)
    distance = 1.0 + (away.linear.residual * away.scale)[packed.boundary_seen]
    radius = max(float(np.median(distance)), np.finfo(np.float64).tiny)
    return replace(aimed, values=np.where(np.array(FULL) == "radius", radius, values))


def _median_slope(places: Array) -> Array:
    """Return dx/dz and dy/dz (2,) of the line through places (N, 3): the median over pairs, the long ones counting."""
    some = places[np.unique(np.linspace(0, len(places) - 1, _PAIRS).round().astype(int))]
    pairs = np.array(list(combinations(range(len(some)), 2)), dtype=int).reshape(-1, 2)
    steps = some[pairs[:, 1]] - some[pairs[:, 0]]
    depth = np.abs(steps[:, 2])
    if not depth.size or depth.max() == 0:
        return np.zeros(2)
    long = depth >= np.median(depth)
    return np.asarray(np.median(steps[long, :2] / steps[long, 2:], axis=0), dtype=np.float64)
