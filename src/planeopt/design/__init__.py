"""What a rig could measure, before it is built: predicted standard deviations, and what would make them smaller."""

from planeopt.design.levers import Sensitivity, Smallest, sensitivities, smallest, with_factors
from planeopt.design.planned import Plan, plan
from planeopt.design.prediction import Prediction, View, plane_at, predict
from planeopt.design.quality import Pixels, Points, Quality
from planeopt.design.rigs import Rigs, planned_rig

__all__ = [
    "Pixels",
    "Plan",
    "Points",
    "Prediction",
    "Quality",
    "Rigs",
    "Sensitivity",
    "Smallest",
    "View",
    "plan",
    "plane_at",
    "planned_rig",
    "predict",
    "sensitivities",
    "smallest",
    "with_factors",
]
