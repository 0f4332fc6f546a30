"""A thousand spots of 200 points by maximum likelihood, start included: at once, and one by one through SciPy.

Twice: from points in millimetres, and from raw pixels through a rig with lens distortion, whose joint covariance of
thirteen parameters goes into that of each plane. SciPy's `least_squares` minimises the same Mahalanobis-orthogonal
distances to the image of a plane, spot by spot: with exact derivatives from the same closed form; and as one would
write it first, with differences for derivatives, a point's distance to first order, and a start given by the closed
form. It finds the planes alone, without covariances, tests and flags.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from pytest_benchmark.fixture import BenchmarkFixture

import planeopt as po
from planeopt import equations as eq
from planeopt.closed_form import solve_both
from planeopt.conic import fit_conic, sampson_distances
from planeopt.estimation import solve_points
from planeopt.estimation.distances import distances_and_derivatives
from planeopt.example import example_folder
from planeopt.rig import Rig, RigCovariance
from planeopt.spot import Spot
from worked_example import SETUP, SIGMA, SPOT, Array

# Of one core, whatever else the machine does.
pytestmark = pytest.mark.benchmark(timer=time.process_time)

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


GROUP = "One spot of 200 points from pixels, start included, one core"
PIXEL_SIGMA = 0.1
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "e_x", "e_y", "radius", "direction_x", "direction_y")
SIGMAS = np.array([1.0, 1.0, 0.5, 0.5, 1e-3, 5e-3, 1e-4, 1e-4, 0.04, 0.04, 0.005, 2e-4, 2e-4])


def calibrated() -> Rig:
    """The example's rig with a joint covariance of thirteen parameters."""
    shape = np.eye(13) + 0.3 * np.random.default_rng(0).normal(size=(13, 13))
    matrix = shape @ shape.T
    size = np.sqrt(np.diag(matrix))
    covariance = RigCovariance(NAMES, matrix / np.outer(size, size) * np.outer(SIGMAS, SIGMAS))
    return replace(po.load_rig(example_folder() / "truth_rig.toml"), covariance=covariance)


def drawn(rig: Rig) -> Rig:
    """The rig off by a draw from its covariance, as a calibration's is."""
    assert rig.covariance is not None
    change = np.random.default_rng(0).multivariate_normal(np.zeros(13), rig.covariance.matrix)
    return rig.with_parameters({name: rig.parameter(name) + by for name, by in zip(NAMES, change, strict=True)})


def seen(rig: Rig, rows: int, sigma: float | None = PIXEL_SIGMA, share: float = 1.0, n: int = 200) -> list[Spot]:
    """Spots on random planes, with 0.1 px of noise."""
    rng, setup = np.random.default_rng(2), setup_of(rig)
    theta, made = 2 * np.pi * share * np.arange(n) / n, []
    for _ in range(rows):
        p, q = rng.uniform(-0.5, 0.5, 2)
        v = eq.SlopeVariables(None, rng.uniform(150, 500) + rig.axial_shift, p, q)
        image = np.stack(eq.image_point(np, setup, *eq.spot_point_in_slopes(np, v, setup, theta)), axis=1)
        pixels = rig.from_laser_plane(image) + PIXEL_SIGMA * rng.standard_normal((n, 2))
        made.append(Spot(pixels, None if sigma is None else np.full(n, sigma)))
    return made


def setup_of(rig: Rig) -> eq.Setup:
    return eq.Setup(rig.focal_length, *rig.laser_offset, rig.require_beam().radius)


CASES: dict[str, tuple[Callable[[Rig], Rig], float | None, float]] = {
    "solve_batch, covariance of 13": (lambda rig: rig, PIXEL_SIGMA, 1.0),
    "solve_batch, no covariance": (lambda rig: replace(rig, covariance=None), PIXEL_SIGMA, 1.0),
    "solve_batch, covariance of 13, no sigma": (lambda rig: rig, None, 1.0),
    "solve_batch, covariance of 13, half the arc": (lambda rig: rig, PIXEL_SIGMA, 0.5),
    "solve_batch, covariance of 13, rig off by a draw from it": (drawn, PIXEL_SIGMA, 1.0),
}


@pytest.mark.parametrize("name", CASES)
def test_from_pixels_at_once(benchmark: BenchmarkFixture, name: str) -> None:
    change, sigma, share = CASES[name]
    true = calibrated()
    given, rig = seen(true, MANY, sigma, share), change(true)
    found = benchmark(po.solve_batch, given, rig)
    benchmark.group = GROUP
    benchmark.extra_info["what"] = name
    benchmark.extra_info["each"] = MANY
    assert found.ok.all()
    assert np.isfinite(found.covariance).all()


