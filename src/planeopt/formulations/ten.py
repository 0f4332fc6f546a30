"""Formulations of all ten equations in the paper's variables: least squares, the penalty function, as printed."""

from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

import casadi as ca
import numpy as np

from planeopt import equations as eq
from planeopt.formulations.base import Refusal, Start
from planeopt.formulations.bounds import VISIBLE, check_choice, pose_bounds, pose_scale
from planeopt.formulations.identifiability import identify
from planeopt.formulations.problem import Problem
from planeopt.nlp import Model, Nlp, Row
from planeopt.solution import Status

Reading = Literal["printed", "image objective"]


@dataclass(frozen=True)
class LeastSquares:
    """min 1/2 sum of all ten residuals squared, unweighted, in their mixed units: what (29) means at a fixed weight.

    The answer depends on the unit of length, since (15) and (21) are in mm^2 and weigh accordingly.
    """

    @property
    def name(self) -> str:
        return "LeastSquares"

    def build(self, problem: Problem, start: Start) -> Nlp:
        return _nlp(_least_squares(), problem, start)


@dataclass(frozen=True)
class Penalty:
    """(29), for a solver that raises the weight: `planeopt.solvers.Swift`.

    Parameters
    ----------
    reading : {"printed", "image objective"}
        As printed, J = 0 and all ten are penalised: one common weight never moves the minimiser, it only tightens the
        tolerance. With the image block as the objective and the laser block penalised, the weight has work to do.
    """

    reading: Reading = "printed"

    def __post_init__(self) -> None:
        check_choice("reading", self.reading, get_args(Reading))

    @property
    def name(self) -> str:
        return "Penalty" if self.reading == "printed" else "Penalty(image objective)"

    def build(self, problem: Problem, start: Start) -> Nlp:
        return _nlp(_penalty(self.reading), problem, start)


@dataclass(frozen=True)
class AsPrinted:
    """The ten as hard equalities: refused before a solver sees it, with counts, rank and the dependent rows."""

    @property
    def name(self) -> str:
        return "AsPrinted"

    def build(self, problem: Problem, start: Start) -> Refusal:
        evidence = identify(problem, start)
        return Refusal(
            Status.OVERDETERMINED,
            f"{evidence.sentence}. IPOPT answers Not_Enough_Degrees_Of_Freedom; use Constrained, which puts slack on "
            "(17)-(21) and keeps one independent form of (11)-(15).",
        )


def _nlp(model: Model, problem: Problem, start: Start) -> Nlp:
    r = problem.setup.r
    lower, upper = pose_bounds("paper", r)
    return Nlp(
        model,
        (np.concatenate([problem.setup, problem.B]),),
        start.in_paper_variables,
        lower,
        upper,
        pose_scale(r, start.plane[0]),
        np.array([1.0 if row.equality else r for row in model.rows]),
        problem.B_factor,
    )


def _symbols() -> tuple[ca.SX, ca.SX, eq.PaperVariables, eq.Setup, list[ca.SX]]:
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p", 9)
    return x, p, eq.PaperVariables(*ca.vertsplit(x)), eq.Setup(*ca.vertsplit(p[:4])), ca.vertsplit(p[4:])


def _model(name: str, x: ca.SX, p: ca.SX, objective: ca.SX, equalities: list[tuple[eq.Equation, ca.SX]]) -> Model:
    """Put the two visibility rows, over the beam's radius, after the equalities, which keep the paper's units."""
    v, k = eq.PaperVariables(*ca.vertsplit(x)), eq.Setup(*ca.vertsplit(p[:4]))
    rows = [residual for _, residual in equalities] + [e(ca, v, k) / k.r for e in VISIBLE]
    return Model(
        name,
        eq.PaperVariables._fields,
        x,
        p,
        objective,
        ca.vertcat(*rows),
        (*(Row(e) for e, _ in equalities), *(Row(e, equality=False) for e in VISIBLE)),
        ca.vertcat(v.z_L, *eq.slopes(ca, v)),
        p[4:9],
    )


@cache
def _least_squares() -> Model:
    x, p, v, k, B = _symbols()
    return _model("least_squares", x, p, eq.eq29(ca, 0, eq.ten_residuals(ca, v, k, B), 0.5), [])


@cache
def _penalty(reading: Reading) -> Model:
    x, p, v, k, B = _symbols()
    laser = list(zip(eq.LASER_BLOCK, [e(ca, v, k) for e in eq.LASER_BLOCK], strict=True))
    image = list(zip(eq.IMAGE_BLOCK, eq.eq23(ca, v, k, B), strict=True))
    if reading == "printed":
        return _model("penalty", x, p, ca.SX(0), laser + image)
    return _model("penalty_image_objective", x, p, eq.eq29(ca, 0, [value for _, value in image], 1), laser)
