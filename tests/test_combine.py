"""Frames of one plane: the spot's part shrinks, the rig's does not; frames that do not belong are named."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from cases import Array
from example_rig import pose_at, seen
from frames import N_POINTS, NAMES, NOISE, frames, outline, uncertain_rig
from planeopt.errors import InputError
from planeopt.estimation import solve, solve_batch
from planeopt.estimation.combine import Agreement, Combined, combine
from planeopt.estimation.weighted_squares import weighted_chi2_sf
from planeopt.formulations import AsPrinted
from planeopt.plane import SpotPose
from planeopt.rig import Rig
from planeopt.solution import Solution
from planeopt.spot import Spot
from planeopt.uncertainty import Uncertainty

FAMILY = 0.001


def shift(solution: Solution, z_L: float) -> Solution:
    """The same solution at another distance."""
    assert solution.pose is not None
    pose = SpotPose(solution.pose.R, solution.pose.z_L + z_L, solution.pose.alpha, solution.pose.beta)
    return replace(solution, pose=pose)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return uncertain_rig()


@pytest.fixture(scope="module")
def solutions(rig: Rig) -> list[Solution]:
    pixels = outline(rig, rig.plane_from_pose(pose_at()))
    return frames(rig, pixels, 16, np.random.default_rng(5))


@pytest.fixture(scope="module")
def combined(solutions: list[Solution], rig: Rig) -> Combined:
    return combine(solutions, rig)


def test_the_spots_part_shrinks_with_the_number_and_the_rigs_does_not(
    solutions: list[Solution], rig: Rig, combined: Combined
) -> None:
    """Frames of one plane differ in their covariances by the noise at which these are evaluated, some per cent."""
    one = combine(solutions[:1], rig)
    assert one.uncertainty.rig[0, 0] > 4 * one.uncertainty.spot[0, 0]
    for part, factor in (("spot", 16), ("normal_spot", 16), ("rig", 1), ("normal_rig", 1)):
        many, single = (getattr(c.uncertainty, part) for c in (combined, one))
        size = np.sqrt(np.diagonal(single))
        np.testing.assert_allclose(many * factor / np.outer(size, size), single / np.outer(size, size), atol=0.05)
    assert combined.sigma_spot.z_L == pytest.approx(one.sigma_spot.z_L / 4, rel=0.05)


def test_one_frame_is_itself(solutions: list[Solution], rig: Rig) -> None:
    one, given = combine(solutions[:1], rig), solutions[0]
    assert given.uncertainty is not None
    assert given.plane is not None
    assert given.pose is not None
    assert (one.agreement, one.p_value, one.dof, one.n_frames) == (Agreement.ALONE, None, 0, 1)
    assert one.ok
    assert one.pose.z_L == pytest.approx(given.pose.z_L, rel=1e-12)
    np.testing.assert_allclose(one.plane.normal, given.plane.normal, atol=1e-12)
    for part in ("spot", "rig", "normal_spot", "normal_rig"):
        expected = getattr(given.uncertainty, part)
        np.testing.assert_allclose(getattr(one.uncertainty, part), expected, atol=1e-9 * np.abs(expected).max())


def test_error_has_the_stated_covariance_and_the_scatter_its_law(rig: Rig) -> None:
    """Rigs drawn from the covariance make the frames, the nominal rig measures them.

    Squared errors over the covariance sum to chi-squared with 3 degrees of freedom a draw; over the spots' part alone
    they do not. The scatter of the frames is chi-squared with 3 (n - 1), whatever the rig is. Two-sided at a
    family-wise 0.001.
    """
    draws, n = 100, 5
    assert rig.covariance is not None
    rng = np.random.default_rng(8)
    root = np.linalg.cholesky(rig.covariance.matrix)
    nominal = np.array([rig.parameter(name) for name in NAMES])
    plane = rig.plane_from_pose(pose_at())
    errors, naive, scatter, p_values = [], [], [], []
    for _ in range(draws):
        values = nominal + root @ rng.normal(size=len(NAMES))
        true = replace(rig, covariance=None).with_parameters(dict(zip(NAMES, values.tolist(), strict=True)))
        pose = true.pose_from_plane(plane)
        result = combine(frames(rig, outline(true, plane), n, rng), rig)
        error = np.array([result.pose.z_L - pose.z_L, *np.subtract(result.pose.slopes, pose.slopes)])
        errors.append(error @ np.linalg.solve(result.covariance, error))
        naive.append(error @ np.linalg.solve(result.uncertainty.spot, error))
        scatter.append(result.chi2)
        p_values.append(result.p_value)
    for values, dof in ((errors, 3), (scatter, 3 * (n - 1))):
        low, high = scipy.stats.chi2.ppf([FAMILY / 6, 1 - FAMILY / 6], dof * draws)
        assert low < np.sum(values) < high, (dof, np.mean(values))
    assert scipy.stats.kstest(p_values, "uniform").pvalue > FAMILY / 3
    assert np.mean(naive) > 30


def test_weights_do_not_take_noise_for_knowledge_of_the_rig(rig: Rig) -> None:
    """The derivatives by the rig, as evaluated at noisy frames, differ: 100 such frames must not shrink the rig's part.

    Generalised least squares that believes the differences does, and the more the more frames.
    """
    pixels = outline(rig, rig.plane_from_pose(pose_at()))
    many = frames(rig, pixels, 100, np.random.default_rng(2))
    assert rig.covariance is not None
    parts = [solution.uncertainty for solution in many if solution.uncertainty is not None]
    spot = np.array([part.spot for part in parts])
    by_rig = np.concatenate([part.plane_by_rig for part in parts if part.plane_by_rig is not None])
    joint = by_rig @ rig.covariance.matrix @ by_rig.T
    for i in range(len(spot)):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += spot[i]
    size = np.sqrt(np.diagonal(joint))
    design = np.tile(np.eye(3), (len(spot), 1)) / size[:, None]
    believing = np.linalg.inv(design.T @ np.linalg.solve(joint / np.outer(size, size), design))
    ours = combine(many, rig).uncertainty.rig
    single = combine(many[:1], rig).uncertainty.rig
    assert np.sqrt(believing[2, 2]) < 0.98 * np.sqrt(ours[2, 2])
    np.testing.assert_allclose(np.sqrt(np.diagonal(ours)), np.sqrt(np.diagonal(single)), rtol=0.02)


def drawn(base: Solution, spot: Array, by_rig: Array, rng: np.random.Generator, rig: Rig) -> list[Solution]:
    """Solutions whose planes are drawn from spots' covariances (n, 3, 3) and one error of the rig, to first order."""
    assert base.pose is not None
    assert rig.covariance is not None
    eta = np.linalg.cholesky(rig.covariance.matrix) @ rng.normal(size=len(NAMES))
    plane = np.array([base.pose.z_L, *base.pose.slopes])
    made = []
    for covariance, moved in zip(spot, by_rig, strict=True):
        z_L, p, q = plane + np.linalg.cholesky(covariance) @ rng.normal(size=3) + moved @ eta
        part = Uncertainty(covariance, moved @ rig.covariance.matrix @ moved.T, np.eye(3), np.eye(3), moved, moved)
        made.append(replace(base, pose=SpotPose.from_slopes(z_L, p, q, base.radius), uncertainty=part))
    return made


