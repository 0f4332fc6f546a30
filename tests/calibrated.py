"""Adjusted sessions for the tests of what is made of them, each computed once."""

from functools import cache

from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.model import Model
from planeopt.simulation.board_random import Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession

FLAT = (0.0, 0.0)


@cache
def good_session(seed: int = 2, views: int = 12) -> SimulatedSession:
    """Return a session with nothing wrong in it, of a random rig."""
    return random_session(seed, shooting=Shooting(views), warp=FLAT, corner_sigma=0.1, spot_sigma=0.1)


@cache
def good(seed: int = 2, views: int = 12) -> Adjustment:
    """Return its adjustment, all parameters free but k3."""
    return adjust(good_session(seed, views).observations, Model())
