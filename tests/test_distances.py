"""Orthogonal distances to the image of a plane's spot: against a search along the curve, and their derivatives."""

from typing import Any

import numpy as np
import pytest
import scipy.optimize

from cases import WORKED, WORKED_SETUP, Array, boundary, circle, slopes
from planeopt import equations as eq
from planeopt.conic import sampson_distances
from planeopt.errors import InputError
from planeopt.estimation.distances import distances, distances_and_derivatives, distances_from
from planeopt.estimation.feet import Boundary

PLANE = slopes(WORKED)
EXACT = boundary(WORKED, WORKED_SETUP, circle(40))
SKEW = np.array([[0.04, 0.01], [0.01, 0.02]])


def nearest(points: Array, noise: Array) -> Array:
    """Distance of each point from the curve by a search over the angle round the beam."""
    whitening = np.linalg.inv(np.linalg.cholesky(noise))

    def away(phi: float | Array, point: Array) -> Array:
        v = eq.SlopeVariables(None, *PLANE)
        image = eq.image_point(np, WORKED_SETUP, *eq.spot_point_in_slopes(np, v, WORKED_SETUP, phi))
        offset = np.stack(image, axis=-1) - point
        return np.sum((offset @ whitening.T) ** 2, axis=-1)

    grid, found = np.linspace(0, 2 * np.pi, 4001), []
    for point in points:
        best = grid[np.argmin(away(grid, point))]
        around = (best - 2e-3, best + 2e-3)
        search: Any = scipy.optimize.minimize_scalar(
            away, bounds=around, args=(point,), method="bounded", options={"xatol": 1e-12}
        )
        found.append(np.sqrt(search.fun))
    return np.array(found)


@pytest.mark.parametrize("noise", [0.04 * np.eye(2), SKEW], ids=["isotropic", "skew"])
@pytest.mark.parametrize("scatter", [0.002, 0.5])
def test_the_distance_is_the_nearest(noise: Array, scatter: float) -> None:
    points = EXACT + scatter * np.random.default_rng(0).normal(size=EXACT.shape)
    own = distances(PLANE, points, np.broadcast_to(noise, (40, 2, 2)), WORKED_SETUP)
    # The search resolves the angle to 1e-12, so the squared distance to rounding: of points up to 50 mm away, 1e-14.
    np.testing.assert_allclose(np.abs(own), nearest(points, noise), atol=1e-8)


def test_deep_inside_the_nearest_is_found_too() -> None:
    centre = EXACT.mean(axis=0)
    points = centre + 0.02 * (EXACT - centre)
    np.testing.assert_allclose(-distances(PLANE, points, 1.0, WORKED_SETUP), nearest(points, np.eye(2)), atol=1e-6)


def test_outside_is_positive() -> None:
    centre = EXACT.mean(axis=0)
    assert (distances(PLANE, centre + 1.1 * (EXACT - centre), 0.01, WORKED_SETUP) > 0).all()
    assert (distances(PLANE, centre + 0.9 * (EXACT - centre), 0.01, WORKED_SETUP) < 0).all()


def test_isotropic_noise_is_a_covariance_too() -> None:
    points = EXACT + 0.1 * np.random.default_rng(1).normal(size=EXACT.shape)
    sigma = np.linspace(0.01, 0.03, 40)
    covariances = sigma[:, None, None] ** 2 * np.eye(2)
    one, other = (distances(PLANE, points, noise, WORKED_SETUP) for noise in (sigma, covariances))
    np.testing.assert_allclose(one, other, rtol=1e-8)


def test_small_distances_are_sampsons() -> None:
    """They differ by the square of the distance times the curvature, at most 1 over a hundredth of the width here."""
    points = EXACT + 1e-4 * np.random.default_rng(2).normal(size=EXACT.shape)
    b = np.array(eq.image_conic(np, WORKED, WORKED_SETUP))
    first = sampson_distances(b[1:] / b[0], points)
    np.testing.assert_allclose(distances(PLANE, points, 1.0, WORKED_SETUP), first, atol=4 * 1e-4**2 * 10)


@pytest.mark.parametrize("noise", [0.04 * np.eye(2), SKEW], ids=["isotropic", "skew"])
def test_the_derivative_is_exact(noise: Array) -> None:
    points = EXACT + 0.3 * np.random.default_rng(3).normal(size=EXACT.shape)
    covariances = np.broadcast_to(noise, (40, 2, 2))
    _, derivative = distances_and_derivatives(PLANE, points, covariances, WORKED_SETUP)
    for column, h in enumerate((1e-4, 1e-6, 1e-6)):
        step = h * np.eye(3)[column]
        ends = [distances(PLANE + s, points, covariances, WORKED_SETUP) for s in (step, -step)]
        numeric = (ends[0] - ends[1]) / (2 * h)
        # Central differences: rounding over h leaves 1e-9 of the largest, feet found to 1e-10 no more than 1e-4.
        np.testing.assert_allclose(numeric, derivative[:, column], atol=2e-4 * np.abs(derivative[:, column]).max())


def test_planes_and_points_broadcast() -> None:
    planes = PLANE + np.array([[0.0, 0, 0], [1, 0.01, 0], [2, 0, 0.01]])
    points = EXACT + 0.01 * np.random.default_rng(4).normal(size=(2, 40, 2))
    both = distances(planes[:, None], points, 0.01, WORKED_SETUP)
    assert both.shape == (3, 2, 40)
    np.testing.assert_allclose(both[1, 0], distances(planes[1], points[0], 0.01, WORKED_SETUP), rtol=1e-9)
    prepared = Boundary.of(points[0], 0.01)
    np.testing.assert_allclose(distances_from(planes, prepared, WORKED_SETUP), both[:, 0], rtol=1e-9)


def test_a_plane_that_is_not_seen_is_infinitely_far() -> None:
    behind, too_steep, dark = [-75.0, 0.1, 0.1], [5.0, 0.0, 1.0], [30.0, 2.0, 0.0]
    found, derivative = distances_and_derivatives(np.array([PLANE, behind, too_steep, dark]), EXACT, 0.01, WORKED_SETUP)
    assert np.isfinite(found[0]).all()
    assert np.isposinf(found[1:]).all()
    assert np.isnan(derivative[1:]).all()


def test_shapes_are_checked() -> None:
    with pytest.raises(InputError, match="planes"):
        distances(np.zeros(2), EXACT, 1.0, WORKED_SETUP)
    with pytest.raises(InputError, match="points"):
        distances(PLANE, np.zeros(3), 1.0, WORKED_SETUP)
