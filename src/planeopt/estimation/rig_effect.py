"""First-order effect of the rig's uncertainty on many planes, and on what each spot says about the rig.

The raw pixels are held fixed. A point's signed distance ``d = m sqrt(grad F' V grad F)`` from the image of its
plane's spot changes with a point of the image plane by ``grad F / sqrt(grad F' V grad F)``, taken at its foot, and
with the ellipse by its coefficients. A camera's parameter moves the point as a pixel moved the other way would; the
beam's offset and radius change the ellipse; its direction turns both, which on the ellipse is a change of its
coefficients too. By the implicit function theorem the plane moves by ``-(J'J)^-1 J' dd/d eta``, J the distances'
derivatives by the plane.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation.images import BEAM, SPAN, BeamImages, Images, conics_at
from planeopt.estimation.regular import Quadratic
from planeopt.estimation.rig_part import CAMERA, PARAMETERS, SEEN, free_parameters
from planeopt.estimation.small_systems import lower_solved, upper_solved
from planeopt.estimation.tangents import Cloud, Tangents, products, tangents
from planeopt.rig import Rig

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RigEffect:
    """Derivatives at M solutions, as `planeopt.estimation.rig_part.Sensitivity` and `planeopt.solution.RigTest` hold.

    Attributes
    ----------
    plane_by_rig : (M, 3, n)
        ``(z_L, p, q)``, ``z_L`` along the beam, by the free parameters of the rig's covariance.
    misfit : (M, 2)
        The part of the points' distances that another ellipse would explain and no plane does; white.
    misfit_by_rig : (M, 2, n)
    misfit_by_beam : (M, 2, 4)
        By e_x, e_y, direction_x and direction_y.
    """

    plane_by_rig: Array
    misfit: Array
    misfit_by_rig: Array
    misfit_by_beam: Array


@dataclass(frozen=True, eq=False)
class Sight:
    """Boundary points of M spots as the camera has them; all (M, N).

    Attributes
    ----------
    xd, yd : (M, N)
        Distorted normalised coordinates: the pixel less the principal point, over the focal length.
    x, y : (M, N)
        Normalised coordinates of their rays in the camera frame.
    by_pixel : four of (M, N)
        Derivatives of the coordinates on the laser-parallel image plane, mm, by the raw pixel: of the first coordinate
        by u and v, then of the second.
    """

    xd: Array
    yd: Array
    x: Array
    y: Array
    by_pixel: tuple[Array, Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of M spots at their solutions.

    Attributes
    ----------
    by_plane : (M, 5, 3)
        As `Images.coordinates` has it.
    tangents : Tangents
    quadratic : Quadratic
    """

    by_plane: Array
    tangents: Tangents
    quadratic: Quadratic

    @classmethod
    def of(cls, planes: Array, images: Images, cloud: Cloud, feet: Array) -> "Seen":
        """At planes (M, 3), from the monomials (6, M, N) of the points' feet, which are overwritten."""
        at, by_plane = images.coordinates(planes, cloud.origin)
        tangent = tangents(cloud, conics_at(at), feet)
        return cls(by_plane, tangent, Quadratic.of(tangent, at))

    def put(self, rows: NDArray[np.intp], values: "Seen") -> None:
        """Write those of some of the spots."""
        self.by_plane[rows] = values.by_plane
        self.tangents.put(rows, values.tangents)
        self.quadratic.put(rows, values.quadratic)


