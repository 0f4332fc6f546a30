"""The rig: camera, beam, and the way between pixels, the laser-parallel image plane, spots and planes."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.rig.beam import Beam, rotation_to_axis
from planeopt.rig.camera import Camera
from planeopt.rig.checks import finite, positive
from planeopt.rig.covariance import BEAM_PARAMETERS, PARAMETERS, RigCovariance
from planeopt.rig.mount import Mount

FloatArray = NDArray[np.float64]

SPOT_KINDS = ("disc", "ring")
CHANNELS = ("gray", "red", "green", "blue")

_DISTORTION = ("k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True)
class SpotDefinition:
    """What counted as the spot's boundary when the beam's radius was calibrated; measurements must use the same.

    Parameters
    ----------
    kind : {"disc", "ring"}
        A filled spot, bounded where its irradiance falls, or a bright loop, followed along its ridge.
    level : float
        Fraction of the plateau at which a disc's edge is taken, between 0 and 1.
    channel : {"gray", "red", "green", "blue"}
        Colour channel in which the spot is measured.
    gamma : float
        Exponent of the image's response: recorded value ~ irradiance ** (1 / gamma); 1 is linear.

    Raises
    ------
    InputError
        If a value is outside the ranges above.
    """

    kind: str = "disc"
    level: float = 0.5
    channel: str = "gray"
    gamma: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in SPOT_KINDS:
            raise InputError(f"spot.kind must be one of {', '.join(SPOT_KINDS)}, not {self.kind!r}")
        level = finite("spot.level", self.level)
        if not 0 < level < 1:
            raise InputError(f"spot.level must be a fraction between 0 and 1, not {level}")
        if self.channel not in CHANNELS:
            raise InputError(f"spot.channel must be one of {', '.join(CHANNELS)}, not {self.channel!r}")
        object.__setattr__(self, "level", level)
        object.__setattr__(self, "gamma", positive("spot.gamma", self.gamma, "1 is a linear response"))


@dataclass(frozen=True)
class Rig:
    """A camera and, if it was calibrated, its laser beam.

    The virtual, laser-parallel camera shares the camera's centre; a ray X becomes X' = Q X and images at
    (x_i, y_i) = f (X'/Z', Y'/Z'), in mm. There the (corrected) equations of Zhu et al. hold as they stand, with
    the offset `laser_offset`.

    Parameters
    ----------
    camera : Camera
    beam : Beam, optional
        Left out for a camera alone.
    spot : SpotDefinition, optional
    covariance : RigCovariance, optional
        Of the free parameters of camera and beam, jointly.
    mount : Mount, optional
        The camera's pose in the frame of a robot's flange or tool.
    refused : str, optional
        Why the calibration that it comes from was refused, where it is kept all the same: whatever is measured with it
        is then `degraded`.

    Raises
    ------
    InputError
        If the covariance names parameters that this rig does not have.
    """

    camera: Camera
    beam: Beam | None = None
    spot: SpotDefinition | None = None
    covariance: RigCovariance | None = None
    mount: Mount | None = None
    refused: str | None = None

    def __post_init__(self) -> None:
        names = () if self.covariance is None else self.covariance.parameters
        if "f" in names and self.camera.fx != self.camera.fy:
            raise InputError("covariance.parameters: 'f' needs camera.fx and camera.fy to be equal; use 'fx' and 'fy'")
        orphan = next((name for name in names if name in BEAM_PARAMETERS), None)
        if orphan is not None and self.beam is None:
            raise InputError(f"covariance.parameters: {orphan!r} is a parameter of the beam, but there is no [laser]")

    def require_beam(self) -> Beam:
        """Return the beam, or raise an `InputError` where the rig is a camera alone."""
        if self.beam is None:
            raise InputError("this rig is a camera alone: it has no [laser], which measuring a plane needs")
        return self.beam

    @property
    def covariance_matrix(self) -> FloatArray:
        """Covariance (n, n) of the free parameters, px, mm and 1; (0, 0) where the rig has none."""
        return np.zeros((0, 0)) if self.covariance is None else self.covariance.matrix

    @property
    def focal_length(self) -> float:
        """Distance f of the laser-parallel image plane, mm: fx * pixel_pitch_mm.

        Without a pixel pitch the image plane is put at z = 1 mm, so that its coordinates are the normalised ones; the
        planes found do not depend on this choice.
        """
        pitch = self.camera.pixel_pitch_mm
        return 1.0 if pitch is None else self.camera.fx * pitch

    @property
    def Q(self) -> FloatArray:
        """Rotation (3, 3) from the camera frame to the laser-parallel frame: the smallest that takes the beam to +z."""
        return np.array(rotation_to_axis(*self.require_beam().direction), dtype=np.float64)

    @property
    def laser_offset(self) -> tuple[float, float]:
        """Offset e' = (Q e)_xy of the beam in the laser-parallel frame, mm, with e = (e_x, e_y, 0)."""
        x, y, _ = self._turned_offset()
        return x, y

    @property
    def axial_shift(self) -> float:
        """(Q e)_z, mm: the z of the spot's centre in the laser-parallel frame is `z_L + axial_shift`."""
        return self._turned_offset()[2]

    def _turned_offset(self) -> tuple[float, float, float]:
        x, y, z = (self.Q @ [*self.require_beam().offset, 0.0]).tolist()
        return x, y, z

    def to_laser_plane(self, px: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return where pixels lie on the laser-parallel image plane, and the Jacobian of that.

        Neither undistortion nor the rotation keeps distances: carry each point's covariance through its Jacobian.

        Parameters
        ----------
        px : array_like, shape (N, 2)
            Raw (distorted) pixels.

        Returns
        -------
        points : ndarray, shape (N, 2)
            (x_i, y_i), mm.
        jacobian : ndarray, shape (N, 2, 2)
            d points / d px, mm per px.

        Raises
        ------
        InputError
            If the distortion cannot be inverted at a pixel, or its ray does not point along the beam; names the row.
        """
        normalised, inner = self.camera.normalise(px)
        Q, f = self.Q, self.focal_length
        rays = normalised @ Q[:, :2].T + Q[:, 2]
        depth = _forward(rays[..., 2], "does not point forward along the beam")
        ratio = rays[..., :2] / depth[..., None]
        outer = (f / depth)[..., None, None] * (Q[:2, :2] - ratio[..., :, None] * Q[2, :2])
        return f * ratio, outer @ inner

    def from_laser_plane(self, points: ArrayLike) -> FloatArray:
        """Return the raw pixels (N, 2) of points (N, 2) on the laser-parallel image plane, mm; undoes `to_laser_plane`.

        Raises
        ------
        InputError
            If the camera cannot see a point: it lies behind, or where the lens's distortion folds over; names the row.
        """
        mm = np.asarray(points, dtype=np.float64)
        Q = self.Q
        # Q is a rotation, so its inverse is its transpose, and rows times Q is the transpose times columns.
        rays = (mm / self.focal_length) @ Q[:2] + Q[2]
        normalised = rays[..., :2] / _forward(rays[..., 2], "does not point forward in the camera")[..., None]
        radius = np.hypot(normalised[..., 0], normalised[..., 1])
        folded = np.ravel(radius >= self.camera.invertible_radius)
        if np.any(folded):
            raise InputError(
                f"point {int(np.argmax(folded))} (counted from 0) lies where the lens's distortion folds over"
            )
        return self.camera.project(normalised)

    def plane_arrays(self, z_L: ArrayLike, p: ArrayLike, q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return planes given by distance along the beam and slopes, many at once.

        Parameters
        ----------
        z_L : array_like, shape (...)
            Distance along the beam from (e_x, e_y, 0), mm.
        p, q : array_like, shape (...)
            Slopes in the laser-parallel frame.

        Returns
        -------
        normals : ndarray, shape (..., 3)
            Unit, camera frame, with positive component along the beam.
        points : ndarray, shape (..., 3)
            Where the beam's axis meets each plane, camera frame, mm.
        """
        beam = self.require_beam()
        p, q = np.broadcast_arrays(np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64))
        upward = np.stack([-p, -q, np.ones_like(p)], axis=-1)
        normals = upward / np.linalg.norm(upward, axis=-1, keepdims=True) @ self.Q
        along = np.asarray(z_L, dtype=np.float64)[..., None] * np.array(beam.direction)
        return normals, np.array([*beam.offset, 0.0]) + along

    def slope_arrays(self, normals: ArrayLike, points: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (z_L, p, q), each (...), of planes by normals (..., 3) and points (..., 3); undoes `plane_arrays`.

        Raises
        ------
        InputError
            If a plane is parallel to the beam.
        """
        beam = self.require_beam()
        normals, points = np.asarray(normals, dtype=np.float64), np.asarray(points, dtype=np.float64)
        turned = normals @ self.Q.T
        along = turned[..., 2]
        if np.any(along == 0):
            raise InputError("a plane parallel to the beam is never met by it: its slopes are infinite")
        z_L = np.sum(normals * (points - [*beam.offset, 0.0]), axis=-1) / along
        return z_L, -turned[..., 0] / along, -turned[..., 1] / along

    def plane_from_pose(self, pose: SpotPose) -> Plane:
        """Return the plane of a spot: normal with positive component along the beam, point where the axis meets it."""
        beam = self.require_beam()
        point = np.array([*beam.offset, 0.0]) + pose.z_L * np.array(beam.direction)
        return Plane(pose.normal @ self.Q, point)

    def pose_from_plane(self, plane: Plane) -> SpotPose:
        """Return the spot that this beam draws on the plane, equation (2), with R = r / cos(alpha).

        Raises
        ------
        InputError
            If the plane is parallel to the beam.
        """
        z_L, p, q = self.slope_arrays(plane.normal, plane.point)
        return SpotPose.from_slopes(float(z_L), float(p), float(q), self.require_beam().radius)

    def parameter(self, name: str) -> float:
        """Return one of `PARAMETERS`: px, mm or 1.

        Raises
        ------
        InputError
            If there is no such parameter, or it is `f` and fx differs from fy.
        """
        _known(name)
        if name == "f":
            if self.camera.fx != self.camera.fy:
                raise InputError("the rig has no single 'f': camera.fx and camera.fy differ")
            return self.camera.fx
        if name in _DISTORTION:
            return self.camera.distortion[_DISTORTION.index(name)]
        if name not in BEAM_PARAMETERS:
            return float(getattr(self.camera, name))
        beam = self.require_beam()
        values = (*beam.offset, beam.radius, *beam.direction[:2])
        return values[BEAM_PARAMETERS.index(name)]

    def with_parameters(self, values: Mapping[str, float]) -> "Rig":
        """Return a rig with some of its `PARAMETERS` changed; `f` sets fx and fy.

        Parameters
        ----------
        values : mapping of str to float
            New values: px, mm or 1. Of the direction x and y are given; z is +sqrt(1 - x^2 - y^2).

        Raises
        ------
        InputError
            If a name is unknown, or a value is impossible.
        """
        for name in values:
            _known(name)
        if "f" in values and ("fx" in values or "fy" in values):
            raise InputError("'f' is fx and fy in one; give either 'f' or 'fx' and 'fy'")
        return replace(self, camera=_changed_camera(self.camera, values), beam=self._changed_beam(values))

    def _changed_beam(self, values: Mapping[str, float]) -> Beam | None:
        if not any(name in values for name in BEAM_PARAMETERS):
            return self.beam
        e_x, e_y, radius, x, y = (float(values.get(name, self.parameter(name))) for name in BEAM_PARAMETERS)
        direction = self.require_beam().direction
        if "direction_x" in values or "direction_y" in values:
            room = 1 - x * x - y * y
            if not room > 0:
                raise InputError(
                    f"direction_x = {x}, direction_y = {y} leave no forward direction: x^2 + y^2 must be below 1"
                )
            direction = (x, y, math.sqrt(room))
        return Beam(radius, (e_x, e_y), direction)


def _changed_camera(camera: Camera, values: Mapping[str, float]) -> Camera:
    both = {"fx": values["f"], "fy": values["f"]} if "f" in values else {}
    plain = {name: values[name] for name in ("fx", "fy", "cx", "cy") if name in values}
    k1, k2, p1, p2, k3 = (values.get(name, old) for name, old in zip(_DISTORTION, camera.distortion, strict=True))
    return replace(camera, distortion=(k1, k2, p1, p2, k3), **(both | plain))


def _known(name: str) -> None:
    if name not in PARAMETERS:
        raise InputError(f"{name!r} is not a parameter of a rig; known are {', '.join(PARAMETERS)}")


def _forward(depth: FloatArray, reason: str) -> FloatArray:
    behind = np.ravel(~(depth > 0))
    if np.any(behind):
        raise InputError(f"the ray of point {int(np.argmax(behind))} (counted from 0) {reason}")
    return depth
