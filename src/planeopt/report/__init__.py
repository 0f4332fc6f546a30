"""Figures of results, and the report.

The report's modules are imported by name, so that a figure alone costs nothing of it: `planeopt.report.build` makes
one (`build`, `Report`), `planeopt.report.examine` measures its inputs (`Options`), `planeopt.report.provenance` says
where it comes from. ``docs/report.md`` shows how.
"""

from planeopt.report.accuracy_figure import accuracy_figure
from planeopt.report.spot_overlay import refusal_picture, spot_overlay

__all__ = ["accuracy_figure", "refusal_picture", "spot_overlay"]
