"""Images of spots with their truth: scenes in Python or TOML, exact in geometry, with the noise of real images."""

from planeopt.simulation.file import load_scene, save_scene, scene_sources
from planeopt.simulation.geometry import boundary_distances
from planeopt.simulation.render import Simulated, clean_light, frame, frames, render, true_record
from planeopt.simulation.scene import Scene
from planeopt.simulation.schema import scene_schema
from planeopt.simulation.tables import BeamProfile, Clutter, Noise, Occlusion, Optics, Sensor, Surface, Sweep

__all__ = [
    "BeamProfile",
    "Clutter",
    "Noise",
    "Occlusion",
    "Optics",
    "Scene",
    "Sensor",
    "Simulated",
    "Surface",
    "Sweep",
    "boundary_distances",
    "clean_light",
    "frame",
    "frames",
    "load_scene",
    "render",
    "save_scene",
    "scene_schema",
    "scene_sources",
    "true_record",
]
