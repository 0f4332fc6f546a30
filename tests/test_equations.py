"""The paper's equations: against each other, against the geometry they describe, and in both namespaces."""

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cases import WORKED, WORKED_SETUP, boundary, circle, slopes
from planeopt import equations as eq
from planeopt.closed_form import other_plane
from planeopt.conic import dual_conic, is_ellipse, sampson_distances
from planeopt.formulations.identifiability import independent_jacobian, ten_jacobian
from planeopt.plane import Plane

THETA = circle(24)
EPS = float(np.finfo(float).eps)
EXAMPLES = settings(max_examples=60, deadline=None, derandomize=True, database=None)

# Rounding, amplified: the strategies below keep the condition of every formula under test under some 1e5.
ROUNDING = 1e5 * EPS


@st.composite
def setups(draw: st.DrawFn) -> eq.Setup:
    offset, turn = draw(st.floats(0, 40)), draw(st.floats(-math.pi, math.pi))
    f, r = draw(st.floats(4, 60)), draw(st.floats(1, 20))
    return eq.Setup(f, offset * math.cos(turn), offset * math.sin(turn), r)


@st.composite
def spots(draw: st.DrawFn, k: eq.Setup, off_the_beam: bool = False) -> eq.PaperVariables:
    """A spot in front of the camera, which lies on the beam unless asked otherwise."""
    alpha = math.radians(draw(st.floats(1, 75)))
    beta = draw(st.floats(-math.pi, math.pi, exclude_min=True))
    stretch = draw(st.floats(0.5, 2)) if off_the_beam else 1.0
    R = stretch * k.r / math.cos(alpha)
    return eq.PaperVariables(R, R * math.sin(alpha) + draw(st.floats(20, 1000)), alpha, beta)


@st.composite
def cases(draw: st.DrawFn, off_the_beam: bool = False) -> tuple[eq.PaperVariables, eq.Setup]:
    k = draw(setups())
    v = draw(spots(k, off_the_beam))
    # b_0 vanishes where the plane runs through the camera's centre: nothing is seen of it then.
    assume(abs(eq.lit_side(np, v, k)) > 0.05 * v.z_L)
    return v, k


def ellipse(v: eq.PaperVariables, k: eq.Setup) -> np.ndarray:
    b = np.array(eq.image_conic(np, v, k))
    return b[1:] / b[0]


def natural_sizes(B: np.ndarray, k: eq.Setup) -> np.ndarray:
    """Sizes of the terms that cancel in each of the ten."""
    length = math.sqrt(np.sum(B[2:4] ** 2) / 4 + abs(B[4]))
    e = math.hypot(k.e_x, k.e_y) + k.r
    return np.array([1, 1, e, e, e**2, 1 + abs(B[0]), 1 + abs(B[1]), length, length, length**2])


def on_the_beam(v: eq.PaperVariables) -> eq.SlopeVariables:
    return eq.SlopeVariables(v.R, v.z_L, *eq.slopes(np, v))


# --- Both namespaces -------------------------------------------------------------------------------------------------

BY_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "paper": (
        *(eq.image_conic, eq.laser_conic, *eq.LASER_BLOCK, eq.laser_constraint, eq.in_front, eq.lit_side),
        *(eq.eq24, eq.eq25, eq.eq26, eq.eq27, eq.eq28),
    ),
    "paper, B": (*eq.IMAGE_BLOCK, eq.eq23),
    "slopes": (
        *(eq.image_conic_in_slopes, eq.laser_constraint_in_slopes),
        *(eq.in_front_in_slopes, eq.before_camera, eq.lit_side_in_slopes),
    ),
    "slopes, B": (eq.image_residuals_in_slopes,),
}
CALLS = [(e, kind) for kind, equations in BY_ARGUMENTS.items() for e in equations]


def call(m: Any, equation: eq.Equation, kind: str, v: Any, k: Any, B: Any) -> list[Any]:
    unknowns = v if kind.startswith("paper") else eq.SlopeVariables(v.R, v.z_L, *eq.slopes(m, v))
    value = equation(m, unknowns, k, *([B] if kind.endswith("B") else []))
    return list(value) if isinstance(value, (list, tuple)) else [value]


