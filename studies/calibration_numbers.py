"""The numbers of the calibration study's headline, and the sentences that say them."""

from collections.abc import Mapping, Sequence

import numpy as np

from studies.calibration_accuracy import BOUNDARY, PLANE_TILT_DEG, SPOT_PX, AccuracyRow, median, values_of
from studies.calibration_fits import of
from studies.calibration_judged import IMAGES, LEVELS, POINTS, Judged, pooled
from studies.calibration_repeats import ALL
from studies.calibration_sessions import DEFAULT, SessionRow
from studies.statistics import LEVEL

USUAL_VIEWS = 15.0
"""Of what the calibration costs a plane the number of views that is said."""


def numbers(sessions: Sequence[SessionRow], accuracy: Sequence[AccuracyRow], judged: Judged) -> dict[str, float]:
    """Return the headline's numbers; `finding` names the tables and columns that they come from."""
    ratios = [row.ratio for row in pooled(judged).values()]
    repeats = [row.draws for row in judged.repeats if row.session != ALL]
    shares = {group: _shares(judged, group) for group in (POINTS, IMAGES)}
    ends = {varied: (values_of(accuracy, varied)[0], values_of(accuracy, varied)[-1]) for varied in _VARIED}
    found = {
        "level_percent": 100 * LEVELS[1],
        "sessions": _count(judged, POINTS),
        "least_covered_percent": shares[POINTS][0],
        "most_covered_percent": shares[POINTS][1],
        "rendered_sessions": _count(judged, IMAGES),
        "least_covered_rendered_percent": shares[IMAGES][0],
        "most_covered_rendered_percent": shares[IMAGES][1],
        "repeats": sum(repeats) // len({row.quantity for row in judged.repeats}),
        "least_reported_over_scatter": min(ratios),
        "largest_reported_over_scatter": max(ratios),
        "tests": judged.tests,
        "tests_within_limits": judged.kept,
        "family_wise_level": LEVEL,
    }
    for varied, (name, said, field, scale) in _VARIED.items():
        for which, value in zip(("least", "most"), ends[varied], strict=True):
            found[f"{which}_{name}"] = value
            found[f"{said}_at_{which}_{name}"] = scale * median(accuracy, varied, value, field)
    usual = USUAL_VIEWS if USUAL_VIEWS in values_of(accuracy, "views") else ends["views"][1]
    found |= {
        "views_of_the_cost": usual,
        "plane_tilt_deg": PLANE_TILT_DEG,
        "z_L_cost_percent": 100 * median(accuracy, "views", usual, "z_L_relative"),
        "normal_cost_deg": median(accuracy, "views", usual, "normal_deg"),
        "boundary_points": BOUNDARY,
        "boundary_px": SPOT_PX,
        "z_L_spot_percent": 100 * median(accuracy, "views", usual, "z_L_spot_relative"),
        "normal_spot_deg": median(accuracy, "views", usual, "normal_spot_deg"),
        "z_L_sigma_apart_over_joint": median_apart(sessions),
    }
    return found


_VARIED = {
    "views": ("views", "f_percent", "f_relative", 100.0),
    "tilt": ("tilt_deg", "f_percent", "f_relative", 100.0),
    "depths": ("depth_ratio", "offset_mm", "offset_mm", 1.0),
}


def headline(n: Mapping[str, float]) -> str:
    """Say it in a few sentences."""
    return (
        f"Over {n['sessions']:.0f} simulated sessions {n['level_percent']:g} % intervals of f, cx, cy, e_x, e_y, r and "
        f"the direction hold the truth in {n['least_covered_percent']:.1f} to {n['most_covered_percent']:.1f} % of "
        f"cases, over {n['rendered_sessions']:.0f} rendered ones in {n['least_covered_rendered_percent']:.1f} to "
        f"{n['most_covered_rendered_percent']:.1f} %; over {n['repeats']:.0f} repeats reported standard deviations are "
        f"{n['least_reported_over_scatter']:.2f} to {n['largest_reported_over_scatter']:.2f} times the scatter; "
        f"{n['tests_within_limits']:.0f} of {n['tests']:.0f} tests are within their limits at a family-wise "
        f"{n['family_wise_level']:g}. From {n['least_views']:g} views to {n['most_views']:g} the standard deviation of "
        f"f goes from {n['f_percent_at_least_views']:.3f} to {n['f_percent_at_most_views']:.3f} %, from tilts of "
        f"{n['least_tilt_deg']:g} degrees at most to {n['most_tilt_deg']:g} from "
        f"{n['f_percent_at_least_tilt_deg']:.3f} to {n['f_percent_at_most_tilt_deg']:.3f} %; from a depth ratio of "
        f"{n['least_depth_ratio']:g} to "
        f"{n['most_depth_ratio']:g} that of the offset from {n['offset_mm_at_least_depth_ratio']:.4f} to "
        f"{n['offset_mm_at_most_depth_ratio']:.4f} mm. A calibration by {n['views_of_the_cost']:g} views costs a plane "
        f"tilted by {n['plane_tilt_deg']:g} degrees {n['z_L_cost_percent']:.3f} % of z_L and "
        f"{n['normal_cost_deg']:.3f} degrees, its own spot's noise ({n['boundary_points']:g} points known to "
        f"{n['boundary_px']:g} px) {n['z_L_spot_percent']:.3f} % and {n['normal_spot_deg']:.3f} degrees. Without what "
        "camera and beam have in common the standard deviation of a plane's z_L would seem to be "
        f"{n['z_L_sigma_apart_over_joint']:.0f} times what it is."
    )


def median_apart(rows: Sequence[SessionRow]) -> float:
    """Return how much larger the standard deviation of a plane's z_L would seem were camera and beam independent."""
    own = [row for row in rows if row.model == DEFAULT]
    return float(np.median(of(own, "z_L_apart_mm") / of(own, "z_L_sigma_mm")))


def _shares(judged: Judged, group: str) -> tuple[float, float]:
    found = [100 * row.share for row in judged.coverage if (row.group, row.level) == (group, LEVELS[1])]
    return min(found), max(found)


def _count(judged: Judged, group: str) -> int:
    return next(row.sessions for row in judged.coverage if row.group == group)
