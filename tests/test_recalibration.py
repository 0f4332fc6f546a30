"""Field recalibration: the law of what is updated, what stays, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from cases import Array
from example_rig import pose_at
from frames import NAMES, outline, uncertain_rig
from planeopt.calibration.recalibration import KEPT, Moves, Outcome, Recalibration, recalibrate, with_stated_sigmas
from planeopt.errors import InputError
from planeopt.estimation import solve_batch
from planeopt.estimation.misfits import seen, seen_by
from planeopt.plane import Plane
from planeopt.rig import Rig, RigCovariance
from planeopt.spot import Spot

NOISE = 0.05
FAMILY = 0.001

POSES = tuple(
    pose_at(z_L, alpha, beta)
    for z_L, alpha, beta in (
        *((180, 0.2, 0.8), (240, 0.6, -2.0), (300, 0.9, 2.5), (220, 0.5, -0.4)),
        *((260, 0.3, 1.7), (200, 0.3, -1.0), (280, 0.4, 2.0), (230, 0.7, 0.3)),
    )
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return uncertain_rig()


def planes(rig: Rig, count: int = len(POSES)) -> list[Plane]:
    return [rig.plane_from_pose(pose) for pose in POSES[:count]]


def spots(true: Rig, where: list[Plane], rng: np.random.Generator, n: int = 40, noise: float = NOISE) -> list[Spot]:
    """What the true rig sees of planes."""
    made = []
    for plane in where:
        pixels = outline(true, plane, n)
        made.append(Spot(pixels + rng.normal(0, noise, pixels.shape), np.full(n, noise)))
    return made


def drawn(rig: Rig, rng: np.random.Generator) -> Rig:
    """A rig drawn from the covariance."""
    values = [rig.parameter(name) for name in NAMES]
    values = values + np.linalg.cholesky(rig.covariance_matrix) @ rng.normal(size=len(NAMES))
    return replace(rig, covariance=None).with_parameters(dict(zip(NAMES, values.tolist(), strict=True)))


def moved(rig: Rig, rng: np.random.Generator) -> Rig:
    """The beam moved by 0.05 mm and turned by 0.5 mrad, in any direction."""
    way, lean = np.exp(1j * rng.uniform(-np.pi, np.pi, 2))
    changes = {"e_x": 0.05 * way.real, "e_y": 0.05 * way.imag}
    changes |= {"direction_x": 5e-4 * lean.real, "direction_y": 5e-4 * lean.imag}
    return rig.with_parameters({name: rig.parameter(name) + float(change) for name, change in changes.items()})


def distances(result: Recalibration, true: Rig) -> tuple[float, float]:
    """Squared distances from the truth of all parameters, and of the four numbers, in their covariances."""
    names = NAMES
    assert result.rig.covariance is not None
    assert result.rig.covariance.parameters == names
    covariance = result.rig.covariance.matrix
    off = np.array([result.rig.parameter(name) - true.parameter(name) for name in names])
    by_free = seen_by(result.rig, names)
    four = seen(result.rig) - seen(true)
    return (
        float(off @ np.linalg.solve(covariance, off)),
        float(four @ np.linalg.solve(by_free @ covariance @ by_free.T, four)),
    )


def pose_distance(result: Recalibration, true: Rig, where: Plane, rng: np.random.Generator) -> float:
    """Squared distance of a new image's plane from the truth, in its stated covariance."""
    found = solve_batch(spots(true, [where], rng), result.rig)
    truth = np.array([*true.slope_arrays(where.normal, where.point)])
    away = found.planes[0] - truth
    return float(away @ np.linalg.solve(found.covariance[0], away))


