"""Figures of results."""

from planeopt.report.accuracy_figure import accuracy_figure

__all__ = ["accuracy_figure"]
