"""The rig checks itself over many images: the law of the pooled statistic, what it finds, what it cannot see."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from cases import Array
from example_rig import pose_at
from frames import NAMES, outline, uncertain_rig
from planeopt.errors import InputError
from planeopt.estimation import solve, solve_batch
from planeopt.estimation.drift import BLIND, Part, State, drift
from planeopt.formulations import AsPrinted
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig
from planeopt.solution import RigTest, Solution
from planeopt.spot import Spot

NOISE = 0.05
FAMILY = 0.001

POSES = tuple(
    pose_at(z_L, alpha, beta)
    for z_L, alpha, beta in ((180, 0.2, 0.8), (240, 0.6, -2.0), (300, 0.9, 2.5), (220, 0.5, -0.4), (260, 0.3, 1.7))
)


def drawn_rig(rig: Rig, rng: np.random.Generator) -> Rig:
    """A rig drawn from the covariance."""
    assert rig.covariance is not None
    nominal = np.array([rig.parameter(name) for name in NAMES])
    values = nominal + np.linalg.cholesky(rig.covariance.matrix) @ rng.normal(size=len(NAMES))
    return replace(rig, covariance=None).with_parameters(dict(zip(NAMES, values.tolist(), strict=True)))


def planes(rig: Rig, poses: tuple[SpotPose, ...] = POSES) -> list[Plane]:
    return [rig.plane_from_pose(pose) for pose in poses]


def seen_by(true: Rig, file: Rig, where: list[Plane], rng: np.random.Generator, n: int = 40) -> list[Solution]:
    """What the rig of the file makes of images that the true rig takes."""
    spots = []
    for plane in where:
        pixels = outline(true, plane, n)
        spots.append(Spot(pixels + rng.normal(0, NOISE, pixels.shape), np.full(n, NOISE)))
    return list(solve_batch(spots, file))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return uncertain_rig()


@pytest.fixture(scope="module")
def solutions(rig: Rig) -> list[Solution]:
    return seen_by(rig, rig, planes(rig), np.random.default_rng(0))


def redrawn(solutions: list[Solution], rig: Rig, rng: np.random.Generator) -> list[Solution]:
    """The same images with misfits drawn anew: white, and one error of the rig, to first order."""
    assert rig.covariance is not None
    eta = np.linalg.cholesky(rig.covariance.matrix) @ rng.normal(size=len(NAMES))
    made = []
    for solution in solutions:
        test = solution.rig_test
        assert test is not None
        misfit = rng.normal(size=2) - test.by_rig @ eta
        covariance = np.eye(2) + test.by_rig @ rig.covariance.matrix @ test.by_rig.T
        chi2 = float(misfit @ np.linalg.solve(covariance, misfit))
        p_value = float(scipy.stats.chi2.sf(chi2, 2))
        made.append(replace(solution, rig_test=replace(test, misfit=misfit), chi2=chi2, p_value=p_value))
    return made


def test_every_part_has_its_law_though_the_rigs_error_is_common(solutions: list[Solution], rig: Rig) -> None:
    """Sums over 600 batches against chi-squared, two-sided at a family-wise 0.001 with those of uniform p-values.

    The sum of the images' own chi-squareds has the right mean and not the right law: its variance is larger.
    """
    rng = np.random.default_rng(1)
    batches = [redrawn(solutions, rig, rng) for _ in range(600)]
    results = [drift(batch, rig) for batch in batches]
    assert {tuple((test.part, test.dof) for test in result.tests) for result in results} == {
        ((Part.POOLED, 10), (Part.SHIFT, 4), (Part.TREND, 4), (Part.REST, 2))
    }
    share = FAMILY / 8
    for number in range(4):
        parts = [result.tests[number] for result in results]
        low, high = scipy.stats.chi2.ppf([share / 2, 1 - share / 2], parts[0].dof * len(parts))
        assert low < sum(part.chi2 for part in parts) < high, parts[0].part
        assert scipy.stats.kstest([part.p_value for part in parts], "uniform").pvalue > share
    naive = scipy.stats.chi2.sf([sum(solution.chi2 or 0 for solution in batch) for batch in batches], 10)
    assert scipy.stats.kstest(naive, "uniform").pvalue < 1e-6


def test_rigs_drawn_from_the_covariance_pass_from_points_to_verdict(rig: Rig) -> None:
    """The whole way with the true rig's curvature in it: pooled chi-squared over 60 rigs, two-sided at 0.001."""
    rng = np.random.default_rng(2)
    where = planes(rig, POSES[:4])
    results = [drift(seen_by(drawn_rig(rig, rng), rig, where, rng), rig) for _ in range(60)]
    low, high = scipy.stats.chi2.ppf([FAMILY / 2, 1 - FAMILY / 2], 8 * len(results))
    assert low < sum(result.chi2 or 0 for result in results) < high
    # At a level of 0.001 a rig, two or more of 60 have a probability of 0.002.
    assert sum(not result.ok for result in results) <= 2


