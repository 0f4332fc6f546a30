"""A formulation without the inequality that tells the two exact planes apart: for studies of where searches end."""

from dataclasses import dataclass

from planeopt.formulations.base import DirectAnswer, Formulation, Refusal, Start
from planeopt.formulations.problem import Problem
from planeopt.nlp import Nlp


@dataclass(frozen=True)
class EitherSide:
    """Another formulation without ``c > 0``: the spot is in front of the camera, but its lit side may face away.

    The ten equations have two exact solutions and an opaque plane shows only one of them. Without the inequality a
    search may end on the other, which is then refused (`planeopt.Status.UNSEEN`). Start, weights, bounds, scaling and
    all other rows are those of the formulation.

    Parameters
    ----------
    formulation : Formulation
        One that is searched; a direct answer or a refusal is passed on as it is.
    """

    formulation: Formulation

    @property
    def name(self) -> str:
        return f"EitherSide({self.formulation.name})"

    def build(self, problem: Problem, start: Start) -> Nlp | DirectAnswer | Refusal:
        built = self.formulation.build(problem, start)
        return built.either_side() if isinstance(built, Nlp) else built
