"""The rig's uncertainty in the posterior: integrated out to first order, proved against the rig itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from cases import Array
from planeopt import InputError, sample_posterior
from planeopt.estimation.distances import distances
from planeopt.estimation.rig_part import sensitivity
from planeopt.formulations import Problem
from planeopt.posterior import Likelihood, Posterior
from planeopt.rig import Rig, RigCovariance
from planeopt.spot import Spot
from posterior_cases import (
    LEVEL,
    PARAMETERS,
    SIGMAS,
    TRUE_POSE,
    along,
    same_law,
    spot_through,
    uncertain_rig,
    without_covariance,
)

TRUTH = np.array([TRUE_POSE.z_L, *TRUE_POSE.slopes])


def log_densities(posterior: Posterior, spot: Spot, rig: Rig, n: int) -> tuple[Array, Array]:
    """Of each of n draws of plane and rig: by its own rig, pixels undistorted and turned anew, orthogonal distances,
    and the calibration's law; and by the law that the sampler drew it from. The prior, in both, is left out.
    """
    problem = Problem.from_spot(spot, rig)
    likelihood = Likelihood.of(problem)
    assert likelihood.rig is not None
    exact, planes = [], []
    drawn = np.linalg.solve(likelihood.rig.root, (posterior.rig_samples[:n] - likelihood.rig.nominal).T).T
    for sample, parameters, z in zip(posterior.samples[:n], posterior.rig_samples[:n], drawn, strict=True):
        other = rig.with_parameters(dict(zip(posterior.rig_parameters, parameters.tolist(), strict=True)))
        there = Problem.from_spot(spot, other)
        assert there.points is not None
        assert there.noise is not None
        planes.append(along(sample, other))
        rho = distances(planes[-1], there.points, there.noise, there.setup)
        exact.append(-0.5 * (rho @ rho + z @ z))
    mean, information = likelihood.rig_given(np.array(planes))
    off = drawn - mean
    given = 0.5 * np.linalg.slogdet(information)[1] - 0.5 * np.einsum("wi,wij,wj->w", off, information, off)
    return np.array(exact), likelihood(np.array(planes)) + given


def seen_by_another_rig(rig: Rig, sigma_px: float, z_L: float, seed: int) -> Spot:
    """A spot as a rig drawn from the calibration's covariance sees it: the nominal one is off by about a sigma."""
    assert rig.covariance is not None
    rng = np.random.default_rng(seed)
    nominal = np.array([rig.parameter(name) for name in PARAMETERS])
    values = nominal + np.linalg.cholesky(rig.covariance.matrix) @ rng.standard_normal(len(PARAMETERS))
    return spot_through(rig.with_parameters(dict(zip(PARAMETERS, values.tolist(), strict=True))), sigma_px, z_L=z_L)


@pytest.mark.parametrize(("sigma_px", "z_L"), [(0.05, 250.0), (0.5, 250.0), (0.1, 1200.0)])
def test_joint_draws_are_those_of_the_true_rig(sigma_px: float, z_L: float) -> None:
    """Each draw of plane and rig is weighed again by the likelihood of its own rig, without any approximation.

    Were the rig integrated out wrongly, the weights would be far from equal and the weighted moments elsewhere. The
    principal point is uncertain by a pixel; the spot's radius is 75 px, or 15 px, where the square of one over the
    other is as large as the noise. Effective draws of 300: at least 90 %; moments by no more than chance moves them.
    """
    rig = uncertain_rig()
    spot = seen_by_another_rig(rig, sigma_px, z_L, seed=11)
    posterior, n = sample_posterior(spot, rig, seed=1, draws=400), 300
    exact, drawn_from = log_densities(posterior, spot, rig, n)
    weights = np.exp(exact - drawn_from - np.max(exact - drawn_from))
    weights /= np.sum(weights)
    assert 1 / np.sum(weights**2) > 0.9 * n
    for values in (*posterior.samples[:n].T, posterior.quantities["R"][:n], *posterior.rig_samples[:n].T):
        spread = np.std(values)
        mean = weights @ values
        # Weights of relative variance 0.1 move a mean by a third of its standard error.
        assert abs(mean - np.mean(values)) < 4 * math.sqrt(0.1 / n) * spread
        assert math.sqrt(weights @ (values - mean) ** 2) == pytest.approx(spread, rel=4 * math.sqrt(0.1 * 2 / n))


def test_rigs_given_the_plane_and_planes_given_the_rig() -> None:
    """The two ways through the joint law agree: the plane's mean moves with the drawn rig as the solver's does.

    The regression of the plane on the rig's parameters is the solver's own derivative, `Sensitivity.plane_by_rig`.
    """
    rig, sigma_px = uncertain_rig(), 0.5
    spot = spot_through(rig, sigma_px)
    posterior = sample_posterior(spot, rig, seed=2, draws=4000)
    problem = Problem.from_spot(spot, rig)
    effect = sensitivity(problem, rig, along(TRUTH, rig))
    centred = (posterior.rig_samples - np.mean(posterior.rig_samples, axis=0)) / SIGMAS
    given_rig = posterior.samples - posterior.rig_samples @ effect.plane_by_rig.T
    given_rig -= np.mean(given_rig, axis=0)
    assert posterior.laplace is not None
    limit = float(scipy.stats.norm.isf(LEVEL / 2 / (3 * len(PARAMETERS))))
    for column in range(3):
        sigma = math.sqrt(posterior.laplace.spot[column, column])
        # What is left is the spot's part, and does not depend on the rig.
        assert np.std(given_rig[:, column]) == pytest.approx(sigma, rel=0.1)
        slopes, *_ = np.linalg.lstsq(centred, given_rig[:, column], rcond=None)
        errors = sigma * np.sqrt(np.diagonal(np.linalg.inv(centred.T @ centred)) * 1.31)
        assert np.max(np.abs(slopes) / errors) < limit


