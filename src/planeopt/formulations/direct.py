"""The closed form as a formulation: an answer without a search."""

from dataclasses import dataclass

import numpy as np

from planeopt.closed_form import slope_jacobian, solve_both
from planeopt.formulations.base import DirectAnswer, Refusal, Start
from planeopt.formulations.problem import Problem
from planeopt.solution import Status


@dataclass(frozen=True)
class ClosedForm:
    """Both planes directly from the fitted ellipse; start and cross-check of all others, not efficient under noise."""

    @property
    def name(self) -> str:
        return "ClosedForm"

    def build(self, problem: Problem, start: Start) -> DirectAnswer | Refusal:
        del start
        planes = solve_both(problem.B, problem.setup)
        if not planes.ok:
            return Refusal(
                Status.NO_PLANE,
                "The closed form finds no plane before the camera, lit on the side it sees: the image ellipse is "
                "too far from any that this beam can make.",
            )
        root = slope_jacobian(problem.B, problem.setup) @ problem.B_factor
        covariance = root @ root.T
        return DirectAnswer(planes.visible, covariance if np.isfinite(covariance).all() else None)
