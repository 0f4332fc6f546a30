"""The camera: distortion against OpenCV, its inverse to rounding, and the Jacobian against differences."""

import math

import casadi
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.errors import InputError
from planeopt.rig import Camera, distort

QUICK = settings(max_examples=40, derandomize=True, deadline=None)
EPS = float(np.finfo(float).eps)
DISTORTION = (-0.163, 0.104, 0.0003, 0.0004, 0.0)
CAMERA = Camera((960, 720), 2181.8, 2181.8, 481.2, 357.6, DISTORTION, 0.0055)
WIDE = Camera((1280, 960), 620.0, 655.0, 650.0, 470.0, (-0.28, 0.09, 0.001, -0.0007, 0.005))


def grid(camera: Camera, n: int = 31) -> np.ndarray:
    width, height = camera.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, n), np.linspace(0, height - 1, n))
    return np.stack([u.ravel(), v.ravel()], axis=-1)


small = st.floats(-2e-3, 2e-3)
cameras = st.builds(
    Camera,
    st.just((1280, 960)),
    st.floats(400, 5000),
    st.floats(400, 5000),
    st.floats(500, 800),
    st.floats(300, 600),
    st.tuples(st.floats(-0.4, 0.3), st.floats(-0.2, 0.3), small, small, st.floats(-0.1, 0.1)),
)


def inside(camera: Camera, seed: int) -> np.ndarray:
    """Return normalised points (50, 2) within 45 degrees of the axis that keep clear of the fold."""
    rng = np.random.default_rng(seed)
    # 0.9: tangential terms of 2e-3 move the fold by under 1 % of its radius, and the inverse is well-conditioned here.
    radius = min(0.9 * camera.invertible_radius, 1.0) * np.sqrt(rng.uniform(size=50))
    angle = rng.uniform(-math.pi, math.pi, size=50)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@given(cameras, st.integers(0, 1000))
@QUICK
def test_projection_is_opencvs(camera: Camera, seed: int) -> None:
    points = inside(camera, seed)
    rays = np.column_stack([points, np.ones(len(points))])
    theirs, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    ours = camera.project(points)
    np.testing.assert_allclose(ours, theirs.reshape(-1, 2), rtol=0, atol=16 * np.spacing(np.abs(ours).max()))


