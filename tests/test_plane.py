"""Planes and spots: every conversion there and back, and the values of the paper's example."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.errors import InputError
from planeopt.plane import BETA_TOLERANCE, Plane, SpotPose

QUICK = settings(max_examples=60, derandomize=True, deadline=None)
EPS = float(np.finfo(float).eps)

lengths = st.floats(-1000, 1000, allow_subnormal=False)
parts = st.floats(-1, 1, allow_subnormal=False)
normals = st.tuples(parts, parts, parts).filter(lambda n: math.hypot(*n) > 1e-3)
planes = st.builds(Plane, normals, st.tuples(lengths, lengths, lengths))
tilts = st.floats(2 * BETA_TOLERANCE, math.radians(85))
turns = st.floats(-math.pi, math.pi, exclude_min=True)


def close(value: object, expected: object, atol: float) -> None:
    np.testing.assert_allclose(np.asarray(value, dtype=float), np.asarray(expected, dtype=float), rtol=0, atol=atol)


@given(normals)
@QUICK
def test_a_normal_becomes_unit_and_then_stays_to_the_last_bit(vector: tuple[float, float, float]) -> None:
    plane = Plane(np.array(vector), np.zeros(3))
    assert float(np.linalg.norm(plane.normal)) == pytest.approx(1, abs=4 * EPS)
    close(np.cross(plane.normal, vector), 0, 4 * EPS * math.hypot(*vector))
    assert Plane(plane.normal, plane.point) == plane
    assert hash(Plane(plane.normal, plane.point)) == hash(plane)


def test_a_normal_of_any_length_is_accepted() -> None:
    for length in (1e-300, 1e-30, 1e300):
        close(Plane(np.array([0.0, 0.6 * length, 0.8 * length]), np.zeros(3)).normal, [0, 0.6, 0.8], 4 * EPS)


def test_a_plane_cannot_be_changed() -> None:
    plane = Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    with pytest.raises(ValueError, match="read-only"):
        plane.normal[0] = 1


def test_a_plane_is_not_equal_to_another_thing() -> None:
    assert Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3)) != "plane"


@pytest.mark.parametrize(
    ("normal", "point", "message"),
    [
        ((0, 0, 0), (0, 0, 1), "must not be zero"),
        ((0, 0, math.nan), (0, 0, 1), "normal of a plane must be three finite numbers"),
        ((0, 0, 1), (0, 0, math.inf), "point of a plane must be three finite numbers"),
        ((0, 0, 1), (0, 0), "point of a plane must be three finite numbers"),
    ],
)
def test_a_plane_that_is_none_is_refused(normal: tuple, point: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Plane(np.array(normal), np.array(point))


intercept = st.one_of(st.floats(1, 1e6), st.floats(-1e6, -1))


@given(st.tuples(*[st.one_of(intercept, st.just(math.inf))] * 3).filter(lambda abc: not all(map(math.isinf, abc))))
@QUICK
def test_intercepts_there_and_back(abc: tuple[float, float, float]) -> None:
    plane = Plane.from_intercepts(*abc)
    assert float(plane.normal @ plane.point) > 0
    for there, back in zip(abc, plane.intercepts, strict=True):
        # A few roundings of the unit vector and of its distance.
        if math.isinf(there):
            assert math.isinf(back)
        else:
            assert back == pytest.approx(there, rel=16 * EPS)


@given(planes)
@QUICK
def test_each_intercept_lies_on_the_plane(plane: Plane) -> None:
    try:
        intercepts = plane.intercepts
    except InputError:
        assert abs(float(plane.normal @ plane.point)) <= 4 * EPS * float(np.linalg.norm(plane.point))
        return
    for axis, value in enumerate(intercepts):
        if math.isfinite(value):
            point = np.zeros(3)
            point[axis] = value
            # The distance is a difference of numbers of the size of the intercept and of the point.
            size = abs(value) + float(np.linalg.norm(plane.point))
            close(plane.distance_to(point), 0, 8 * EPS * size)


def test_parallel_to_two_axes() -> None:
    assert Plane(np.array([0.0, 0.0, -1.0]), np.array([3.0, 4.0, 250.0])).intercepts == (math.inf, math.inf, 250.0)


def test_intercepts_of_a_plane_through_the_centre_are_refused() -> None:
    for plane in (
        Plane(np.array([0.0, 0.6, 0.8]), np.zeros(3)),
        Plane(np.array([0.0, 0.6, 0.8]), np.array([5.0, 8.0, -6.0])),
    ):
        with pytest.raises(InputError, match="through the camera's centre"):
            _ = plane.intercepts


@pytest.mark.parametrize(
    ("abc", "message"),
    [
        ((0.0, 1.0, 1.0), "hold a zero"),
        ((math.nan, 1.0, 1.0), "must be numbers"),
        ((math.inf, -math.inf, math.inf), "at least one intercept must be finite"),
    ],
)
def test_impossible_intercepts_are_refused(abc: tuple[float, float, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Plane.from_intercepts(*abc)


@given(planes)
@QUICK
def test_the_rotation_is_opencvs_and_the_smallest(plane: Plane) -> None:
    rotation, _ = cv2.Rodrigues(plane.rvec)
    # OpenCV takes the cosine of an angle near pi: a few roundings of pi.
    close(rotation, plane.matrix[:3, :3], 32 * EPS)
    close(plane.matrix[:3, 2], plane.normal, 4 * EPS)
    assert plane.rvec[2] == 0, "a turn about z would not be the smallest"
    angle = math.atan2(math.hypot(plane.normal[0], plane.normal[1]), plane.normal[2])
    assert float(np.linalg.norm(plane.rvec)) == pytest.approx(angle, abs=4 * EPS)
    close(plane.tvec, plane.point, 0)


@pytest.mark.parametrize("tiny", [0.0, 1e-300, 1e-17, 1e-9])
def test_the_rotation_holds_at_and_near_both_poles(tiny: float) -> None:
    for z in (1.0, -1.0):
        plane = Plane(np.array([tiny, -tiny, z]), np.zeros(3))
        pose = plane.matrix
        close(pose[:3, :3].T @ pose[:3, :3], np.eye(3), 8 * EPS)
        assert float(np.linalg.det(pose[:3, :3])) == pytest.approx(1, abs=8 * EPS)
        close(pose[:3, 2], plane.normal, 4 * EPS)


def test_the_opposite_normal_is_half_a_turn_about_x() -> None:
    close(Plane(np.array([0.0, 0.0, -1.0]), np.zeros(3)).rvec, [math.pi, 0, 0], 0)


@given(planes)
@QUICK
def test_matrix_there_and_back(plane: Plane) -> None:
    back = Plane.from_matrix(plane.matrix)
    close(back.normal, plane.normal, 4 * EPS)
    close(back.point, plane.point, 0)


def test_a_pose_that_is_not_rigid_is_refused() -> None:
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    stretched = np.diag([1.0, 1.0, 1.001, 1.0])
    projective = np.eye(4)
    projective[3, 0] = 1
    for matrix in (mirror, stretched, projective):
        with pytest.raises(InputError, match="must be a rotation and a translation"):
            Plane.from_matrix(matrix)
    for matrix in (np.eye(3), np.full((4, 4), math.nan)):
        with pytest.raises(InputError, match="4 x 4 finite numbers"):
            Plane.from_matrix(matrix)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 0.3, math.pi / 2, math.pi - 1e-9, math.pi])
def test_angle_is_accurate_at_both_ends(angle: float) -> None:
    first = Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    second = Plane(np.array([math.sin(angle), 0.0, math.cos(angle)]), np.zeros(3))
    assert first.angle_to(second) == pytest.approx(angle, abs=4 * EPS)


@given(planes, st.floats(-100, 100))
@QUICK
def test_distance_is_signed(plane: Plane, step: float) -> None:
    moved = plane.point + step * plane.normal
    size = 1 + abs(step) + float(np.linalg.norm(plane.point))
    close(plane.distance_to(np.stack([moved, plane.point])), [step, 0], 8 * EPS * size)


def test_the_papers_example() -> None:
    """Equation (2) at (R, z_L, alpha, beta) = (20, 75, 60 deg, 30 deg): the slopes and intercepts by hand."""
    pose = SpotPose(20, 75, math.radians(60), math.radians(30))
    p, q = pose.slopes
    assert p == pytest.approx(-math.sqrt(3) / 2, abs=4 * EPS)
    assert q == pytest.approx(1.5, abs=8 * EPS)
    close(pose.normal, [math.sqrt(3) / 4, -0.75, 0.5], 2 * EPS)
    plane = Plane(pose.normal, np.array([30.0, 40.0, 75.0]))
    c = 75 - p * 30 - q * 40
    assert plane.intercepts == pytest.approx((-c / p, -c / q, c), rel=1e-14)


@given(st.floats(1, 50), lengths, tilts, turns)
@QUICK
def test_slopes_there_and_back(radius: float, z_L: float, alpha: float, beta: float) -> None:
    pose = SpotPose(radius / math.cos(alpha), z_L, alpha, beta)
    back = SpotPose.from_slopes(z_L, *pose.slopes, radius)
    assert back.beta is not None
    assert pose.beta is not None
    assert abs(back.R / pose.R - 1) <= 32 * EPS / math.cos(alpha)
    assert back.z_L == z_L
    assert back.alpha == pytest.approx(alpha, rel=16 * EPS)
    # The two ends of (-pi, pi] are one direction.
    assert math.remainder(back.beta - pose.beta, math.tau) == pytest.approx(0, abs=16 * EPS)
    p, q = pose.slopes
    close(pose.normal, np.array([-p, -q, 1]) / math.hypot(p, q, 1), 8 * EPS)


@given(st.floats(0.1, 50), lengths, st.floats(-20, 20), st.floats(-20, 20), st.booleans())
@QUICK
def test_canonical_is_the_same_plane(R: float, z_L: float, alpha: float, beta: float, negative: bool) -> None:
    if abs(math.cos(alpha)) < 1e-3:
        alpha += 0.1
    pose = SpotPose.canonical(-R if negative else R, z_L, alpha, beta)
    assert 0 <= pose.alpha < math.pi / 2
    assert pose.beta is None or -math.pi < pose.beta <= math.pi
    assert pose.R == R
    raw = np.array([math.sin(alpha) * math.sin(beta), -math.sin(alpha) * math.cos(beta), math.cos(alpha)])
    # A tilt within the tolerance is put to zero; the angles have magnitude up to 20 rad.
    close(np.cross(pose.normal, raw), 0, 64 * EPS + (BETA_TOLERANCE if pose.beta is None else 0))
    assert SpotPose.canonical(pose.R, pose.z_L, pose.alpha, pose.beta) == pose


@pytest.mark.parametrize(
    ("alpha_deg", "beta_deg", "expected"),
    [
        (-60, 30, (60, -150)),
        (-60, 180, (60, 0)),
        (60, -180, (60, 180)),
        (60, 390, (60, 30)),
        (120, 30, (60, -150)),
        (240, 30, (60, 30)),
        (-300, -90, (60, -90)),
    ],
)
def test_canonical_angles(alpha_deg: float, beta_deg: float, expected: tuple[float, float]) -> None:
    pose = SpotPose.canonical(20, 75, math.radians(alpha_deg), math.radians(beta_deg))
    assert pose.beta is not None
    # Angles of up to 2 pi, reduced by multiples of pi that are rounded themselves.
    assert (math.degrees(pose.alpha), math.degrees(pose.beta)) == pytest.approx(expected, abs=1e-12)


def test_slopes_along_the_axes_give_the_four_directions() -> None:
    for (p, q), beta in {
        (0.0, 1.0): 0.0,
        (0.0, -1.0): math.pi,
        (1.0, 0.0): -math.pi / 2,
        (-1.0, 0.0): math.pi / 2,
    }.items():
        pose = SpotPose.from_slopes(75, p, q, 10)
        assert pose.beta is not None
        assert pose.beta == beta
        assert math.copysign(1, pose.beta) == (-1 if beta < 0 else 1), "no negative zero in a report"
    assert SpotPose.from_slopes(75, -0.0, -1.0, 10).beta == math.pi


def test_without_tilt_beta_means_nothing() -> None:
    for pose in (
        SpotPose(10, 75, 0, None),
        SpotPose(10, 75, 0, 1.0),
        SpotPose(10, 75, BETA_TOLERANCE / 2, None),
        SpotPose.canonical(10, 75, math.pi, 2.0),
        SpotPose.canonical(10, 75, 0, None),
        SpotPose.from_slopes(75, 0, 0, 10),
        SpotPose.from_slopes(75, BETA_TOLERANCE / 2, 0, 10),
    ):
        assert pose.alpha == 0
        assert pose.beta is None
        assert pose.slopes == (0, 0)
        close(pose.normal, [0, 0, 1], 0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0, 75, 0.1, 0.1), "R of a spot must be positive"),
        ((math.nan, 75, 0.1, 0.1), "R of a spot must be finite"),
        ((10, math.inf, 0.1, 0.1), "z_L of a spot must be finite"),
        ((10, 75, -0.1, 0.1), "alpha of a spot must be at least 0"),
        ((10, 75, math.pi / 2, 0.1), "below pi/2"),
        ((10, 75, 0.1, None), "beta of a spot is needed"),
        ((10, 75, 0.1, -math.pi), "above -pi"),
        ((10, 75, 0.1, 4.0), "at most pi"),
    ],
)
def test_a_spot_that_is_not_canonical_is_refused(values: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SpotPose(*values)


def test_impossible_angles_and_slopes_are_refused() -> None:
    with pytest.raises(InputError, match="parallel to the beam"):
        SpotPose.canonical(10, 75, 3 * math.pi / 2, 0)
    with pytest.raises(InputError, match="must be finite"):
        SpotPose.canonical(10, 75, math.nan, 0)
    with pytest.raises(InputError, match="slopes of a plane must be finite"):
        SpotPose.from_slopes(75, math.inf, 0, 10)
    with pytest.raises(InputError, match="R of a spot must be positive"):
        SpotPose.from_slopes(75, 0.1, 0, 0)


@pytest.mark.parametrize("normal", ["up", ("a", 0, 1), object()])
def test_words_are_no_normal(normal):
    with pytest.raises(InputError, match="three finite numbers"):
        Plane(normal, np.array([0.0, 0.0, 1.0]))
