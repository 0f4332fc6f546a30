"""The arrow-shaped equations against dense ones."""

import numpy as np
import pytest

from planeopt.calibration.arrow import Arrow, Inverse, condition


def _dense(arrow: Arrow) -> tuple[np.ndarray, np.ndarray]:
    views, _, g = arrow.W.shape
    N = np.zeros((g + 6 * views,) * 2)
    pull = np.concatenate([arrow.shared, arrow.pose.ravel()])
    N[:g, :g] = arrow.V
    for row in range(views):
        place = slice(g + 6 * row, g + 6 * row + 6)
        N[place, place] = arrow.U[row]
        N[place, :g] = arrow.W[row]
        N[:g, place] = arrow.W[row].T
    return N, pull


def _random(g: int, seed: int = 0, views: int = 4, count: int = 30) -> Arrow:
    rng = np.random.default_rng(seed)
    shared = rng.standard_normal((views, count, g)) * 10.0 ** rng.uniform(-3, 3, g)
    pose = rng.standard_normal((views, count, 6))
    return Arrow.of(rng.standard_normal((views, count)), shared, pose, rng.uniform(0.5, 2, (views, count)))


@pytest.mark.parametrize("g", [0, 1, 7])
def test_step_is_the_dense_one(g: int):
    arrow = _random(g)
    N, pull = _dense(arrow)
    shared, pose = arrow.step()
    np.testing.assert_allclose(np.concatenate([shared, pose.ravel()]), -np.linalg.solve(N, pull), rtol=1e-8)
    expected = np.sqrt(pull @ np.linalg.solve(N, pull))
    assert arrow.decrement(shared, pose) == pytest.approx(expected, rel=1e-9)


def test_inverse_s_blocks_are_the_dense_ones():
    one, other = _random(5, 1), _random(5, 2)
    total = one + other
    dense = np.linalg.inv(_dense(total)[0])
    found = Inverse.of(total)
    np.testing.assert_allclose(found.shared, dense[:5, :5], rtol=1e-8)
    for row in range(4):
        place = slice(5 + 6 * row, 11 + 6 * row)
        np.testing.assert_allclose(found.between[row], dense[place, :5], rtol=1e-6, atol=1e-9 * np.abs(dense).max())
        np.testing.assert_allclose(found.pose[row], dense[place, place], rtol=1e-8)
    assert found.trace(one) == pytest.approx(np.trace(dense @ _dense(one)[0]), rel=1e-9)
    # All observations together pay for all unknowns.
    assert found.trace(one) + found.trace(other) == pytest.approx(5 + 6 * 4, rel=1e-9)


def test_information_without_the_poses():
    arrow = _random(4)
    dense = np.linalg.inv(_dense(arrow)[0])[:4, :4]
    np.testing.assert_allclose(np.linalg.inv(arrow.reduced()), dense, rtol=1e-7)


def test_condition_does_not_depend_on_units_but_sees_what_poses_imitate():
    rng = np.random.default_rng(3)
    views, count = 3, 40
    shared, pose = rng.standard_normal((views, count, 3)), rng.standard_normal((views, count, 6))
    weight, residual = np.ones((views, count)), np.zeros((views, count))
    plain = condition(Arrow.of(residual, shared, pose, weight))
    scaled = condition(Arrow.of(residual, shared * [1e3, 1.0, 1e-4], pose, weight))
    assert plain == pytest.approx(scaled, rel=1e-6)
    imitated = shared.copy()
    # But for a thousandth, the third parameter does what the poses can do by themselves.
    imitated[..., 2] = pose @ rng.standard_normal(6) + 1e-3 * shared[..., 2]
    assert condition(Arrow.of(residual, imitated, pose, weight)) > 100 * plain
