"""Errors in variables: every boundary point has its own angle on the spot, distances are orthogonal."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.formulations.base import Refusal, Start
from planeopt.formulations.bounds import less_steep, nearer
from planeopt.formulations.problem import Problem
from planeopt.nlp import Model, Nlp, Row
from planeopt.solution import Status

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reprojection:
    """min 1/2 sum |L_i' (x_i - x(phi_i; z_L, p, q))|^2: the maximum-likelihood answer for Gaussian noise.

    ``L_i L_i'`` is the inverse of point i's covariance and ``x(phi)`` is (5) of (3). The laser block holds by
    construction, since the spot is written by the angle ``phi`` round the beam.
    """

    @property
    def name(self) -> str:
        return "Reprojection"

    def build(self, problem: Problem, start: Start) -> Nlp | Refusal:
        if problem.points is None or problem.noise is None:
            return Refusal(
                Status.UNIDENTIFIABLE, "Reprojection needs the boundary points; only the ellipse (16) was given."
            )
        n, k = problem.n_points, problem.setup
        roots = np.linalg.cholesky(problem.noise)
        whitening = np.asarray(np.linalg.inv(roots), dtype=float)
        triangle = np.stack([whitening[:, 0, 0], whitening[:, 1, 0], whitening[:, 1, 1]])
        centre = np.concatenate([start.plane, _angles(problem.points, eq.SlopeVariables(start.R, *start.plane), k)])
        plane_unit, angle_unit = _units(problem, whitening, centre)
        parameters = [
            k,
            problem.points.ravel(),
            triangle.ravel(order="F"),
            centre,
            plane_unit.ravel(order="F"),
            angle_unit,
        ]
        free = np.full(3 + n, np.inf)
        return Nlp(
            _model(n),
            (np.concatenate(parameters),),
            np.zeros(3 + n),
            -free,
            free,
            np.ones(3 + n),
            np.array([k.r, k.r**2, k.r, 1.0, 1.0]),
            scipy.sparse.csr_array(scipy.sparse.block_diag(list(roots))),
        )


def _angles(points: Array, v: eq.SlopeVariables, k: eq.Setup) -> Array:
    """Angle round the beam where each point's ray meets the plane: the nearest angle on the spot, nearly."""
    w = eq.lit_side_in_slopes(np, v, k)
    distance = w / (k.f - points @ np.array([v.p, v.q]))
    return np.arctan2(distance * points[:, 1] - k.e_y, distance * points[:, 0] - k.e_x)


def _units(problem: Problem, whitening: Array, centre: Array) -> tuple[Array, Array]:
    """Standard deviations at the start as units of the unknowns: a factor (3, 3) of the plane's covariance, and (n,).

    Without them IPOPT loses one case in six at tight tolerances: depth in mm and angles on a small spot differ by
    orders.
    """
    images = np.asarray(_image_derivatives().map(problem.n_points)(centre[None, 3:], centre[:3], problem.setup))
    by_unknown = whitening @ images.reshape(2, 4, problem.n_points, order="F").transpose(2, 0, 1)
    by_plane, by_angle = by_unknown[:, :, :3], by_unknown[:, :, 3]
    speed = np.linalg.norm(by_angle, axis=1)
    tangent = by_angle / speed[:, None]
    across = by_plane - tangent[:, :, None] * np.einsum("ni,nij->nj", tangent, by_plane)[:, None, :]
    size = np.linalg.norm(across.reshape(-1, 3), axis=0)
    triangle = np.linalg.qr(across.reshape(-1, 3) / size, mode="r")
    return np.linalg.inv(triangle) / size[:, None], 1 / speed


def _spot_image(m: eq.Namespace, plane: Sequence[Any], phi: Any, k: eq.Setup) -> tuple[Any, Any]:
    """(5) of (3): the image of the spot's point at angle ``phi`` round the beam."""
    return eq.image_point(m, k, *eq.spot_point_in_slopes(m, eq.SlopeVariables(None, *plane), k, phi))


@cache
def _image_derivatives() -> ca.Function:
    """Derivative (2, 4) of `_spot_image` by ``(z_L, p, q, phi)``."""
    phi, plane, setup = ca.SX.sym("phi"), ca.SX.sym("plane", 3), ca.SX.sym("setup", 4)
    image = ca.vertcat(*_spot_image(ca, ca.vertsplit(plane), phi, eq.Setup(*ca.vertsplit(setup))))
    return ca.Function(
        "image_derivatives", [phi, plane, setup], [ca.densify(ca.jacobian(image, ca.vertcat(plane, phi)))]
    )


@lru_cache(maxsize=16)
def _model(n: int) -> Model:
    """Programme for ``n`` points; the map keeps the symbols as small as one point's."""
    plane, phi = ca.SX.sym("plane", 3), ca.SX.sym("phi")
    setup, point, triangle = ca.SX.sym("setup", 4), ca.SX.sym("point", 2), ca.SX.sym("triangle", 3)
    image = _spot_image(ca, ca.vertsplit(plane), phi, eq.Setup(*ca.vertsplit(setup)))
    dx, dy = point[0] - image[0], point[1] - image[1]
    whitened = ca.vertcat(triangle[0] * dx, triangle[1] * dx + triangle[2] * dy)
    distance = ca.Function("distance", [plane, phi, setup, point, triangle], [whitened])

    # The unknowns are whitened: the pose and the angles are their values at the start plus so many standard deviations.
    x = ca.MX.sym("x", 3 + n)
    setup, points, triangles, centre, plane_unit, angle_unit = (
        ca.MX.sym(name, rows, columns)
        for name, rows, columns in (
            ("setup", 4, 1),
            ("points", 2, n),
            ("triangles", 3, n),
            ("centre", 3 + n, 1),
            ("plane_unit", 3, 3),
            ("angle_unit", n, 1),
        )
    )
    p = ca.veccat(setup, points, triangles, centre, plane_unit, angle_unit)
    # The pose comes last: eliminated first, its three full columns would fill the KKT matrix.
    pose, angles = centre[:3] + plane_unit @ x[n:], centre[3:] + angle_unit * x[:n]
    residuals = distance.map(n)(pose, angles.T, setup, points, triangles)
    k, v = eq.Setup(*ca.vertsplit(setup)), eq.SlopeVariables(None, *ca.vertsplit(pose))
    # The unknowns mix depth and slopes: what bounds them in other formulations is a row here.
    limits = (eq.before_camera, eq.in_front_in_slopes, eq.lit_side_in_slopes, nearer, less_steep)
    rows = [e(ca, v, k) / scale for e, scale in zip(limits, (k.r, k.r**2, k.r, 1, 1), strict=True)]
    return Model(
        f"reprojection_{n}",
        (*(f"phi_{i}" for i in range(n)), "z_L", "p", "q"),
        x,
        p,
        0.5 * ca.sumsqr(residuals),
        ca.vertcat(*rows),
        tuple(Row(e, equality=False) for e in limits),
        pose,
        points,
    )
