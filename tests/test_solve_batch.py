"""Spots in, planes out, many at once: solve's answers with their evidence, flags and the rig's part."""

from dataclasses import replace

import numpy as np
import pytest

import planeopt as po
from cases import boundary, circle
from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.estimation import combine
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig
from planeopt.solution import Flag, Status
from planeopt.spot import Spot, SpotFlag
from planeopt.spot.points import SIGMAS
from test_rig_uncertainty import covariance

SIGMA = 0.05


def rig() -> Rig:
    camera = Camera((1440, 1080), 3000.0, 3000.0, 725.0, 530.0, (-0.12, 0.09, 3e-4, -2e-4, 0.01), 0.00345)
    direction = np.array([0.012, -0.008, 1.0])
    return Rig(camera, Beam(6.0, (24.0, -11.0), tuple(direction / np.linalg.norm(direction))), None, covariance())


def spot(rng: np.random.Generator, n: int, sigma: float | None = SIGMA, seen: Rig | None = None) -> Spot:
    """A spot on a random plane, with noise of `SIGMA`."""
    true = rig() if seen is None else seen
    pose = SpotPose.from_slopes(rng.uniform(150, 400), rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), 6.0)
    k = eq.Setup(true.focal_length, *true.laser_offset, 6.0)
    assert pose.beta is not None
    v = eq.PaperVariables(pose.R, pose.z_L + true.axial_shift, pose.alpha, pose.beta)
    pixels = true.from_laser_plane(boundary(v, k, circle(n)))
    pixels = pixels + SIGMA * rng.standard_normal(pixels.shape)
    return Spot(pixels, None if sigma is None else np.full(n, sigma))


def spots() -> list[Spot]:
    rng = np.random.default_rng(0)
    return [spot(rng, int(rng.integers(6, 150)), SIGMA if i % 3 else None) for i in range(9)]


def test_it_is_solve() -> None:
    given, used = spots(), rig()
    batch = po.solve_batch(given, used)
    assert len(batch) == len(given)
    for i, (one, row) in enumerate(zip(given, batch, strict=True)):
        alone = po.solve(one, used, formulation=po.Reprojection())
        assert (row.status, row.message, row.flags) == (alone.status, alone.message, alone.flags)
        assert row.n_points == len(one)
        assert row.arc_fraction == alone.arc_fraction
        assert row.pose is not None
        assert alone.pose is not None
        assert row.uncertainty is not None
        assert alone.uncertainty is not None
        step = np.array([row.pose.z_L - alone.pose.z_L, *np.subtract(row.pose.slopes, alone.pose.slopes)])
        assert step @ np.linalg.solve(alone.uncertainty.spot, step) < 1e-3**2
        assert row.plane is not None
        assert alone.plane is not None
        np.testing.assert_allclose(row.plane.normal, alone.plane.normal, atol=1e-6)
        np.testing.assert_allclose(row.plane.point, alone.plane.point, rtol=1e-6)
        # First-order covariances with and without the residuals' curvature, which is noise (0.05 px) over size (50 px);
        # derivatives at the points or at their feet, 0.05 px apart.
        for part in ("spot", "rig", "normal_spot", "normal_rig", "plane_by_rig", "normal_by_rig"):
            ours, theirs = getattr(row.uncertainty, part), getattr(alone.uncertainty, part)
            np.testing.assert_allclose(ours, theirs, rtol=0.02, atol=0.01 * np.abs(theirs).max())
        np.testing.assert_array_equal(batch.covariance[i], row.uncertainty.spot + row.uncertainty.rig)
        assert row.chi2 == pytest.approx(alone.chi2, rel=0.1, abs=0.01)
        assert row.p_value == pytest.approx(alone.p_value, rel=0.1)
        assert row.dof_points == alone.dof_points
        assert (row.chi2_points is None) is (alone.chi2_points is None)
        if alone.chi2_points is not None:
            assert row.chi2_points == pytest.approx(alone.chi2_points, rel=0.01)
        assert row.rig_test is not None
        assert alone.rig_test is not None
        # The two components are free to turn: what they say of the rig is not.
        for ours, theirs in (
            (row.rig_test.by_rig, alone.rig_test.by_rig),
            (row.rig_test.by_beam, alone.rig_test.by_beam),
        ):
            products = theirs.T @ theirs
            np.testing.assert_allclose(ours.T @ ours, products, atol=0.02 * np.abs(products).max())


def test_one_bad_spot_costs_itself() -> None:
    good = spots()[1]
    pixels = good.points
    given = [
        good,
        Spot(pixels[:5]),
        Spot(pixels[0] + np.arange(7)[:, None] * [1.0, 2.0], np.ones(7)),
        Spot(pixels + np.array([1e5, 0.0]), good.sigma),
        replace(good, flags=(SpotFlag.SATURATED,)),
    ]
    camera = replace(rig().camera, distortion=(-0.12, 0.0, 0.0, 0.0, 0.0))
    batch = po.solve_batch(given, replace(rig(), camera=camera, covariance=None))
    assert batch.status[1:4] == (Status.NO_NOISE_SCALE, Status.UNUSABLE, Status.UNUSABLE)
    assert batch.status[0] is batch.status[4]
    assert "straight line" in batch.message[2]
    assert "cannot be inverted" in batch.message[3]
    assert not any("\n" in message for message in batch.message)
    np.testing.assert_array_equal(batch.planes[0], batch.planes[4])
    assert batch.flags[4][0] is SpotFlag.SATURATED
    assert Flag.RIG_WITHOUT_COVARIANCE in batch.flags[0]
    five, line = batch.row(1), batch.row(2)
    assert five.pose is not None
    assert (five.uncertainty, five.chi2, five.uncertainty_reason) == (None, None, five.message)
    assert (line.pose, line.plane, line.uncertainty) == (None, None, None)
    assert np.isnan(batch.planes[2:4]).all()
    assert not batch.rig_covariance[0].any()


