"""Errors of planes from every conic fit by both routes of the closed form, over the Cramér-Rao bound."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from planeopt.closed_form import from_dual, from_primal
from planeopt.conic import Method, fit_conic, is_ellipse, transform_conic
from planeopt.equations import Setup
from planeopt.estimation import solve_points
from planeopt.executors import ordered_map
from studies import efficiency_rivals as rivals
from studies.efficiency_cells import PITCH_MM, Array
from studies.efficiency_sweeps import Errors, Sample, Setting, Step, draw, errors_of, steps_of
from studies.study import Mode

DRAWS: dict[Mode, int] = {"full": 1000, "quick": 100}
POSE = "none: maximum likelihood of the plane"


@dataclass(frozen=True, kw_only=True)
class FitRow(Errors):
    """A conic fit and a route of the closed form, at one place of an axis.

    Attributes
    ----------
    axis : str
    value : float
    fit : str
        Whose ellipse; the last, for comparison, is the plane of maximum likelihood itself (`solve_points`).
    route : str
        "primal" or "dual", of `planeopt.closed_form`; "-" where there is none.
    excess : float
        By what factor the criterion's worst number is over its limit: at most 1 where the bound can be reached.
    draws : int
    failed : int
        Draws without an ellipse, or without a plane that the camera sees.
    """

    axis: str
    value: float
    fit: str
    route: str
    excess: float
    draws: int


def _ours(method: Method, points: Array, sigma: float) -> Array:
    return np.asarray(fit_conic(points, sigma, method, check=False).B, dtype=np.float64)


def _alike(fit: Callable[[Array], Array], points: Array, sigma: float) -> Array:
    """A fit that weighs all points alike, and knows no refusal: hyperbolas count as failures here."""
    del sigma
    B = fit(points)
    return np.where(is_ellipse(B)[:, None], B, np.nan)


def _in_pixels(fit: Callable[[Array], Array], points: Array) -> Array:
    B = transform_conic(fit(points / PITCH_MM), PITCH_MM * np.eye(2), np.zeros(2))
    return np.asarray(B, dtype=np.float64)


FITS: dict[str, Callable[[Array, float], Array]] = {
    "least squares (16)": partial(_ours, "least_squares"),
    "Taubin": partial(_ours, "taubin"),
    "HyperLS": partial(_alike, rivals.hyper),
    "direct (Halir-Flusser)": partial(_ours, "direct"),
    "maximum likelihood (Sampson)": partial(_ours, "maximum_likelihood"),
    "cv2.fitEllipse": partial(_alike, partial(_in_pixels, rivals.ellipse)),
    "cv2.fitEllipseAMS": partial(_alike, partial(_in_pixels, rivals.ellipse_ams)),
    "cv2.fitEllipseDirect": partial(_alike, partial(_in_pixels, rivals.ellipse_direct)),
}
"""From sets of points (D, N, 2) in mm and their sigma to ``B`` (D, 5); NaN where there is no ellipse."""

ROUTES = {"primal": from_primal, "dual": from_dual}


def plane_of(B: Array, setup: Setup, route: str) -> Array:
    """Return the visible planes (D, 3) of conics by one route; NaN where there is none before the camera."""
    # Numbers of numpy: where the camera is on the beam's surface the primal route divides by zero.
    numbers = Setup(*np.array(setup))
    with np.errstate(all="ignore"):
        planes = np.stack(ROUTES[route](B, numbers), axis=-1)
        in_front = planes[:, 0] > setup.r * np.hypot(planes[:, 1], planes[:, 2])
        lit = planes[:, 0] - planes[:, 1] * setup.e_x - planes[:, 2] * setup.e_y > 0
        seen = np.isfinite(planes).all(axis=1) & in_front & lit
    return np.where(seen[:, None], planes, np.nan)


def run_fits(mode: Mode, executor: Executor | None) -> list[FitRow]:
    """Measure all fits at all steps; a setting that lies on several axes is measured once."""
    steps = steps_of(mode)
    settings = list(dict.fromkeys(step.setting for step in steps))
    measured = dict(zip(settings, ordered_map(partial(measure, draws=DRAWS[mode]), settings, executor), strict=True))
    return [_row(step, *found, DRAWS[mode]) for step in steps for found in measured[step.setting]]


Found = tuple[str, str, float, Errors]


def measure(setting: Setting, *, draws: int) -> list[Found]:
    """Return each fit's and route's name, the criterion's excess, and the errors, of one setting."""
    sample = draw(setting, draws)
    found = [
        (name, route, sample.excess, errors_of(plane_of(B, sample.truth.setup, route), sample))
        for name, B in ((name, fit(sample.points, sample.sigma)) for name, fit in FITS.items())
        for route in ROUTES
    ]
    return [*found, (POSE, "-", sample.excess, errors_of(maximum_likelihood(sample), sample))]


def maximum_likelihood(sample: Sample) -> Array:
    """Return the planes of maximum likelihood (D, 3)."""
    return solve_points(sample.points, sample.sigma, sample.truth.setup).planes


def _row(step: Step, fit: str, route: str, excess: float, errors: Errors, draws: int) -> FitRow:
    return FitRow(**asdict(errors), axis=step.axis, value=step.value, fit=fit, route=route, excess=excess, draws=draws)
