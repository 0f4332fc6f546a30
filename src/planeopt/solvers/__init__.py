"""Solvers: each takes any `planeopt.nlp.Nlp`."""

from planeopt.solvers.base import Found, Solver
from planeopt.solvers.ipopt import Ipopt
from planeopt.solvers.penalised import Penalised
from planeopt.solvers.sqp import Sqp
from planeopt.solvers.swift import Swift

__all__ = ["Found", "Ipopt", "Penalised", "Solver", "Sqp", "Swift"]