@pytest.mark.parametrize(("equation", "kind"), CALLS, ids=[str(e) for e, _ in CALLS])
def test_casadi_and_numpy_agree(equation: eq.Equation, kind: str) -> None:
    x = ca.SX.sym("x", 13)
    v, k, B = eq.PaperVariables(*ca.vertsplit(x[:4])), eq.Setup(*ca.vertsplit(x[4:8])), ca.vertsplit(x[8:])
    function = ca.Function("f", [x], [ca.vertcat(*call(ca, equation, kind, v, k, B))])
    # Off the beam, where no residual vanishes.
    numbers = WORKED._replace(R=23.0), WORKED_SETUP, np.array([-4.0, 9.0, 31.0, -190.0, 1100.0])
    expected = call(np, equation, kind, *numbers)
    found = np.asarray(function(np.concatenate([np.ravel(part) for part in numbers]))).ravel()
    assert found == pytest.approx(np.array(expected, dtype=float), rel=1e-12)


def test_the_ten_are_the_laser_block_and_the_image_block_in_order() -> None:
    B = [-4.0, 9.0, 31.0, -190.0, 1100.0]
    together = eq.ten_residuals(np, WORKED, WORKED_SETUP, B)
    apart = [*(e(np, WORKED, WORKED_SETUP) for e in eq.TEN[:5]), *(e(np, WORKED, WORKED_SETUP, B) for e in eq.TEN[5:])]
    assert together == apart
    assert [e.number for e in eq.TEN] == [str(number) for number in (*range(11, 16), *range(17, 22))]


def test_equations_take_arrays() -> None:
    many = eq.PaperVariables(*(np.array([value, 1.1 * value]) for value in WORKED))
    rows = eq.ten_residuals(np, many, WORKED_SETUP, [1.0] * 5)
    second = eq.ten_residuals(np, eq.PaperVariables(*(1.1 * value for value in WORKED)), WORKED_SETUP, [1.0] * 5)
    assert [row[1] for row in rows] == pytest.approx(second, rel=1e-12)


# --- The spot and its images -----------------------------------------------------------------------------------------


@EXAMPLES
@given(case=cases(off_the_beam=True))
def test_points_of_3_lie_on_the_plane_and_are_an_ellipse_with_semi_axes_r_and_R(case) -> None:
    v, k = case
    points = np.stack(eq.spot_point(np, v, k, THETA), axis=1)
    centre = np.array([k.e_x, k.e_y, v.z_L])
    p, q = eq.slopes(np, v)
    plane = Plane(np.array([-p, -q, 1.0]), centre)
    size = np.linalg.norm(points, axis=1).max()
    assert np.abs(plane.distance_to(points)).max() < 100 * EPS * size
    along = np.array([math.cos(v.beta), math.sin(v.beta), 0.0])
    across = np.cross(plane.normal, along)
    offset = points - centre
    assert ((offset @ along) / k.r) ** 2 + ((offset @ across) / v.R) ** 2 == pytest.approx(1, abs=ROUNDING)


@EXAMPLES
@given(case=cases())
def test_3_in_slopes_is_3_on_the_beam_at_the_angle_theta_plus_beta(case) -> None:
    v, k = case
    paper = np.array(eq.spot_point(np, v, k, THETA))
    in_slopes = np.array(eq.spot_point_in_slopes(np, on_the_beam(v), k, THETA + v.beta))
    assert in_slopes == pytest.approx(paper, abs=100 * EPS * np.abs(paper).max())


@EXAMPLES
@given(case=cases(off_the_beam=True))
def test_image_points_lie_on_6(case) -> None:
    v, k = case
    points = boundary(v, k, THETA)
    # The distance from the ellipse loses digits as the image's position over its width.
    width = np.ptp(points, axis=0).min()
    position = np.abs(points).max() + width
    assert np.abs(sampson_distances(ellipse(v, k), points)).max() < 100 * EPS * position**2 / width


