"""Planes that cannot be measured, what would help, and what a design refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from planeopt.design import (
    Pixels,
    Points,
    Rigs,
    View,
    plan,
    plane_at,
    planned_rig,
    predict,
    smallest,
    with_factors,
)
from planeopt.errors import InputError
from planeopt.rig import Rig
from planeopt.spot.bound import size_cost
from test_design import PIXELS, POINTS, RIG, TILTED

# --- What cannot be measured ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "tilt", "toward", "quality", "view"),
    [
        (250.0, 30.0, 0.0, PIXELS, View.OK),
        (60.0, 30.0, 0.0, PIXELS, View.OUT),
        (40.0, 85.0, 180.0, PIXELS, View.BEHIND),
        (100.0, 80.0, 0.0, PIXELS, View.DARK),
        (5000.0, 30.0, 0.0, Pixels(120, 0.1, 4.0), View.SMALL),
        (5000.0, 30.0, 0.0, Points(0.5, 200), View.BEYOND),
        (250.0, 30.0, 0.0, Points(1e300, 200), View.BLANK),
    ],
)
def test_views(distance: float, tilt: float, toward: float, quality: Points | Pixels, view: View) -> None:
    found = predict(RIG, plane_at(RIG, distance, tilt, toward), quality)
    assert found.views == view
    assert bool(found.ok) == (view == View.OK)
    assert bool(found.visible) == (view in (View.OK, View.BEYOND))
    assert np.isfinite(found.z_L_mm) == (view not in (View.BEHIND, View.DARK, View.BLANK))


def test_a_lens_that_folds_over_is_told() -> None:
    rig = Rig(replace(RIG.camera, distortion=(-20.0, 0.0, 0.0, 0.0, 0.0)), RIG.beam)
    assert predict(rig, plane_at(rig, 100.0, 0.0), POINTS).views == View.FOLDED


@pytest.mark.parametrize("radius", [2.0, 5.0, 33.0, 400.0])
def test_the_cost_of_the_size_is_that_of_the_bound(radius: float) -> None:
    """Interpolated between 24 radii a factor of 1.17 apart: off by a hundredth of its excess where it is steep."""
    width = math.hypot(1.0, math.sqrt(1 / 12))
    found = PIXELS.at(np.ones((1, 4)), np.array([2 * np.pi * radius * width])).size_cost[0]
    assert found - 1 == pytest.approx(size_cost(radius, 1.0) - 1, rel=0.03)


def test_less_of_the_boundary_tells_less() -> None:
    """Half of the pixels' boundary tells less than all of it in every direction of (z_L, p, q)."""
    whole, half = (predict(RIG, TILTED, Pixels(120, 2, arc=arc)).spot for arc in (1.0, 0.5))
    assert np.all(np.linalg.eigvalsh(half - whole) > 0)


# --- What would help --------------------------------------------------------------------------------------------------


def test_the_smallest_that_will_do_just_does() -> None:
    planes = plane_at(RIG, [150.0, 250.0], 30.0, [0.0, 180.0])
    present = predict(RIG, planes, PIXELS)
    wanted = 0.8 * float(np.max(present.normal_deg))
    found = smallest(RIG, planes, PIXELS, "f", normal_deg=wanted)
    assert found.factor == pytest.approx(0.8 ** (-1 / 1.5), rel=0.01)
    assert found.factor is not None
    at = with_factors(RIG, planes, PIXELS, "f", found.factor)
    assert np.max(at.normal_deg) == pytest.approx(wanted, rel=1e-6)
    assert found.best == pytest.approx(1, rel=1e-6)


def test_what_takes_the_spot_out_of_the_image_will_not_do() -> None:
    planes = plane_at(RIG, [120.0, 400.0], 30.0, 0.0)
    found = smallest(RIG, planes, PIXELS, "offset", depth_mm=0.1 * float(np.max(predict(RIG, planes, PIXELS).z_L_mm)))
    assert found.factor is None
    assert found.reason == f"larger ones cannot be used: {View.OUT}"
    assert found.best_factor is not None
    assert np.all(with_factors(RIG, planes, PIXELS, "offset", found.best_factor).visible)
    assert smallest(RIG, plane_at(RIG, 5.0, 0.0)[None], PIXELS, "offset", depth_mm=1.0).best_factor is None


def test_a_plan_has_each_plane_once() -> None:
    made = plan(RIG, PIXELS, [200, 200, 300], [0, 40], [0, 180], depth_mm=0.01)
    assert [(row["distance_mm"], row["tilt_deg"], row["toward_deg"]) for row in made.rows()] == [
        (z, tilt, toward) for z in (200, 300) for tilt, toward in ((0, 0), (40, 0), (40, 180))
    ]
    assert made.hardest is not None
    assert made.rows()[made.hardest]["sigma_z_L_mm"] == max(row["sigma_z_L_mm"] for row in made.rows())
    assert [each.lever for each in made.wanted] == ["offset", "radius", "f"]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: plane_at(RIG, -1.0, 0.0), "distances must be positive"),
        (lambda: plane_at(RIG, 1.0, 90.0), "below 90 degrees, not 90"),
        (lambda: plane_at(RIG, 1.0, 0.0, math.nan), "directions of tilt"),
        (lambda: plane_at(RIG, [1.0, 2.0], [0.0, 1.0, 2.0]), "do not broadcast"),
        (lambda: predict(RIG, [1.0, 2.0], POINTS), "must be \\(z_L, p, q\\)"),
        (lambda: predict(Rigs.of(RIG).scaled("f", [1.0, 2.0]), np.ones((3, 3)), POINTS), "do not broadcast"),
        (lambda: predict(replace(RIG, beam=None), TILTED, POINTS), "camera alone"),
        (lambda: Pixels(0, 2), "contrast must be a positive"),
        (lambda: Pixels(100, -1), "noise must be"),
        (lambda: Pixels(100, 1, kind="ring"), "line_mm"),
        (lambda: Points(0.1, 4), "at least 5 points"),
        (lambda: Points(0.1, 10**12), "at most 1,000,000,000 points, not 1000000000000"),
        (lambda: Points(0.1, 50, arc=1.2), "arc must be a fraction"),
        (lambda: planned_rig(offset_mm=(1, 2), radius_mm=3, f_mm=0, pitch_um=5, image=(10, 10)), "f_mm must be"),
        (
            lambda: planned_rig(offset_mm=(1, 2), radius_mm=3, f_mm=9, pitch_um=5, image=(10, 10), sigmas={"f": -1}),
            "standard deviation of f",
        ),
        (lambda: smallest(RIG, TILTED, POINTS, "f"), "say what is wanted"),
        (lambda: smallest(RIG, TILTED, POINTS, "f", depth_mm=0.0), "must be positive"),
        (lambda: plan(RIG, POINTS, [], [0], [0]), "no distances"),
        (lambda: plan(RIG, POINTS, range(1, 10_002), [0], [0]), "at most 10000"),
    ],
)
def test_bad_input_is_told_in_a_line(make: object, said: str) -> None:
    assert callable(make)
    with pytest.raises(InputError, match=said) as told:
        make()
    assert "\n" not in str(told.value)
