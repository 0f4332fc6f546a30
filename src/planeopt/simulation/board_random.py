"""Random rigs and boards, and sessions as a person would shoot them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planeopt.board import Board, SpotOnBoard
from planeopt.errors import InputError
from planeopt.rig import Beam, Camera, Rig
from planeopt.simulation.board_sessions import SimulatedSession, simulated_session
from planeopt.simulation.board_views import BoardPoses, BoardView

Array = NDArray[np.float64]

_SIZES = ((960, 720), (1280, 960), (1280, 1024), (1440, 1080), (1600, 1200))
_DICTIONARIES = ("DICT_4X4_100", "DICT_5X5_100", "DICT_6X6_250")
_PITCHES = (None, 0.00345, 0.0048, 0.0055)

_LEANEST = math.radians(1.0)
_TRIES = 400
_SETTINGS = 20
_MARGIN_PX = 8.0
_MARGIN_MM_SHARE = 0.12
"""Of a square: what the spot keeps from the window's edge."""
_LEAST_CORNERS = 20
_GOLDEN = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True)
class Shooting:
    """How a session is shot.

    Parameters
    ----------
    views : int
    tilt_deg : (float, float)
        Least and largest tilt of the board against the image; every direction.
    depth_ratio : float
        Of the farthest to the nearest board, 1: one depth.
    spotless : float
        Share of the views, at the end, in which the board is anywhere in the image and the spot is not asked for.
    turn_deg : float
        Largest turn of the board in its plane.
    """

    views: int
    tilt_deg: tuple[float, float] = (0.0, 45.0)
    depth_ratio: float = 2.0
    spotless: float = 0.0
    turn_deg: float = 40.0


@dataclass(frozen=True)
class Setting:
    """A rig and a board that fits it.

    Attributes
    ----------
    rig : Rig
    board : Board
    depth : float
        The middle of the working distances, mm.
    """

    rig: Rig
    board: Board
    depth: float = field(kw_only=True)


def random_session(
    seed: int,
    *,
    shooting: Shooting | None = None,
    setting: Setting | None = None,
    image_size: tuple[int, int] | None = None,
    warp: tuple[float, float] | None = None,
    corner_sigma: float | None = None,
    spot_sigma: float | None = None,
    spot: SpotOnBoard = "disc",
) -> SimulatedSession:
    """Return a sensible session of a random rig: 8 to 30 views, all tilts up to 45 degrees, a depth ratio over 1.5.

    Parameters
    ----------
    seed : int
        Of all that is not given.
    shooting : Shooting, optional
    setting : Setting, optional
        See `random_setting`.
    image_size : tuple of int, optional
    warp : (float, float), optional
        mm; unless given the board is bowed by 0.1 mm or so, as boards are.
    corner_sigma, spot_sigma : float, optional
        px; unless given 0.05 to 0.25 and 0.05 to 0.2 px.
    spot : {"disc", "ring", "none"}

    Raises
    ------
    InputError
        If the setting that is given has no such poses.
    """
    rng = np.random.default_rng((seed, 1))
    count, ratio, share = int(rng.integers(8, 31)), rng.uniform(1.6, 2.4), rng.choice([0.0, 0.1, 0.2])
    noise = np.exp(rng.uniform(np.log([0.05, 0.05]), np.log([0.25, 0.2]))).tolist()
    bowed = rng.normal(0, 0.1, 2).tolist()
    shooting = Shooting(count, depth_ratio=float(ratio), spotless=float(share)) if shooting is None else shooting
    setting, poses = _shot(seed, setting, image_size, shooting)
    of_corners: float = noise[0] if corner_sigma is None else corner_sigma
    of_spot: float = noise[1] if spot_sigma is None else spot_sigma
    warp = (bowed[0], bowed[1]) if warp is None else warp
    points = int(rng.integers(60, 200))
    observations = simulated_session(
        setting.rig,
        setting.board,
        poses,
        corner_sigma=of_corners,
        spot_sigma=of_spot,
        warp=warp,
        spot_points=points,
        spot=spot,
        seed=seed,
    )
    return SimulatedSession(
        setting.rig, setting.board, poses, observations, of_corners, of_spot, warp, spot_points=points
    )


