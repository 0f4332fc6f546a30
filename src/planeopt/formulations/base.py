"""What a formulation is: a `Problem` goes in; an `Nlp`, a direct answer or a refusal comes out."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planeopt.formulations.problem import Problem
from planeopt.nlp import Nlp
from planeopt.solution import Status

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """Where a search begins: ``R`` (mm) and ``(z_L, p, q)`` of the laser-parallel frame; ``cold`` when a user chose it.

    ``beta`` (rad) is kept because a paper-variables search at ``alpha = 0`` still needs one. ``held``: no formulation
    may begin from a better one of its own, so that all that are compared begin at one plane.
    """

    R: float
    plane: tuple[float, float, float]
    beta: float
    cold: bool = False
    held: bool = False

    @property
    def in_slopes(self) -> Array:
        return np.array([self.R, *self.plane])

    @property
    def in_paper_variables(self) -> Array:
        z_L, p, q = self.plane
        return np.array([self.R, z_L, np.arctan(np.hypot(p, q)), self.beta])


@dataclass(frozen=True)
class DirectAnswer:
    """A plane found without a search: ``(z_L, p, q)`` and its covariance from the spot."""

    plane: Array
    covariance: Array | None


@dataclass(frozen=True)
class Refusal:
    """Why a formulation cannot be solved, before any solver is called."""

    status: Status
    message: str


class Formulation(Protocol):
    """Builds the programme of a problem."""

    @property
    def name(self) -> str:
        """What tables and records call it."""
        ...

    def build(self, problem: Problem, start: Start) -> Nlp | DirectAnswer | Refusal:
        """Make the programme for one case; symbols and compiled functions are cached per formulation."""
        ...
