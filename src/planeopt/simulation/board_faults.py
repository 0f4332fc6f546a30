"""Sessions that a calibration must refuse or warn of: each with one fault, otherwise as `random_session` makes them."""

from dataclasses import replace

import numpy as np

from planeopt.board import Observations
from planeopt.rig import Camera
from planeopt.simulation.board_random import Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession, simulated_session

_VIEWS = 15
_FLAT = (0.0, 0.0)


def frontal_session(seed: int, tilt_deg: float = 1.0) -> SimulatedSession:
    """Return a session whose views are all tilted by less than this."""
    return random_session(seed, shooting=Shooting(_VIEWS, tilt_deg=(0.0, tilt_deg)), warp=_FLAT)


def one_depth_session(seed: int, depth_ratio: float = 1.02) -> SimulatedSession:
    """Return a session with the board tilted in every direction, but always where the beam meets it at one depth."""
    return random_session(seed, shooting=Shooting(_VIEWS, depth_ratio=depth_ratio), warp=_FLAT)


def short_session(seed: int, views: int = 2) -> SimulatedSession:
    """Return a session of so many views."""
    return random_session(seed, shooting=Shooting(views), warp=_FLAT)


def spotless_session(seed: int, share: float = 0.8) -> SimulatedSession:
    """Return a session without a spot in this share of its views, the last ones."""
    session = random_session(seed, shooting=Shooting(_VIEWS), warp=_FLAT)
    views = session.observations.views
    kept = len(views) - round(share * len(views))
    bare = tuple(view if index < kept else replace(view, spot=None) for index, view in enumerate(views))
    return replace(session, observations=replace(session.observations, views=bare))


def mixed_session(seed: int, longer: float = 1.1) -> SimulatedSession:
    """Return a session every second view of which another camera took, whose focal length is longer by this factor."""
    session = random_session(seed, shooting=Shooting(_VIEWS), warp=_FLAT)
    camera = session.rig.camera
    other = replace(session.rig, camera=replace(camera, fx=longer * camera.fx, fy=longer * camera.fy))
    strange = simulated_session(
        other,
        session.board,
        session.poses,
        corner_sigma=session.corner_sigma,
        spot_sigma=session.spot_sigma,
        spot_points=session.spot_points,
        seed=seed,
    )
    pairs = zip(session.observations.views, strange.views, strict=True)
    views = tuple(b if index % 2 else a for index, (a, b) in enumerate(pairs))
    return replace(session, observations=replace(session.observations, views=views))


def bowed_session(seed: int, bow_mm: float = 0.5) -> SimulatedSession:
    """Return a session with a board bowed by so much, mm, half as much along y."""
    return random_session(seed, shooting=Shooting(_VIEWS), warp=(bow_mm, bow_mm / 2))


def wrong_scale_session(seed: int, x: float = 1.02, y: float = 1.02) -> SimulatedSession:
    """Return a session with its board stated to be longer than it is by these factors along x and along y."""
    session = random_session(seed, shooting=Shooting(_VIEWS), warp=_FLAT)
    return replace(session, observations=replace(session.observations, board=session.board.stretched(x, y)))


def mirrored_session(seed: int) -> SimulatedSession:
    """Return a session whose images were mirrored left to right before anything was measured in them."""
    session = random_session(seed, shooting=Shooting(_VIEWS), warp=_FLAT)
    return replace(session, observations=_mirrored(session.observations, session.rig.camera))


def _mirrored(observations: Observations, camera: Camera) -> Observations:
    flip = np.array([-1.0, 1.0])
    shift = np.array([camera.image_size[0] - 1.0, 0.0])
    views = []
    for view in observations.views:
        spot = None if view.spot is None else replace(view.spot, points=view.spot.points * flip + shift)
        views.append(replace(view, corners=view.corners * flip + shift, spot=spot))
    return replace(observations, views=tuple(views))


def long_session(seed: int, views: int = 1000) -> SimulatedSession:
    """Return a session of very many views."""
    return random_session(seed, shooting=Shooting(views))