def test_scatter_allows_for_what_the_rig_moves_differently(solutions: list[Solution], rig: Rig) -> None:
    """Frames with different arcs answer a wrong rig differently; the p-value stays uniform, by its scaled law.

    Kolmogorov and Smirnov's test, and the number below 0.1, two-sided at a family-wise 0.001: 400 draws do not see the
    law's own error, under 0.02.
    """
    base = solutions[0]
    assert base.uncertainty is not None
    assert base.uncertainty.plane_by_rig is not None
    rng = np.random.default_rng(3)
    share = 0.05 * rng.normal(size=(6, 3, 1))
    by_rig = base.uncertainty.plane_by_rig * (1 + share)
    spot = np.broadcast_to(base.uncertainty.spot, (6, 3, 3))
    results = [combine(drawn(base, spot, by_rig, rng, rig), rig) for _ in range(400)]
    p_values = np.array([result.p_value for result in results])
    plain = scipy.stats.chi2.sf([result.chi2 for result in results], 15)
    assert scipy.stats.kstest(p_values, "uniform").pvalue > FAMILY / 2
    assert np.mean(plain < 0.01) > 0.05
    low, high = scipy.stats.binom.ppf([FAMILY / 4, 1 - FAMILY / 4], 400, 0.1)
    assert low <= np.sum(p_values < 0.1) <= high


def test_frames_that_the_others_contradict_are_named_and_left_out_when_asked(
    solutions: list[Solution], rig: Rig, combined: Combined
) -> None:
    sigma = combined.sigma_spot.z_L * 4
    odd = list(solutions)
    odd[3], odd[11] = shift(odd[3], 12 * sigma), shift(odd[11], -25 * sigma)
    kept, without = combine(odd, rig), combine(odd, rig, without_outliers=True)
    assert kept.outliers == without.outliers == (11, 3)
    assert kept.agreement is Agreement.SCATTER
    assert not kept.ok
    assert (kept.n_frames, without.n_frames) == (16, 14)
    assert "12, 4 (counted from 1)" in kept.message
    assert "all the same" in kept.message
    assert "left out" in without.message
    assert without.ok
    expected = combine([s for i, s in enumerate(solutions) if i not in (3, 11)], rig)
    assert without.pose == expected.pose
    assert without.chi2 == expected.chi2


