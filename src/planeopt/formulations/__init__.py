"""Formulations of one problem: what is minimised, over which unknowns, under which equations."""

from planeopt.formulations.base import DirectAnswer, Formulation, Refusal, Start
from planeopt.formulations.constrained import Constrained
from planeopt.formulations.direct import ClosedForm
from planeopt.formulations.either_side import EitherSide
from planeopt.formulations.elastic import Elastic
from planeopt.formulations.identifiability import identify
from planeopt.formulations.problem import Problem
from planeopt.formulations.reprojection import Reprojection
from planeopt.formulations.ten import AsPrinted, LeastSquares, Penalty

__all__ = [
    "AsPrinted",
    "ClosedForm",
    "Constrained",
    "DirectAnswer",
    "EitherSide",
    "Elastic",
    "Formulation",
    "LeastSquares",
    "Penalty",
    "Problem",
    "Refusal",
    "Reprojection",
    "Start",
    "identify",
]