@pytest.mark.parametrize("moves", [Moves(0.0, 0.0), Moves()], ids=["nothing moved", "the beam moved"])
def test_the_covariance_after_the_update_is_right(rig: Rig, moves: Moves) -> None:
    """Rigs drawn from the calibration, in the second case moved by 0.05 mm and 0.5 mrad, of which no test may know.

    Sums over 16 rigs against chi-squared, two-sided at a family-wise 0.001 over the eight sums and four tests of
    uniformity: of all parameters, of the four numbers, of a new image's plane, and of trend and rest.
    """
    rng = np.random.default_rng(1 + moves.none)
    new = planes(rig)[5]
    rows: list[tuple[float, float, float]] = []
    tests: list[list[float]] = []
    for _ in range(16):
        true = drawn(rig, rng)
        true = true if moves.none else moved(true, rng)
        result = recalibrate(spots(true, planes(rig), rng), rig, moves=moves)
        assert result.ok, result.message
        rows.append((*distances(result, true), pose_distance(result, true, new, rng)))
        tests.append([test.p_value for test in result.tests[2:]])
    share = FAMILY / 12
    for values, dof in zip(np.transpose(rows), (len(NAMES), 4, 3), strict=True):
        low, high = scipy.stats.chi2.ppf([share / 2, 1 - share / 2], dof * len(values))
        assert low < values.sum() < high
    for p_values in np.transpose(tests):
        assert scipy.stats.kstest(p_values, "uniform").pvalue > share


def test_a_beam_that_moved_is_found_where_it_is(rig: Rig) -> None:
    """By 0.5 mm and 5 mrad, ten and more standard deviations of the calibration."""
    changes = {"e_x": 0.4, "e_y": -0.3, "direction_x": 4e-3, "direction_y": 3e-3}
    true = rig.with_parameters({name: rig.parameter(name) + change for name, change in changes.items()})
    result = recalibrate(spots(true, planes(rig), np.random.default_rng(3)), rig)
    assert result.ok
    assert result.message.startswith("UPDATED: ")
    assert "contradict the old rig file" in result.message
    expected = seen(true) - seen(rig)
    for row, change in zip(result.seen, expected, strict=True):
        # 4.5 standard deviations, of which one of four is beyond with a probability of 3e-5.
        assert abs(row.change - change) < 4.5 * row.sigma_after
    assert all(abs(row.sigmas) > 5 for row in result.seen[:2])
    assert not result.before.ok
    assert result.rig.require_beam().offset[0] == pytest.approx(true.parameter("e_x"), abs=0.1)


def test_what_images_cannot_see_keeps_its_prior(rig: Rig) -> None:
    """Of an undistorted camera: the focal length, and given the four numbers all else.

    Derivatives by what exact points cannot see are taken at noisy points: there they are about the noise over the
    picture's scale, 4e-4 of the focal length's sigma in each of 16 misfits, which moves it by 0.002 of its sigma, rms,
    and up to ten times that by those of the beam. Its standard deviation changes by the square of that.
    """
    names = ("f", "cx", "cy", "e_x", "e_y", "radius", "direction_x", "direction_y")
    sigmas = np.array([1.0, 0.5, 0.5, 0.04, 0.04, 0.005, 2e-4, 2e-4])
    flat = replace(
        rig, camera=replace(rig.camera, distortion=(0.0,) * 5), covariance=RigCovariance(names, np.diag(sigmas**2))
    ).with_parameters({"direction_x": 0.0, "direction_y": 0.0})
    result = recalibrate(spots(flat, planes(flat), np.random.default_rng(4)), flat, moves=Moves(0.0, 0.0))
    assert result.ok
    after = result.rig.covariance_matrix
    row = names.index("f")
    assert result.rig.parameter("f") == pytest.approx(flat.parameter("f"), abs=0.03 * sigmas[row])
    assert np.sqrt(after[row, row]) == pytest.approx(sigmas[row], rel=1e-3)

    by_free = seen_by(flat, names)

    def left_over(covariance: Array) -> Array:
        gain = covariance @ by_free.T @ np.linalg.inv(by_free @ covariance @ by_free.T)
        return (covariance - gain @ by_free @ covariance) / np.outer(sigmas, sigmas)

    np.testing.assert_allclose(left_over(after), left_over(np.diag(sigmas**2)), atol=1e-3)


