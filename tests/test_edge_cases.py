"""Spots at the edge of what can be answered: each has a sensible answer, or one clear line, all the way through."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

import planeopt as po
from cases import Array
from planeopt.errors import InputError
from planeopt.estimation import solve, solve_batch
from planeopt.plane import SpotPose
from planeopt.posterior import Posterior, sample_posterior
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from planeopt.solution import Solution
from studies.coverage_draws import Truth, draw_spot

RIG = Rig(
    Camera((1280, 960), 2000.0, 2000.0, 640.0, 480.0, (-0.1, 0.05, 0.0, 0.0, 0.0)),
    Beam(6.0, (20.0, 15.0), (0.0, 0.0, 1.0)),
)
Z_L = 200.0


# The second plane that fits a spot is tilted by about 2 z_L / |e| against the first.
FAR_BEAM = replace(RIG, beam=Beam(6.0, (80.0, 60.0), (0.0, 0.0, 1.0)))
NO_NOISE = 1e-12  # px: a spot refuses a sigma of 0


def spot(
    alpha_deg: float, *, points: int = 60, sigma_px: float = 0.2, sigma: float | None = 0.2, rig: Rig = RIG
) -> po.Spot:
    """A spot on a tilted plane, with noise, and the sigma that is said of it."""
    slope = math.tan(math.radians(alpha_deg))
    truth = Truth(rig, (Z_L, -0.6 * slope, 0.8 * slope))
    drawn = draw_spot(truth, arc=1.0, points=points, sigma_px=sigma_px, rng=np.random.default_rng(5))
    return replace(drawn, sigma=None if sigma is None else np.full(points, sigma))


@dataclass(frozen=True)
class Answer:
    solution: Solution
    row: Solution
    posterior: Posterior


def answer(given: po.Spot, rig: Rig = RIG, *, both_sides: bool = False) -> Answer:
    """Solve alone and in a batch, and sample."""
    solution, row = solve(given, rig), solve_batch([given], rig).row(0)
    return Answer(solution, row, sample_posterior(given, rig, budget=200, both_sides=both_sides))


def near(found: Answer, alpha_deg: float) -> None:
    """The tilt is within 5 own sigmas, by a root-mean-square of the slopes; both solutions are one."""
    assert found.solution.pose is not None
    assert found.row.pose is not None
    assert found.solution.covariance is not None
    assert found.row.pose.z_L == pytest.approx(found.solution.pose.z_L, abs=1e-3)
    slope = math.tan(math.radians(alpha_deg))
    error = np.array(found.solution.pose.slopes) - [-0.6 * slope, 0.8 * slope]
    assert error @ np.linalg.solve(found.solution.covariance[1:, 1:], error) < 25
    medians = np.median(found.posterior.samples, axis=0)
    spread = np.std(found.posterior.samples, axis=0)
    assert np.all(np.abs(medians - [Z_L, -0.6 * slope, 0.8 * slope]) < 5 * spread)


def untilted(found: Answer) -> None:
    near(found, 0.0)
    assert found.posterior.summary("beta") is None
    alpha = found.posterior.summary("alpha")
    assert alpha is not None
    # It cannot be 0 itself, but what is said of it begins near there.
    assert alpha.low95 < alpha.median < math.radians(1.0)


def steep(found: Answer) -> None:
    near(found, 75.0)


def two_modes(found: Answer) -> None:
    first, second = found.posterior.modes
    assert first.weight + second.weight == pytest.approx(1.0)
    assert min(first.weight, second.weight) > 0
    assert {first.lit_side, second.lit_side} == {True, False}
    assert np.linalg.norm(first.plane - second.plane) > 0.1


def five_points(found: Answer) -> None:
    near(found, 30.0)


ANSWERS: dict[str, tuple[Callable[[], Answer], Callable[[Answer], None]]] = {
    "alpha 0": (lambda: answer(spot(0.0)), untilted),
    "tilt 75 deg": (lambda: answer(spot(75.0)), steep),
    "two modes": (lambda: answer(spot(30.0, rig=FAR_BEAM), FAR_BEAM, both_sides=True), two_modes),
    "no noise, and a sigma of none": (
        lambda: answer(spot(30.0, sigma_px=NO_NOISE, sigma=NO_NOISE)),
        lambda found: near(found, 30.0),
    ),
    "five points": (lambda: answer(spot(30.0, points=5)), five_points),
    "no noise, and a sigma": (lambda: answer(spot(30.0, sigma_px=NO_NOISE)), lambda found: near(found, 30.0)),
    "no noise, and no sigma": (
        lambda: answer(spot(30.0, sigma_px=NO_NOISE, sigma=None)),
        lambda found: near(found, 30.0),
    ),
    "rig uncertain": (
        lambda: answer(spot(30.0), replace(RIG, covariance=RigCovariance(("e_x", "e_y"), 1e-4 * np.eye(2)))),
        lambda found: near(found, 30.0),
    ),
}


@pytest.mark.parametrize("case", ANSWERS)
def test_it_is_answered(case: str) -> None:
    make, holds = ANSWERS[case]
    found = make()
    holds(found)
    for values in (found.posterior.samples, found.posterior.covariance):
        assert np.isfinite(values).all()


def covariance(matrix: Array) -> Rig:
    return replace(RIG, covariance=RigCovariance(("e_x", "e_y"), matrix))


REFUSALS: dict[str, tuple[Callable[[], object], str]] = {
    "zero sigma": (lambda: spot(30.0, sigma=0.0), "sigma must be positive"),
    "four points": (lambda: spot(30.0, points=4), "at least 5 points"),
    "five points, no sigma": (
        lambda: sample_posterior(spot(30.0, points=5, sigma=None), RIG),
        "five points leave nothing to estimate their noise from: give sigma_px",
    ),
    "covariance not positive definite": (
        lambda: covariance(np.array([[1.0, 2.0], [2.0, 1.0]])),
        "covariance.matrix must be positive definite",
    ),
    "negative variance": (
        lambda: covariance(np.diag([1.0, -1.0])),
        "covariance.matrix must be positive definite, but the variance of e_y is -1",
    ),
    "points on a line": (
        lambda: sample_posterior(po.Spot(np.stack([np.arange(8.0), np.arange(8.0)], axis=1), np.full(8, 0.2)), RIG),
        "lie on a straight line",
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_it_is_refused_in_one_line(case: str) -> None:
    ask, line = REFUSALS[case]
    with pytest.raises(InputError) as refusal:
        ask()
    assert line in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_spot_pose_of_no_tilt_has_no_beta() -> None:
    assert SpotPose.from_slopes(Z_L, 0.0, 0.0, 6.0).beta is None
