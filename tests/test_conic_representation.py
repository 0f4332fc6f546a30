"""The image ellipse's representations are each other's inverses and move with the plane as they should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt import conic
from planeopt.errors import InputError

EPS = np.finfo(float).eps


def number(low, high):
    """A float whose products do not underflow: half of a subnormal number is not exact."""
    return st.floats(low, high).map(lambda value: value if abs(value) > 1e-100 else 0.0)


ellipses = st.tuples(number(-30, 30), number(-30, 30), st.floats(0.5, 5), st.floats(0.05, 1), number(-1.5, 1.5))


def on_ellipse(ellipse, angles):
    x, y, a, ratio, angle = ellipse
    u, v = a * np.cos(angles), a * ratio * np.sin(angles)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([x + cos * u - sin * v, y + sin * u + cos * v], axis=-1)


def coefficients(ellipse):
    x, y, a, ratio, angle = ellipse
    return conic.conic_from_geometric([x, y], [a, a * ratio], angle)


def holding(ellipse):
    """How much of B5 is the ellipse's own size: the rounding of B in units of its smallest axis, squared."""
    x, y, a, ratio, _ = ellipse
    return EPS * (x * x + y * y + a * a) / (a * ratio) ** 2 / ratio**2


@given(ellipses)
@settings(max_examples=60, derandomize=True)
def test_geometric_and_back(ellipse):
    B = coefficients(ellipse)
    found = conic.geometric_from_conic(B)
    x, y, a, ratio, angle = ellipse
    tolerance = 50 * holding(ellipse)
    np.testing.assert_allclose(found.centre, [x, y], rtol=0, atol=tolerance * 30)
    np.testing.assert_allclose(found.semi_axes, [a, a * ratio], rtol=tolerance)
    if ratio < 0.95:
        assert abs(np.sin(found.angle - angle)) < tolerance / (1 - ratio)
    # B5 is a difference of squares of this size, and may cancel to nothing.
    cancelled = 100 * EPS * (x * x + y * y + a * a) / ratio**2
    again = conic.conic_from_geometric(found.centre, found.semi_axes, found.angle)
    np.testing.assert_allclose(again, B, rtol=1e-6, atol=cancelled)


@given(ellipses)
@settings(max_examples=60, derandomize=True)
def test_matrix_and_dual_and_back(ellipse):
    B = coefficients(ellipse)
    C = conic.conic_matrix(B)
    np.testing.assert_array_equal(conic.conic_from_matrix(C), B)
    np.testing.assert_allclose(conic.conic_from_matrix(-3 * C), B, rtol=4 * EPS)
    dual = conic.dual_conic(B)
    scale = np.linalg.norm(C, axis=(-1, -2)) ** 3
    np.testing.assert_allclose(dual @ C, np.linalg.det(C) * np.eye(3), atol=20 * EPS * scale)
    # adj(adj(C)) = det(C) C: its digits are those of det(C), which cancels as the ellipse's size does in B5.
    np.testing.assert_allclose(
        conic.conic_from_dual(dual), B, atol=1e3 * holding(ellipse) * np.max(np.abs(B)), rtol=1e-9
    )


def test_dual_holds_the_tangents():
    ellipse = (3.0, -2.0, 2.0, 0.6, 0.4)
    angles = np.linspace(0, 6, 9)
    points = on_ellipse(ellipse, angles)
    B = coefficients(ellipse)
    tangents = np.c_[points, np.ones(9)] @ conic.conic_matrix(B)
    values = np.einsum("ni,ij,nj->n", tangents, conic.dual_conic(B), tangents)
    assert np.max(np.abs(values)) < 1e-10


def test_leading_dimensions_are_kept():
    B = conic.conic_from_geometric(np.zeros((2, 3, 2)), [2.0, 1.0], np.linspace(0, 1, 3))
    assert B.shape == (2, 3, 5)
    assert conic.conic_matrix(B).shape == (2, 3, 3, 3)
    assert conic.is_ellipse(B).shape == (2, 3)
    assert conic.geometric_from_conic(B).semi_axes.shape == (2, 3, 2)
    assert conic.sampson_distances(B, np.ones((2, 1, 7, 2))).shape == (2, 3, 7)
    assert conic.arc_fraction(B, on_ellipse((0, 0, 2, 0.5, 0), np.arange(9.0))).shape == (2, 3)