def test_split_is_that_of_the_first_order_law() -> None:
    rig = uncertain_rig()
    posterior = sample_posterior(spot_through(rig, 0.5), rig, seed=3, draws=4000)
    assert posterior.laplace is not None
    assert posterior.agrees
    for column, name in enumerate(("z_L", "p", "q")):
        part = posterior.split[name]
        assert part.spot == pytest.approx(math.sqrt(posterior.laplace.spot[column, column]), rel=0.1)
        assert part.calibration == pytest.approx(math.sqrt(posterior.laplace.rig[column, column]), rel=0.1)
        assert part.spot**2 + part.calibration**2 == pytest.approx(posterior.covariance[column, column], rel=1e-9)
    total = posterior.split["normal"]
    assert math.hypot(total.spot, total.calibration) == pytest.approx(
        math.sqrt(np.trace(np.cov(posterior.normals, rowvar=False))), rel=1e-9
    )
    depth = posterior.split["z_L"]
    assert depth.share > 0.5


def test_conditioned_on_the_rig_it_is_a_rig_without_covariance() -> None:
    rig = uncertain_rig()
    spot = spot_through(rig, 0.5)
    conditioned = sample_posterior(spot, rig, seed=4, draws=400, condition_on_rig=True)
    without = sample_posterior(spot, without_covariance(rig), seed=4, draws=400)
    assert conditioned.samples.tobytes() == without.samples.tobytes()
    assert conditioned.rig_samples.shape == (len(conditioned), 0)
    assert conditioned.rig_parameters == ()
    assert conditioned.split["z_L"].calibration == 0


def test_a_rig_known_nearly_exactly_changes_nothing() -> None:
    rig = uncertain_rig()
    assert rig.covariance is not None
    sure = replace(rig, covariance=RigCovariance(PARAMETERS, 1e-8 * rig.covariance.matrix))
    spot = spot_through(rig, 0.5)
    one = sample_posterior(spot, sure, seed=5, draws=2000)
    other = sample_posterior(spot, rig, seed=6, draws=2000, condition_on_rig=True)
    for column in range(3):
        assert same_law(one.samples[:, column], other.samples[:, column]) > LEVEL / 3


def test_student_t_of_many_degrees_of_freedom_is_normal_with_an_uncertain_rig_too() -> None:
    """The two ways to the likeliest rig, of seven steps and of one, agree to what the one leaves: some 1e-3."""
    rig = uncertain_rig()
    problem = Problem.from_spot(spot_through(rig, 0.1), rig)
    normal, student = (Likelihood.of(problem, robust=dof) for dof in (None, 1e9))
    draws = sample_posterior(spot_through(rig, 0.1), rig, seed=7, draws=200).samples[:50]
    planes = along(draws, rig)
    one, other = normal(planes), student(planes)
    np.testing.assert_allclose(one - one[0], other - other[0], rtol=0, atol=5e-3)


def test_robust_with_an_uncertain_rig_leaves_outliers_aside() -> None:
    rig = uncertain_rig()
    clean = spot_through(rig, 0.1)
    points = clean.points.copy()
    points[::10] += 5.0
    spoilt = Spot(points, clean.sigma)
    robust = sample_posterior(spoilt, rig, seed=8, robust=3.0, draws=1000)
    reference = sample_posterior(clean, rig, seed=8, draws=1000)
    spread = np.std(reference.samples, axis=0)
    assert np.all(np.abs(np.mean(robust.samples, axis=0) - np.mean(reference.samples, axis=0)) < 2 * spread)
    assert np.all(np.std(robust.samples, axis=0) < 2 * spread)


def test_unknown_noise_and_an_uncertain_rig_together() -> None:
    """The noise's scale is sampled with the plane; at its estimate it changes little."""
    rig = uncertain_rig()
    known = spot_through(rig, 0.3)
    unknown = sample_posterior(Spot(known.points), rig, seed=9, draws=1500)
    reference = sample_posterior(known, rig, seed=9, draws=1500)
    scale = unknown.summary("noise_scale")
    assert scale is not None
    assert scale.low95 < 1 < scale.high95
    ratio = np.std(unknown.samples, axis=0) / np.std(reference.samples, axis=0)
    # 55 degrees of freedom know sigma to 10 %.
    assert np.all((ratio > 0.7) & (ratio < 1.4)), ratio


def test_a_covariance_that_is_none_is_one_clear_line() -> None:
    matrix = np.diag(SIGMAS**2)
    matrix[0, 1] = matrix[1, 0] = 2.0
    with pytest.raises(InputError, match="positive definite") as refusal:
        RigCovariance(PARAMETERS, matrix)
    assert "\n" not in str(refusal.value)


def test_the_drawn_rigs_are_no_wider_than_the_calibration() -> None:
    """The image adds what it knows: along no direction does a rig become less certain than before."""
    rig = uncertain_rig()
    assert rig.covariance is not None
    posterior = sample_posterior(spot_through(rig, 0.1), rig, seed=10, draws=2000)
    root = np.linalg.cholesky(rig.covariance.matrix)
    whitened = np.linalg.solve(root, (posterior.rig_samples - [rig.parameter(name) for name in PARAMETERS]).T)
    sizes = np.linalg.eigvalsh(np.cov(whitened))
    # The largest of eight sample variances of 1 from 2000 draws stays below 1.2.
    assert sizes[-1] < 1.2
    assert sizes[0] < 0.1
