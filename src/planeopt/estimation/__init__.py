"""From a spot and a rig to a plane."""

from planeopt.estimation.batch import BatchSolution, solve_batch
from planeopt.estimation.combine import Combined, combine
from planeopt.estimation.judged import PointsSolution
from planeopt.estimation.points import solve_points
from planeopt.estimation.solve import solve, solve_problem

__all__ = [
    "BatchSolution",
    "Combined",
    "PointsSolution",
    "combine",
    "solve",
    "solve_batch",
    "solve_points",
    "solve_problem",
]