@pytest.mark.parametrize(
    ("B", "expected"),
    [
        ([0, 1, 0, 0, -1], True),
        ([0, -1, 0, 0, -1], False),  # hyperbola
        ([0, 0, 0, 1, 0], False),  # parabola
        ([0, 1, 0, 0, 1], False),  # imaginary ellipse
        ([0, 1, 0, 0, 0], False),  # a point
        ([2, 1, 0, 0, -1], False),  # parallel lines
        ([0, 1, 0, 0, np.nan], False),
    ],
)
def test_is_ellipse(B, expected):
    assert bool(conic.is_ellipse(B)) is expected


@given(ellipses, st.floats(-3, 3), st.floats(0.3, 3), st.floats(-1, 1))
@settings(max_examples=50, derandomize=True)
def test_affine_transport_moves_the_points(ellipse, turn, stretch, shear):
    cos, sin = np.cos(turn), np.sin(turn)
    A = np.array([[cos, -sin], [sin, cos]]) @ np.array([[stretch, shear], [0, 1]])
    t = np.array([5.0, -7.0])
    moved = on_ellipse(ellipse, np.linspace(0, 6, 12)) @ A.T + t
    distance = conic.sampson_distances(conic.transform_conic(coefficients(ellipse), A, t), moved)
    x, y, a, ratio, _ = ellipse
    # Q is known to eps |B5|-like terms; over its gradient, at least the small semi-axis (in the stretched plane).
    assert np.max(np.abs(distance)) < 1e4 * EPS * (x * x + y * y + 100) / (a * ratio**2)


def test_transport_jacobian_is_the_derivative():
    B, A, t = coefficients((3.0, -2.0, 2.0, 0.6, 0.4)), np.array([[1.2, -0.3], [0.4, 0.8]]), np.array([1.0, 2.0])
    step = 1e-5
    columns = [
        (conic.transform_conic(B + step * e, A, t) - conic.transform_conic(B - step * e, A, t)) / (2 * step)
        for e in np.eye(5)
    ]
    J = conic.transform_jacobian(B, A, t)
    # Central differences err by step^2 times the third derivative, and by eps |B| / step.
    np.testing.assert_allclose(J, np.stack(columns, axis=-1), rtol=1e-7, atol=1e-7)
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    np.testing.assert_allclose(conic.transform_covariance(covariance, B, A, t), J @ covariance @ J.T)
    back = conic.transform_conic(conic.transform_conic(B, A, t), np.linalg.inv(A), -np.linalg.inv(A) @ t)
    np.testing.assert_allclose(back, B, rtol=1e-12)


def test_sampson_distance_of_a_circle_and_with_covariance():
    B = conic.conic_from_geometric([0, 0], [2, 2])
    points = np.array([[2.001, 0], [0, -1.999]])
    # First order: (rho^2 - r^2) / (2 rho).
    np.testing.assert_allclose(conic.sampson_distances(B, points), [1e-3, -1e-3], rtol=1e-3)
    V = np.broadcast_to(np.diag([0.25, 4.0]), (2, 2, 2))
    np.testing.assert_allclose(conic.sampson_distances(B, points, V), [2e-3, -0.5e-3], rtol=1e-3)


@given(ellipses)
@settings(max_examples=30, derandomize=True)
def test_eccentric_angles(ellipse):
    ellipse = (*ellipse[:3], min(ellipse[3], 0.9), ellipse[4])
    angles = np.linspace(-3, 3, 11)
    found = conic.eccentric_angles(coefficients(ellipse), on_ellipse(ellipse, angles))
    assert np.max(np.abs(np.sin(found - angles))) < 1e4 * holding(ellipse)
    assert np.all(np.cos(found - angles) > 0)


@pytest.mark.parametrize("n", [5, 20, 200, 5000])
@pytest.mark.parametrize("fraction", [1.0, 0.75, 0.4])
def test_arc_fraction_of_even_points(n, fraction):
    ellipse = (3.0, -2.0, 2.0, 0.6, 0.4)
    span = 2 * np.pi * fraction
    angles = 1.0 + (span * np.arange(n) / n if fraction == 1 else np.linspace(0, span, n))
    if n == 5 and fraction == 0.75:
        # The open quarter is no wider than three spacings of five points, so it counts as covered.
        fraction = 1.0
    np.testing.assert_allclose(conic.arc_fraction(coefficients(ellipse), on_ellipse(ellipse, angles)), fraction)


