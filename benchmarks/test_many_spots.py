"""A thousand spots of 200 points by maximum likelihood, start included: at once, and one by one through SciPy.

The same points in millimetres, the same Mahalanobis-orthogonal distances to the image of a plane. SciPy's
`least_squares` minimises them spot by spot with exact derivatives from the same closed form.
"""

from typing import Any

import numpy as np
import pytest
import scipy.optimize
from pytest_benchmark.fixture import BenchmarkFixture

from planeopt import equations as eq
from planeopt.closed_form import solve_both
from planeopt.conic import fit_conic
from planeopt.estimation import solve_points
from planeopt.estimation.distances import distances_and_derivatives
from worked_example import SETUP, SIGMA, SPOT, Array

MANY, FEW = 1000, 20
TRUTH = np.array([SPOT.z_L, *eq.slopes(np, SPOT)])


def points(rows: int, n: int = 200) -> Array:
    """The worked example's boundary with 0.3 px of noise, again and again."""
    theta = 2 * np.pi * np.arange(n) / n
    exact = np.stack(eq.image_point(np, SETUP, *eq.spot_point(np, SPOT, SETUP, theta)), axis=1)
    return exact + SIGMA * np.random.default_rng(1).standard_normal((rows, n, 2))


@pytest.mark.parametrize("robust", [None, 4.0], ids=["normal", "Student's t"])
def test_at_once(benchmark: BenchmarkFixture, robust: float | None) -> None:
    given = points(MANY)
    found = benchmark(solve_points, given, SIGMA, SETUP, robust=robust)
    benchmark.group = "One spot of 200 points, start included, one core"
    benchmark.extra_info["what"] = f"solve_points, {'normal noise' if robust is None else 'Student t noise'}"
    benchmark.extra_info["each"] = MANY
    assert found.ok.all()
    check(found.planes, found.covariance)


def test_one_by_one(benchmark: BenchmarkFixture) -> None:
    given = points(FEW)

    def loop() -> Array:
        return np.array([minimise(spot) for spot in given])

    planes = benchmark(loop)
    benchmark.group = "One spot of 200 points, start included, one core"
    benchmark.extra_info["what"] = "SciPy least_squares"
    benchmark.extra_info["each"] = FEW
    np.testing.assert_allclose(planes, solve_points(given, SIGMA, SETUP).planes, rtol=1e-6)


def minimise(spot: Array) -> Array:
    """One spot's plane, from the closed form of Taubin's fit; distances and derivatives are computed together."""
    start = solve_both(fit_conic(spot, SIGMA, "taubin").B, SETUP).visible
    derivatives: dict[bytes, Array] = {}

    def residuals(plane: Array) -> Array:
        found, derivatives[plane.tobytes()] = distances_and_derivatives(plane, spot, SIGMA, SETUP)
        return found

    def jacobian(plane: Array) -> Array:
        return derivatives[plane.tobytes()]

    search: Any = scipy.optimize.least_squares
    return np.asarray(search(residuals, start, jacobian, x_scale=np.array([SPOT.z_L, 1.0, 1.0])).x)


def check(planes: Array, covariance: Array) -> None:
    """All planes within what chance allows a thousand of them: a squared distance of 40 has p = 1e-8."""
    error = planes - TRUTH
    assert np.max(np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1)) < 40
