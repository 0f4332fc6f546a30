"""Many spots at once, the quick way: as the careful way finds them, with the rig's derivatives by two other routes."""

from dataclasses import replace

import numpy as np
import pytest

import planeopt as po
from cases import WORKED, WORKED_SETUP, Array, boundary, circle
from example_rig import example_rig
from planeopt import equations as eq
from planeopt.estimation import batch_pieces, points, regular, rig_effect, rig_part, solve_points
from planeopt.estimation.tangents import Cloud, Tangents, tangents
from planeopt.plane import SpotPose
from planeopt.rig import Rig, RigCovariance
from planeopt.solution import Status
from planeopt.spot import Spot

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "e_x", "e_y", "radius", "direction_x", "direction_y")
SIGMAS = np.array([1.0, 1.0, 0.5, 0.5, 1e-3, 5e-3, 1e-4, 1e-4, 0.04, 0.04, 0.005, 2e-4, 2e-4])
SIGMA = 0.1


@pytest.fixture(scope="module")
def rig() -> Rig:
    """The example's rig with lens distortion, and a joint covariance of thirteen parameters."""
    shape = np.eye(13) + 0.3 * np.random.default_rng(0).normal(size=(13, 13))
    matrix = shape @ shape.T
    size = np.sqrt(np.diag(matrix))
    correlation = matrix / np.outer(size, size)
    return replace(example_rig(), covariance=RigCovariance(NAMES, correlation * np.outer(SIGMAS, SIGMAS)))


def spots(rig: Rig, rows: int, n: int = 60, sigma: float | None = SIGMA, share: float = 1.0) -> list[Spot]:
    """Spots on random planes, with noise of `SIGMA`."""
    rng, made = np.random.default_rng(1), []
    radius = rig.require_beam().radius
    k = eq.Setup(rig.focal_length, *rig.laser_offset, radius)
    for _ in range(rows):
        pose = SpotPose.from_slopes(rng.uniform(150, 400), rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), radius)
        v = eq.PaperVariables(pose.R, pose.z_L + rig.axial_shift, pose.alpha, pose.beta or 0.0)
        exact = rig.from_laser_plane(boundary(v, k, circle(n, share)))
        noise = None if sigma is None else np.full(n, sigma)
        made.append(Spot(exact + SIGMA * rng.standard_normal((n, 2)), noise))
    return made


