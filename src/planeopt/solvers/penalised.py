"""A penalty with a rising weight, as SWIFT's, but each stage searched with exact derivatives."""

from dataclasses import dataclass, field, replace

import numpy as np

from planeopt.nlp import Nlp
from planeopt.solution import Effort, Status
from planeopt.solvers.base import NO_TRACE, Found, check_weights, too_many_equalities
from planeopt.solvers.ipopt import Ipopt
from planeopt.solvers.kkt import check
from planeopt.solvers.sqp import Sqp


@dataclass(frozen=True)
class Penalised:
    """Minimise (29), ``J + weight * sum h^2``, for each weight in turn, from the last one's answer, by another solver.

    It minimises the same functions at the same weights as `Swift`: what differs between the two is the simplex search.
    Inequalities stay constraints. It is for programmes whose equations outnumber their unknowns; others can be solved
    as they are.

    Parameters
    ----------
    solver : Ipopt or Sqp
    weights : tuple of float
        The schedule, rising.
    """

    solver: Ipopt | Sqp = field(default_factory=Ipopt)
    weights: tuple[float, ...] = (1.0, 1e1, 1e2, 1e3, 1e4, 1e5)

    def __post_init__(self) -> None:
        check_weights("Penalised", self.weights)

    @property
    def name(self) -> str:
        return f"{self.solver.name}(penalty)"

    def prepare(self, nlp: Nlp) -> None:
        if too_many_equalities(nlp) is not None:
            self.solver.prepare(self._penalised(nlp))

    def solve(self, nlp: Nlp) -> Found:
        if too_many_equalities(nlp) is not None:
            return self.solver.solve(self._penalised(nlp))
        count = int(nlp.model.equalities.sum())
        reason = "there is no equation to penalise"
        if count:
            reason = f"{count} equations for {len(nlp.start)} unknowns can be hard: {self.solver.name} takes them"
        found = check(nlp, nlp.start)
        return Found(nlp, nlp.start, "not called", found, Effort(), NO_TRACE, reason, Status.UNSUITED)

    def _penalised(self, nlp: Nlp) -> Nlp:
        stages = tuple(np.append(nlp.parameters, weight) for weight in self.weights)
        return replace(nlp.penalised(self.weights[-1]), stages=stages)
