"""Edge cases of the posterior: each a sensible answer or one clear line."""

import math

import numpy as np
import pytest

from cases import Array
from example_rig import example_rig, pose_at, spot_of
from planeopt import InputError, Prior, sample_posterior
from planeopt import equations as eq
from planeopt.formulations import Problem
from planeopt.posterior import Posterior, Stop, sample_problem
from planeopt.solution import Flag
from posterior_cases import SETUP, seen


@pytest.mark.parametrize("sigma_px", [0.05, 1.0])
def test_untilted_plane_has_no_beta(sigma_px: float) -> None:
    posterior = sample_problem(seen(alpha=0.0, sigma_px=sigma_px), draws=1000)
    assert posterior.summary("beta") is None
    tilt = posterior.summary("alpha")
    assert tilt is not None
    assert tilt.low95 > 0
    assert posterior.summary("a") is None or posterior.summary("b") is None
    assert posterior.summary("c") is not None


def test_a_direction_across_half_a_turn_is_not_averaged_as_a_number() -> None:
    posterior = sample_problem(seen(beta=math.pi, sigma_px=0.2), draws=1000)
    direction = posterior.summary("beta")
    assert direction is not None
    assert abs(direction.median) > 3.0
    assert direction.low95 > 3.0
    assert direction.high95 < -3.0


@pytest.mark.parametrize("alpha_deg", [75.0, 84.0])
def test_steep_planes_cost_no_more(alpha_deg: float) -> None:
    posterior = sample_problem(seen(alpha=math.radians(alpha_deg), sigma_px=0.3), draws=1000)
    assert posterior.diagnostics.stopped is Stop.CONVERGED
    assert posterior.diagnostics.tau < 15
    tilt = posterior.summary("alpha")
    assert tilt is not None
    assert tilt.low95 - 0.01 < math.radians(alpha_deg) < tilt.high95 + 0.01


def test_five_points() -> None:
    posterior = sample_problem(seen(n=5), draws=500)
    depth = posterior.summary("z_L")
    assert depth is not None
    assert abs(depth.median - 240) < 2 * (depth.high95 - depth.low95)
    with pytest.raises(InputError, match="five points leave nothing to estimate their noise from") as refusal:
        sample_problem(seen(n=5, known=False))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("sigma", [1e-15, None])
def test_no_noise_at_all_is_set_to_a_floor(sigma: float | None) -> None:
    points = seen(sigma_px=0.0, known=False).points
    assert points is not None
    posterior = sample_problem(Problem.from_points(points, SETUP, sigma), draws=500)
    assert Flag.SCALE_AT_FLOOR in posterior.flags
    depth = posterior.summary("z_L")
    assert depth is not None
    assert depth.median == pytest.approx(240, abs=1e-4)
    assert 0 < depth.high95 - depth.low95 < 1e-3


def test_noise_as_large_as_the_spot_gives_back_the_prior_and_says_so() -> None:
    posterior = sample_problem(seen(sigma_px=20.0), draws=500)
    assert posterior.prior_dominated
    assert not posterior.agrees
    tilt = posterior.summary("alpha")
    assert tilt is not None
    assert tilt.high95 < Prior().max_tilt


@pytest.mark.parametrize("z_L", [100.0, 7000.0])
def test_a_prior_that_leaves_out_the_answer_is_one_clear_line(z_L: float) -> None:
    with pytest.raises(InputError, match="the prior leaves out every plane that the spot allows") as refusal:
        sample_problem(seen(z_L=z_L, sigma_px=0.01))
    assert "\n" not in str(refusal.value)
    assert f"{z_L / 6:.4g}"[:2] in str(refusal.value)
    assert sample_problem(seen(z_L=z_L, sigma_px=0.01), prior=Prior((5.0, 2000.0)), draws=200).samples.size


def test_a_posterior_cut_off_by_a_bound_is_sampled_all_the_same() -> None:
    """The likeliest plane is four sigmas outside: the proposals follow the posterior, not the likelihood's peak."""
    posterior = sample_problem(seen(z_L=119.0, sigma_px=0.5, arc=0.3), draws=300)
    assert posterior.diagnostics.stopped is Stop.CONVERGED
    assert posterior.diagnostics.tau < 60
    assert np.all(posterior.samples[:, 0] >= 120)
    assert posterior.prior_dominated
    assert "beyond the prior's bounds" in posterior.prior_effect.sentence


def test_beta_of_two_planes_is_not_lost_between_them() -> None:
    """Both are clearly tilted, in one direction; an ellipse over both together would hold the untilted plane."""
    setup = eq.Setup(12.0, 160.0, 120.0, 6.0)
    beta = math.atan2(-160.0, 120.0)
    problem = seen(z_L=300.0, alpha=0.3, beta=beta, sigma_px=0.1, setup=setup)
    posterior = sample_problem(problem, both_sides=True, draws=500)
    assert len(posterior.modes) == 2
    direction = posterior.summary("beta")
    assert direction is not None
    assert direction.median == pytest.approx(beta, abs=0.05)


class Narrow:
    """A user's own prior: tilts near 30 deg."""

    def sentence(self, radius: float) -> str:
        return f"The tilt is near 30 deg (r = {radius:g})."

    def log_density(self, planes: Array, setup: eq.Setup) -> Array:
        del setup
        tilt = np.arctan(np.hypot(planes[..., 1], planes[..., 2]))
        return -0.5 * ((tilt - math.radians(30)) / 0.01) ** 2


def test_another_prior() -> None:
    posterior = sample_problem(seen(alpha=0.5, sigma_px=3.0), prior=Narrow(), draws=1000)
    tilt = posterior.summary("alpha")
    assert tilt is not None
    assert math.degrees(tilt.median) == pytest.approx(30, abs=0.5)
    assert posterior.prior_dominated
    assert posterior.prior_sentence == "The tilt is near 30 deg (r = 6)."


class Broken(Narrow):
    def log_density(self, planes: Array, setup: eq.Setup) -> Array:
        return super().log_density(planes, setup) * np.nan


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"robust": 0.0}, "robust must be"),
        ({"robust": math.inf}, "robust must be"),
        ({"draws": 0}, "draws must be"),
        ({"budget": 0}, "budget must be"),
        ({"seed": -1}, "seed must be"),
        ({"prior": Broken()}, "log density must be a number"),
    ],
)
def test_options_that_make_no_sense_are_one_line(wrong: dict[str, object], line: str) -> None:
    with pytest.raises(InputError, match=line):
        sample_problem(seen(), **wrong)  # pyright: ignore[reportArgumentType] - the point of the test


def test_an_ellipse_without_its_points_is_refused() -> None:
    problem = seen()
    with pytest.raises(InputError, match="boundary points"):
        sample_problem(Problem.from_conic(problem.B, problem.B_factor @ problem.B_factor.T, SETUP))


def test_quantities_belong_together() -> None:
    """Every draw is one plane: the paper's relations hold for each."""
    posterior: Posterior = sample_posterior(spot_of(pose_at()), example_rig(), draws=300)
    rig, of = example_rig(), posterior.quantities
    normals, points = rig.plane_arrays(*posterior.samples.T)
    np.testing.assert_allclose(posterior.normals, normals, atol=1e-12)
    np.testing.assert_allclose(of["R"], rig.require_beam().radius / np.cos(of["alpha"]), rtol=1e-12)
    np.testing.assert_allclose(of["p"], -np.tan(of["alpha"]) * np.sin(of["beta"]), atol=1e-12)
    for axis, name in enumerate("abc"):
        np.testing.assert_allclose(of[name] * normals[:, axis], np.sum(normals * points, axis=1), rtol=1e-9)
