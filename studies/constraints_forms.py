"""Programmes that the library has no formulation for: chosen laser or image rows as hard constraints."""

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.formulations import Problem, Start
from planeopt.formulations.bounds import VISIBLE, pose_bounds, pose_scale, unit_size
from planeopt.nlp import Model, Nlp, Row

Array = NDArray[np.float64]
Rows = tuple[int, ...]
Image = Literal["slack", "objective"]

LASER_FORMS = (*eq.LASER_BLOCK, eq.laser_constraint)
"""(11)-(15), and their independent form."""


@dataclass(frozen=True)
class HardLaserRows:
    """min 1/2 |S^-1 (b/b_0 - B)|^2, ``S S' = Sigma_B``, s.t. chosen rows of (11)-(15) and the visibility inequalities.

    Parameters
    ----------
    rows : tuple of int
        Indices into `LASER_FORMS`.
    image : {"slack", "objective"}
        The image block with five slack unknowns and equality rows, as `Constrained` has it, or as the objective of four
        unknowns.
    """

    rows: Rows
    image: Image = "slack"

    @property
    def name(self) -> str:
        numbers = (f"({e.number})" if e in eq.LASER_BLOCK else "R cos(alpha) = r" for e in self._equations)
        return " ".join(numbers)

    @property
    def _equations(self) -> list[eq.Equation]:
        return [LASER_FORMS[i] for i in self.rows]

    def build(self, problem: Problem, start: Start) -> Nlp:
        r = problem.setup.r
        slack = 5 if self.image == "slack" else 0
        lower, upper = pose_bounds("paper", r)
        free, scale = np.full(slack, np.inf), pose_scale(r, start.plane[0])
        matrix = problem.B_factor if slack else np.linalg.inv(problem.B_factor)
        sigma = np.sqrt(np.sum(problem.B_factor**2, axis=1))
        sizes = [unit_size(e.unit, r) for e in self._equations]
        return Nlp(
            laser_model(self.rows, self.image),
            (np.concatenate([problem.setup, problem.B, matrix.ravel(order="F")]),),
            np.concatenate([start.in_paper_variables, np.zeros(slack)]),
            np.concatenate([lower, -free]),
            np.concatenate([upper, free]),
            np.concatenate([scale, np.ones(slack)]),
            np.concatenate([sigma[:slack], sizes, [r, r]]),
            problem.B_factor,
        )


@dataclass(frozen=True)
class HardImageRows:
    """``R^2 = r^2 (1 + p^2 + q^2)`` and three of (17)-(21) hard, the other two left out; in slopes.

    Parameters
    ----------
    rows : tuple of int
        Indices into `planeopt.equations.IMAGE_BLOCK`.
    """

    rows: Rows

    @property
    def name(self) -> str:
        return " ".join(f"({eq.IMAGE_BLOCK[i].number})" for i in self.rows)

    def build(self, problem: Problem, start: Start) -> Nlp:
        r = problem.setup.r
        lower, upper = pose_bounds("slopes", r)
        sigma = np.sqrt(np.sum(problem.B_factor**2, axis=1))
        return Nlp(
            image_model(self.rows),
            (np.concatenate([problem.setup, problem.B, sigma]),),
            start.in_slopes,
            lower,
            upper,
            pose_scale(r, start.plane[0]),
            np.concatenate([sigma[list(self.rows)], [r**2, r**2, r]]),
            problem.B_factor,
        )


def _data(rest: int) -> tuple[ca.SX, eq.Setup, list[Any], ca.SX]:
    p = ca.SX.sym("p", 9 + rest)
    return p, eq.Setup(*ca.vertsplit(p[:4])), ca.vertsplit(p[4:9]), p[9:]


@cache
def laser_model(rows: Rows, image: Image) -> Model:
    """The programme of `HardLaserRows` in symbols."""
    p, k, B, rest = _data(25)
    slack = 5 if image == "slack" else 0
    x, matrix = ca.SX.sym("x", 4 + slack), ca.reshape(rest, 5, 5)
    v = eq.PaperVariables(*ca.vertsplit(x[:4]))
    misfit = ca.vertcat(*eq.eq23(ca, v, k, B))
    laser = [LASER_FORMS[i] for i in rows]
    hard = [e(ca, v, k) / unit_size(e.unit, k.r) for e in laser]
    seen = [e(ca, v, k) / k.r for e in VISIBLE]
    if image == "slack":
        equal = [(misfit - matrix @ x[4:]) / ca.sqrt(ca.sum2(matrix**2)), *hard]
        objective, first = 0.5 * ca.sumsqr(x[4:]), tuple(Row(e) for e in eq.IMAGE_BLOCK)
    else:
        equal, objective, first = hard, 0.5 * ca.sumsqr(matrix @ misfit), ()
    return Model(
        f"hard_laser_{image}_{'_'.join(e.number for e in laser)}",
        (*v._fields, *(f"slack_{e.number}" for e in eq.IMAGE_BLOCK[:slack])),
        x,
        p,
        objective,
        ca.vertcat(*equal, *seen),
        (*first, *(Row(e) for e in laser), *(Row(e, equality=False) for e in VISIBLE)),
        ca.vertcat(v.z_L, *eq.slopes(ca, v)),
        p[4:9],
    )


@cache
def image_model(rows: Rows) -> Model:
    """The programme of `HardImageRows` in symbols."""
    p, k, B, sigma = _data(5)
    x = ca.SX.sym("x", 4)
    v = eq.SlopeVariables(*ca.vertsplit(x))
    misfit = eq.image_residuals_in_slopes(ca, v, k, B)
    visible = (eq.in_front_in_slopes, eq.lit_side_in_slopes)
    return Model(
        f"hard_image_{'_'.join(eq.IMAGE_BLOCK[i].number for i in rows)}",
        v._fields,
        x,
        p,
        ca.SX(0),
        ca.vertcat(
            *(misfit[i] / sigma[i] for i in rows),
            eq.laser_constraint_in_slopes(ca, v, k) / k.r**2,
            eq.in_front_in_slopes(ca, v, k) / k.r**2,
            eq.lit_side_in_slopes(ca, v, k) / k.r,
        ),
        (
            *(Row(eq.IMAGE_BLOCK[i]) for i in rows),
            Row(eq.laser_constraint_in_slopes),
            *(Row(e, equality=False) for e in visible),
        ),
        x[1:4],
        p[4:9],
    )