@EXAMPLES
@given(case=cases(off_the_beam=True))
def test_5_inverted_returns_the_angle_on_the_spot(case) -> None:
    v, k = case
    cosine, sine = eq.spot_angle(np, v, k, *boundary(v, k, THETA).T)
    assert cosine == pytest.approx(np.cos(THETA), abs=10 * ROUNDING)
    assert sine == pytest.approx(np.sin(THETA), abs=10 * ROUNDING)


@EXAMPLES
@given(case=cases())
def test_6_in_slopes_is_6_over_r_squared_on_the_beam(case) -> None:
    v, k = case
    paper = np.array(eq.image_conic(np, v, k)) / k.r**2
    in_slopes = np.array(eq.image_conic_in_slopes(np, on_the_beam(v), k))
    # In units of f, so that the six coefficients are of one size.
    lengths = k.f ** np.array([0, 0, 0, 1, 1, 2])
    assert in_slopes / lengths == pytest.approx(paper / lengths, abs=ROUNDING * np.abs(paper / lengths).max())


def test_6_in_slopes_says_the_ray_meets_the_plane_on_the_cylinder() -> None:
    v, k = on_the_beam(WORKED), WORKED_SETUP
    x, y = np.random.default_rng(1).uniform(-20, 20, (2, 50))
    b = eq.image_conic_in_slopes(np, v, k)
    value = b[0] * x**2 + b[1] * x * y + b[2] * y**2 + b[3] * x + b[4] * y + b[5]
    scale = k.f - v.p * x - v.q * y
    distance = (v.z_L - v.p * k.e_x - v.q * k.e_y) / scale
    off_axis = np.hypot(distance * x - k.e_x, distance * y - k.e_y)
    assert value == pytest.approx(scale**2 * (off_axis**2 - k.r**2), rel=1e-9)


@EXAMPLES
@given(case=cases(off_the_beam=True))
def test_9_is_the_spot_of_3_seen_along_the_beam(case) -> None:
    v, k = case
    d = np.array(eq.laser_conic(np, v, k))
    x, y, _ = eq.spot_point(np, v, k, THETA)
    terms = d * np.stack([x**2, x * y, y**2, x, y, np.ones_like(x)], axis=1)
    assert np.abs(terms.sum(axis=1)).max() < ROUNDING * np.abs(terms).max()


@EXAMPLES
@given(case=cases())
def test_dual_of_6_has_the_form_that_the_closed_form_inverts(case) -> None:
    """C* ~ [[f^2 (e e' - r^2 I), f (e z_L - r^2 n)], [., z_L^2 - r^2 |n|^2]]."""
    v, k = case
    e, n = np.array([k.e_x, k.e_y]), np.array(eq.slopes(np, v))
    side = k.f * (e * v.z_L - k.r**2 * n)
    model = np.block(
        [[k.f**2 * (np.outer(e, e) - k.r**2 * np.eye(2)), side[:, None]], [side, v.z_L**2 - k.r**2 * n @ n]]
    )
    # In units of f, so that the entries are of one size.
    unit = np.diag([1 / k.f, 1 / k.f, 1.0])
    measured, expected = unit @ dual_conic(ellipse(v, k)) @ unit, unit @ model @ unit
    factor = np.sum(measured * expected) / np.sum(expected**2)
    assert measured == pytest.approx(factor * expected, abs=ROUNDING * np.abs(measured).max())


# --- The laser block -------------------------------------------------------------------------------------------------


@EXAMPLES
@given(case=cases(off_the_beam=True))
def test_each_laser_equation_is_its_factor_times_one_fact(case) -> None:
    v, k = case
    fact = v.R**2 * math.cos(v.alpha) ** 2 - k.r**2
    residuals = np.array([e(np, v, k) for e in eq.LASER_BLOCK])
    factors = np.array(eq.laser_factors(np, v, k))
    sizes = natural_sizes(np.zeros(5), k)[:5] * max(1, k.r**2 / eq.laser_conic(np, v, k)[0])
    assert residuals / sizes == pytest.approx(factors * fact / sizes, abs=ROUNDING)


