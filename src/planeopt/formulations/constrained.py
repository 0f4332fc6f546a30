"""The true constrained programme: weighted slack on (17)-(21), (11)-(15) hard in their independent form."""

from dataclasses import dataclass
from functools import cache
from typing import get_args

import casadi as ca
import numpy as np

from planeopt import equations as eq
from planeopt.formulations.base import Start
from planeopt.formulations.bounds import Variables, check_choice, pose_bounds, pose_scale
from planeopt.formulations.problem import Problem
from planeopt.nlp import Model, Nlp, Row

# A coefficient of B can vanish by symmetry, and 1/B_i^2 would then be no mild weight at all: this much of the size that
# the coefficient has for an ellipse of this kind is added.
_MILD_SHARE = 0.05


@dataclass(frozen=True)
class Constrained:
    """min 1/2 s's  s.t.  b_i/b_0 - B_i = (S s)_i,  the spot on the beam,  the spot in front,  its lit side visible.

    ``S S' = Sigma_B``, so that twice the objective at the solution is chi-squared with 2 degrees of freedom when the
    rig is right. From a cold start a mild weight ``1/B_i^2`` comes first: with ``Sigma_B`` at once (its condition
    number reaches 1e10) most cold starts end in local minima.

    Parameters
    ----------
    variables : {"slopes", "paper"}
        ``(R, z_L, p, q)``, regular at ``alpha = 0``, or the paper's ``(R, z_L, alpha, beta)``.
    """

    variables: Variables = "slopes"

    def __post_init__(self) -> None:
        check_choice("variables", self.variables, get_args(Variables))

    @property
    def name(self) -> str:
        return "Constrained" if self.variables == "slopes" else "Constrained(paper)"

    def build(self, problem: Problem, start: Start) -> Nlp:
        model = _model(self.variables)
        final = _parameters(problem, problem.B_factor)
        mild = _parameters(problem, np.diag(np.abs(problem.B) + _MILD_SHARE * problem.natural_B))
        lower, upper = pose_bounds(self.variables, problem.setup.r)
        x0 = start.in_slopes if self.variables == "slopes" else start.in_paper_variables
        free = np.full(5, np.inf)
        sigma_B = np.sqrt(np.sum(problem.B_factor**2, axis=1))
        r = problem.setup.r
        scale = pose_scale(r, start.plane[0])
        beam_scale = r**2 if self.variables == "slopes" else r
        return Nlp(
            model,
            (mild, final) if start.cold else (final,),
            np.concatenate([x0, np.zeros(5)]),
            np.concatenate([lower, -free]),
            np.concatenate([upper, free]),
            np.concatenate([scale, np.ones(5)]),
            np.concatenate([sigma_B, [beam_scale, beam_scale, r]]),
            problem.B_factor,
            np.asarray(np.linalg.solve(problem.B_factor, np.diag(sigma_B)), dtype=float),
        )


def _parameters(problem: Problem, factor: np.ndarray) -> np.ndarray:
    return np.concatenate([problem.setup, problem.B, factor.ravel(order="F")])


@cache
def _model(variables: Variables) -> Model:
    x, p = ca.SX.sym("x", 9), ca.SX.sym("p", 34)
    k = eq.Setup(*ca.vertsplit(p[:4]))
    B, factor, slack = ca.vertsplit(p[4:9]), ca.reshape(p[9:], 5, 5), x[4:]
    if variables == "slopes":
        v = eq.SlopeVariables(*ca.vertsplit(x[:4]))
        image, on_beam = eq.image_residuals_in_slopes(ca, v, k, B), eq.laser_constraint_in_slopes(ca, v, k) / k.r**2
        in_front, lit = eq.in_front_in_slopes(ca, v, k) / k.r**2, eq.lit_side_in_slopes(ca, v, k) / k.r
        visible = (eq.in_front_in_slopes, eq.lit_side_in_slopes)
        hard, plane = eq.laser_constraint_in_slopes, x[1:4]
    else:
        v = eq.PaperVariables(*ca.vertsplit(x[:4]))
        image, on_beam = eq.eq23(ca, v, k, B), eq.laser_constraint(ca, v, k) / k.r
        in_front, lit = eq.in_front(ca, v, k) / k.r, eq.lit_side(ca, v, k) / k.r
        visible = (eq.in_front, eq.lit_side)
        hard, plane = eq.laser_constraint, ca.vertcat(v.z_L, *eq.slopes(ca, v))
    scale = ca.sqrt(ca.sum2(factor**2))
    rows = (ca.vertcat(*image) - factor @ slack) / scale
    return Model(
        f"constrained_{variables}",
        (*v._fields, *(f"slack_{e.number}" for e in eq.IMAGE_BLOCK)),
        x,
        p,
        0.5 * ca.sumsqr(slack),
        ca.vertcat(rows, on_beam, in_front, lit),
        (*(Row(e) for e in eq.IMAGE_BLOCK), Row(hard), *(Row(e, equality=False) for e in visible)),
        plane,
        p[4:9],
    )