def test_right_frames_are_rarely_called_outliers(solutions: list[Solution], rig: Rig) -> None:
    """At a level of 0.001 a set, more than 4 of 500 sets have a probability of 2e-4."""
    base = solutions[0]
    assert base.uncertainty is not None
    assert base.uncertainty.plane_by_rig is not None
    rng = np.random.default_rng(4)
    spot = np.broadcast_to(base.uncertainty.spot, (5, 3, 3))
    by_rig = np.broadcast_to(base.uncertainty.plane_by_rig, (5, 3, len(NAMES)))
    assert sum(bool(combine(drawn(base, spot, by_rig, rng, rig), rig).outliers) for _ in range(500)) <= 4


def test_two_frames_that_disagree_scatter_and_neither_is_named(solutions: list[Solution], rig: Rig) -> None:
    assert solutions[0].sigma_spot is not None
    result = combine([solutions[0], shift(solutions[1], 30 * solutions[0].sigma_spot.z_L)], rig)
    assert result.agreement is Agreement.SCATTER
    assert result.outliers == ()
    assert "too short" in result.message


def test_copies_of_a_frame_are_too_alike(solutions: list[Solution], rig: Rig) -> None:
    result = combine([solutions[0]] * 8, rig)
    assert result.agreement is Agreement.ALIKE
    assert not result.ok
    assert "in common" in result.message


def test_what_has_no_plane_is_left_out_and_said(solutions: list[Solution], rig: Rig) -> None:
    spot = Spot(seen(pose_at(), 5), None)
    five, refused = solve(spot, rig), solve(spot, rig, formulation=AsPrinted())
    result = combine([refused, *solutions[:2], five], rig)
    assert result.used == (1, 2)
    assert [index for index, _ in result.left_out] == [0, 3]
    assert "2 more frames" in result.message
    with pytest.raises(InputError, match="none of the 1 frames"):
        combine([refused], rig)
    with pytest.raises(InputError, match="none of the 0 frames"):
        combine([], rig)


def test_a_batch_combines_as_its_frames_do(rig: Rig) -> None:
    """To the batch's own agreement with single solves, 1e-3 standard deviations of a frame."""
    pixels = outline(rig, rig.plane_from_pose(pose_at()))
    rng = np.random.default_rng(6)
    spots = [Spot(pixels + rng.normal(0, NOISE, pixels.shape), np.full(N_POINTS, NOISE)) for _ in range(4)]
    together = combine(solve_batch(spots, rig), rig)
    alone = combine([solve(spot, rig) for spot in spots], rig)
    assert together.pose.z_L == pytest.approx(alone.pose.z_L, abs=1e-3 * alone.sigma_spot.z_L)
    assert together.n_frames == 4
    assert together.chi2 == pytest.approx(alone.chi2, rel=1e-2)
    np.testing.assert_allclose(together.uncertainty.rig, alone.uncertainty.rig, rtol=1e-2)


def test_without_a_rig_covariance_all_is_the_spots(rig: Rig) -> None:
    bare = replace(rig, covariance=None)
    pixels = outline(bare, bare.plane_from_pose(pose_at()))
    result = combine(frames(bare, pixels, 3, np.random.default_rng(1)), bare)
    assert not result.uncertainty.rig.any()
    assert "no covariance" in result.message
    assert result.ok


def test_frames_of_another_rig_are_refused(solutions: list[Solution], rig: Rig) -> None:
    with pytest.raises(InputError, match=r"frame 0 .* 8 free parameters, and this rig has 0"):
        combine(solutions, replace(rig, covariance=None))


@pytest.mark.parametrize("weights", [(5.0, 1.0, 1.0), (30.0, 4.0, 1.0, 1.0, 1.0, 1.0), (1.0001, 1.0, 1.0)])
def test_tail_of_weighted_squares(weights: tuple[float, ...]) -> None:
    """Against a million draws, whose own error at the smallest share is 3 %; the formula's is at most 5 %."""
    squares = np.random.default_rng(0).normal(size=(1_000_000, len(weights))) ** 2 @ np.array(weights)
    for share in (0.9, 0.5, 0.1, 1e-3):
        found = weighted_chi2_sf(float(np.quantile(squares, 1 - share)), np.array(weights))
        assert found == pytest.approx(share, rel=0.05 if share > 0.01 else 0.15)
    mean = float(np.sum(weights))
    around = [weighted_chi2_sf(mean * (1 + 1e-4 * step), np.array(weights)) for step in range(-20, 21)]
    assert np.all(np.diff(around) < 0)
    assert np.ptp(np.diff(around)) < 1e-3


def test_tail_of_equal_weights_is_that_of_chi_squared() -> None:
    for value in (0.0, 0.3, 4.0, 80.0):
        assert weighted_chi2_sf(value, np.full(3, 2.0)) == scipy.stats.chi2.sf(value / 2, 3)
