"""From a spot and a rig to a plane."""

from planeopt.estimation.combine import Combined, combine
from planeopt.estimation.solve import solve, solve_problem

__all__ = ["Combined", "combine", "solve", "solve_problem"]
