"""A scene: a rig before a plane, and all that shapes the image of the spot."""

import math
from typing import Any

import msgspec

from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig
from planeopt.simulation.tables import BeamProfile, Clutter, Noise, Occlusion, Optics, Sensor, Surface, Sweep


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    """All that an image depends on; change parts with `msgspec.structs.replace`.

    Parameters
    ----------
    rig : Rig
        With a beam; its covariance is not used.
    plane : Plane or SpotPose
        In the camera frame, or in the paper's variables, with the R that follows from the beam, as `of` puts it in.
    beam, optics, surface, noise, sensor, clutter
        See the classes.
    occlusions : tuple of Occlusion
    sweep : Sweep, optional
        Planes of a series of images, see `frame`.
    frames : int
        How many images a series has.
    laser_off : bool
        Whether a series also has an image without laser for each.
    seed : int
        Of all that is random.
    """

    rig: Rig
    plane: Plane | SpotPose
    beam: BeamProfile = BeamProfile()
    optics: Optics = Optics()
    surface: Surface = Surface()
    noise: Noise = Noise()
    sensor: Sensor = Sensor()
    occlusions: tuple[Occlusion, ...] = ()
    clutter: Clutter = Clutter()
    sweep: Sweep | None = None
    frames: int = 1
    laser_off: bool = False
    seed: int = 0

    @classmethod
    def of(cls, rig: Rig, plane: Plane | SpotPose, **tables: Any) -> "Scene":
        """Return the scene of a rig and a plane; a disc or a ring as the rig says, all else by default or as given."""
        if isinstance(plane, SpotPose):
            plane = SpotPose(rig.require_beam().radius / math.cos(plane.alpha), plane.z_L, plane.alpha, plane.beta)
        if "beam" not in tables and rig.spot is not None:
            tables["beam"] = BeamProfile(kind="ring" if rig.spot.kind == "ring" else "disc", level=rig.spot.level)
        return cls(rig=rig, plane=plane, **tables)

    @property
    def pose(self) -> SpotPose:
        """The plane in the paper's variables, with the rig's own radius."""
        if isinstance(self.plane, Plane):
            return self.rig.pose_from_plane(self.plane)
        return self.plane

    @property
    def true_plane(self) -> Plane:
        """The plane in the camera frame: normal with positive component along the beam, point on the beam's axis."""
        return self.rig.plane_from_pose(self.pose)
