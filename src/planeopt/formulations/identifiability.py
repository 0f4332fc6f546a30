"""Counts and ranks before a solve: what the ten equations really fix, and which of them repeat the others."""

from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.formulations.base import Start
from planeopt.formulations.bounds import pose_scale, unit_size
from planeopt.formulations.problem import Problem
from planeopt.ranks import independent_rows
from planeopt.solution import Identifiability

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-9
"""Relative to the largest singular value of rows and columns scaled to order 1: far above rounding, far below data."""


DEFICIENT = 1e-12
"""Of the independent system, whitened by the covariance of B, whose condition number itself can reach 1e10."""


def identify(problem: Problem, start: Start) -> Identifiability:
    """Ranks of the ten equations at the start, moved onto the laser constraint, and what the independent ones fix.

    Parameters
    ----------
    problem : Problem
    start : Start
        Where the Jacobians are evaluated; any feasible plane shows the same ranks.
    """
    z_L, p, q = start.plane
    r = problem.setup.r
    alpha = np.arctan(np.hypot(p, q))
    paper = np.array([r / np.cos(alpha), z_L, alpha, start.beta])
    slopes = np.array([eq.long_axis(np, p, q, r), z_L, p, q])
    columns = pose_scale(r, z_L)
    row_scale = np.array([unit_size(e.unit, r) for e in eq.LASER_BLOCK] + list(problem.natural_B))
    ten = np.asarray(ten_jacobian()(paper, np.concatenate([problem.setup, problem.B]))) * columns / row_scale[:, None]
    laser, image = ten[:5], ten[5:]
    independent = np.asarray(independent_jacobian()(slopes, np.concatenate([problem.setup, problem.B]))) * columns
    independent[0] /= r**2
    # Whitened by the covariance of B, the image rows are comparable with each other; the largest sets the unit.
    independent[1:] = np.linalg.solve(problem.B_factor, independent[1:])
    independent[1:] /= max(float(np.linalg.norm(independent[1:])), np.finfo(float).tiny)
    values, right = np.linalg.svd(independent)[1:]
    deficient = values[-1] <= DEFICIENT * values[0]
    return Identifiability(
        len(eq.TEN),
        4,
        _rank(ten),
        _rank(laser),
        _rank(image),
        tuple(float(value) for value in values),
        _dependent(laser),
        _in_words(right[-1] * columns) if deficient else None,
    )


def _rank(matrix: Array) -> int:
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(values > RANK_TOLERANCE * values[0])) if values[0] > 0 else 0


def _dependent(laser: Array) -> tuple[str, ...]:
    """Rows of the laser block that repeat one before them; rows that hardly change there (sin 2 beta = 0) come last."""
    length = np.linalg.norm(laser, axis=1)
    order = np.argsort(length < 0.1 * length.max(), kind="stable")
    # A row that vanishes there but for rounding has no direction of its own.
    laser = np.where(length[:, None] > RANK_TOLERANCE * length.max(), laser, 0.0)
    kept: list[int] = []
    for i in order:
        if len(independent_rows(laser[[*kept, i]], RANK_TOLERANCE)) > len(kept):
            kept.append(int(i))
    return tuple(f"({e.number})" for i, e in enumerate(eq.LASER_BLOCK) if i not in kept)


def _in_words(direction: Array) -> str:
    direction = direction / np.max(np.abs(direction))
    parts = [
        f"{value:+.3g} {name}"
        for name, value in zip(("R", "z_L", "p", "q"), direction, strict=True)
        if abs(value) > 1e-3
    ]
    return f"moving along {', '.join(parts)} (mm, mm, 1, 1) changes no equation"


@cache
def ten_jacobian() -> ca.Function:
    """``((R, z_L, alpha, beta), (setup, B)) -> (10, 4)``."""
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p", 9)
    rows = eq.ten_residuals(
        ca, eq.PaperVariables(*ca.vertsplit(x)), eq.Setup(*ca.vertsplit(p[:4])), ca.vertsplit(p[4:])
    )
    return ca.Function("ten", [x, p], [ca.densify(ca.jacobian(ca.vertcat(*rows), x))])


@cache
def independent_jacobian() -> ca.Function:
    """``((R, z_L, p, q), (setup, B)) -> (6, 4)``: the laser constraint, then the image block."""
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p", 9)
    v, k = eq.SlopeVariables(*ca.vertsplit(x)), eq.Setup(*ca.vertsplit(p[:4]))
    rows = [eq.laser_constraint_in_slopes(ca, v, k), *eq.image_residuals_in_slopes(ca, v, k, ca.vertsplit(p[4:]))]
    return ca.Function("independent", [x, p], [ca.densify(ca.jacobian(ca.vertcat(*rows), x))])
