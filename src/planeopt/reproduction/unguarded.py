"""The programme that the ten equations suggest at first sight, without the inequalities that say what can be seen.

It exists to be watched: `planeopt.formulations.Constrained` is the one to use.
"""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from planeopt import equations as eq
from planeopt.formulations import Problem, Start
from planeopt.nlp import Model, Nlp, Row


@dataclass(frozen=True)
class Unguarded:
    """min factor * sum ((b_i/b_0 - B_i)/B_i)^2  s.t.  R^2 = r^2 (1 + p^2 + q^2), without bounds or inequalities.

    Its unknowns are searched as they are, mm beside slopes: scaling is another thing that a first attempt leaves out.

    Parameters
    ----------
    factor : float
        Of the objective. It moves no minimum; it only changes the steps of the search.
    """

    factor: float = 1.0

    @property
    def name(self) -> str:
        return "without inequalities" if self.factor == 1 else f"without inequalities, objective times {self.factor:g}"

    def build(self, problem: Problem, start: Start) -> Nlp:
        free = np.full(4, np.inf)
        return Nlp(
            _model(),
            (np.concatenate([problem.setup, problem.B, [self.factor]]),),
            start.in_slopes,
            -free,
            free,
            np.ones(4),
            np.array([problem.setup.r**2]),
            problem.B_factor,
        )


@cache
def _model() -> Model:
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p", 10)
    v, k, B = eq.SlopeVariables(*ca.vertsplit(x)), eq.Setup(*ca.vertsplit(p[:4])), ca.vertsplit(p[4:9])
    image = [value / b for value, b in zip(eq.image_residuals_in_slopes(ca, v, k, B), B, strict=True)]
    return Model(
        "unguarded",
        v._fields,
        x,
        p,
        eq.eq29(ca, 0, image, p[9]),
        eq.laser_constraint_in_slopes(ca, v, k) / k.r**2,
        (Row(eq.laser_constraint_in_slopes),),
        x[1:4],
        p[4:9],
    )