@pytest.mark.parametrize("camera", [CAMERA, WIDE])
def test_inverse_is_opencvs(camera: Camera) -> None:
    pixels = grid(camera)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 2000, 1e-14)
    # 4.x has a function of its own for a stop criterion; 5.0 has an argument.
    undistort = getattr(cv2, "undistortPointsIter", None)
    k, d = camera.matrix, np.array(camera.distortion)
    if undistort is None:
        theirs = cv2.undistortPoints(pixels[:, None], k, d, criteria=criteria)
    else:
        theirs = undistort(pixels[:, None], k, d, None, None, criteria)
    ours, _ = camera.normalise(pixels)
    # OpenCV stops at a step of 1e-14; at a rate of contraction q at most 1e-14 q / (1 - q) is left, and q is below 0.95
    # in these images.
    np.testing.assert_allclose(ours, np.reshape(theirs, (-1, 2)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("camera", [CAMERA, WIDE])
def test_inverse_to_a_billionth_of_a_thousandth_of_a_pixel(camera: Camera) -> None:
    pixels = grid(camera)
    normalised, _ = camera.normalise(pixels)
    assert np.abs(camera.project(normalised) - pixels).max() < 1e-12


@given(cameras, st.integers(0, 1000))
@QUICK
def test_inverse_there_and_back(camera: Camera, seed: int) -> None:
    points = inside(camera, seed)
    pixels = camera.project(points)
    found, jacobian = camera.normalise(pixels)
    np.testing.assert_allclose(camera.project(found), pixels, rtol=0, atol=8 * np.spacing(np.abs(pixels).max()))
    # The same ray, not another that images there: a pixel's rounding and the distortion's own, through the Jacobian.
    growth = np.linalg.norm(jacobian, ord=2, axis=(1, 2))[:, None]
    floor = 8 * EPS * (1 + growth * max(camera.fx, camera.fy))
    assert np.all(np.abs(found - points) <= 4 * growth * np.spacing(np.abs(pixels).max()) + floor)


@given(cameras, st.integers(0, 1000))
@QUICK
def test_jacobian_against_central_differences(camera: Camera, seed: int) -> None:
    pixels = camera.project(0.8 * inside(camera, seed))
    # Binary fractions, so that the steps are exactly what they say.
    step = 1 / 32
    pixels = np.round(pixels * 64) / 64
    _, jacobian = camera.normalise(pixels)
    # The rounding of pixel and ray over the step.
    slope = np.abs(jacobian).max(axis=(1, 2))
    rounding = 4 * (np.spacing(np.abs(pixels).max()) * slope + 8 * EPS * (1 + slope * (camera.fx + camera.fy))) / step
    for axis in range(2):
        one, two = (_difference(camera, pixels, axis, width) for width in (step, 2 * step))
        # The error of a central difference grows as the square of its step, so it is a third of the change when the
        # step doubles: a factor 3 is in hand.
        allowed = np.abs(two - one).max(axis=1) + rounding
        assert np.all(np.abs(one - jacobian[:, :, axis]) <= allowed[:, None])


def _difference(camera: Camera, pixels: np.ndarray, axis: int, step: float) -> np.ndarray:
    shift = np.zeros(2)
    shift[axis] = step
    return (camera.normalise(pixels + shift)[0] - camera.normalise(pixels - shift)[0]) / (2 * step)


def test_jacobian_without_distortion_is_one_over_the_focal_length() -> None:
    camera = Camera((640, 480), 500, 400, 320, 240, (0, 0, 0, 0, 0))
    normalised, jacobian = camera.normalise([[320, 240], [820, 640]])
    np.testing.assert_array_equal(normalised, [[0, 0], [1, 1]])
    np.testing.assert_allclose(jacobian, [np.diag([1 / 500, 1 / 400])] * 2, rtol=2 * EPS, atol=0)


def test_shapes_are_kept() -> None:
    for shape in ((2,), (0, 2), (5, 2), (3, 4, 2)):
        pixels = np.full(shape, 300.0)
        normalised, jacobian = CAMERA.normalise(pixels)
        assert normalised.shape == shape
        assert jacobian.shape == (*shape[:-1], 2, 2)
        assert CAMERA.project(normalised).shape == shape
    for wrong in (np.zeros(3), np.zeros((2, 3)), np.float64(1)):
        with pytest.raises(InputError, match=r"shape \(\.\.\., 2\)"):
            CAMERA.normalise(wrong)
        with pytest.raises(InputError, match=r"shape \(\.\.\., 2\)"):
            CAMERA.project(wrong)


def test_one_pixel_far_outside_does_not_spoil_the_others() -> None:
    pixels = grid(CAMERA, 5)
    alone, _ = CAMERA.normalise(pixels)
    beside, _ = CAMERA.normalise(np.vstack([pixels, [[1e6, 1e6]]]))
    np.testing.assert_allclose(beside[:-1], alone, rtol=0, atol=4 * EPS)


def test_the_fold_is_where_the_radius_stops_growing() -> None:
    camera = Camera((640, 480), 500, 500, 320, 240, (-0.3, 0, 0, 0, 0))
    # 1 - 0.9 r^2 = 0
    assert camera.invertible_radius == pytest.approx(1 / math.sqrt(0.9), rel=8 * EPS)
    assert CAMERA.invertible_radius == math.inf


def test_a_pixel_beyond_the_fold_is_refused_by_row() -> None:
    camera = Camera((640, 480), 500, 500, 320, 240, (-0.3, 0, 0, 0, 0))
    edge = float(camera.project([camera.invertible_radius, 0])[0])
    camera.normalise([edge - 1e-6, 240])
    with pytest.raises(InputError, match=r"point 2 \(counted from 0\).*cannot be inverted"):
        camera.normalise([[300, 200], [310, 210], [edge + 1e-6, 240], [2000, 0]])


def test_a_second_branch_beyond_the_fold_is_not_taken() -> None:
    # 1 - 3 r^2 + 1.5 r^4 = 0 at r = 0.65 and 1.26: the radius grows, falls, and grows again. A plain Newton step from a
    # pixel near the fold lands on the outer branch.
    camera = Camera((640, 480), 500, 500, 320, 240, (-1.0, 0.3, 0, 0, 0))
    assert camera.invertible_radius == pytest.approx(math.sqrt(1 - math.sqrt(1 / 3)), rel=8 * EPS)
    reach = float(camera.project([camera.invertible_radius, 0])[0])
    for radius in (1.3, 1.4):
        pixel = camera.project([radius, 0.0])
        assert pixel[0] < reach
        found, _ = camera.normalise(pixel)
        assert float(np.hypot(*found)) < camera.invertible_radius
    for radius in np.linspace(1.6, 4.0, 25):
        outer = camera.project([radius, 0.0])
        assert outer[0] > reach
        with pytest.raises(InputError, match="cannot be inverted"):
            camera.normalise(outer)


def test_a_ray_on_the_other_side_of_the_axis_is_not_taken() -> None:
    # Far beyond the fold the radial factor is negative: some ray across the axis images here exactly, and upright too.
    camera = Camera((1000, 1000), 500, 500, 500, 500, (-0.637, -0.03, 0.02, -0.019, -0.077))
    with pytest.raises(InputError, match="cannot be inverted"):
        camera.normalise([1238.0, 377.0])


def test_rays_close_to_the_fold_are_found() -> None:
    # The radius grows by more than it should and then folds: the pixel's own radius is beyond the fold already.
    camera = Camera((640, 480), 500, 500, 320, 240, (0.5, -0.3, 0, 0, 0))
    radius = camera.invertible_radius * np.array([0.9, 0.99, 0.999])
    points = np.stack([0.6 * radius, -0.8 * radius], axis=-1)
    pixels = camera.project(points)
    assert np.hypot(*(pixels[-1] - [320, 240])) / 500 > camera.invertible_radius
    found, jacobian = camera.normalise(pixels)
    growth = np.linalg.norm(jacobian, ord=2, axis=(1, 2))[:, None]
    assert np.all(np.abs(found - points) <= 8 * growth * np.spacing(1000.0))


@pytest.mark.parametrize(
    ("pixel", "message"),
    [
        ([math.nan, 1], "not a finite number"),
        ([math.inf, 1], "not a finite number"),
        ([1e300, 1], "cannot be inverted"),
    ],
)
def test_impossible_pixels_are_refused(pixel: list[float], message: str) -> None:
    with pytest.raises(InputError, match=rf"point 1 \(counted from 0\).*{message}"):
        CAMERA.normalise([[1, 1], pixel])


def test_distortion_serves_casadi_as_well() -> None:
    x, y, coefficients = casadi.SX.sym("x"), casadi.SX.sym("y"), casadi.SX.sym("k", 5)
    outputs = distort(x, y, *(coefficients[i] for i in range(5)))
    function = casadi.Function("distort", [x, y, coefficients], list(outputs))
    symbolic = [float(value) for value in function(0.21, -0.13, list(DISTORTION))]
    np.testing.assert_allclose(symbolic, distort(0.21, -0.13, *DISTORTION), rtol=0, atol=4 * EPS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"image_size": (960, 0)},
            r"camera.image_size must be two positive whole numbers \[width, height\], not \[960, 0\]",
        ),
        ({"image_size": (960,)}, "camera.image_size must be two positive whole numbers"),
        ({"fx": 0.0}, r"camera.fx must be positive \(px\), not 0.0"),
        ({"fy": -1.0}, r"camera.fy must be positive \(px\), not -1.0"),
        ({"cx": math.nan}, "camera.cx must be a finite number, not nan"),
        ({"pixel_pitch_mm": 0.0}, r"camera.pixel_pitch_mm must be positive \(mm\), not 0.0"),
        ({"distortion": (0, 0, 0, 0, math.inf)}, "camera.distortion must be a finite number, not inf"),
        ({"distortion": (0,) * 4}, r"five numbers \[k1, k2, p1, p2, k3\], not 4: append k3 = 0.*fisheye"),
        ({"distortion": (0,) * 8}, "not 8: OpenCV's rational model is not supported"),
        ({"distortion": (0,) * 6}, "not 6: other models are not supported"),
    ],
)
def test_impossible_cameras_are_refused(changes: dict, message: str) -> None:
    values = {"image_size": (960, 720), "fx": 2000.0, "fy": 2000.0, "cx": 480.0, "cy": 360.0, "distortion": (0.0,) * 5}
    with pytest.raises(InputError, match=message):
        Camera(**(values | changes))
