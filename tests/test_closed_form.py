"""The closed form: both planes, by both routes, over the whole range; refusals without a warning; its derivative."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cases import WORKED, WORKED_SETUP, Array, slopes
from planeopt import equations as eq
from planeopt.closed_form import from_dual, from_primal, other_plane, slope_jacobian, solve_both

EPS = float(np.finfo(float).eps)

SETUPS = {
    "outside": eq.Setup(25.0, 30.0, 40.0, 10.0),
    "just outside": eq.Setup(16.0, 6.0, 8.5, 10.0),
    "on the beam": eq.Setup(16.0, 6.0, 8.0, 10.0),
    "inside": eq.Setup(16.0, 3.0, -2.0, 10.0),
    "on the axis": eq.Setup(16.0, 0.0, 0.0, 10.0),
}


def paper_variables(plane: Array, k: eq.Setup) -> eq.PaperVariables:
    z_L, p, q = (float(value) for value in plane)
    alpha = math.atan(math.hypot(p, q))
    return eq.PaperVariables(k.r / math.cos(alpha), z_L, alpha, math.atan2(-p, q))


def conic(plane: Array, k: eq.Setup) -> Array:
    """B_1 ... B_5 of (6), in the paper's variables."""
    b = np.array(eq.image_conic(np, paper_variables(plane, k), k))
    return b[1:] / b[0]


def random_planes(rng: np.random.Generator, k: eq.Setup, n: int) -> Array:
    """Planes whose lit side the camera sees and whose whole spot is in front, tilts up to 75 deg."""
    found = []
    while len(found) < n:
        tangent, azimuth = math.tan(math.radians(rng.uniform(0, 75))), rng.uniform(-np.pi, np.pi)
        z_L = rng.uniform(60, 1000)
        p, q = tangent * math.cos(azimuth), tangent * math.sin(azimuth)
        if z_L > 1.01 * k.r * tangent and z_L - p * k.e_x - q * k.e_y > 0.01 * z_L:
            found.append((z_L, p, q))
    return np.array(found)


def conic_derivative(plane: Array, k: eq.Setup) -> Array:
    """dB/d(z_L, p, q), (5, 3), by a complex step of (6) in slopes."""
    columns = []
    for i in range(3):
        z_L, p, q = plane + 1e-30j * np.eye(3)[i]
        b = np.array(eq.image_conic_in_slopes(np, eq.SlopeVariables(None, z_L, p, q), k))
        columns.append((b[1:] / b[0]).imag / 1e-30)
    return np.stack(columns, axis=1)


def size_of(B: Array) -> Array:
    """Sizes of B_1 ... B_5 that rounding is relative to: a coefficient may vanish, its terms do not."""
    length = math.sqrt((B[2] ** 2 + B[3] ** 2) / 4 + abs(B[4]))
    return np.abs(B) + np.array([1, 1, length, length, length**2])


