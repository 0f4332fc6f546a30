"""A plane in the camera frame, and the spot that the beam draws on it in the paper's variables.

`Plane` is what a user wants: a unit normal and a point, in mm, camera frame (x right, y down, z forward).
`SpotPose` is what the equations of Zhu et al. speak of: the ellipse's long semi-axis, its distance and its two angles,
in the laser-parallel frame (`planeopt.rig` holds the rotation between the two frames).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError

FloatArray = NDArray[np.float64]

BETA_TOLERANCE = 1e-6
"""Tilt below which `beta` means nothing and the tilt counts as zero, rad (0.2 arc seconds)."""

_EPS = float(np.finfo(np.float64).eps)
# A unit vector's components carry about one rounding each, and a dot product of three about four.
_ROUNDING = 4 * _EPS


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane by its normal and a point on it, camera frame.

    Parameters
    ----------
    normal : array_like, shape (3,)
        Any vector but zero; it is kept as a unit vector.
    point : array_like, shape (3,)
        A point on the plane, mm.

    Raises
    ------
    InputError
        If a number is not finite, a shape is not (3,), or the normal is zero.
    """

    normal: FloatArray
    point: FloatArray

    def __post_init__(self) -> None:
        normal = _vector("normal", self.normal)
        largest = float(np.max(np.abs(normal)))
        if largest == 0:
            raise InputError("the normal of a plane must not be zero")
        # A vector that is unit already stays as it is to the last bit, so that what was written reads back equal.
        if abs(math.hypot(*normal.tolist()) - 1) > _ROUNDING:
            normal = normal / largest
            normal /= np.linalg.norm(normal)
        object.__setattr__(self, "normal", _frozen(normal))
        object.__setattr__(self, "point", _frozen(_vector("point", self.point)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Plane):
            return NotImplemented
        return bool(np.array_equal(self.normal, other.normal) and np.array_equal(self.point, other.point))

    def __hash__(self) -> int:
        return hash((*self.normal.tolist(), *self.point.tolist()))

    @classmethod
    def from_intercepts(cls, a: float, b: float, c: float) -> "Plane":
        """Return the plane x/a + y/b + z/c = 1, equation (1).

        Parameters
        ----------
        a, b, c : float
            Where the plane cuts the camera's x, y and z axes, mm; `math.inf` where it is parallel to that axis.

        Returns
        -------
        Plane
            Its normal points away from the camera's centre; its point is the foot of the perpendicular from there.

        Raises
        ------
        InputError
            If an intercept is not a number, is zero (a plane through the camera's centre), or all are infinite.
        """
        intercepts = np.array([a, b, c], dtype=np.float64)
        if np.any(np.isnan(intercepts)):
            raise InputError(
                f"the intercepts ({a}, {b}, {c}) must be numbers; use inf where the plane is parallel to an axis"
            )
        if np.any(intercepts == 0):
            raise InputError(
                f"the intercepts ({a}, {b}, {c}) hold a zero: a plane through the camera's centre has no such form"
            )
        smallest = float(np.min(np.abs(intercepts)))
        if math.isinf(smallest):
            raise InputError("at least one intercept must be finite: no plane is parallel to all three axes")
        scaled = smallest / intercepts
        length = float(np.linalg.norm(scaled))
        normal = scaled / length
        return cls(normal, normal * (smallest / length))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> "Plane":
        """Return the plane z = 0 of a frame given by its 4x4 pose in the camera frame.

        Parameters
        ----------
        matrix : array_like, shape (4, 4)
            Takes coordinates of the frame to the camera's, mm; its upper left block is a rotation.

        Raises
        ------
        InputError
            If this is not a rigid transformation (to 1e-6).
        """
        pose = np.asarray(matrix, dtype=np.float64)
        if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
            raise InputError(f"the pose of a plane must be 4 x 4 finite numbers, not an array of shape {pose.shape}")
        rotation = pose[:3, :3]
        rigid = np.allclose(rotation.T @ rotation, np.eye(3), rtol=0, atol=1e-6) and np.linalg.det(rotation) > 0
        if not rigid or not np.allclose(pose[3], [0, 0, 0, 1], rtol=0, atol=1e-12):
            raise InputError(
                "the pose of a plane must be a rotation and a translation, with (0, 0, 0, 1) as its last row"
            )
        return cls(rotation[:, 2], pose[:3, 3])

    @property
    def intercepts(self) -> tuple[float, float, float]:
        """Where the plane cuts the camera's axes (a, b, c), mm; `math.inf` where it is parallel to one. Equation (1).

        Raises
        ------
        InputError
            If the plane goes through the camera's centre, where equation (1) cannot hold.
        """
        offset = float(self.normal @ self.point)
        if abs(offset) <= _ROUNDING * float(np.linalg.norm(self.point)):
            raise InputError(
                "a plane through the camera's centre has no intercepts: x/a + y/b + z/c = 1 cannot hold there"
            )
        a, b, c = (math.inf if abs(part) <= _ROUNDING else offset / part for part in self.normal.tolist())
        return a, b, c

    @property
    def rvec(self) -> FloatArray:
        """Rotation vector (3,), rad, OpenCV's convention: the smallest rotation from the camera's z axis to the normal.

        For the normal (0, 0, -1), where every axis serves, it is half a turn about x.
        """
        axis, cosine, sine = self._turn()
        return axis * math.atan2(sine, cosine)

    @property
    def tvec(self) -> FloatArray:
        """Origin (3,) of the plane's own frame in the camera frame, mm: the plane's point."""
        return self.point

    @property
    def matrix(self) -> FloatArray:
        """Pose (4, 4) of the plane's own frame in the camera frame: the rotation of `rvec`, and `tvec` in mm."""
        axis, cosine, sine = self._turn()
        x, y = float(axis[0]), float(axis[1])
        pose = np.eye(4)
        pose[:3, :3] = cosine * np.eye(3) + (1 - cosine) * np.outer(axis, axis)
        pose[:3, :3] += sine * np.array([[0, 0, y], [0, 0, -x], [-y, x, 0]])
        pose[:3, 3] = self.point
        return pose

    def _turn(self) -> tuple[FloatArray, float, float]:
        """Return the axis, cosine and sine of the smallest rotation from z to the normal."""
        x, y, z = self.normal.tolist()
        sine = math.hypot(x, y)
        axis = np.array([1.0, 0.0, 0.0]) if sine == 0 else np.array([-y / sine, x / sine, 0.0])
        return axis, z, sine

    def angle_to(self, other: "Plane") -> float:
        """Return the angle between the two normals, rad, 0 to pi; accurate also where it is small."""
        cross = float(np.linalg.norm(np.cross(self.normal, other.normal)))
        return math.atan2(cross, float(self.normal @ other.normal))

    def distance_to(self, points: ArrayLike) -> FloatArray:
        """Return the signed distances (...) of points (..., 3), mm: positive on the side the normal points to."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.point) @ self.normal)


@dataclass(frozen=True)
class SpotPose:
    """The spot on the plane in the paper's variables, laser-parallel frame, equation (2).

    Always canonical: `(alpha, beta)` and `(-alpha, beta + pi)` are one plane, and this holds the one with
    `0 <= alpha < pi/2`, `-pi < beta <= pi`. A tilt below `BETA_TOLERANCE` is kept as `alpha = 0`, `beta = None`.
    For angles as a solver returns them use `SpotPose.canonical`.

    Parameters
    ----------
    R : float
        Long semi-axis of the spot, mm.
    z_L : float
        Distance along the beam from (e_x, e_y, 0) to the plane, mm.
    alpha : float
        Tilt of the plane against the beam's cross-section, rad.
    beta : float or None
        Direction of the tilt, rad; `None` where the tilt is zero.

    Raises
    ------
    InputError
        If a number is not finite, `R` is not positive, or the angles are not canonical.
    """

    R: float
    z_L: float
    alpha: float
    beta: float | None

    def __post_init__(self) -> None:
        values = {"R": self.R, "z_L": self.z_L, "alpha": self.alpha, "beta": 0.0 if self.beta is None else self.beta}
        for name, value in values.items():
            if not math.isfinite(value):
                raise InputError(f"{name} of a spot must be finite, not {value}")
        if not self.R > 0:
            raise InputError(f"R of a spot must be positive, not {self.R} mm")
        if not 0 <= self.alpha < math.pi / 2:
            raise InputError(f"alpha of a spot must be at least 0 and below pi/2, not {self.alpha} rad")
        flat = self.alpha < BETA_TOLERANCE
        if not flat and self.beta is None:
            raise InputError(f"beta of a spot is needed where alpha is not 0 (alpha is {self.alpha} rad)")
        if self.beta is not None and not -math.pi < self.beta <= math.pi:
            raise InputError(f"beta of a spot must be above -pi and at most pi, not {self.beta} rad")
        object.__setattr__(self, "R", float(self.R))
        object.__setattr__(self, "z_L", float(self.z_L))
        object.__setattr__(self, "alpha", 0.0 if flat else float(self.alpha))
        object.__setattr__(self, "beta", None if flat or self.beta is None else float(self.beta))

    @classmethod
    def canonical(cls, R: float, z_L: float, alpha: float, beta: float | None) -> "SpotPose":
        """Return the canonical form of any real angles, as a solver without bounds returns them.

        Parameters
        ----------
        R, z_L : float
            As in the class, mm. A negative `R` counts as positive: equations (6) and (9) hold its square only.
        alpha, beta : float
            Any real angles, rad. A tilt beyond a right angle turns the normal round, which leaves the plane as it is.

        Raises
        ------
        InputError
            If a number is not finite or the plane is parallel to the beam.
        """
        if not (math.isfinite(alpha) and (beta is None or math.isfinite(beta))):
            raise InputError(f"the angles of a spot must be finite, not alpha = {alpha}, beta = {beta} rad")
        # (alpha + pi) turns the normal round, which leaves the plane where it is. `remainder` is exact.
        tilt = math.remainder(alpha, math.pi)
        if abs(tilt) >= math.pi / 2:
            raise InputError(f"alpha = {alpha} rad is a plane parallel to the beam, which draws no spot on it")
        if beta is None:
            return cls(abs(R), z_L, abs(tilt), None)
        return cls(abs(R), z_L, abs(tilt), _half_open(beta if tilt >= 0 else math.remainder(beta, math.tau) + math.pi))

    @classmethod
    def from_slopes(cls, z_L: float, p: float, q: float, radius: float) -> "SpotPose":
        """Return the spot of a beam of this radius on the plane with slopes p = dz/dx, q = dz/dy.

        Parameters
        ----------
        z_L : float
            Distance along the beam, mm (not the z of the spot's centre: these differ by `Rig.axial_shift`).
        p, q : float
            Slopes of the plane in the laser-parallel frame.
        radius : float
            Radius of the beam, mm.

        Raises
        ------
        InputError
            If a number is not finite or the radius is not positive.
        """
        if not (math.isfinite(p) and math.isfinite(q)):
            raise InputError(f"the slopes of a plane must be finite, not ({p}, {q})")
        slope = math.hypot(p, q)
        return cls(radius * math.hypot(1.0, slope), z_L, math.atan(slope), _half_open(math.atan2(-p, q)))

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes (p, q) in the laser-parallel frame: p = -tan(alpha) sin(beta), q = tan(alpha) cos(beta)."""
        if self.beta is None:
            return 0.0, 0.0
        tangent = math.tan(self.alpha)
        return -tangent * math.sin(self.beta), tangent * math.cos(self.beta)

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) in the laser-parallel frame: (sin a sin b, -sin a cos b, cos a)."""
        if self.beta is None:
            return np.array([0.0, 0.0, 1.0])
        sine = math.sin(self.alpha)
        return np.array([sine * math.sin(self.beta), -sine * math.cos(self.beta), math.cos(self.alpha)])


def _half_open(angle: float) -> float:
    """Return the same direction in (-pi, pi], without a negative zero."""
    turned = math.remainder(angle, math.tau)
    return math.pi if turned <= -math.pi else turned + 0.0


def _vector(name: str, value: ArrayLike) -> FloatArray:
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {name} of a plane must be three finite numbers, not {value!r}") from error
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise InputError(f"the {name} of a plane must be three finite numbers, not {value}")
    return vector


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