@EXAMPLES
@given(case=cases())
def test_laser_block_has_rank_one_and_the_whole_system_two_left_over(case) -> None:
    v, k = case
    B = ellipse(v, k)
    data = np.concatenate([k, B])
    units = np.array([k.r, v.z_L, 1.0, 1.0])
    sizes = natural_sizes(B, k)[:, None]
    ten = np.asarray(ten_jacobian()(np.array(v), data)) * units / sizes
    laser = np.linalg.svd(ten[:5], compute_uv=False)
    assert laser[0] > 1e-4
    assert laser[1] < 1e-10 * laser[0]
    independent = np.asarray(independent_jacobian()(np.array(on_the_beam(v)), data)) * units
    independent /= np.concatenate([[k.r**2], natural_sizes(B, k)[5:]])[:, None]
    values = np.linalg.svd(independent / np.linalg.norm(independent, axis=0), compute_uv=False)
    # One laser equation and five image equations, six rows, fix four unknowns: two rows are left over.
    assert independent.shape == (6, 4)
    assert values[3] > 1e-8 * values[0]


@pytest.mark.parametrize("beta", [-135.0, -45.0, 45.0, 135.0])
def test_12_alone_holds_at_odd_multiples_of_45_degrees_whatever_R(beta: float) -> None:
    for R in (11.0, 20.0, 37.0):
        v = WORKED._replace(R=R, beta=math.radians(beta))
        assert eq.eq12(np, v, WORKED_SETUP) == pytest.approx(0, abs=10 * EPS)
        if R != 20.0:
            assert abs(eq.eq11(np, v, WORKED_SETUP)) > 0.1


def test_11_and_12_together_hold_only_on_the_beam() -> None:
    beta = np.linspace(-np.pi, np.pi, 361)
    for R in (11.0, 19.9, 20.1, 37.0):
        v = WORKED._replace(R=R, beta=beta)
        assert np.hypot(eq.eq11(np, v, WORKED_SETUP), eq.eq12(np, v, WORKED_SETUP)).min() > 1e-3


@EXAMPLES
@given(case=cases())
def test_independent_forms_of_the_laser_block_hold_on_the_beam(case) -> None:
    v, k = case
    assert eq.laser_constraint(np, v, k) == pytest.approx(0, abs=10 * EPS * k.r)
    assert eq.laser_constraint_in_slopes(np, on_the_beam(v), k) == pytest.approx(0, abs=10 * EPS * v.R**2)


# --- The domain and the second plane ---------------------------------------------------------------------------------


@EXAMPLES
@given(case=cases(), depth=st.floats(0.2, 3))
def test_in_front_is_positive_exactly_where_the_image_is_an_ellipse(case, depth: float) -> None:
    v, k = case
    v = v._replace(z_L=depth * k.r * math.tan(v.alpha))
    assume(abs(depth - 1) > 1e-6)
    assume(abs(eq.lit_side(np, v, k)) > 1e-3 * (v.z_L + math.hypot(k.e_x, k.e_y)))
    front = eq.in_front(np, v, k)
    nearest = v.z_L - v.R * math.sin(v.alpha)
    assert front == pytest.approx(nearest * math.cos(v.alpha), abs=ROUNDING * v.z_L)
    assert (front > 0) == (eq.in_front_in_slopes(np, on_the_beam(v), k) > 0) == bool(is_ellipse(ellipse(v, k)))


@EXAMPLES
@given(case=cases())
def test_discriminant_of_6_is_the_square_of_the_intercept_times_in_front(case) -> None:
    v, k = case
    s = on_the_beam(v)
    b = eq.image_conic_in_slopes(np, s, k)
    c = eq.lit_side_in_slopes(np, s, k)
    expected = c**2 * eq.in_front_in_slopes(np, s, k)
    assert b[0] * b[2] - b[1] ** 2 / 4 == pytest.approx(expected, abs=ROUNDING * (abs(b[0] * b[2]) + b[1] ** 2))


