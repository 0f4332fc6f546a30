"""The rig: camera, beam, their joint covariance, and the way from pixels to the laser-parallel image plane."""

from planeopt.rig.beam import Beam, rotation_to_axis
from planeopt.rig.beam_image import Silhouette, silhouette
from planeopt.rig.camera import Camera, distort
from planeopt.rig.covariance import BEAM_PARAMETERS, CAMERA_PARAMETERS, PARAMETERS, RigCovariance
from planeopt.rig.file import load_rig, rig_as_toml, rig_from_dict, save_rig
from planeopt.rig.model import CHANNELS, SPOT_KINDS, Rig, SpotDefinition
from planeopt.rig.mount import Mount

__all__ = [
    "BEAM_PARAMETERS",
    "CAMERA_PARAMETERS",
    "CHANNELS",
    "PARAMETERS",
    "SPOT_KINDS",
    "Beam",
    "Camera",
    "Mount",
    "Rig",
    "RigCovariance",
    "Silhouette",
    "SpotDefinition",
    "distort",
    "load_rig",
    "rig_as_toml",
    "rig_from_dict",
    "rotation_to_axis",
    "save_rig",
    "silhouette",
]
