"""The parts of the search, each against what it should give exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.errors import InputError
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig, silhouette
from planeopt.spot.ellipses import Ellipses, from_outline, unlike
from planeopt.spot.grey import to_grey
from planeopt.spot.hints import BeamHint, region_box
from planeopt.spot.outline import Outline
from planeopt.spot.pyramid import Level, pixel_noise, pyramid

CAMERA = Camera((1200, 900), 2000, 1990, 610, 440, (-0.15, 0.08, 5e-4, -3e-4, 0))
RIG = Rig(CAMERA, Beam(6.0, (21.0, 16.0), (0.02, -0.01, float(np.sqrt(1 - 0.02**2 - 0.01**2)))))


def boundary(rig: Rig, pose: SpotPose, count: int = 2000) -> np.ndarray:
    """Return the image (count, 2) of the spot's boundary, px, from rays parallel to the beam meeting the plane."""
    beam, plane = rig.require_beam(), rig.plane_from_pose(pose)
    angle = 2 * np.pi * np.arange(count) / count
    rim = beam.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1) @ rig.Q
    start, along = np.array([*beam.offset, 0.0]) + rim, np.array(beam.direction)
    space = start - (plane.distance_to(start) / (plane.normal @ along))[:, None] * along
    return rig.camera.project(space[:, :2] / space[:, 2:])


@settings(derandomize=True, max_examples=30, deadline=None)
@given(z_L=st.floats(200, 900), alpha=st.floats(0, 1.1), beta=st.floats(-3, 3))
def test_every_spot_touches_the_lines_that_bound_the_beam(z_L: float, alpha: float, beta: float) -> None:
    lines = silhouette(RIG)
    assert lines is not None
    pixels = boundary(RIG, SpotPose.canonical(6.0 / np.cos(alpha), z_L, alpha, beta))
    sides, before = lines.distances(pixels)
    # 2,000 points on an ellipse of semi-axis a: the closest to where it touches is off by a (pi / 2000)^2 / 2.
    np.testing.assert_allclose(sides.min(axis=0), 0, atol=1e-3)
    assert np.all(before > 0)


def test_a_camera_in_the_beam_has_no_lines() -> None:
    inside = Rig(CAMERA, Beam(30.0, (21.0, 16.0)))
    assert silhouette(inside) is None
    hint = BeamHint(inside)
    assert not hint.known
    assert hint.box((0, 0, 1200, 900)) == (0, 0, 1200, 900)
    assert np.all(hint.misfit(from_outline(Outline(5, 5, 3, 2, 0))) == 0)


def test_misfit_tells_spots_from_others() -> None:
    hint = BeamHint(RIG)
    pixels = boundary(RIG, SpotPose.canonical(6.0 / np.cos(0.6), 400.0, 0.6, 1.0))
    mean, spread = pixels.mean(axis=0), np.cov(pixels.T)
    values, vectors = np.linalg.eigh(spread)
    spot = Ellipses(mean[None], (vectors * np.sqrt(2 * values))[None])
    assert hint.allows(mean[None])[0]
    assert hint.misfit(spot)[0] < 2
    across = Ellipses(spot.centre + np.array([40.0, -50.0]), spot.shape)
    assert np.isinf(hint.misfit(across)[0])
    assert np.isinf(hint.misfit(Ellipses(spot.centre, 2 * spot.shape))[0])
    x0, y0, x1, y1 = hint.box((0, 0, 1200, 900))
    assert np.all((pixels > [x0, y0]) & (pixels < [x1, y1]))
    assert (x1 - x0) * (y1 - y0) < 1200 * 900


def test_region_is_whole_pixels() -> None:
    assert region_box(None, (480, 640)) == (0, 0, 640, 480)
    assert region_box((10.2, 20.7, 99.1, 480), (480, 640)) == (10, 20, 100, 480)


outlines = st.builds(
    Outline,
    x=st.floats(-50, 900),
    y=st.floats(-50, 900),
    a=st.floats(20, 90),
    b=st.floats(4, 20),
    angle=st.floats(-1.5, 1.5),
)


@settings(derandomize=True, max_examples=30, deadline=None)
@given(outline=outlines)
def test_ellipses_are_outlines(outline: Outline) -> None:
    many = from_outline(outline)
    back = many.outline(0)
    np.testing.assert_allclose(
        [back.x, back.y, back.a, back.b], [outline.x, outline.y, outline.a, outline.b], rtol=1e-9
    )
    assert np.sin(back.angle - outline.angle) == pytest.approx(0, abs=1e-9)
    points, normals, share = many.at(48)
    np.testing.assert_allclose(outline.radius_of(points[0]), 1, atol=1e-9)
    np.testing.assert_allclose(many.radius_of(points), 1, atol=1e-9)
    # First order: the next term is the curvature, at most a / b^2, times half the step squared.
    np.testing.assert_allclose(outline.distances(points[0] + 1e-3 * normals[0]), 1e-3, rtol=1e-2)
    assert share.sum() == pytest.approx(1)
    assert many.size[0] == pytest.approx(outline.size)