def test_arc_fraction_of_points_even_along_a_long_ellipse():
    ellipse = (0.0, 0.0, 5.0, 0.05, 0.0)
    dense = np.linspace(0, 2 * np.pi, 200001)
    length = np.r_[0, np.cumsum(np.hypot(*np.diff(on_ellipse(ellipse, dense), axis=0).T))]
    angles = np.interp(np.arange(300) / 300 * length[-1], length, dense)
    points = on_ellipse(ellipse, angles)
    assert conic.arc_fraction(coefficients(ellipse), points) == 1
    half = points[angles < np.pi]
    assert conic.arc_fraction(coefficients(ellipse), half) == pytest.approx(0.5, abs=0.03)


def test_arc_fraction_sums_several_gaps_and_shrugs_at_repeated_points():
    ellipse = (0.0, 0.0, 2.0, 0.7, 0.3)
    angles = np.r_[np.linspace(0, 1, 50), np.linspace(2, 3, 50), np.linspace(4, 4.5, 25)]
    points = on_ellipse(ellipse, np.repeat(angles, 2))
    assert conic.arc_fraction(coefficients(ellipse), points) == pytest.approx(2.5 / (2 * np.pi), abs=1e-9)


def test_arc_fraction_of_gaps_of_three_spacings_is_not_left_to_rounding():
    rng = np.random.default_rng(0)
    for n in np.repeat([24, 35, 50, 55], 50):
        # On a grid: many gaps are three typical ones, but for the last digits.
        angles = np.round(rng.uniform(0, 2 * np.pi, n) * 20) / 20
        ellipses = [(x, -2.0, 3.0, 2.7, 0.4) for x in (-5.0, 0.1, 3.0)]
        fractions = [conic.arc_fraction(coefficients(e), on_ellipse(e, angles)) for e in ellipses]
        np.testing.assert_allclose(fractions, fractions[0], rtol=1e-9)


def test_arc_fraction_of_rows_filled_up_with_their_own_points():
    ellipse = (1.0, 2.0, 3.0, 1.1, 0.4)
    rng = np.random.default_rng(0)
    rows = [on_ellipse(ellipse, rng.uniform(0, 5, n)) for n in (12, 17, 30, 9)]
    filled = np.stack([row[np.arange(30) % len(row)] for row in rows])
    together = conic.arc_fraction(coefficients(ellipse), filled, [len(row) for row in rows])
    alone = [conic.arc_fraction(coefficients(ellipse), row) for row in rows]
    np.testing.assert_allclose(together, alone, rtol=1e-12)
    assert len(set(together)) == len(rows)
    with pytest.raises(InputError, match="4 points given"):
        conic.arc_fraction(coefficients(ellipse), filled, [12, 4, 30, 9])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: conic.conic_matrix([1, 2, 3]), r"five coefficients.*\(3,\)"),
        (lambda: conic.conic_from_matrix(np.eye(2)), r"\(\.\.\., 3, 3\)"),
        (lambda: conic.conic_from_matrix(np.diag([0.0, 1, 1])), "coefficient of x\\^2 is zero"),
        (lambda: conic.geometric_from_conic([[0, 1, 0, 0, -1], [0, -1, 0, 0, -1]]), "conic 1 of 2 is not a real"),
        (lambda: conic.conic_from_geometric([0, 0], [1, -1]), "semi-axes"),
        (lambda: conic.transform_conic([0, 1, 0, 0, -1], np.ones((2, 2)), [0, 0]), "invertible"),
        (lambda: conic.transform_conic([0, 1, 0, 0, -1], np.eye(3), [0, 0]), "shapes are"),
        (lambda: conic.arc_fraction([0, 1, 0, 0, -1], np.ones((4, 2))), "4 points given"),
        (lambda: conic.sampson_distances([0, 1, 0, 0, -1], np.ones(4)), r"\(4,\)"),
    ],
)
def test_wrong_input_is_refused_in_one_line(call, message):
    with pytest.raises(InputError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)
