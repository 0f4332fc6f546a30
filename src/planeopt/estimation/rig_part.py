"""First-order effect of the rig's own uncertainty on the plane: kept apart from the spot's, because frames share it."""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.formulations.problem import Problem
from planeopt.rig import BEAM_PARAMETERS, CAMERA_PARAMETERS, Rig, distort, rotation_to_axis

Array = NDArray[np.float64]

CAMERA = tuple(name for name in CAMERA_PARAMETERS if name != "f")
PARAMETERS = CAMERA + BEAM_PARAMETERS
"""Every number of a rig; ``f`` is fx and fy together."""

SEEN = ("e_x", "e_y", "direction_x", "direction_y")
"""Parameters of the beam through which the four numbers of a rig that images test can change, all others held fixed:
the beam's vanishing point, the direction of its offset, and the offset over the radius."""


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives at a solution; rows and columns as named.

    Attributes
    ----------
    residual_by_rig : (N, n)
        Whitened distances of the points from the plane's ellipse, by the free parameters of the rig's covariance, the
        raw pixels held fixed.
    plane_by_rig : (3, n)
        ``(z_L, p, q)`` with ``z_L`` along the beam.
    residual_by_beam : (N, 4)
        As ``residual_by_rig``, by `SEEN`, whether the covariance has them or not.
    """

    residual_by_rig: Array
    plane_by_rig: Array
    residual_by_beam: Array


def sensitivity(problem: Problem, rig: Rig, plane: Array) -> Sensitivity:
    """Differentiate the maximum-likelihood plane by the rig's free parameters.

    The plane minimises ``sum rho_i^2``; at small residuals ``d plane/d eta = -(J'J)^-1 J' d rho/d eta`` with ``J`` the
    derivative of the whitened distances by the plane. Every efficient formulation shares it to first order.

    Parameters
    ----------
    problem : Problem
        Made from a spot, so that pixels, points and noise are there.
    rig : Rig
        Without a covariance it has no free parameters: n is 0.
    plane : (3,)
        ``(z_L, p, q)`` in the equations' sense (``z_L`` the spot centre's z in the laser-parallel frame).

    Raises
    ------
    ValueError
        If the problem has no pixels.
    """
    if problem.pixels is None or problem.noise is None:
        raise ValueError("the rig's part needs boundary points in pixels")
    normalised = np.asarray(rig.camera.normalise(problem.pixels)[0])
    by_plane, by_all = point_derivatives(rig, normalised, problem.noise, np.broadcast_to(plane, (len(normalised), 3)))
    by_rig = by_all @ free_parameters(rig)
    step = -np.asarray(np.linalg.lstsq(by_plane, by_rig, rcond=None)[0], dtype=float)
    along_beam = step.copy()
    along_beam[0] -= axial_shift_by_rig(rig)
    return Sensitivity(by_rig, along_beam, by_all @ _choice(SEEN))


def point_derivatives(rig: Rig, normalised: Array, noise: Array, planes: Array) -> tuple[Array, Array]:
    """Derivatives of points' whitened distances by their planes and by the rig, raw pixels held fixed.

    Parameters
    ----------
    rig : Rig
    normalised : (N, 2)
        The points' rays in the camera frame, from `Camera.normalise`.
    noise : (N, 2, 2)
        Their covariances on the laser-parallel image plane, mm^2.
    planes : (N, 3)
        ``(z_L, p, q)`` in the equations' sense: each point's own.

    Returns
    -------
    by_plane : (N, 3)
    by_rig : (N, 14)
        By `PARAMETERS`.
    """
    n = len(normalised)
    nominal = np.array([rig.parameter(name) for name in PARAMETERS])
    covariances = np.stack([noise[:, 0, 0], noise[:, 0, 1], noise[:, 1, 1]])
    rows = np.asarray(_point_rows().map(n)(normalised.T, covariances, nominal, planes.T, rig.focal_length))
    derivative = rows.reshape(3 + len(PARAMETERS), n, order="F").T
    return derivative[:, :3], derivative[:, 3:]


def axial_shift_by_rig(rig: Rig) -> Array:
    """Derivative (n,) of ``(Q e)_z`` by the free parameters of the rig's covariance."""
    nominal = np.array([rig.parameter(name) for name in PARAMETERS])
    by_all = np.asarray(_outputs()(np.zeros(3), nominal)[0])
    return (by_all @ free_parameters(rig))[0]