def test_unlike_keeps_the_best_of_each() -> None:
    circle = np.eye(2) * 10
    turned = circle @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    many = Ellipses(
        np.array([[0, 0], [0.5, 0], [30, 0], [0, 0]], dtype=float), np.stack([circle, circle, circle, turned])
    )
    assert unlike(many, np.array([1.0, 2.0, 3.0, 1.5]), 0.1).tolist() == [2, 1]


def test_levels_lie_over_one_another() -> None:
    x = np.mgrid[:203, :311][1].astype(np.float32)
    places = np.array([[[100.0, 60.0], [151.3, 99.2], [20.5, 150.1]]])
    for level in pyramid(x, (7, 5), 0.0):
        found, there = level.sample(places + np.array([7, 5]))
        assert there.all()
        # A ramp stays one, smoothed and halved; interpolation in 1/32 px.
        np.testing.assert_allclose(found[0], places[0, :, 0], atol=0.05 * level.factor)
        assert not level.sample(np.array([[[3.0, 50.0]]]))[1].any()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_part_of_a_level_is_smoothed_as_the_whole(dtype: type) -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 250, (200, 300)).astype(dtype)
    for factor in (1, 2):
        whole, part = (Level(image, factor, np.array([-0.5, -0.5]), 1.0) for _ in range(2))
        assert whole.smooth.shape == image.shape
        for x, y in ((0, 0), (150, 100), (292, 195)):
            places = factor * (rng.uniform(-8, 8, (5, 7, 3, 2)) + np.array([x, y]))
            expected, there = whole.sample(places)
            found, also = part.sample(places)
            assert np.array_equal(there, also)
            assert np.array_equal(found[there], expected[there])
        assert "smooth" not in part.__dict__


def test_what_is_bright_shows_at_the_next_level() -> None:
    rng = np.random.default_rng(4)
    image = rng.normal(20, 2, (400, 600)).astype(np.float32)
    places = np.stack(np.meshgrid(np.arange(30, 580, 41), np.arange(30, 380, 43)), axis=-1).reshape(-1, 2)
    for x, y in places:
        image[y - 2 : y + 3, x - 2 : x + 3] += 60
    levels = pyramid(image, (0, 0), 2.0)
    # Boxes of 5 px at every phase of pixels twice as large: by the mean in 6 px they still have (5 / 6)^2 of it.
    for index, level in enumerate(levels[:2]):
        shown = level.peaks(30.0 / 4**index, len(places))
        nearby = levels[index + 1].brighter(0.4 * 30.0 / 4**index)
        apart = np.linalg.norm(shown[:, None] - nearby, axis=2).min(axis=1)
        assert len(shown) == len(places)
        assert np.all(apart < 2 * level.factor)


@settings(derandomize=True, max_examples=30, deadline=None)
@given(outline=outlines)
def test_sizes_in_closed_form(outline: Outline) -> None:
    many = from_outline(outline)
    np.testing.assert_allclose(many.semi_axes[0], [outline.a, outline.b], rtol=1e-9)
    np.testing.assert_allclose(many.semi_axes[0], np.linalg.svd(many.shape[0], compute_uv=False), rtol=1e-9)


def test_noise_of_rounded_values() -> None:
    rng = np.random.default_rng(0)
    for sigma in (0.7, 1.0, 2.5):
        stored = np.rint(100 + rng.normal(0, sigma, (300, 400)))
        # Rounding adds 1/12 of a step squared.
        assert pixel_noise(stored, 1.0) == pytest.approx(np.sqrt(sigma**2 + 1 / 12), rel=0.06)
    assert pixel_noise(np.full((300, 400), 7.0), 1.0) == 0


def test_grey_by_parts() -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (60, 80), dtype=np.uint8)
    box = (10, 20, 50, 45)
    for gamma in (1.0, 2.2):
        grey = to_grey(image, gamma=gamma)
        np.testing.assert_allclose(grey.values, (image / 255) ** gamma, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(grey.crop(box), grey.values[20:45, 10:50], rtol=1e-6)
        clipped = grey.crop_clipped(box)
        assert clipped is not None
        assert np.array_equal(clipped, image[20:45, 10:50] == 255)
    assert to_grey(image / 255).crop_clipped(box) is None


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_the_laser_off_image_is_subtracted_in_linear_light(gamma: float) -> None:
    rng = np.random.default_rng(2)
    on, off = (rng.integers(0, 256, (40, 50), dtype=np.uint8) for _ in range(2))
    grey = to_grey(on, gamma=gamma, dark=off)
    np.testing.assert_allclose(grey.values, (on / 255) ** gamma - (off / 255) ** gamma, atol=1e-6)
    assert grey.clipped is not None
    assert np.array_equal(grey.clipped, on == 255)
    expected = np.maximum(on.astype(int) - off, 0) if gamma == 1 else grey.values
    np.testing.assert_allclose(grey.search, expected, atol=1e-6)


@pytest.mark.parametrize(
    "dark", [np.zeros((40, 51), np.uint8), np.zeros((40, 50), np.uint16), np.zeros((40, 50, 3), np.uint8), np.zeros(3)]
)
def test_a_laser_off_image_of_another_kind(dark: np.ndarray) -> None:
    with pytest.raises(InputError, match="laser-off image"):
        to_grey(np.zeros((40, 50), np.uint8), dark=dark)
