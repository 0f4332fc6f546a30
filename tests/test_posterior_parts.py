"""The parts of the sampler against what is known about them: distances, moves, autocorrelation, summaries."""

import math

import emcee
import numpy as np
import pytest

from cases import Array
from planeopt import equations as eq
from planeopt.conic import sampson_distances
from planeopt.estimation.distances import distances
from planeopt.estimation.rig_part import sensitivity
from planeopt.formulations import Problem
from planeopt.posterior import Likelihood, Prior
from planeopt.posterior.diagnostics import autocorrelation_time, split_r_hat
from planeopt.posterior.kernel import Kernel, conic_by_monomials, monomials
from planeopt.posterior.moves import SnookerMove
from planeopt.posterior.proposal import climb
from planeopt.posterior.summary import circular_interval, cone, intercept_interval, interval, variance_split
from planeopt.posterior.target import Target
from posterior_cases import SETUP, seen, spot_through, uncertain_rig

PLANES = np.array([[240.0, -0.39, 0.38], [180.0, 0.0, 0.0], [600.0, 2.5, -3.0], [150.0, -4.0, 1.0]])


def test_conic_by_monomials_is_equation_6() -> None:
    found = monomials(PLANES) @ conic_by_monomials(SETUP)
    expected = np.array(
        [eq.image_conic_in_slopes(np, eq.SlopeVariables(None, *plane), SETUP) for plane in PLANES], dtype=float
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize(("sigma_px", "order"), [(4.0, 3), (0.4, 3)])
def test_distances_are_orthogonal_up_to_third_order(sigma_px: float, order: int) -> None:
    """Twice the noise: eight times the difference, in mm, from the exact distance; Sampson's would be four times."""
    exact = seen(sigma_px=1e-4).points
    assert exact is not None
    rng = np.random.default_rng(1)
    offsets, shape = rng.standard_normal(exact.shape), np.array([[1.0, 0.3], [0.3, 0.8]])
    differences, first_order = [], []
    for sigma in (sigma_px * 0.0055, 2 * sigma_px * 0.0055):
        points, noise = exact + sigma * offsets, np.broadcast_to(sigma**2 * shape, (len(exact), 2, 2))
        plane = np.array([240.0, -math.tan(0.5) * math.sin(0.8), math.tan(0.5) * math.cos(0.8)])
        orthogonal = distances(plane, points, noise, SETUP)
        b = np.array(eq.image_conic_in_slopes(np, eq.SlopeVariables(None, *plane), SETUP))
        ours, _ = Kernel.of(points, noise, SETUP).distances(plane[None])
        differences.append(sigma * np.sqrt(np.mean((ours[0] - orthogonal) ** 2)))
        first_order.append(sigma * np.sqrt(np.mean((sampson_distances(b[1:] / b[0], points, noise) - orthogonal) ** 2)))
    assert math.log2(differences[1] / differences[0]) == pytest.approx(order, abs=0.5)
    assert math.log2(first_order[1] / first_order[0]) == pytest.approx(2, abs=0.3)
    assert differences[1] < 0.2 * first_order[1]


def test_derivatives_by_the_rig_are_the_solvers_and_numerical_ones() -> None:
    """At exact points, where the derivative of the noise of (16) drops out: two derivations of one Jacobian."""
    rig = uncertain_rig()
    problem = Problem.from_spot(spot_through(rig, 1e-3), rig)
    plane = np.array([250.0 + rig.axial_shift, 0.35, -0.5])
    part = Likelihood.of(problem).rig
    assert part is not None
    distance, found = part.distances(plane[None], np.zeros((1, part.size)))
    expected = sensitivity(problem, rig, plane).residual_by_rig @ part.root
    # A secant over a tenth of a standard deviation and noise of 1e-3 px leave three digits.
    np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-3 * np.abs(expected).max(axis=0).min())
    step = 1e-4
    moved = [part.distances(np.repeat(plane[None], part.size, 0), s * np.eye(part.size))[0] for s in (step, -step)]
    numeric = ((moved[0] - moved[1]) / (2 * step)).T
    np.testing.assert_allclose(found[0], numeric, rtol=0, atol=1e-2 * np.abs(numeric).max())
    assert problem.points is not None
    assert problem.noise is not None
    at_rest, _ = Kernel.of(problem.points, problem.noise, problem.setup).distances(plane[None])
    np.testing.assert_allclose(distance, at_rest, atol=1e-6 * np.abs(at_rest).max())