@EXAMPLES
@given(case=cases())
def test_lit_side_is_the_intercept_on_the_optical_axis(case) -> None:
    v, k = case
    p, q = eq.slopes(np, v)
    plane = Plane(np.array([-p, -q, 1.0]), np.array([k.e_x, k.e_y, v.z_L]))
    c = plane.intercepts[2]
    assert eq.lit_side_in_slopes(np, on_the_beam(v), k) == pytest.approx(c, rel=ROUNDING)
    assert eq.lit_side(np, v, k) == pytest.approx(c * math.cos(v.alpha), rel=ROUNDING)


@EXAMPLES
@given(case=cases())
def test_second_plane_satisfies_all_ten(case) -> None:
    v, k = case
    distance2 = k.e_x**2 + k.e_y**2
    assume(abs(distance2 - k.r**2) > 0.05 * k.r**2)
    z_L, p, q = other_plane(slopes(v), k)
    tangent = math.hypot(p, q)
    # A plane almost parallel to the beam has no angles to speak of.
    assume(1e-3 < tangent < 1e3)
    other = eq.PaperVariables(k.r * math.hypot(1, tangent), z_L, math.atan(tangent), math.atan2(-p, q))
    B = ellipse(v, k)
    residuals = np.array(eq.ten_residuals(np, other, k, B.tolist())) / natural_sizes(B, k)
    assert np.abs(residuals).max() < 100 * ROUNDING * (1 + tangent**2)
    assert eq.lit_side_in_slopes(np, on_the_beam(other), k) == pytest.approx(
        -eq.lit_side_in_slopes(np, on_the_beam(v), k), rel=10 * ROUNDING
    )
    # From the lit side of the first plane, a camera outside the beam has the second spot before it, one inside behind.
    if eq.lit_side(np, v, k) > 0:
        assert (z_L > 0) == (distance2 > k.r**2)


# --- What every equation says of itself ------------------------------------------------------------------------------

ALL = [value for value in vars(eq).values() if isinstance(value, eq.Equation)]


def test_every_equation_has_number_name_unit_block_and_words() -> None:
    assert len(ALL) > 25
    for e in ALL:
        assert e.number
        assert e.name
        assert e.unit
        assert isinstance(e.block, eq.Block)
        assert e.__doc__
        assert str(e) == f"({e.number}) {e.name}"
    covered = {e.number for e in ALL}
    assert covered >= {"3", "5", "6", "9", *map(str, range(11, 22)), *map(str, range(23, 30))}


def test_blocks_are_the_papers() -> None:
    assert {e.block for e in eq.LASER_BLOCK} == {eq.Block.LASER}
    assert {e.block for e in eq.IMAGE_BLOCK} == {eq.Block.IMAGE}


def powers(unit: str, n: int) -> list[int]:
    """Powers of mm in a unit such as "mm^2", or in one for each component."""
    by_name = {"1": 0, "mm": 1, "mm^2": 2, "mm^4": 4, "mm^6": 6}
    parts = [by_name[part] for part in unit.split(", ")]
    return parts if len(parts) == n else parts * n


def scaled(s: float) -> tuple[eq.PaperVariables, eq.Setup, np.ndarray]:
    """The worked example, off the beam, with all lengths ``s`` times as long."""
    v = WORKED._replace(R=23.0 * s, z_L=WORKED.z_L * s)
    return v, eq.Setup(*(s * length for length in WORKED_SETUP)), np.array([-4.0, 9.0, 31 * s, -190 * s, 1100 * s**2])


RESIDUALS = [(e, kind) for e, kind in CALLS if e not in (eq.image_conic, eq.image_conic_in_slopes, eq.laser_conic)]


@pytest.mark.parametrize(("equation", "kind"), RESIDUALS, ids=[str(e) for e, _ in RESIDUALS])
def test_unit_is_how_the_residual_scales_with_length(equation: eq.Equation, kind: str) -> None:
    one, ten = (np.array(call(np, equation, kind, *scaled(s))) for s in (1.0, 10.0))
    assert ten == pytest.approx(one * 10.0 ** np.array(powers(equation.unit, len(one))), rel=1e-9)


