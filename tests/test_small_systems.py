"""Small systems solved side by side: what numpy.linalg says, to rounding."""

import numpy as np

from planeopt.estimation.small_systems import lower_solved, positive_solved, upper_solved


def test_triangles() -> None:
    rng = np.random.default_rng(0)
    triangles = np.tril(rng.standard_normal((40, 5, 5)), -1) + 3 * np.eye(5)
    right = rng.standard_normal((40, 5, 7))
    given = right.copy()
    np.testing.assert_allclose(lower_solved(triangles, right), np.linalg.solve(triangles, right), atol=1e-13)
    upper = np.swapaxes(triangles, 1, 2)
    np.testing.assert_allclose(upper_solved(upper, right), np.linalg.solve(upper, right), atol=1e-13)
    np.testing.assert_array_equal(right, given)
    # What lies on the other side of the diagonal is not looked at.
    full = triangles + np.triu(rng.standard_normal((40, 5, 5)), 1)
    np.testing.assert_array_equal(lower_solved(full, right), lower_solved(triangles, right))


def test_positive_definite() -> None:
    """Of any units: rows and columns a thousand million apart cost no digits."""
    rng = np.random.default_rng(1)
    half = rng.standard_normal((40, 3, 3)) + 3 * np.eye(3)
    size = np.array([1e-6, 1.0, 1e3])
    matrices = half @ np.swapaxes(half, 1, 2) * size[:, None] * size
    wanted = rng.standard_normal((40, 3)) / size
    right = (matrices @ wanted[..., None])[..., 0]
    condition = np.max(np.linalg.cond(matrices / (size[:, None] * size)))
    assert condition < 1e3
    np.testing.assert_allclose(positive_solved(matrices, right) * size, wanted * size, atol=1e3 * 1e-15 * 10)


def test_singular_ones_cost_themselves() -> None:
    matrices = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)])
    with np.errstate(all="ignore"):
        found = positive_solved(matrices, np.ones((3, 3)))
    np.testing.assert_array_equal(found[0], 1.0)
    assert not np.isfinite(found[1:]).any()