@pytest.mark.parametrize("sigma", [SIGMA, None], ids=["sigma given", "sigma estimated"])
@pytest.mark.parametrize("share", [1.0, 0.5], ids=["whole", "half"])
def test_the_quick_way_is_the_careful_way(
    rig: Rig, sigma: float | None, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = spots(rig, 30, 60, sigma, share)
    quick = po.solve_batch(given, rig)
    monkeypatch.setattr(points, "FEW", 10**6)
    slow = po.solve_batch(given, rig)
    assert quick.status == slow.status
    assert quick.flags == slow.flags
    step = quick.planes - slow.planes
    assert np.max(np.sum(step * np.linalg.solve(slow.spot_covariance, step[..., None])[..., 0], axis=-1)) < 1e-3**2
    # What is left is the change of these over a thousandth of a standard deviation, and rounding of sums of squares.
    for name in ("spot_covariance", "rig_covariance", "plane_by_rig", "normal", "point", "fineness", "scale"):
        ours, theirs = getattr(quick, name), getattr(slow, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-3 * np.abs(theirs).max(), err_msg=name)
    np.testing.assert_allclose(quick.chi2, slow.chi2, atol=1e-3 * (1 + np.sqrt(slow.chi2).max()))
    if sigma is not None:
        np.testing.assert_allclose(quick.chi2_points, slow.chi2_points, rtol=1e-5)
    np.testing.assert_allclose(quick.arc_fraction, slow.arc_fraction, rtol=1e-5)
    for ours, theirs in ((quick.misfit_by_rig, slow.misfit_by_rig), (quick.misfit_by_beam, slow.misfit_by_beam)):
        # The two components are free to turn.
        products, others = (np.swapaxes(m, 1, 2) @ m for m in (ours, theirs))
        np.testing.assert_allclose(products, others, rtol=1e-3, atol=1e-3 * np.abs(others).max())


def test_the_rigs_derivatives_are_casadis(rig: Rig) -> None:
    """Derivatives at the feet and at the points differ by the noise over the spot's size: 0.1 px of 40 px."""
    given = spots(rig, 5)
    batch = po.solve_batch(given, rig)
    free = rig_part.free_parameters(rig)
    for i, spot in enumerate(given):
        mm, jacobian = rig.to_laser_plane(spot.points)
        noise = SIGMA**2 * jacobian @ np.swapaxes(jacobian, 1, 2)
        plane = batch.planes[i] + [rig.axial_shift, 0.0, 0.0]
        rays = np.asarray(rig.camera.normalise(spot.points)[0])
        by_plane, by_all = rig_part.point_derivatives(rig, rays, noise, np.tile(plane, (len(mm), 1)))
        step = -np.linalg.lstsq(by_plane, by_all @ free, rcond=None)[0]
        step[0] -= rig_part.axial_shift_by_rig(rig)
        scaled, expected = batch.plane_by_rig[i] * SIGMAS, step * SIGMAS
        np.testing.assert_allclose(scaled, expected, rtol=0.01, atol=0.005 * np.abs(expected).max(axis=1).min())


def test_the_rigs_derivatives_are_differences(rig: Rig) -> None:
    """Gauss-Newton's derivative leaves out the curvature of the residuals, which vanish here: exact points."""
    bare = replace(rig, covariance=None)
    exact = []
    for spot in spots(bare, 4):
        plane = po.solve_batch([spot], bare).planes[0]
        k = eq.Setup(rig.focal_length, *rig.laser_offset, rig.require_beam().radius)
        v = eq.SlopeVariables(None, plane[0] + rig.axial_shift, plane[1], plane[2])
        image = np.stack(eq.image_point(np, k, *eq.spot_point_in_slopes(np, v, k, circle(60))), axis=-1)
        exact.append(Spot(rig.from_laser_plane(image), np.full(60, SIGMA)))
    batch = po.solve_batch(exact, rig)
    for column, (name, sigma) in enumerate(zip(NAMES, SIGMAS, strict=True)):
        h = 1e-2 * sigma
        ends = [
            po.solve_batch(exact, bare.with_parameters({name: rig.parameter(name) + sign * h})).planes
            for sign in (1, -1)
        ]
        numeric = (ends[0] - ends[1]) / (2 * h)
        # A search ends within some 1e-5 standard deviations, a step is 1e-2 of the parameter's: what it moves the
        # plane, in standard deviations of the spot's, is of the order of 1e-2 to 1.
        spread = np.sqrt(np.einsum("mii->mi", batch.spot_covariance))
        off = np.abs(numeric - batch.plane_by_rig[..., column]) * h / spread
        assert off.max() < 1e-4, name


def test_nothing_of_it_is_done_spot_by_spot(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """No CasADi, no careful search, six looks at the points at most, however many spots there are."""
    looks = []

    def refuse(*_: object) -> None:
        pytest.fail("called")

    def counted(cloud: Cloud, conics: Array, guess: Array) -> Tangents:
        looks.append(cloud.x.size)
        return tangents(cloud, conics, guess)

    for module in (regular, rig_effect):
        monkeypatch.setattr(module, "tangents", counted)
    monkeypatch.setattr(rig_part, "_point_rows", refuse)
    monkeypatch.setattr(rig_part, "_outputs", refuse)
    monkeypatch.setattr(points, "_solve_rows", refuse)
    given = spots(rig, 60, 50)
    assert po.solve_batch(given, rig).ok.all()
    assert len(looks) <= 6
    # The first, from the algebraic fit; then two or three from planes.
    assert sum(looks) <= 4 * 60 * 50
    monkeypatch.setattr(batch_pieces, "CHUNK", 20 * 50)
    once = len(looks)
    pieces = po.solve_batch(given, rig)
    assert len(looks) - once <= 3 * 6
    assert max(looks[once:]) <= 20 * 50
    assert pieces.ok.all()


def test_pieces_do_not_matter(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    given = [spot for n in (20, 24, 60) for spot in spots(rig, 4, n)]
    whole = po.solve_batch(given, rig)
    monkeypatch.setattr(batch_pieces, "CHUNK", 100)
    parts = po.solve_batch(given, rig)
    np.testing.assert_allclose(parts.planes, whole.planes, rtol=1e-9)
    np.testing.assert_allclose(parts.plane_by_rig, whole.plane_by_rig, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(parts.chi2, whole.chi2, rtol=1e-6, atol=1e-9)
    assert parts.flags == whole.flags


@pytest.mark.parametrize("sigma", [1e-5, 1e-3, 0.02, 0.1])
def test_points_are_solved_the_careful_way_too(sigma: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """From a spot 7 mm wide measured to 10 nm, to one whose noise is a tenth of its width's half."""
    exact = boundary(WORKED, WORKED_SETUP, circle(80))
    given = exact + sigma * np.random.default_rng(2).standard_normal((40, 80, 2))
    quick = solve_points(given, sigma, WORKED_SETUP)
    monkeypatch.setattr(points, "FEW", 10**6)
    slow = solve_points(given, sigma, WORKED_SETUP)
    assert quick.status == slow.status
    step = quick.planes - slow.planes
    assert np.max(np.sum(step * np.linalg.solve(slow.covariance, step[..., None])[..., 0], axis=-1)) < 1e-3**2
    np.testing.assert_allclose(quick.cost, slow.cost, rtol=1e-6)
    np.testing.assert_allclose(quick.chi2, slow.chi2, atol=1e-2)


def test_a_rig_off_by_its_covariance_does_not_cost_the_quick_way(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Spots at odds with it, but for its covariance, are looked at from elsewhere by their sums, not searched again."""
    assert rig.covariance is not None
    change = np.random.default_rng(0).multivariate_normal(np.zeros(13), rig.covariance.matrix)
    off = rig.with_parameters({name: rig.parameter(name) + by for name, by in zip(NAMES, change, strict=True)})
    given = spots(rig, 10, 100)
    with monkeypatch.context() as patched:
        patched.setattr(points, "_solve_rows", lambda *_: pytest.fail("called"))
        quick = po.solve_batch(given, off)
    assert quick.ok.all()
    assert po.solve_batch(given, replace(off, covariance=None)).status == (Status.INCONSISTENT,) * 10
    monkeypatch.setattr(points, "FEW", 10**6)
    slow = po.solve_batch(given, off)
    assert quick.status == slow.status
    step = quick.planes - slow.planes
    scaled = np.sum(step * np.linalg.solve(slow.spot_covariance, step[..., None])[..., 0], axis=-1)
    # Residuals are larger than the noise says, and so is what a last step leaves.
    assert np.all(scaled < 1e-3**2 * np.maximum(1.0, slow.chi2_points / slow.dof_points))