def test_a_right_rig_is_ok_and_what_cannot_be_seen_is_said(solutions: list[Solution], rig: Rig) -> None:
    result = drift(solutions, rig)
    assert result.ok
    assert result.verdict.startswith("OK: ")
    assert result.images == (0, 1, 2, 3, 4)
    assert result.worst == ()
    assert result.blind == BLIND
    for words in ("focal length", "scale", "principal point", "board"):
        assert words in result.blind


def numbers(rig: Rig) -> Array:
    beam, camera = rig.require_beam(), rig.camera
    x, y, z = beam.direction
    offset = np.array(rig.laser_offset) / beam.radius
    return np.array([camera.cx + camera.fx * x / z, camera.cy + camera.fy * y / z, *offset])


def test_a_shifted_beam_is_found_and_measured(rig: Rig) -> None:
    """A change of 10 standard deviations of the calibration's; its four numbers come out within 4.5 of their own.

    With bounds at 4.5 one of four is beyond them with a probability of 3e-5.
    """
    true = rig.with_parameters({"direction_x": rig.parameter("direction_x") + 2e-3, "e_y": rig.parameter("e_y") + 0.4})
    result = drift(seen_by(true, rig, planes(rig), np.random.default_rng(3)), rig)
    assert result.state is State.DEGRADED
    assert result.verdict.startswith("DEGRADED: ")
    assert [test.part for test in result.tests if not test.ok][:2] == [Part.POOLED, Part.SHIFT]
    assert "vanishing point x by" in result.verdict
    expected = numbers(true) - numbers(rig)
    assert len(result.shift) == 4
    for change, truth in zip(result.shift, expected, strict=True):
        assert abs(change.value - truth) < 4.5 * change.sigma, change
    assert abs(result.shift[0].value) > 5 * result.shift[0].sigma


def test_a_beam_that_moves_along_the_sequence_is_a_trend(rig: Rig) -> None:
    """Centred on the rig file, and planes there and back: no shift. The trend's part fails, and its size comes out."""
    rng = np.random.default_rng(4)
    solutions, offsets = [], np.linspace(-0.5, 0.5, 10)
    for step, plane in zip(offsets, planes(rig, POSES + POSES[::-1]), strict=True):
        true = rig.with_parameters({"direction_y": rig.parameter("direction_y") + 3e-4 * step})
        solutions += seen_by(true, rig, [plane], rng)
    result = drift(solutions, rig, positions=100 + 7 * np.arange(10))
    assert [test.part for test in result.tests if not test.ok] == [Part.POOLED, Part.TREND]
    assert "moves along the sequence" in result.verdict
    change = result.trend[1]
    turned = rig.with_parameters({"direction_y": rig.parameter("direction_y") + 3e-4})
    assert change.value == pytest.approx((numbers(turned) - numbers(rig))[1], abs=4.5 * change.sigma)
    assert change.value > 3 * change.sigma


@pytest.mark.parametrize(
    "changes",
    [{"f": 1.02}, {"e_x": 1.03, "e_y": 1.03, "radius": 1.03}],
    ids=["focal length", "scale"],
)
def test_what_it_can_never_see_stays_unseen(rig: Rig, changes: dict[str, float]) -> None:
    """Of an undistorted camera and a parallel beam, where the statement is exact; distortion makes f just visible."""
    flat = replace(rig, camera=replace(rig.camera, distortion=(0.0,) * 5), covariance=None)
    flat = flat.with_parameters({"direction_x": 0.0, "direction_y": 0.0})
    true = flat.with_parameters({name: flat.parameter(name) * factor for name, factor in changes.items()})
    solutions = seen_by(true, flat, planes(flat), np.random.default_rng(5))
    assert drift(solutions, flat).ok
    pose = solutions[0].pose
    assert pose is not None
    assert solutions[0].sigma_spot is not None
    assert abs(pose.z_L - true.pose_from_plane(planes(flat)[0]).z_L) > 100 * solutions[0].sigma_spot.z_L


def test_one_bad_image_is_named(solutions: list[Solution], rig: Rig) -> None:
    test = solutions[2].rig_test
    assert test is not None
    bad = replace(solutions[2], rig_test=replace(test, misfit=test.misfit + 30), chi2=900.0, p_value=1e-190)
    result = drift([*solutions[:2], bad, *solutions[3:]], rig)
    assert result.state is State.DEGRADED
    assert result.worst == (2,)
    assert "image 3 (counted from 1)" in result.verdict