@pytest.mark.parametrize("k", SETUPS.values(), ids=SETUPS)
def test_many_conics_at_once_equal_one_by_one(k: eq.Setup) -> None:
    planes = random_planes(np.random.default_rng(1), k, 60)
    B = np.stack([conic(plane, k) for plane in planes]).reshape(3, 20, 5)
    B[1, 4] = np.nan
    B[2, 7] = [0, -1, 0, 0, -1]
    together = solve_both(B, k)
    for i in np.ndindex(3, 20):
        alone = solve_both(B[i], k)
        # Vectorised loops may round differently from scalar ones: by a few units in the last place.
        np.testing.assert_allclose(together.visible[i], alone.visible, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(together.other[i], alone.other, rtol=1e-9, atol=1e-9)
        assert together.ok[i] == alone.ok
    assert together.visible.shape == together.other.shape == (3, 20, 3)
    assert together.ok.sum() == 58
    jacobians = slope_jacobian(B, k)
    assert jacobians.shape == (3, 20, 3, 5)
    np.testing.assert_allclose(jacobians[0, 3], slope_jacobian(B[0, 3], k), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("k", SETUPS.values(), ids=SETUPS)
def test_both_planes_satisfy_all_ten_equations(k: eq.Setup) -> None:
    lengths = {"1": 1.0, "mm": k.r, "mm^2": k.r**2 + k.e_x**2 + k.e_y**2}
    for plane in random_planes(np.random.default_rng(2), k, 40):
        B = conic(plane, k)
        planes = solve_both(B, k)
        assert planes.ok
        for found in (planes.visible, planes.other):
            if np.isnan(found).all():
                assert k == SETUPS["on the beam"]
                continue
            # Rounding of B moves the plane by |J| |B| eps, which shows in the residuals through dB/d plane. The dual
            # route forms minors that are up to 1e3 smaller than their terms in this range.
            moved = np.abs(slope_jacobian(B, k)) @ size_of(B) * (1 + np.abs(found / planes.visible).max())
            allowed = np.abs(conic_derivative(found, k)) @ moved + size_of(B)
            residuals = np.array(eq.ten_residuals(np, paper_variables(found, k), k, B))
            tilt = 1 + found[1] ** 2 + found[2] ** 2
            laser = [lengths[e.unit] * tilt for e in eq.LASER_BLOCK]
            assert np.all(np.abs(residuals[:5]) <= 1e2 * EPS * np.array(laser))
            assert np.all(np.abs(residuals[5:]) <= 1e3 * EPS * allowed)


@pytest.mark.parametrize("k", SETUPS.values(), ids=SETUPS)
def test_the_visible_plane_has_c_above_zero_and_the_other_its_negative(k: eq.Setup) -> None:
    truth = random_planes(np.random.default_rng(3), k, 200)
    planes = solve_both(np.stack([conic(plane, k) for plane in truth]), k)
    e = np.array([k.e_x, k.e_y])
    intercept = truth[:, 0] - truth[:, 1:] @ e
    assert planes.ok.all()
    assert np.all(planes.intercept > 0)
    np.testing.assert_allclose(planes.intercept, intercept, rtol=1e-8)
    if k == SETUPS["on the beam"]:
        assert np.isnan(planes.other).all()
        return
    other_c = planes.other[:, 0] - planes.other[:, 1:] @ e
    np.testing.assert_allclose(other_c, -planes.intercept, rtol=1e-9)
    outside = k.e_x**2 + k.e_y**2 > k.r**2
    # Outside the beam the other plane's spot is always in front of the camera, inside it always behind.
    in_front = planes.other[:, 0] > k.r * np.linalg.norm(planes.other[:, 1:], axis=1)
    assert np.all(in_front == outside)
    # Taking the other plane twice comes back.
    np.testing.assert_allclose(other_plane(planes.other, k), planes.visible, rtol=1e-9, atol=1e-9)


def test_on_the_axis_the_other_plane_is_the_mirror_image() -> None:
    k = SETUPS["on the axis"]
    truth = random_planes(np.random.default_rng(4), k, 20)
    planes = solve_both(np.stack([conic(plane, k) for plane in truth]), k)
    np.testing.assert_allclose(planes.other, planes.visible * [-1, 1, 1], rtol=1e-14)


def test_the_worked_example_and_its_second_plane() -> None:
    planes = solve_both(conic(slopes(WORKED), WORKED_SETUP), WORKED_SETUP)
    np.testing.assert_allclose(planes.visible, slopes(WORKED), rtol=1e-12)
    other = paper_variables(planes.other, WORKED_SETUP)
    # c = 75 + 15 sqrt(3) - 60, z_L' = z_L + 2 c r^2/k and n' = n + 2 c e/k with k = 2400.
    c = 15 + 15 * math.sqrt(3)
    p, q = -math.sqrt(3) / 2 + c / 40, 1.5 + c / 30
    assert planes.intercept == pytest.approx(c, rel=1e-12)
    assert other.z_L == pytest.approx(75 + c / 12, rel=1e-12)
    assert other.alpha == pytest.approx(math.atan(math.hypot(p, q)), rel=1e-12)
    assert other.beta == pytest.approx(math.atan2(-p, q), rel=1e-12)


@pytest.mark.parametrize("k", SETUPS.values(), ids=SETUPS)
@pytest.mark.parametrize(
    "B",
    [
        [0, -1, 0, 0, -1],
        [0, -1, 0, 0, 1],
        [0, 1, 0, 0, 1],
        [-3.99, 8.89, -31.4, 194.0, -1111.1],
        [-3.99, 8.89, 31.4, -194.0, 0.0],
        [0, 1, 0, 0, 0],
        [0, 0, 0, 0, 0],
        [2, 1, 0, 0, 0],
        [math.nan] * 5,
        [0, 1, math.inf, 0, 1],
    ],
    ids=[
        "hyperbola",
        "other hyperbola",
        "imaginary",
        "indefinite",
        "through the origin",
        "a point",
        "a double line",
        "a line through the origin",
        "nan",
        "infinite",
    ],
)
def test_a_conic_without_a_plane_is_refused_without_a_warning(k: eq.Setup, B: list[float]) -> None:
    planes = solve_both(B, k)
    if planes.ok:
        # The least-squares scale finds a plane for some conics that no plane makes; it must at least be a visible one.
        assert planes.intercept > 0
        assert planes.visible[0] > k.r * np.hypot(planes.visible[1], planes.visible[2])
        return
    assert np.isnan(planes.visible).all()
    assert np.isnan(planes.other).all()
    assert np.isnan(planes.intercept)


@pytest.mark.parametrize("k", SETUPS.values(), ids=SETUPS)
def test_the_derivative_is_that_of_the_visible_plane(k: eq.Setup) -> None:
    for plane in random_planes(np.random.default_rng(5), k, 10):
        B = conic(plane, k)
        exact = slope_jacobian(B, k)
        # Steps that change the plane by about h of its size; the third derivative then counts as 1/h^2 of the first.
        h = 1e-4 / (np.abs(exact) / np.array([[plane[0]], [1], [1]])).max(axis=0)

        def difference(scale: float, B: Array = B, h: Array = h) -> Array:
            steps = scale * np.diag(h)
            return ((solve_both(B + steps, k).visible - solve_both(B - steps, k).visible) / (2 * scale * h[:, None])).T

        near, far = difference(1.0), difference(2.0)
        extrapolated = near + (near - far) / 3
        # Central differences err by f''' h^2/6 = (far - near)/3, extrapolation takes that off; rounding of the values
        # (that of B carried through the derivative, by the dual route 1e3 times that) is divided by the step.
        rounding = 1e3 * EPS * (np.abs(exact) @ size_of(B))[:, None] / h
        assert np.all(np.abs(extrapolated - exact) <= np.abs(far - near) / 3 + rounding)
        assert np.all(np.abs(far - near) <= 1e-2 * np.abs(exact).max(axis=1, keepdims=True))


visible_cases = st.tuples(
    st.floats(1, 20),
    st.floats(0, 4),
    st.floats(-math.pi, math.pi),
    st.floats(0, 75),
    st.floats(-math.pi, math.pi),
    st.floats(60, 1000),
    st.floats(1, 50),
)


def drawn(values: tuple[float, ...]) -> tuple[Array, eq.Setup]:
    """A plane with its lit side and whole spot well in view, and a rig."""
    r, offset, turn, tilt, azimuth, z_L, f = values
    k = eq.Setup(f, offset * r * math.cos(turn), offset * r * math.sin(turn), r)
    tangent = math.tan(math.radians(tilt))
    plane = np.array([z_L, tangent * math.cos(azimuth), tangent * math.sin(azimuth)])
    assume(z_L > 1.01 * r * tangent)
    assume(z_L - plane[1:] @ [k.e_x, k.e_y] > 0.01 * z_L)
    return plane, k


def worst(found: Array, plane: Array) -> float:
    """The larger of the relative error of depth and the angle between the normals."""
    a, b = np.array([*found[1:], -1.0]), np.array([*plane[1:], -1.0])
    angle = math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
    return max(abs(found[0] / plane[0] - 1), angle)


@given(visible_cases)
@settings(max_examples=300, deadline=None, derandomize=True)
def test_any_visible_plane_is_found_from_its_exact_image(values: tuple[float, ...]) -> None:
    plane, k = drawn(values)
    planes = solve_both(conic(plane, k), k)
    assert planes.ok
    # The dual's minors lose up to (z_L/r)^2 of the digits, 1e6 x 2e-16 at worst in this range, times a small constant.
    assert worst(planes.visible, plane) < 1e-8


@given(visible_cases)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_both_routes_agree_where_both_are_well_conditioned(values: tuple[float, ...]) -> None:
    plane, k = drawn(values)
    assume(abs(k.e_x**2 + k.e_y**2 - k.r**2) > 0.1 * k.r**2)
    assume(k.e_x**2 + k.e_y**2 > 0.01 * k.r**2)
    B = conic(plane, k)
    primal, dual = np.array(from_primal(B, k), dtype=float), np.array(from_dual(B, k), dtype=float)
    assert worst(primal, dual) < 1e-8


@given(visible_cases, st.sampled_from([0.25, 0.5, 2.0, 16.0]))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_a_change_of_the_unit_of_length_changes_nothing_but_the_unit(values: tuple[float, ...], unit: float) -> None:
    plane, k = drawn(values)
    B = conic(plane, k)
    here = solve_both(B, k)
    there = solve_both(B * np.array([1, 1, unit, unit, unit**2]), eq.Setup(*(unit * length for length in k)))
    # Powers of two: every product is scaled exactly.
    np.testing.assert_array_equal(there.visible, here.visible * [unit, 1, 1])
    np.testing.assert_array_equal(there.other, here.other * [unit, 1, 1])


@given(visible_cases)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_the_image_does_not_know_the_focal_length(values: tuple[float, ...]) -> None:
    plane, k = drawn(values)
    B = conic(plane, k)
    wrong = solve_both(B, k._replace(f=2 * k.f))
    # The same ellipse with f -> 2 f is the plane with all of (z_L, p, q) doubled.
    np.testing.assert_array_equal(wrong.visible, 2 * solve_both(B, k).visible)


@given(visible_cases, st.floats(-math.pi, math.pi))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_turning_the_camera_about_its_axis_turns_the_slopes(values: tuple[float, ...], turn: float) -> None:
    plane, k = drawn(values)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    e_x, e_y = rotation @ [k.e_x, k.e_y]
    turned_plane = np.array([plane[0], *(rotation @ plane[1:])])
    turned = solve_both(conic(turned_plane, k._replace(e_x=e_x, e_y=e_y)), k._replace(e_x=e_x, e_y=e_y))
    assert worst(turned.visible, turned_plane) < 1e-8