def _shot(
    seed: int, given: Setting | None, image_size: tuple[int, int] | None, shooting: Shooting
) -> tuple[Setting, BoardPoses]:
    """Return a setting with poses; where a drawn one has none, another is drawn."""
    attempt = 0
    while True:
        setting = random_setting(np.random.default_rng((seed, 2, attempt)), image_size) if given is None else given
        try:
            return setting, shot_poses(setting, shooting, np.random.default_rng((seed, 3, attempt)))
        except InputError:
            attempt += 1
            if attempt == _SETTINGS:
                raise


def random_setting(rng: np.random.Generator, image_size: tuple[int, int] | None = None) -> Setting:
    """Return a random rig with a board that fills most of its image at the working distance.

    The working distance is 150 to 600 mm, the image's angle 26 to 58 degrees across; the distortion moves the image's
    corner by up to 8 %, a third of the lenses have k3; the beam is off the lens by more than its radius, in any
    direction, and up to 1 degree off the optical axis; the window is larger than the spot tilted by 45 degrees.
    """
    size = _SIZES[int(rng.integers(len(_SIZES)))] if image_size is None else image_size
    depth = float(np.exp(rng.uniform(np.log(150), np.log(600))))
    camera = _random_camera(size, rng)
    board, room = _random_board(depth * size[0] / camera.fx, rng)
    radius = room / math.sqrt(2) * rng.uniform(0.45, 0.8)
    reach = 0.25 * depth * size[1] / camera.fx
    away = rng.uniform(min(1.3 * radius, reach), reach)
    around = rng.uniform(-math.pi, math.pi)
    lean = math.sin(_LEANEST) * math.sqrt(rng.uniform()) * np.exp(1j * rng.uniform(-math.pi, math.pi))
    direction = (float(lean.real), float(lean.imag), math.sqrt(1 - abs(lean) ** 2))
    beam = Beam(radius, (away * math.cos(around), away * math.sin(around)), direction)
    return Setting(Rig(camera, beam), board, depth=depth)


def _random_camera(size: tuple[int, int], rng: np.random.Generator) -> Camera:
    width, height = size
    f = width * rng.uniform(0.9, 2.2)
    corner = math.hypot(width, height) / 2 / f
    k1, k2 = rng.uniform(-0.08, 0.04) / corner**2, rng.uniform(-0.03, 0.03) / corner**4
    k3 = rng.uniform(-0.02, 0.02) / corner**6 if rng.uniform() < 1 / 3 else 0.0
    p1, p2 = rng.uniform(-1e-3, 1e-3, 2).tolist()
    cx, cy = (np.array(size) / 2 + 0.012 * width * rng.standard_normal(2)).tolist()
    pitch = _PITCHES[int(rng.integers(len(_PITCHES)))]
    camera = Camera(size, f, f, cx, cy, (k1, k2, p1, p2, k3), pitch)
    # A lens that folds over within reach of its image is not one that anybody calibrates.
    return camera if camera.invertible_radius > 1.6 * corner else _random_camera(size, rng)


