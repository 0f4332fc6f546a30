"""Boundary points to image ellipse (16), with its covariance; its dual and other representations."""

from planeopt.conic.ellipse import (
    Ellipse,
    adjugate,
    conic_from_dual,
    conic_from_geometric,
    conic_from_matrix,
    conic_matrix,
    dual_conic,
    geometric_from_conic,
    is_ellipse,
)
from planeopt.conic.fits import ConicFit, Method, direct, fit_conic, least_squares, maximum_likelihood, taubin
from planeopt.conic.points import arc_fraction, eccentric_angles, sampson_distances
from planeopt.conic.sample import Verdict
from planeopt.conic.transport import transform_conic, transform_covariance, transform_jacobian

__all__ = [
    "ConicFit",
    "Ellipse",
    "Method",
    "Verdict",
    "adjugate",
    "arc_fraction",
    "conic_from_dual",
    "conic_from_geometric",
    "conic_from_matrix",
    "conic_matrix",
    "direct",
    "dual_conic",
    "eccentric_angles",
    "fit_conic",
    "geometric_from_conic",
    "is_ellipse",
    "least_squares",
    "maximum_likelihood",
    "sampson_distances",
    "taubin",
    "transform_conic",
    "transform_covariance",
    "transform_jacobian",
]