def test_without_a_covariance_the_verdict_says_what_that_means(rig: Rig) -> None:
    bare = replace(rig, covariance=None)
    true = bare.with_parameters({"e_x": bare.parameter("e_x") + 0.3})
    result = drift(seen_by(true, bare, planes(bare), np.random.default_rng(6)), bare)
    assert result.state is State.DEGRADED
    assert "no covariance" in result.verdict


def test_misfits_too_small_are_said_and_are_no_fault(solutions: list[Solution], rig: Rig) -> None:
    quiet = [
        replace(s, rig_test=replace(s.rig_test, misfit=1e-3 * s.rig_test.misfit))
        for s in solutions
        if s.rig_test is not None
    ]
    result = drift(quiet, rig)
    assert result.ok
    assert "too large" in result.verdict


def test_one_image_is_tested_as_by_itself(solutions: list[Solution], rig: Rig) -> None:
    result = drift(solutions[:1], rig)
    assert [(test.part, test.dof) for test in result.tests] == [(Part.POOLED, 2)]
    assert result.p_value == pytest.approx(solutions[0].p_value, rel=1e-9)
    assert result.shift == result.trend == ()


def test_a_batch_is_tested_as_its_images_are(rig: Rig) -> None:
    rng = np.random.default_rng(8)
    pixels = [outline(rig, plane) for plane in planes(rig)]
    spots = [Spot(xy + rng.normal(0, NOISE, xy.shape), np.full(len(xy), NOISE)) for xy in pixels]
    together, alone = drift(solve_batch(spots, rig), rig), drift([solve(spot, rig) for spot in spots], rig)
    assert together.chi2 == pytest.approx(alone.chi2, rel=0.05)
    assert together.verdict[:3] == alone.verdict[:3] == "OK:"


def test_an_estimated_scale_keeps_its_p_value(rig: Rig) -> None:
    """F of few degrees of freedom, made chi-squared by its p-value: one image alone has its own p-value again."""
    pixels = outline(rig, planes(rig)[0], 12) + np.random.default_rng(7).normal(0, NOISE, (12, 2))
    bare = replace(rig, covariance=None).with_parameters({"e_x": rig.parameter("e_x") + 0.2})
    alone = solve(Spot(pixels, None), bare)
    assert alone.chi2 is not None
    assert alone.p_value != pytest.approx(scipy.stats.chi2.sf(alone.chi2, 2), rel=0.1)
    assert drift([alone], bare).p_value == pytest.approx(alone.p_value, rel=1e-6)


def test_what_cannot_be_used_is_left_out_and_said(solutions: list[Solution], rig: Rig) -> None:
    refused = solve(Spot(outline(rig, planes(rig)[0]), None), rig, formulation=AsPrinted())
    result = drift([refused, *solutions], rig)
    assert result.images == (1, 2, 3, 4, 5)
    assert result.left_out[0][0] == 0
    nothing = drift([refused], rig)
    assert nothing.state is State.UNTESTED
    assert not nothing.ok
    assert (nothing.chi2, nothing.dof, nothing.p_value) == (None, 0, None)
    assert nothing.verdict.startswith("UNTESTED: ")
    assert drift([], rig).state is State.UNTESTED


def test_positions_must_be_numbers_for_each_image(solutions: list[Solution], rig: Rig) -> None:
    for positions in ([1.0], [1, 2, 3, 4, np.nan]):
        with pytest.raises(InputError, match="positions must be 5 finite numbers"):
            drift(solutions, rig, positions=positions)
    with pytest.raises(InputError, match="8 free parameters, and this rig has 0"):
        drift(solutions, replace(rig, covariance=None))


def test_misfit_answers_the_beam_as_stated(rig: Rig) -> None:
    """Derivatives by the beam against whole new solves: chi-squared of exact points is that of the predicted misfit.

    The change is so small that the points' misfit is a tenth of their sigma; second order is then at the per cent.
    """
    pixels = outline(rig, planes(rig)[1])
    spot = Spot(pixels, np.full(len(pixels), NOISE))
    bare = replace(rig, covariance=None)
    test = solve(spot, bare).rig_test
    assert isinstance(test, RigTest)
    for column, (name, step) in enumerate({"e_x": 1e-2, "e_y": 1e-2, "direction_x": 5e-5, "direction_y": 5e-5}.items()):
        moved = solve(spot, bare.with_parameters({name: bare.parameter(name) + step}))
        predicted = step * test.by_beam[:, column]
        assert moved.chi2 == pytest.approx(float(predicted @ predicted), rel=0.03)
