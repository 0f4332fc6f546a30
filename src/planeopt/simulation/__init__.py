"""Images of spots with their truth: scenes in Python or TOML, exact in geometry, with the noise of real images."""

from planeopt.simulation.board_faults import (
    bowed_session,
    frontal_session,
    long_session,
    mirrored_session,
    mixed_session,
    one_depth_session,
    short_session,
    spotless_session,
    wrong_scale_session,
)
from planeopt.simulation.board_files import write_session
from planeopt.simulation.board_look import BoardSurface
from planeopt.simulation.board_random import (
    Setting,
    Shooting,
    aimed,
    random_session,
    random_setting,
    shot_poses,
    tilted,
)
from planeopt.simulation.board_render import BoardScene, board_light, render_board, render_session
from planeopt.simulation.board_scene_file import (
    BoardSession,
    board_scene_sources,
    is_board_scene,
    load_board_session,
)
from planeopt.simulation.board_sessions import SimulatedSession, board_views, simulated_session
from planeopt.simulation.board_views import BoardPoses, BoardView
from planeopt.simulation.file import load_scene, save_scene, scene_sources
from planeopt.simulation.geometry import boundary_distances
from planeopt.simulation.render import Simulated, clean_light, frame, frames, render, true_record
from planeopt.simulation.scene import Scene
from planeopt.simulation.schema import scene_schema
from planeopt.simulation.tables import BeamProfile, Clutter, Noise, Occlusion, Optics, Sensor, Surface, Sweep

__all__ = [
    "BeamProfile",
    "BoardPoses",
    "BoardScene",
    "BoardSession",
    "BoardSurface",
    "BoardView",
    "Clutter",
    "Noise",
    "Occlusion",
    "Optics",
    "Scene",
    "Sensor",
    "Setting",
    "Shooting",
    "Simulated",
    "SimulatedSession",
    "Surface",
    "Sweep",
    "aimed",
    "board_light",
    "board_scene_sources",
    "board_views",
    "boundary_distances",
    "bowed_session",
    "clean_light",
    "frame",
    "frames",
    "frontal_session",
    "is_board_scene",
    "load_board_session",
    "load_scene",
    "long_session",
    "mirrored_session",
    "mixed_session",
    "one_depth_session",
    "random_session",
    "random_setting",
    "render",
    "render_board",
    "render_session",
    "save_scene",
    "scene_schema",
    "scene_sources",
    "short_session",
    "shot_poses",
    "simulated_session",
    "spotless_session",
    "tilted",
    "true_record",
    "write_session",
    "wrong_scale_session",
]
