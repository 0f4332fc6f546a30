"""From a spot and a rig to a plane."""

from planeopt.estimation.solve import solve, solve_problem

__all__ = ["solve", "solve_problem"]