def free_parameters(rig: Rig) -> Array:
    """Matrix (14, n) that spreads the free parameters of the rig's covariance over `PARAMETERS`."""
    return _choice(() if rig.covariance is None else rig.covariance.parameters)


def normal_by_rig(rig: Rig, plane: Array, plane_by_rig: Array) -> Array:
    """Derivative (3, n) of the unit normal in the camera frame, given that (3, n) of the plane ``(z_L, p, q)``."""
    nominal = np.array([rig.parameter(name) for name in PARAMETERS])
    _, by_plane, by_rig = (np.asarray(m) for m in _outputs()(plane, nominal))
    return by_plane @ plane_by_rig + by_rig @ free_parameters(rig)


def _choice(names: tuple[str, ...]) -> Array:
    """Matrix (14, n) that spreads the free parameters over all of them; ``f`` moves fx and fy together."""
    choice = np.zeros((len(PARAMETERS), len(names)))
    for column, name in enumerate(names):
        for target in ("fx", "fy") if name == "f" else (name,):
            choice[PARAMETERS.index(target), column] = 1.0
    return choice


def _laser_frame(eta: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation Q (3, 3) and turned offset Q e (3,) as functions of the rig's parameters."""
    e_x, e_y, _, l_x, l_y = ca.vertsplit(eta[len(CAMERA) :])
    rows = rotation_to_axis(l_x, l_y, ca.sqrt(1 - l_x**2 - l_y**2))
    turn = ca.vertcat(*(ca.horzcat(*row) for row in rows))
    return turn, turn @ ca.vertcat(e_x, e_y, 0)


@cache
def _point_rows() -> ca.Function:
    """Derivatives of one point's whitened distance by plane and rig, its raw pixel held fixed.

    ``rho = F/|grad F|`` is the Sampson distance from the plane's ellipse. The pixel depends on the normalised point
    ``x`` and the rig, so ``dx/d eta = -(d pixel/dx)^-1 d pixel/d eta``.
    """
    x, noise, eta, plane, f = (
        ca.SX.sym("x", 2),
        ca.SX.sym("noise", 3),
        ca.SX.sym("eta", len(PARAMETERS)),
        ca.SX.sym("plane", 3),
        ca.SX.sym("f"),
    )
    fx, fy, cx, cy, *distortion = ca.vertsplit(eta[: len(CAMERA)])
    distorted = distort(x[0], x[1], *distortion)
    pixel = ca.vertcat(fx * distorted[0] + cx, fy * distorted[1] + cy)
    turn, offset = _laser_frame(eta)
    image = eq.image_point(ca, eq.Setup(f, None, None, None), *ca.vertsplit(turn @ ca.vertcat(x, 1)))
    setup = eq.Setup(f, offset[0], offset[1], eta[PARAMETERS.index("radius")])
    b = eq.image_conic_in_slopes(ca, eq.SlopeVariables(None, *ca.vertsplit(plane)), setup)
    B = [b_i / b[0] for b_i in b[1:]]
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    value = eq.eq16(ca, B, u, v)
    g_u, g_v = ca.gradient(value, u), ca.gradient(value, v)
    height = ca.sqrt(noise[0] * g_u**2 + 2 * noise[1] * g_u * g_v + noise[2] * g_v**2)
    rho = ca.substitute(value / height, ca.vertcat(u, v), ca.vertcat(*image))
    moved = -ca.solve(ca.jacobian(pixel, x), ca.jacobian(pixel, eta))
    row = ca.horzcat(ca.jacobian(rho, plane), ca.jacobian(rho, eta) + ca.jacobian(rho, x) @ moved)
    return ca.Function("point_rows", [x, noise, eta, plane, f], [ca.densify(row).T])


@cache
def _outputs() -> ca.Function:
    """``(plane, eta) -> d (Q e)_z / d eta, d normal / d plane, d normal / d eta``; normal in the camera frame."""
    plane, eta = ca.SX.sym("plane", 3), ca.SX.sym("eta", len(PARAMETERS))
    turn, offset = _laser_frame(eta)
    upward = ca.vertcat(-plane[1], -plane[2], 1)
    normal = turn.T @ (upward / ca.norm_2(upward))
    return ca.Function(
        "outputs",
        [plane, eta],
        [
            ca.densify(ca.jacobian(offset[2], eta)),
            ca.densify(ca.jacobian(normal, plane)),
            ca.densify(ca.jacobian(normal, eta)),
        ],
    )