def _random_board(across: float, rng: np.random.Generator) -> tuple[Board, float]:
    """Return a board for a field of this width, mm, and half the window's shorter side, mm."""
    columns, rows = int(rng.choice([9, 11, 12, 13, 15])), int(rng.choice([7, 9, 11]))
    rows = min(rows, columns - 2)
    square = across * rng.uniform(0.65, 0.95) / columns
    # A third of all prints are measured to be a little longer one way.
    sides = (square, square * (1 + rng.normal(0, 0.002) * (rng.uniform() < 1 / 3)))
    wide, high = int(rng.choice([3, 4, 5])), 3
    left = int(np.clip((columns - wide) // 2 + rng.integers(-1, 2), 2, columns - wide - 2))
    top = (rows - high) // 2
    window = (left * sides[0], top * sides[1], wide * sides[0], high * sides[1])
    dictionary = _DICTIONARIES[int(rng.integers(len(_DICTIONARIES)))]
    board = Board((columns, rows), sides, 0.75 * min(sides), dictionary, window_mm=window)
    return board, min(wide * sides[0], high * sides[1]) / 2


def shot_poses(setting: Setting, shooting: Shooting, rng: np.random.Generator) -> BoardPoses:
    """Return poses of the board in which the beam meets its window (or, without one, its middle).

    Depths are spread evenly in their logarithm and tilts evenly, in every direction in turn. Where the spot would not
    lie in the window and in the image, or too few corners would be seen, another aim and turn are drawn.

    Raises
    ------
    InputError
        If some view finds no pose in 400 tries.
    """
    count = shooting.views
    with_spot = count - round(shooting.spotless * count)
    share = (np.arange(count) + rng.uniform(0, 1, count)) / count
    depths = setting.depth * shooting.depth_ratio ** (rng.permutation(share) - 0.5)
    if count > 1 and shooting.depth_ratio > 1:
        # Both ends are reached, whatever the draw.
        nearest, farthest = np.argmin(depths[: max(with_spot, 2)]), np.argmax(depths[: max(with_spot, 2)])
        depths[nearest] = setting.depth * shooting.depth_ratio**-0.5
        depths[farthest] = setting.depth * shooting.depth_ratio**0.5
    low, high = np.radians(shooting.tilt_deg)
    tilts = low + (high - low) * np.sqrt(rng.permutation(share))
    directions = rng.uniform(-math.pi, math.pi) + _GOLDEN * np.arange(count)
    rotations, translations = np.empty((count, 3, 3)), np.empty((count, 3))
    for index in range(count):
        aim = _aimed if index < with_spot else _anywhere
        rotations[index], translations[index] = _pose(
            setting, shooting, aim, depths[index], tilts[index], directions[index], rng
        )
    return BoardPoses(rotations, translations)


def _pose(
    setting: Setting,
    shooting: Shooting,
    aim: Callable[[Setting, Array, float, np.random.Generator], Array],
    depth: float,
    tilt: float,
    direction: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    turn = math.radians(shooting.turn_deg)
    for tried in range(_TRIES):
        # What cannot be had at this tilt and depth is had a little flatter, elsewhere in the range.
        eased = max(0.0, tried / _TRIES - 0.25)
        lean = tilt * (1 - eased)
        rotation = tilted(lean, direction + eased * rng.normal(), rng.uniform(-turn, turn))
        translation = aim(setting, rotation, depth, rng)
        view = BoardView(setting.rig, setting.board, rotation, translation)
        if _good(view, setting.board, aim is _aimed):
            return rotation, translation
    raise InputError(f"no pose at {depth:.0f} mm with a tilt of {math.degrees(tilt):.0f} degrees in {_TRIES} tries")


def tilted(tilt: float, direction: float, turn: float) -> Array:
    """Return the rotation (3, 3) of a board turned in its plane, then tilted about an axis in the image, all rad."""
    axis = tilt * np.array([math.cos(direction), math.sin(direction), 0.0])
    return np.asarray((Rotation.from_rotvec(axis) * Rotation.from_rotvec([0.0, 0.0, turn])).as_matrix())


def aimed(rig: Rig, rotation: Array, depth: float, at: Array) -> Array:
    """Return the translation (3,) by which the beam's axis meets a place (2,) of the board, mm, at a depth z, mm."""
    beam = rig.require_beam()
    hit = np.array([*beam.offset, 0.0]) + depth / beam.direction[2] * np.array(beam.direction)
    return hit - rotation[:, :2] @ at


def _aimed(setting: Setting, rotation: Array, depth: float, rng: np.random.Generator) -> Array:
    x, y, width, height = setting.board.window_mm or (0.0, 0.0, *setting.board.size_mm)
    at = np.array([x + width * rng.uniform(0.2, 0.8), y + height * rng.uniform(0.2, 0.8)])
    return aimed(setting.rig, rotation, depth, at)


def _anywhere(setting: Setting, rotation: Array, depth: float, rng: np.random.Generator) -> Array:
    camera = setting.rig.camera
    px = np.array(camera.image_size) * rng.uniform(0.2, 0.8, 2)
    normalised, _ = camera.normalise(px)
    return depth * np.array([*normalised, 1.0]) - rotation[:, :2] @ (np.array(setting.board.size_mm) / 2)


def _good(view: BoardView, board: Board, spot: bool) -> bool:
    seen = int(np.count_nonzero(view.corners[1]))
    if seen < max(_LEAST_CORNERS, 0.4 * np.count_nonzero(board.printed)):
        return False
    return not spot or view.spot_state(_MARGIN_MM_SHARE * min(board.square_mm), _MARGIN_PX) == "seen"
