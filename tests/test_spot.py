"""From image to boundary: right, with the right sigma, and refusals that say why."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from planeopt.errors import InputError
from planeopt.rig import Camera, Rig, SpotDefinition, load_rig
from planeopt.simulation import BeamProfile, Noise, Sensor, boundary_distances, render
from planeopt.spot import NoSpotReason, Spot, SpotFlag, SpotNotFound, find_spot, read_image, read_points, write_points
from simulation_cases import spot_scene
from spot_scene import Scene, low_harmonics, noisy

Array = NDArray[np.float64]
EXAMPLE = Path(__file__).parents[1] / "calibration" / "example"
PIXEL = 1 / 12  # variance of a pixel's own area, px^2


def scene(radius: float, blur: float, kind: str = "disc", **changes: object) -> Scene:
    """Return a tilted spot whose semi-axes are `radius` and 0.8 of it, off the pixel grid."""
    size = int(2.5 * radius + 40)
    values = {"centre": (size / 2 + 0.3, size / 2 - 0.2), "semi_axes": (radius, 0.8 * radius), "size": (size, size)}
    return Scene(**(values | {"blur": blur, "kind": kind} | changes))  # pyright: ignore[reportArgumentType] - a test's dict


def flags_of(spot: Spot) -> set[SpotFlag]:
    return set(spot.flags)


def harmonics(spot: Spot, truth: Scene) -> tuple[Array, Array]:
    assert spot.sigma is not None
    offsets, angles = truth.offsets(spot.points)
    return low_harmonics(offsets, spot.sigma, angles)


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize(("radius", "blur"), [(15, 0.8), (15, 2.0), (40, 1.2), (150, 0.8), (150, 2.0)])
def test_without_noise_the_boundary_is_true(kind: str, radius: float, blur: float) -> None:
    truth = scene(radius, blur, kind)
    spot = find_spot(truth.clean(8 if radius < 100 else 4), camera_blur=float(np.sqrt(blur**2 + PIXEL)))
    offsets, _ = truth.offsets(spot.points)
    assert spot.kind == kind
    assert spot.arc_fraction == 1.0
    # The correction for curvature k is good to first order, k blur^2 / 2: at worst, k blur = 0.2 at the ends of the
    # smallest, what is left is of order k^3 blur^4 = 0.017 px.
    assert abs(offsets.mean()) < 0.01
    assert np.abs(offsets).max() < 0.02
    width = np.sqrt(blur**2 + PIXEL + (truth.line**2 if kind == "ring" else 0))
    assert spot.blur == pytest.approx(width, rel=0.05)
    assert spot.contrast is not None


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize(("radius", "blur", "noise"), [(15, 0.8, 1.0), (30, 2.0, 5.0), (60, 1.2, 2.0)])
def test_sigma_is_calibrated(kind: str, radius: float, blur: float, noise: float) -> None:
    truth = scene(radius, blur, kind)
    clean = truth.clean()
    draws = 20
    chi2, mean, ratio = [], [], []
    for seed in range(draws):
        spot = find_spot(noisy(clean, noise, seed), camera_blur=float(np.sqrt(blur**2 + PIXEL)))
        change, covariance = harmonics(spot, truth)
        chi2.append(change @ np.linalg.solve(covariance, change))
        mean.append(change[0])
        assert spot.sigma is not None
        ratio.append(np.mean((truth.offsets(spot.points)[0] / spot.sigma) ** 2))
    # 100 degrees of freedom: 0.14 from the draws; sigma's own error, 10 to 15 % from the correlation's length, which
    # is estimated from a few hundred points, adds 0.25. Three of both together.
    assert 0.4 < np.mean(chi2) / 5 < 1.85
    assert abs(np.mean(mean)) < 0.01
    # Inflated: the scatter of single points is a little less than sigma, and of its order.
    assert 0.3 < np.mean(ratio) < 1.1


def test_sigma_is_near_the_bound() -> None:
    truth, noise = scene(60, 1.2), 5.0
    spot = find_spot(truth.image(noise, 1))
    offsets, _ = truth.offsets(spot.points)
    bound = noise / truth.height * np.sqrt(2 * np.sqrt(np.pi) * np.sqrt(1.2**2 + PIXEL))
    # 330 points say 4 % about a deviation, three times; segments are a little shorter than a pixel.
    assert 0.88 * bound < offsets.std() < 1.15 * bound


def test_a_wide_round_ring_says_that_its_width_is_ambiguous() -> None:
    truth = scene(30, 1.0, "ring", line=3.0, semi_axes=(30.0, 30.0))
    image = truth.image(1.0, 0)
    spot = find_spot(image, kind="ring")
    assert flags_of(spot) == {SpotFlag.OWN_WIDTH}
    assert flags_of(find_spot(image)) == {SpotFlag.OWN_WIDTH, SpotFlag.RING_ASSUMED}
    change, covariance = harmonics(spot, truth)
    # The size is wrong by what is not known, and sigma says so; chi-squared with 5 degrees of freedom as above.
    assert change @ np.linalg.solve(covariance, change) < 20.5
    known = find_spot(image, kind="ring", camera_blur=float(np.sqrt(1 + PIXEL)))
    assert not known.flags
    assert abs(truth.offsets(known.points)[0].mean()) < 0.005


def test_a_wide_ring_that_is_not_round_tells_its_width() -> None:
    """Its own line is wider where the beam's scale is, the camera's blur is not."""
    truth = scene(30, 1.0, "ring", line=3.0)
    spot = find_spot(truth.image(1.0, 0), kind="ring")
    assert not spot.flags
    change, covariance = harmonics(spot, truth)
    assert change @ np.linalg.solve(covariance, change) < 20.5
    assert abs(truth.offsets(spot.points)[0].mean()) < 0.005


def test_the_level_is_an_iso_level_of_a_soft_edge() -> None:
    camera = Camera((115, 115), 1000, 1000, 57, 57, (0, 0, 0, 0, 0))
    truth = scene(30, 2.0)
    image = truth.clean()
    width = np.sqrt(2.0**2 + PIXEL)
    means = [
        truth.offsets(find_spot(image, Rig(camera, spot=SpotDefinition(level=level))).points)[0].mean()
        for level in (0.3, 0.5, 0.7)
    ]
    # Phi^-1(0.7) = 0.5244
    np.testing.assert_allclose(means, [0.5244 * width, 0, -0.5244 * width], atol=0.02 * width)


def test_gamma_is_undone() -> None:
    truth = scene(30, 1.5)
    linear = truth.clean() / 255
    stored = np.clip(np.rint(255 * linear ** (1 / 2.2)), 0, 255).astype(np.uint8)
    camera = Camera((115, 115), 1000, 1000, 57, 57, (0, 0, 0, 0, 0))
    told = find_spot(stored, Rig(camera, spot=SpotDefinition(gamma=2.2)))
    assert abs(truth.offsets(told.points)[0].mean()) < 0.01
    # Half of the stored edge is far below half of the light: the boundary moves outwards.
    assert truth.offsets(find_spot(stored).points)[0].mean() > 0.2


def test_an_uneven_surface_moves_nothing() -> None:
    truth = scene(50, 1.0)
    y, x = np.mgrid[: truth.size[1], : truth.size[0]] / 165 - 0.5
    light = (truth.clean() - truth.background) * (1 + 0.4 * x - 0.3 * y + 0.3 * x * y)
    spot = find_spot(noisy(light + 40 + 50 * x, 2.0, 0))
    change, covariance = harmonics(spot, truth)
    # chi-squared with 5 degrees of freedom exceeds 20.5 once in 1,000.
    assert change @ np.linalg.solve(covariance, change) < 20.5
    assert not spot.flags


def test_noise_that_ends_at_black_moves_nothing() -> None:
    truth, draws = scene(50, 1.0, background=0.0, height=120.0), 12
    clean, chi2, size = truth.clean(), [], []
    for seed in range(draws):
        spot = find_spot(noisy(clean, 4.0, seed))
        change, covariance = harmonics(spot, truth)
        chi2.append(change @ np.linalg.solve(covariance, change))
        size.append(change[0])
    # Half of the background's noise is cut off, which lifts it by 0.4 sigma: 1.6 grey values or 0.016 px if believed.
    # The size's standard deviation is 0.0085 px, of the mean of 12 0.0025, three times; chi-squared of 60 degrees.
    assert abs(np.mean(size)) < 0.0075
    assert np.sum(chi2) < 99.6


@pytest.mark.parametrize("tilt", [30, 60])
def test_the_line_of_a_tilted_ring_leans(tilt: float) -> None:
    """Perspective makes the line wider where the plane is nearer, and skew: the ridge is right nevertheless."""
    rig_scene = spot_scene(60.0, tilt, blur=0.9, beam=BeamProfile(kind="ring", height=0.7, line_mm=0.25))
    made = replace(rig_scene, noise=Noise(full_well_electrons=0, read=0.2 / 255), sensor=Sensor(bits=16))
    spot = find_spot(render(made, seed=0).image, made.rig, kind="ring")
    offsets = boundary_distances(made, spot.points)
    away = spot.points - spot.points.mean(axis=0)
    change, _ = low_harmonics(offsets, np.ones(len(offsets)), np.arctan2(away[:, 1], away[:, 0]))
    # Without the correction 0.0015 and 0.0048 px in the two waves of the place; its next order is a third of that.
    assert np.abs(change).max() < (0.0010 if tilt == 30 else 0.0025)


def as_colour(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.stack([grey // 4, grey // 2, grey], axis=2)


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize(
    ("shape", "radius", "ratio", "blur"),
    [
        # A circle has no major axis: where the count of its segments begins is chance, another one with every fit.
        ("half plane", 40.0, 1.0, 1.2),
        ("bar", 40.0, 1.0, 1.2),
        # Of the pixels round a small one, more than half see the bar or are blurred with it.
        ("bar", 24.0, 0.9, 1.8),
    ],
)
def test_a_third_is_hidden(kind: str, shape: str, radius: float, ratio: float, blur: float) -> None:
    truth = scene(radius, blur, kind, semi_axes=(radius, ratio * radius), line=1.0)
    clean, (y, x) = truth.clean(), np.indices(truth.size)
    for seed, direction in enumerate(np.arange(6) + 0.1):
        along = (x - truth.centre[0]) * np.cos(direction) + (y - truth.centre[1]) * np.sin(direction)
        depth = (
            along - radius * np.cos(np.pi / 3) if shape == "half plane" else radius * np.sin(np.pi / 6) - np.abs(along)
        )
        cover = gaussian_filter(np.clip(depth + 0.5, 0, 1), blur)
        spot = find_spot(noisy(clean + cover * (80.0 - clean), 2.0, seed), camera_blur=float(np.sqrt(blur**2 + PIXEL)))
        change, covariance = harmonics(spot, truth)
        # Chi-squared of five: beyond once in 100,000.
        assert change @ np.linalg.solve(covariance, change) < 30.9


def in_8_bits(clean: Array) -> NDArray[np.uint8]:
    return np.rint(clean).astype(np.uint8)


IMAGE_KINDS: dict[str, Callable[[Array], NDArray[np.generic]]] = {
    "8 bit": in_8_bits,
    "one channel": lambda clean: in_8_bits(clean)[:, :, None],
    "colour": lambda clean: as_colour(in_8_bits(clean)),
    "alpha": lambda clean: np.dstack([as_colour(in_8_bits(clean)), np.full(clean.shape, 255, np.uint8)]),
    "10 bit": lambda clean: np.rint(clean * 4).astype(np.uint16),
    "16 bit": lambda clean: np.rint(clean * 256).astype(np.uint16),
    "float 0 to 1": lambda clean: clean / 255,
    "float 0 to 255": lambda clean: clean.astype(np.float32),
    "not contiguous": lambda clean: in_8_bits(clean)[::-1, ::-1].copy()[::-1, ::-1],
}


@pytest.mark.parametrize("name", IMAGE_KINDS)
def test_every_kind_of_image(name: str) -> None:
    truth = scene(40, 1.2)
    offsets, _ = truth.offsets(find_spot(IMAGE_KINDS[name](truth.clean())).points)
    # Rounding to 8 bits (of a colour's darkest channel: to 6) is noise of 0.3 to 1 grey value.
    assert abs(offsets.mean()) < 0.005
    assert offsets.std() < 0.02


def test_one_channel_alone() -> None:
    truth, other = scene(40, 1.2), scene(40, 1.2, semi_axes=(20.0, 20.0))
    image = np.stack([other.image(), other.image(), truth.image()], axis=2)
    camera = Camera((140, 140), 1000, 1000, 70, 70, (0, 0, 0, 0, 0))
    spot = find_spot(image, Rig(camera, spot=SpotDefinition(channel="red")))
    assert abs(truth.offsets(spot.points)[0].mean()) < 0.01


def in_large_image(**changes: object) -> Scene:
    values = {"centre": (160.3, 120.2), "semi_axes": (40.0, 30.0), "size": (320, 240)}
    return Scene(**(values | changes))  # pyright: ignore[reportArgumentType] - a test's dict


def test_flags() -> None:
    truth = in_large_image()
    clean = truth.clean(4)
    assert flags_of(find_spot(noisy(clean, 2, 0))) == set()
    over = find_spot(np.clip(2 * clean, 0, 255).astype(np.uint8))
    assert SpotFlag.SATURATED in over.flags
    assert over.saturation == pytest.approx(1.0, abs=0.1)
    assert flags_of(find_spot(noisy(30 + (clean - 30) / 12, 2, 0))) == {SpotFlag.LOW_CONTRAST}
    assert SpotFlag.STRONG_CURVATURE in find_spot(in_large_image(semi_axes=(5.0, 4.0)).image(2)).flags
    # 2 px from the border all of its boundary is to be seen, 6 px beyond it a fifth is not.
    assert not find_spot(in_large_image(centre=(278.0, 120.0), angle=0.0).image(2)).flags
    assert SpotFlag.PARTIAL_ARC in find_spot(in_large_image(centre=(285.0, 120.0), angle=0.0).image(2)).flags


def test_a_speck_or_a_bright_square_is_not_the_spot() -> None:
    truth = in_large_image()
    image = np.maximum(truth.image(2), in_large_image(centre=(40.0, 40.0), semi_axes=(4.0, 4.0), height=220.0).image(2))
    image[180:230, 20:70] = 220
    image[5, 300] = 255
    assert abs(truth.offsets(find_spot(image).points)[0].mean()) < 0.01


DARK = np.zeros((240, 320), np.uint8)
RNG = np.random.default_rng(0)


def square() -> NDArray[np.uint8]:
    image = np.full_like(DARK, 30)
    image[50:150, 50:150] = 200
    return image


def two() -> NDArray[np.uint8]:
    return np.maximum(in_large_image().image(), in_large_image(centre=(60.0, 60.0), semi_axes=(30.0, 30.0)).image())


REFUSED: dict[str, tuple[Callable[[], NDArray[np.generic]], NoSpotReason]] = {
    "one pixel": (lambda: DARK[:1, :1], NoSpotReason.IMAGE_TOO_SMALL),
    "black": (lambda: DARK, NoSpotReason.TOO_DARK),
    "transparent black": (lambda: np.zeros((240, 320, 4), np.uint8), NoSpotReason.TOO_DARK),
    "black, float": (lambda: DARK.astype(float), NoSpotReason.TOO_DARK),
    "dark noise": (lambda: RNG.poisson(1, DARK.shape).astype(np.uint8), NoSpotReason.TOO_DARK),
    "white": (lambda: DARK + np.uint8(255), NoSpotReason.TOO_BRIGHT),
    "grey": (lambda: DARK + np.uint8(90), NoSpotReason.NO_CONTRAST),
    "noise": (lambda: RNG.integers(0, 256, DARK.shape, dtype=np.uint8), NoSpotReason.NO_CONTRAST),
    "dark spot": (lambda: 255 - in_large_image().image(2), NoSpotReason.NOT_AN_ELLIPSE),
    "square": (square, NoSpotReason.NOT_AN_ELLIPSE),
    "speck": (lambda: in_large_image(semi_axes=(2.0, 2.0)).image(), NoSpotReason.TOO_SMALL),
    "grain": (lambda: in_large_image(semi_axes=(1.0, 1.0), blur=0.5).image(), NoSpotReason.TOO_SMALL),
    "cut": (lambda: in_large_image(centre=(322.0, 120.0)).image(2), NoSpotReason.TOUCHES_BORDER),
    "in the corner": (lambda: in_large_image(centre=(310.0, 10.0)).image(2), NoSpotReason.TOUCHES_BORDER),
    "two": (two, NoSpotReason.SEVERAL),
}


@pytest.mark.parametrize("name", REFUSED)
def test_no_spot_has_a_reason(name: str) -> None:
    image, reason = REFUSED[name]
    with pytest.raises(SpotNotFound) as caught:
        find_spot(image())
    assert caught.value.reason is reason
    assert "\n" not in str(caught.value)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 90), st.integers(1, 90)),
    grain=st.floats(0, 12),
    power=st.integers(1, 9),
    dtype=st.sampled_from([np.uint8, np.uint16, np.float32]),
)
def test_any_image_gives_a_spot_or_a_reason(
    seed: int, shape: tuple[int, int], grain: float, power: int, dtype: type
) -> None:
    texture = gaussian_filter(np.random.default_rng(seed).normal(size=shape), grain, mode="wrap")
    spread = np.ptp(texture)
    texture = ((texture - texture.min()) / spread) ** power if spread > 0 else texture
    image = (texture * (1 if dtype == np.float32 else np.iinfo(dtype).max)).astype(dtype)
    try:
        spot = find_spot(image)
    except SpotNotFound:
        return
    assert len(spot) >= 12
    assert spot.sigma is not None
    assert np.all((spot.points > -1) & (spot.points < np.array(shape[::-1])))


def test_the_wrong_kind_is_refused() -> None:
    for kind, other in (("disc", "ring"), ("ring", "disc")):
        rig = Rig(Camera((320, 240), 1000, 1000, 160, 120, (0, 0, 0, 0, 0)), spot=SpotDefinition(kind=other))
        with pytest.raises(SpotNotFound, match=f"A {kind} was found .* not a {other}") as caught:
            find_spot(in_large_image(kind=kind).image(2), rig)
        assert caught.value.reason is NoSpotReason.WRONG_KIND


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros(5, np.uint8), "shape"),
        (np.zeros((0, 5), np.uint8), "shape"),
        (np.zeros((9, 9, 5), np.uint8), "shape"),
        (np.zeros((9, 9), int), "unsigned integers or floats"),
        (np.zeros((9, 9), complex), "unsigned integers or floats"),
        (np.array([["a"]]), "unsigned integers or floats"),
        (np.full((9, 9), np.nan), "NaN"),
        ([[1, 2], [3]], "not an array"),
    ],
)
def test_what_is_no_image(image: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        find_spot(image)  # pyright: ignore[reportArgumentType] - the mistake that is tested


def test_the_rig_must_fit_the_image() -> None:
    rig = Rig(Camera((640, 480), 1000, 1000, 320, 240, (0, 0, 0, 0, 0)))
    with pytest.raises(InputError, match=r"a\.png: 320 x 240 px, but .* 640 x 480"):
        find_spot(in_large_image().image(), rig, source="a.png")
    with pytest.raises(InputError, match="camera_blur must be"):
        find_spot(in_large_image().image(), camera_blur=0.0)


def test_a_lens_that_bends_the_ellipse_is_allowed_for() -> None:
    camera = Camera((400, 300), 320, 320, 200, 150, (-0.25, 0.05, 0, 0, 0))
    factor = 4
    x = (np.arange(400 * factor) + 0.5) / factor - 0.5
    y = (np.arange(300 * factor) + 0.5) / factor - 0.5
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    straight = camera.normalise(pixels)[0]
    flat = Scene(centre=(0.30, 0.20), semi_axes=(0.20, 0.12), angle=0.3)
    distance = flat.offsets(straight)[0].reshape(300 * factor, 400 * factor) * 320 * factor
    light = np.asarray(cv2.GaussianBlur(np.clip(0.5 - distance, 0, 1), (0, 0), 0.8 * factor))
    image = noisy(30 + 180 * light.reshape(300, factor, 400, factor).mean(axis=(1, 3)), 1.0, 0)
    spot = find_spot(image, Rig(camera))
    assert not spot.flags
    offsets, _ = flat.offsets(camera.normalise(spot.points)[0])
    # Noise of 1/180 of the edge is 0.012 px across it, and raw pixels are up to 1.4 straight ones here.
    assert abs(offsets.mean()) * 320 < 0.01
    assert offsets.std() * 320 < 0.025
    # Without the rig the spot is not an ellipse, and says so.
    assert {SpotFlag.NOT_AN_ELLIPSE, SpotFlag.MANY_OUTLIERS} & flags_of(find_spot(image))


def test_an_image_and_its_points_are_the_same(tmp_path: Path) -> None:
    spot = find_spot(read_image(EXAMPLE / "targets" / "target00.png"))
    write_points(spot, tmp_path / "spot.csv")
    back = read_points(tmp_path / "spot.csv")
    assert back.sigma is not None
    assert spot.sigma is not None
    np.testing.assert_array_equal(back.points, spot.points)
    np.testing.assert_array_equal(back.sigma, spot.sigma)


def true_boundary(rig: Rig, target: Path, count: int = 20_000) -> tuple[Array, Array]:
    """Return the true boundary (count, 2) in raw pixels and its outward normals, from the target's plane."""
    truth = json.loads(target.with_suffix(".json").read_text())
    beam = rig.require_beam()
    direction, offset = np.array(beam.direction), np.array([*beam.offset, 0.0])
    across = np.linalg.svd(direction[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = offset + beam.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across
    normal, point = np.array(truth["normal"]), np.array(truth["point_mm"])
    space = rim + ((point - rim) @ normal / (direction @ normal))[:, None] * direction
    pixels = rig.camera.project(space[:, :2] / space[:, 2:])
    tangent = np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0)
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    return pixels, outward * np.sign(np.sum(outward * (pixels - pixels.mean(axis=0))))


def target_folders() -> list[Path]:
    data = os.environ.get("PLANEOPT_DATA")
    return [EXAMPLE, *([Path(data) / "rig-a"] if data else [])]


@pytest.mark.parametrize("folder", target_folders(), ids=lambda folder: folder.name)
def test_path_traced_targets(folder: Path) -> None:
    rig = load_rig(folder / "truth_rig.toml")
    chi2 = []
    targets = sorted((folder / "targets").glob("*.png"))
    for target in targets:
        spot = find_spot(read_image(target), rig, source=target.name)
        assert spot.sigma is not None
        boundary, outward = true_boundary(rig, target)
        nearest = KDTree(boundary).query(spot.points)[1]
        offsets = np.sum((spot.points - boundary[nearest]) * outward[nearest], axis=1)
        angles = np.arctan2(*(spot.points - spot.points.mean(axis=0)).T[::-1])
        change, covariance = low_harmonics(offsets, spot.sigma, angles)
        chi2.append(change @ np.linalg.solve(covariance, change))
        assert not spot.flags
        # The level to hold is a scatter of 0.02 to 0.035 px.
        assert offsets.std() < 0.035, target.name
        assert abs(change[0]) < 4 * np.sqrt(covariance[0, 0]), target.name
    # Five a target; sigma as well calibrated as in the test with white noise above.
    assert np.mean(chi2) / 5 < 1.75 + 3 * np.sqrt(0.4 / len(targets)), chi2