def test_a_direction_that_was_not_free_is_known_afterwards(rig: Rig) -> None:
    """A parallel beam's calibration, of f, cx, cy, e and r: the direction joins with what the move allows."""
    some = slice(0, 6)
    parallel = replace(rig, covariance=RigCovariance(NAMES[some], rig.covariance_matrix[some, some]))
    result = recalibrate(spots(rig, planes(rig), np.random.default_rng(5)), parallel)
    assert result.ok
    assert result.rig.covariance is not None
    assert result.rig.covariance.parameters == NAMES
    turned = result.parameters[-1]
    assert turned.sigma_before == 0
    assert 0 < turned.sigma_after < 0.01


def test_refusals_say_why(rig: Rig) -> None:
    rng = np.random.default_rng(6)
    where = planes(rig)
    few = recalibrate(spots(rig, where[:4], rng), rig)
    assert few.outcome is Outcome.TOO_FEW
    assert "4 of 4, and 5 are needed" in few.message
    same = recalibrate(spots(rig, where[:1] * 6, rng), rig)
    assert same.outcome is Outcome.NOT_FIXED
    steps = np.linspace(-1, 1, 16)
    drifting = [
        spots(rig.with_parameters({"direction_x": rig.parameter("direction_x") + 5e-4 * step}), [plane], rng)[0]
        for step, plane in zip(steps, where + where[::-1], strict=True)
    ]
    trend = recalibrate(drifting, rig)
    assert trend.outcome is Outcome.MOVING
    assert "trend: chi-squared" in trend.message
    far = rig.with_parameters({"e_x": rig.parameter("e_x") + 1.0})
    assert recalibrate(spots(far, where, rng), rig, moves=Moves(0.02, 1e-3)).outcome is Outcome.TOO_FAR
    odd = spots(rig, where, rng)
    bent = odd[2].points + 0.6 * np.sin(2 * np.pi * np.arange(40) / 20)[:, None]
    wrong = recalibrate([*odd[:2], Spot(bent, odd[2].sigma), *odd[3:]], rig)
    assert wrong.outcome in (Outcome.DISAGREE, Outcome.MOVING)
    for result in (few, same, trend, wrong):
        assert not result.ok
        assert result.message.startswith("REFUSED: ")
        assert result.rig is rig
        assert result.kept == KEPT


def test_a_rig_without_a_covariance_needs_stated_sigmas(rig: Rig) -> None:
    bare = replace(rig, covariance=None)
    seen_spots = spots(rig, planes(rig), np.random.default_rng(7))
    with pytest.raises(InputError, match="no covariance"):
        recalibrate(seen_spots, bare)
    stated = with_stated_sigmas(bare, {"radius": 0.01, "f": 2.0, "cx": 1.0, "cy": 1.0})
    assert stated.covariance is not None
    assert stated.covariance.parameters == ("f", "cx", "cy", "radius")
    assert recalibrate(seen_spots, stated).ok
    for sigmas, reason in (({"q": 1.0}, "not a parameter"), ({"f": 0.0}, "positive"), ({"f": np.nan}, "positive")):
        with pytest.raises(InputError, match=reason):
            with_stated_sigmas(bare, sigmas)
    with pytest.raises(InputError, match="that has none"):
        with_stated_sigmas(rig, {"f": 1.0})


def test_what_is_asked_for_is_checked(rig: Rig) -> None:
    for moves in ((-1.0, 0.0), (0.0, np.inf)):
        with pytest.raises(InputError, match="from 0"):
            Moves(*moves)
    with pytest.raises(InputError, match="positions must be 8 finite numbers"):
        recalibrate(spots(rig, planes(rig), np.random.default_rng(8)), rig, positions=[1.0])


def test_points_without_a_sigma_do(rig: Rig) -> None:
    """Their scale is estimated from 40 points: the four numbers are where they are with the sigma given."""
    given = spots(rig, planes(rig), np.random.default_rng(9))
    with_sigma = recalibrate(given, rig)
    without = recalibrate([Spot(spot.points, None) for spot in given], rig)
    assert without.ok
    for one, other in zip(without.seen, with_sigma.seen, strict=True):
        assert one.after == pytest.approx(other.after, abs=1.5 * other.sigma_after)
        assert one.sigma_after == pytest.approx(other.sigma_after, rel=0.5)