@pytest.mark.parametrize(
    ("conic", "power"), [(eq.image_conic, 6), (eq.image_conic_in_slopes, 4), (eq.laser_conic, 4)], ids=str
)
def test_value_of_a_conic_scales_with_length(conic: Callable[..., Any], power: int) -> None:
    def value(s: float) -> float:
        v, k, _ = scaled(s)
        b = conic(np, on_the_beam(v) if conic is eq.image_conic_in_slopes else v, k)
        x, y = 7.0 * s, 11.0 * s
        return b[0] * x * x + b[1] * x * y + b[2] * y * y + b[3] * x + b[4] * y + b[5]

    assert value(10.0) == pytest.approx(value(1.0) * 10.0**power, rel=1e-9)


def test_29_is_the_objective_and_the_weighted_squares() -> None:
    assert eq.eq29(np, 3.0, [1.0, -2.0], 10.0) == pytest.approx(3.0 + 10.0 * 5.0)


def test_16_vanishes_on_the_image() -> None:
    B = ellipse(WORKED, WORKED_SETUP)
    values = eq.eq16(np, B.tolist(), *boundary(WORKED, WORKED_SETUP, THETA).T)
    assert np.abs(values).max() < 100 * EPS * 1111


# --- What the image holds of plane and rig (docs/model.md, sections 5 to 7) ------------------------------------------


@EXAMPLES
@given(case=cases())
def test_quadratic_of_the_closed_form(case) -> None:
    """A z_L^2 + 2 h z_L - C = 0, and the intercept is A z_L + h, so that c^2 = h^2 + A C."""
    v, k = case
    e, n = np.array([k.e_x, k.e_y]), np.array(eq.slopes(np, v))
    d, m = e * v.z_L - k.r**2 * n, v.z_L**2 - k.r**2 * n @ n
    outside, h, C = 1 - e @ e / k.r**2, e @ d / k.r**2, d @ d / k.r**2 + m
    terms = np.array([outside * v.z_L**2, 2 * h * v.z_L, -C])
    assert terms.sum() == pytest.approx(0, abs=ROUNDING * np.abs(terms).max())
    c = eq.lit_side_in_slopes(np, on_the_beam(v), k)
    assert outside * v.z_L + h == pytest.approx(c, abs=ROUNDING * (abs(outside * v.z_L) + abs(h)))
    assert h**2 + outside * C == pytest.approx(c**2, abs=ROUNDING * (h**2 + abs(outside * C)))


@EXAMPLES
@given(case=cases())
def test_every_image_touches_the_images_of_the_beams_silhouettes(case) -> None:
    v, k = case
    distance = math.hypot(k.e_x, k.e_y)
    assume(distance > 1.05 * k.r)
    dual = dual_conic(ellipse(v, k))
    scale = np.abs(dual[:2, :2]).max()
    for side in (1, -1):
        # A line through the principal point whose unit normal l has l.e = +-r.
        direction = math.atan2(k.e_y, k.e_x) + side * math.acos(k.r / distance)
        line = np.array([math.cos(direction), math.sin(direction), 0.0])
        assert line @ dual @ line == pytest.approx(0, abs=ROUNDING * scale)


@EXAMPLES
@given(case=cases(), s=st.floats(0.5, 2))
def test_image_tells_neither_the_focal_length_nor_the_scale(case, s: float) -> None:
    v, k = case
    plane, B = slopes(v), ellipse(v, k)

    def image(plane: np.ndarray, setup: eq.Setup) -> np.ndarray:
        b = np.array(eq.image_conic_in_slopes(np, eq.SlopeVariables(None, *plane), setup))
        return b[1:] / b[0]

    sizes = natural_sizes(B, k)[5:]
    # A lens s times as long sees a plane s times as far and as steep in the same place of the sensor.
    longer = image(s * plane, k._replace(f=s * k.f))
    assert longer / sizes == pytest.approx(B / sizes, abs=ROUNDING)
    larger = image(plane * [s, 1, 1], eq.Setup(k.f, s * k.e_x, s * k.e_y, s * k.r))
    assert larger / sizes == pytest.approx(B / sizes, abs=ROUNDING)
