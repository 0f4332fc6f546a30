"""The paper reproduced: its tables, its result by several methods, its figures and its misprints."""

from planeopt.reproduction.results import Reproduction, compute
from planeopt.reproduction.run import reproduce

__all__ = ["Reproduction", "compute", "reproduce"]
