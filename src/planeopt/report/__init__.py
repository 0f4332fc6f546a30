"""Figures of results."""

from planeopt.report.accuracy_figure import accuracy_figure
from planeopt.report.spot_overlay import refusal_picture, spot_overlay

__all__ = ["accuracy_figure", "refusal_picture", "spot_overlay"]
