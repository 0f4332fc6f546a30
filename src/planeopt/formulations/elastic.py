"""All ten equations with L1 slack: the answer leaves out what does not fit, and so names the equation at fault."""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.stats
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.formulations.base import Start
from planeopt.formulations.bounds import VISIBLE, pose_bounds, pose_scale, unit_size
from planeopt.formulations.identifiability import ten_jacobian
from planeopt.formulations.problem import Problem
from planeopt.formulations.snooping import detectability, image_misfit, space_left_by_plane
from planeopt.nlp import Model, Nlp, Row

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Elastic:
    """min sum (u_i + v_i)  s.t.  w_i h_i(x) = u_i - v_i,  u, v >= 0,  h the ten residuals.

    A sum of absolute values puts all of a gross error into as few slacks as it can. The weights of (17)-(21) are those
    of `detectability`: with them an error in any one of the five is cheapest explained by that one, which with weights
    of ``1/sigma_i`` it is not. The laser rows are data of the rig, not of the image: their weight is above the largest
    that the image rows could pull against, so that they give way only where they contradict each other.
    """

    @property
    def name(self) -> str:
        return "Elastic"

    def build(self, problem: Problem, start: Start) -> Nlp:
        r = problem.setup.r
        if not (start.cold or start.held):
            start = _best_without_one(problem, start)
        weights = _weights(problem, start)
        lower, upper = pose_bounds("paper", r)
        x0 = start.in_paper_variables
        residual = np.array(eq.ten_residuals(np, eq.PaperVariables(*x0), problem.setup, problem.B)) * weights
        scale = pose_scale(r, start.plane[0])
        return Nlp(
            _model(),
            (np.concatenate([problem.setup, problem.B, weights]),),
            np.concatenate([x0, np.maximum(residual, 0.0), np.maximum(-residual, 0.0)]),
            np.concatenate([lower, np.zeros(20)]),
            np.concatenate([upper, np.full(20, np.inf)]),
            np.concatenate([scale, np.ones(20)]),
            np.concatenate([1 / weights, [r, r]]),
            problem.B_factor,
        )


def _best_without_one(problem: Problem, start: Start) -> Start:
    """The start where it explains all five image equations, else the best plane of four of them.

    A gross error in one coefficient of B pulls the closed form far away. Which one to leave out is told by how well the
    other four agree.
    """
    plane = np.array(start.plane)
    statistic = space_left_by_plane(problem, plane) @ np.linalg.solve(problem.B_factor, image_misfit(problem, plane))
    if scipy.stats.chi2.sf(statistic @ statistic, len(statistic)) > GROSS:
        return start
    candidates = [_without(problem, plane, i) for i in range(5)]
    visible = [(cost, tuple(found)) for cost, found in candidates if _is_visible(problem, found)]
    if not visible:
        return start
    z_L, p, q = (float(value) for value in min(visible)[1])
    tangent = float(np.hypot(p, q))
    beta = float(np.arctan2(-p, q)) if tangent > 0 else start.beta
    return Start(float(eq.long_axis(np, p, q, problem.setup.r)), (z_L, p, q), beta)


GROSS = 1e-6
"""Misfit of the closed form that is less probable than this is an error, not noise."""


def _without(problem: Problem, plane: Array, left_out: int) -> tuple[float, Array]:
    """Least-squares plane of four of the image equations, whitened by their own covariance, and what it leaves."""
    rest = [i for i in range(5) if i != left_out]
    factor = np.asarray(np.linalg.qr(problem.B_factor[rest].T, mode="r")).T
    scale = np.array([abs(plane[0]), 1.0, 1.0])

    def residual(scaled: Array) -> Array:
        return scipy.linalg.solve_triangular(factor, image_misfit(problem, scaled * scale)[rest], lower=True)

    found = scipy.optimize.least_squares(residual, plane / scale, method="lm", max_nfev=200)
    return float(found.cost), found.x * scale


def _is_visible(problem: Problem, plane: Array) -> bool:
    v = eq.SlopeVariables(None, *plane)
    rows = (eq.before_camera, eq.in_front_in_slopes, eq.lit_side_in_slopes)
    return bool(np.isfinite(plane).all() and all(e(np, v, problem.setup) > 0 for e in rows))


def _weights(problem: Problem, start: Start) -> Array:
    """Weights of the ten slacks, in standard deviations per unit of each equation; see `Elastic`."""
    image = detectability(problem, np.array(start.plane))
    by_R = np.asarray(ten_jacobian()(start.in_paper_variables, np.concatenate([problem.setup, problem.B])))[5:, 0]
    r = problem.setup.r
    pull = 2 * r * float(np.sum(image * np.abs(by_R)))
    return np.concatenate([[pull / unit_size(e.unit, r) for e in eq.LASER_BLOCK], image])


@cache
def _model() -> Model:
    x, p = ca.SX.sym("x", 24), ca.SX.sym("p", 19)
    v, k, B = eq.PaperVariables(*ca.vertsplit(x[:4])), eq.Setup(*ca.vertsplit(p[:4])), ca.vertsplit(p[4:9])
    weights, above, below = p[9:19], x[4:14], x[14:24]
    ten = ca.vertcat(*eq.ten_residuals(ca, v, k, B)) * weights - above + below
    return Model(
        "elastic",
        (*v._fields, *(f"above_{e.number}" for e in eq.TEN), *(f"below_{e.number}" for e in eq.TEN)),
        x,
        p,
        ca.sum1(above + below),
        ca.vertcat(ten, *(e(ca, v, k) / k.r for e in VISIBLE)),
        (*(Row(e) for e in eq.TEN), *(Row(e, equality=False) for e in VISIBLE)),
        ca.vertcat(v.z_L, *eq.slopes(ca, v)),
        p[4:9],
    )
