"""Solvers: each takes any `planeopt.nlp.Nlp`."""

from planeopt.solvers.base import Found, Solver
from planeopt.solvers.ipopt import Ipopt
from planeopt.solvers.sqp import Sqp
from planeopt.solvers.swift import Swift

__all__ = ["Found", "Ipopt", "Solver", "Sqp", "Swift"]