def test_mirrored_plane_has_the_same_image_and_the_stated_jacobian() -> None:
    target = Target(Likelihood.of(seen(sigma_px=1.0)), Prior(), both_sides=True)
    theta = np.column_stack([np.log(PLANES[:, 0]), PLANES[:, 1:]])
    image, log_jacobian = target.mirrored(theta)
    back, log_inverse = target.mirrored(image)
    np.testing.assert_allclose(back, theta, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(log_jacobian, -log_inverse, atol=1e-10)
    np.testing.assert_allclose(
        target.likelihood(target.planes(theta)), target.likelihood(target.planes(image)), rtol=1e-8
    )
    step = 1e-6
    for row, size in zip(theta, log_jacobian, strict=True):
        moved = [(target.mirrored(row + s * np.eye(3))[0]) for s in (step, -step)]
        assert math.log(abs(np.linalg.det((moved[0] - moved[1]) / (2 * step)))) == pytest.approx(size, abs=1e-5)


def test_snooker_move_alone_samples_a_normal_law() -> None:
    """The mean square length of normal vectors in 3-D is 3; its standard error follows from its autocorrelation."""
    scale = np.array([1.0, 3.0, 0.2])
    sampler = emcee.EnsembleSampler(
        40, 3, lambda x: -0.5 * np.sum((x / scale) ** 2, axis=1), vectorize=True, moves=SnookerMove()
    )
    random = np.random.RandomState(1)
    sampler.run_mcmc(emcee.State(random.randn(40, 3) * scale, random_state=random.get_state()), 2500)
    chain = np.asarray(sampler.get_chain())[200:] / scale
    square = np.sum(chain**2, axis=2, keepdims=True)
    error = math.sqrt(np.var(square) * autocorrelation_time(square) / square.size)
    # emcee's own is off by 0.25.
    assert error < 0.06
    assert abs(np.mean(square) - 3) < 4 * error


def test_climb_finds_a_normal_peak_and_its_width_from_a_bad_guess() -> None:
    covariance = np.array([[4.0, 1.9, 0.0], [1.9, 1.0, 0.001], [0.0, 0.001, 1e-4]])
    centre, information = np.array([3.0, -2.0, 0.5]), np.linalg.inv(covariance)
    peak = climb(
        lambda x: -0.5 * np.einsum("wi,ij,wj->w", x - centre, information, x - centre), np.zeros(3), 0.05 * np.eye(3)
    )
    assert peak.curved
    np.testing.assert_allclose(peak.centre, centre, atol=1e-5)
    np.testing.assert_allclose(peak.covariance, covariance, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_autocorrelation_time_of_a_known_process(rho: float) -> None:
    """An AR(1) process has (1 + rho)/(1 - rho); a window of 5 tau in 40 chains knows it to a tenth."""
    rng = np.random.default_rng(2)
    steps, walkers = 4000, 40
    chain = np.empty((steps, walkers, 1))
    chain[0] = rng.standard_normal((walkers, 1))
    for i in range(1, steps):
        chain[i] = rho * chain[i - 1] + math.sqrt(1 - rho**2) * rng.standard_normal((walkers, 1))
    assert autocorrelation_time(chain) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)
    assert split_r_hat(chain) == pytest.approx(1, abs=0.02)
    assert split_r_hat(chain + np.linspace(0, 3, steps)[:, None, None]) > 1.2


def test_summaries_of_known_draws() -> None:
    n = 200_001
    ends = interval(np.linspace(0, 1, n))
    assert (ends.median, ends.low68, ends.high68, ends.low95, ends.high95) == pytest.approx(
        (0.5, 0.16, 0.84, 0.025, 0.975), abs=1e-5
    )
    # A direction about pi: the mean of the numbers would be 0.
    turned = circular_interval(np.remainder(np.pi + np.linspace(-0.2, 0.2, n) + np.pi, 2 * np.pi) - np.pi)
    assert abs(turned.median) == pytest.approx(np.pi, abs=1e-4)
    assert turned.low95 == pytest.approx(np.pi - 0.19, abs=1e-4)
    assert turned.high95 == pytest.approx(-np.pi + 0.19, abs=1e-4)
    assert intercept_interval(1 / np.linspace(-0.5, 1.0, n)) is None
    negative = intercept_interval(1 / np.linspace(-2.0, -1.0, n))
    assert negative is not None
    assert negative.low95 < negative.low68 < negative.median < negative.high68 < negative.high95


def test_cone_of_a_normal_law_of_directions() -> None:
    """The angle is Rayleigh: 68 and 95 % lie within sigma sqrt(-2 ln(1 - P))."""
    sigma, n = 1e-3, 200_000
    tangent = sigma * np.random.default_rng(3).standard_normal((n, 2))
    normals = np.column_stack([tangent, np.ones(n)])
    found = cone(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    np.testing.assert_allclose(found.axis, [0, 0, 1], atol=5 * sigma / math.sqrt(n))
    assert found.radius68 == pytest.approx(sigma * math.sqrt(-2 * math.log(0.32)), rel=0.01)
    assert found.radius95 == pytest.approx(sigma * math.sqrt(-2 * math.log(0.05)), rel=0.01)


def test_split_of_a_known_mixture() -> None:
    rng = np.random.default_rng(4)
    rig: Array = rng.standard_normal((4000, 5)) * [1e3, 1, 1, 1e-3, 1]
    values = 3.0 * rig[:, 1] + 4.0 * rng.standard_normal(4000)
    parts = variance_split(values, rig)
    assert parts.spot == pytest.approx(4, rel=0.05)
    assert parts.calibration == pytest.approx(3, rel=0.07)
    assert variance_split(values, np.empty((4000, 0))).calibration == 0