def test_points_that_are_no_spot_cost_themselves() -> None:
    rng, used = np.random.default_rng(0), rig()
    good = spot(rng, 60)
    stray = [Spot(rng.uniform(100, 900, (50, 2)), np.full(50, s)) for s in (0.1, 1.0, 10.0)]
    stray += [Spot(rng.uniform(100, 900, (n, 2))) for n in (5, 6, 9, 50)]
    batch = po.solve_batch([good, *stray, good], used)
    assert batch.status[0] is batch.status[-1] is Status.CONVERGED
    np.testing.assert_allclose(batch.planes[0], batch.planes[-1], rtol=1e-9)
    assert Status.CONVERGED not in batch.status[1:3]
    assert len([row.message for row in batch]) == len(stray) + 2


@pytest.mark.parametrize("robust", [0, -1, np.nan, np.inf])
def test_no_degrees_of_freedom_are_refused(robust: float) -> None:
    with pytest.raises(InputError, match="robust must be a positive number"):
        po.solve_batch([], rig(), robust=robust)


def test_spots_may_come_one_by_one() -> None:
    given, used = spots()[:3], rig()
    np.testing.assert_array_equal(po.solve_batch(iter(given), used).planes, po.solve_batch(given, used).planes)


@pytest.mark.parametrize("robust", [None, 4.0])
@pytest.mark.parametrize("limit", SIGMAS)
def test_the_largest_and_the_smallest_sigmas_cost_themselves(limit: float, robust: float | None) -> None:
    rng, used = np.random.default_rng(0), rig()
    good, other = spot(rng, 40), spot(rng, 40)
    batch = po.solve_batch([good, replace(other, sigma=np.full(40, limit))], used, robust=robust)
    np.testing.assert_allclose(batch.planes[0], po.solve_batch([good], used, robust=robust).planes[0], rtol=1e-9)
    if limit > 1:
        assert "lie on a straight line (within their noise)" in batch.message[1]


def test_spots_of_other_lengths_do_not_change_a_spot() -> None:
    """Padding counts for nothing: alone, and among longer ones, a spot's numbers are the same to rounding."""
    rng, used = np.random.default_rng(6), rig()
    given = [spot(rng, n) for n in (40, 43, 47, 49)]
    given = [replace(s, points=s.points[:-9], sigma=np.full(len(s) - 9, SIGMA)) for s in given]
    batch = po.solve_batch(given, used)
    for i, one in enumerate(given):
        alone = po.solve_batch([one], used)
        assert (batch.status[i], batch.flags[i]) == (alone.status[0], alone.flags[0])
        for name in ("planes", "covariance", "plane_by_rig", "chi2_points", "arc_fraction", "fineness"):
            ours, theirs = getattr(batch, name)[i], getattr(alone, name)[0]
            # Sums over the points carry half the digits of what they tell.
            np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8 * np.abs(theirs).max())
        assert batch.chi2[i] == pytest.approx(alone.chi2[0], rel=1e-8, abs=1e-8)
        assert batch.arc_fraction[i] < 1


def test_no_spots_no_planes() -> None:
    batch = po.solve_batch([], rig())
    assert len(batch) == 0
    assert list(batch) == []
    assert batch.planes.shape == (0, 3)


def test_a_camera_alone_is_refused() -> None:
    with pytest.raises(InputError, match="camera alone"):
        po.solve_batch(spots(), Rig(rig().camera))


def test_a_wrong_rig_is_inconsistent_unless_its_covariance_allows_it() -> None:
    used = rig()
    wrong = replace(used, covariance=covariance(1e-3)).with_parameters({"e_x": 24.0 * 1.05, "e_y": -11.0 * 0.9})
    rng = np.random.default_rng(3)
    given = [spot(rng, 120) for _ in range(3)]
    batch = po.solve_batch(given, wrong)
    assert batch.status == (Status.INCONSISTENT,) * 3
    assert "p = " in batch.message[0]
    assert po.solve_batch(given, replace(wrong, covariance=covariance(100.0))).ok.all()


def test_gross_errors_are_taken_by_students_t() -> None:
    rng = np.random.default_rng(4)
    clean = [spot(rng, 150) for _ in range(5)]
    spoilt = [Spot(s.points + np.where(np.arange(150)[:, None] % 10, 0.0, 2.0), s.sigma) for s in clean]
    right = po.solve_batch(clean, rig())
    for robust, good in ((None, False), (4.0, True)):
        found = po.solve_batch(spoilt, rig(), robust=robust)
        error = found.planes - right.planes
        squared = np.sum(error * np.linalg.solve(right.spot_covariance, error[..., None])[..., 0], axis=-1)
        # 16.3 is the 0.999 quantile of chi-squared with 3 degrees of freedom.
        assert bool(np.all(squared < 16.3)) is good


def test_frames_of_a_batch_can_be_combined() -> None:
    used, frames = rig(), []
    for seed in range(4):
        frame = spot(np.random.default_rng(5), 100)
        shift = SIGMA * np.random.default_rng(seed).standard_normal(frame.points.shape)
        frames.append(Spot(frame.points + shift, np.full(100, SIGMA)))
    mean = combine(list(po.solve_batch(frames, used)), used)
    assert mean.n_frames == 4