class RigDerivatives:
    """What of the derivatives is the same for all spots of a rig."""

    def __init__(self, rig: Rig, setup: eq.Setup) -> None:
        beam = rig.require_beam()
        self.rig = rig
        self.images = Images.of(setup)
        self._beam = BeamImages.of(setup, beam.offset, beam.direction)
        self.free = free_parameters(rig)
        self._camera = bool(np.any(self.free[: len(CAMERA)]))
        l_x, l_y, _ = beam.direction
        # (Q e)_z is the direction times the offset.
        shift: dict[str, float] = dict(zip(BEAM, (l_x, l_y, 0.0, *beam.offset), strict=True))
        self._axial_shift = np.array([shift.get(name, 0.0) for name in PARAMETERS]) @ self.free
        self._places = [PARAMETERS.index(name) for name in BEAM]
        self._seen = [PARAMETERS.index(name) for name in SEEN]

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of free parameters, and of `SEEN`."""
        return self.free.shape[1], len(SEEN)

    def effect(
        self,
        planes: Array,
        origin: Array,
        seen: Seen,
        sight: Sight,
        scale: Array,
        square: NDArray[np.intp],
        others: NDArray[np.intp],
    ) -> RigEffect:
        """Differentiate M maximum-likelihood planes.

        Parameters
        ----------
        planes : (M, 3)
            In the equations' sense.
        origin : (M, 2)
            Of the points' coordinates.
        seen : Seen
        sight : Sight
        scale : (M,)
            What the noise has to be multiplied by.
        square, others : (K,) of int
            Rows where the squares of the points' information are far from rounding, and where they need not be; those
            in neither are NaN.
        """
        by_beam = self._beam.derivatives(planes, _trace(planes, self.images), origin)
        camera = camera_columns(self.rig, seen.tangents, sight) if self._camera else None
        n, n_seen = self.sizes
        shapes = (3, n), (2,), (2, n), (2, n_seen)
        made = RigEffect(*(np.full((len(planes), *shape), np.nan) for shape in shapes))
        if len(square):
            _put(made, square, self._by_sums(seen, by_beam, camera, scale, square))
        if len(others):
            _put(made, others, self._by_points(seen, by_beam, camera, scale, others))
        return made

    def _by_sums(
        self, seen: Seen, by_beam: Array, camera: Array | None, scale: Array, rows: NDArray[np.intp]
    ) -> RigEffect:
        """From sums over the points: Cholesky's factor of the information is the triangle of the points' rows."""
        sums = seen.tangents.sums()[:, :, :6]
        by_all = np.zeros((len(sums), 5, len(PARAMETERS)))
        by_all[:, :, self._places] = SPAN.T @ (sums @ by_beam)
        if camera is not None:
            by_all[:, :, : len(CAMERA)] = SPAN.T @ products(seen.tangents.weighted[:6], camera)
        triangle = np.asarray(np.linalg.cholesky(seen.quadratic.information[rows]), dtype=float)
        right = np.concatenate([by_all[rows], seen.quadratic.score[rows, :, None]], axis=2)
        inside = np.swapaxes(triangle, 1, 2) @ seen.by_plane[rows]
        return self._solved(inside, lower_solved(triangle, right), scale[rows])

    def _by_points(
        self, seen: Seen, by_beam: Array, camera: Array | None, scale: Array, rows: NDArray[np.intp]
    ) -> RigEffect:
        """By QR of the points' rows: short arcs hardly tell the coefficients of an ellipse apart."""
        root = np.sqrt(seen.tangents.weight[rows])
        monomials = np.moveaxis(seen.tangents.monomials[:, rows] * root, 0, 2)
        by_all = np.zeros((*root.shape, len(PARAMETERS)))
        by_all[:, :, self._places] = monomials @ by_beam[rows]
        if camera is not None:
            by_all[:, :, : len(CAMERA)] = np.moveaxis(camera[:, rows] * root, 0, 2)
        distance = seen.tangents.left[rows] * root
        basis, triangle = np.linalg.qr(monomials @ SPAN)
        right = np.swapaxes(basis, 1, 2) @ np.concatenate([by_all, distance[..., None]], axis=2)
        return self._solved(triangle @ seen.by_plane[rows], right, scale[rows])

    def _solved(self, inside: Array, right: Array, scale: Array) -> RigEffect:
        """From derivatives in an orthonormal basis of what ellipses can change: by plane (M, 5, 3), by all and d."""
        turned, triangle = np.linalg.qr(inside, mode="complete")
        rotated = np.swapaxes(turned, 1, 2) @ right
        plane_by_rig = -upper_solved(triangle[:, :3], rotated[:, :3, :-1] @ self.free)
        plane_by_rig[:, 0] -= self._axial_shift
        left_over = rotated[:, 3:] / scale[:, None, None]
        by_all = left_over[..., :-1]
        return RigEffect(plane_by_rig, left_over[..., -1], by_all @ self.free, by_all[..., self._seen])


def camera_columns(rig: Rig, seen: Tangents, sight: Sight) -> Array:
    """Derivatives (9, M, N) by `CAMERA` of the points' distances, times ``sqrt(grad F' V grad F)``."""
    camera = rig.camera
    gx, gy = seen.gradient
    xu, xv, yu, yv = sight.by_pixel
    made = np.empty((len(CAMERA), *gx.shape))
    by_fx, by_fy, by_cx, by_cy, by_k1, by_k2, by_p1, by_p2, by_k3 = (made[i, :, :] for i in range(len(CAMERA)))
    part = gy * yu
    np.multiply(gx, xu, out=by_cx)
    by_cx += part
    np.multiply(gy, yv, out=part)
    np.multiply(gx, xv, out=by_cy)
    by_cy += part
    np.negative(made[2:4], out=made[2:4])
    np.multiply(by_cx, sight.xd, out=by_fx)
    np.multiply(by_cy, sight.yd, out=by_fy)
    x, y = sight.x, sight.y
    u, v = by_cx * camera.fx, by_cy * camera.fy
    along = u * x
    np.multiply(v, y, out=part)
    along += part
    r2 = x * x
    np.multiply(y, y, out=part)
    r2 += part
    np.multiply(along, r2, out=by_k1)
    np.multiply(by_k1, r2, out=by_k2)
    np.multiply(by_k2, r2, out=by_k3)
    # 2 x y u + (r^2 + 2 y^2) v is twice y times what is along, and r^2 v.
    along *= 2
    for coordinate, way, to in ((y, v, by_p1), (x, u, by_p2)):
        np.multiply(along, coordinate, out=to)
        np.multiply(way, r2, out=part)
        to += part
    return made


def _trace(planes: Array, images: Images) -> Array:
    """What the ellipses' coefficients were divided by, (M,)."""
    v = np.ones((len(planes), 4))
    v[:, 1:] = planes
    return np.einsum("mi,ij,mj->m", v, images.forms[0] + images.forms[2], v)


def _put(into: RigEffect, rows: NDArray[np.intp], values: RigEffect) -> None:
    into.plane_by_rig[rows], into.misfit[rows] = values.plane_by_rig, values.misfit
    into.misfit_by_rig[rows], into.misfit_by_beam[rows] = values.misfit_by_rig, values.misfit_by_beam