@pytest.mark.parametrize("exact", [True, False], ids=["exact", "plain"])
def test_from_pixels_one_by_one(benchmark: BenchmarkFixture, exact: bool) -> None:
    rig = calibrated()
    given = seen(rig, FEW)
    planes = benchmark(scipy_loop, given, rig, exact)
    benchmark.group = GROUP
    benchmark.extra_info["what"] = "SciPy least_squares" if exact else "SciPy least_squares, plain"
    benchmark.extra_info["each"] = FEW
    found = po.solve_batch(given, rig)
    error = planes - found.planes
    squared = np.sum(error * np.linalg.solve(found.spot_covariance, error[..., None])[..., 0], axis=-1)
    # First-order distances are off by the noise over the spot's size.
    assert np.max(squared) < (1e-3**2 if exact else 0.1**2)


def test_the_ratio() -> None:
    """At once and one by one in turns, processor time, best of five: what is claimed, with both kinds of rig."""
    rig = calibrated()
    given = seen(rig, MANY)
    loop = fastest(lambda: scipy_loop(given[:FEW], rig, True)) / FEW
    for used in (rig, replace(rig, covariance=None)):
        at_once = fastest(lambda used=used: po.solve_batch(given, used)) / MANY
        assert loop / at_once >= 10, f"{1 / at_once:.0f} and {1 / loop:.0f} planes a second"


def test_lengths_do_not_matter() -> None:
    """Spots of 190 to 208 points, as images give them, cost no more than a third above equally many of 200."""
    rig = calibrated()
    longest, counts = seen(rig, MANY, n=208), np.random.default_rng(3).integers(190, 209, MANY)
    mixed = []
    for spot, n in zip(longest, counts.tolist(), strict=True):
        assert spot.sigma is not None
        mixed.append(Spot(spot.points[:n], spot.sigma[:n]))
    equal = seen(rig, MANY)
    assert fastest(lambda: po.solve_batch(mixed, rig)) < 4 / 3 * fastest(lambda: po.solve_batch(equal, rig))


def fastest(run: Callable[[], object]) -> float:
    """Processor time of the best of five runs, s."""
    times = []
    for _ in range(5):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return min(times)


def scipy_loop(given: Sequence[Spot], rig: Rig, exact: bool) -> Array:
    """Planes ``(z_L along the beam, p, q)`` of spots, one by one."""
    setup, planes = setup_of(rig), []
    for spot in given:
        mm, jacobian = rig.to_laser_plane(spot.points)
        assert spot.sigma is not None
        noise = jacobian @ np.swapaxes(jacobian, 1, 2) * (spot.sigma**2)[:, None, None]
        planes.append((minimise if exact else minimise_plainly)(mm, noise, setup))
    return np.array(planes) - [rig.axial_shift, 0.0, 0.0]


def minimise(spot: Array, noise: Array | float = SIGMA, setup: eq.Setup = SETUP) -> Array:
    """One spot's plane, from the closed form of Taubin's fit; distances and derivatives are computed together."""
    start = solve_both(fit_conic(spot, noise, "taubin").B, setup).visible
    derivatives: dict[bytes, Array] = {}

    def residuals(plane: Array) -> Array:
        found, derivatives[plane.tobytes()] = distances_and_derivatives(plane, spot, noise, setup)
        return found

    def jacobian(plane: Array) -> Array:
        return derivatives[plane.tobytes()]

    search: Any = scipy.optimize.least_squares
    return np.asarray(search(residuals, start, jacobian, x_scale=np.array([start[0], 1.0, 1.0])).x)


def minimise_plainly(spot: Array, noise: Array, setup: eq.Setup) -> Array:
    """One spot's plane by differences of first-order distances."""
    start = solve_both(fit_conic(spot, noise, "taubin").B, setup).visible

    def residuals(plane: Array) -> Array:
        b = np.array(eq.image_conic_in_slopes(np, eq.SlopeVariables(None, *plane), setup))
        return np.asarray(sampson_distances(b[1:] / b[0], spot, noise), dtype=float)

    search: Any = scipy.optimize.least_squares
    return np.asarray(search(residuals, start, x_scale=np.array([start[0], 1.0, 1.0])).x)


def check(planes: Array, covariance: Array) -> None:
    """All planes within what chance allows a thousand of them: a squared distance of 40 has p = 1e-8."""
    error = planes - TRUTH
    assert np.max(np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1)) < 40
