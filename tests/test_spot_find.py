"""Finding the spot: hidden, touched, faint, noisy and cut ones, hints, and images that hold none."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.plane import SpotPose
from planeopt.rig import Beam, Camera, Rig, load_rig
from planeopt.simulation import Clutter, Scene, Sensor, render
from planeopt.spot import NoSpotReason, SpotNotFound, read_image
from planeopt.spot.candidates import Candidate, find_candidate
from planeopt.spot.grey import to_grey
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind
from planeopt.spot.pyramid import pixel_noise

Array = NDArray[np.float64]
EXAMPLE = Path(__file__).parents[1] / "calibration" / "example"
SIZE = (640, 480)
Y, X = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
TRUTH = Outline(300.3, 220.8, 60.0, 45.0, 0.5)


def distances(outline: Outline) -> Array:
    return outline.distances(np.stack([X.ravel(), Y.ravel()], axis=1)).reshape(X.shape)


def disc(outline: Outline, blur: float = 1.2) -> Array:
    """Return a disc of height 1; far better than the pixel or two that is asked of a candidate."""
    return np.asarray(cv2.GaussianBlur(np.clip(0.5 - distances(outline), 0, 1), (0, 0), blur), dtype=np.float64)


def ring(outline: Outline, line: float = 1.6) -> Array:
    return np.exp(-((distances(outline) / line) ** 2) / 2)


def spot(kind: Kind, outline: Outline = TRUTH) -> Array:
    return disc(outline) if kind == "disc" else ring(outline)


def noisy(light: Array, sigma: float = 2.0, seed: int = 0) -> NDArray[np.uint8]:
    return np.clip(np.rint(light + np.random.default_rng(seed).normal(0, sigma, light.shape)), 0, 255).astype(np.uint8)


def found(image: NDArray[np.generic], kind: Kind | None = None, **hints: object) -> Candidate:
    grey = to_grey(image)
    noise = pixel_noise(grey.values, grey.quantum)
    return find_candidate(grey, noise, kind, **hints)  # pyright: ignore[reportArgumentType] - a test's dict


def refusal(image: NDArray[np.generic], **hints: object) -> NoSpotReason:
    with pytest.raises(SpotNotFound) as caught:
        found(image, **hints)  # pyright: ignore[reportArgumentType] - a test's dict
    assert "\n" not in str(caught.value)
    return caught.value.reason


def error(candidate: Candidate, truth: Outline = TRUTH) -> float:
    return float(np.abs(candidate.outline.distances(truth.at(truth.spaced(100))[0])).max())


def speckled(light: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    field = cv2.GaussianBlur(rng.normal(size=light.shape), (0, 0), 1.2 / np.sqrt(2))
    return light * np.maximum(1 + 0.35 * np.asarray(field) / np.std(field), 0)


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize("seed", range(4))
def test_speckle(kind: Kind, seed: int) -> None:
    candidate = found(noisy(20 + speckled(120 * spot(kind), seed), seed=seed))
    assert candidate.kind == kind
    # Grains of 1.2 px move single edges by a pixel; an ellipse through 48 of them by a few tenths.
    assert error(candidate) < 1.5


def half_plane(direction: float) -> NDArray[np.bool_]:
    # 0.45 of the ellipse off its centre hides acos(0.45) / pi = 35 % of it in eccentric angle.
    local = TRUTH.local(np.stack([X.ravel(), Y.ravel()], axis=1)) / [TRUTH.a, TRUTH.b]
    return (local @ [np.cos(direction), np.sin(direction)] > 0.45).reshape(X.shape)


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize("level", [0.0, 20.0, 70.0])
@pytest.mark.parametrize("direction", [0.3, 2.0, 4.5])
def test_a_third_is_hidden(kind: Kind, level: float, direction: float) -> None:
    image = noisy(np.where(half_plane(direction), level, 20 + 170 * spot(kind)))
    candidate = found(image)
    assert candidate.kind == kind
    assert error(candidate) < 2.0


@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_a_bar_splits_it(kind: Kind) -> None:
    bar = np.abs((X - TRUTH.x) * 0.6 + (Y - TRUTH.y) * 0.8) < 15
    candidate = found(noisy(np.where(bar, 5.0, 20 + 170 * spot(kind))))
    assert candidate.kind == kind
    assert error(candidate) < 1.0


@pytest.mark.parametrize("direction", [0.4, 1.2, 2.8])
def test_a_bar_brighter_than_a_fine_ring_crosses_it(direction: float) -> None:
    # Smoothed, the line is less bright than the bar, between whose sides many ellipses fit.
    truth = Outline(289.1, 178.4, 73.7, 70.6, 0.43)
    bar = np.abs((X - truth.x) * np.cos(direction) + (Y - truth.y) * np.sin(direction)) < 38
    candidate = found(noisy(np.where(bar, 70.0, 13 + 134 * ring(truth, 1.2))))
    assert candidate.kind == "ring"
    assert error(candidate, truth) < 1.0


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize("level", [0.0, 20.0, 45.0, 76.0])
@pytest.mark.parametrize("told", [False, True])
def test_a_bar_leaves_two_caps_of_a_small_one(kind: Kind, level: float, told: bool) -> None:
    truth = Outline(300.3, 220.8, 27.0, 23.0, 0.5)
    bar = np.abs((X - truth.x) * 0.6 + (Y - truth.y) * 0.8) < 12.5
    candidate = found(noisy(np.where(bar, level, 20 + 170 * spot(kind, truth))), kind if told else None)
    assert candidate.kind == kind
    assert error(candidate, truth) < 1.5


@pytest.mark.parametrize("height", [150.0, 470.0])
@pytest.mark.parametrize("told", [False, True])
def test_a_small_soft_ring(height: float, told: bool) -> None:
    truth = Outline(300.3, 220.8, 9.0, 7.5, 0.5)
    candidate = found(noisy(20 + height * ring(truth, 2.4)), "ring" if told else None)
    assert candidate.kind == "ring"
    assert error(candidate, truth) < 1.0


@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_faint_on_a_slope(kind: Kind) -> None:
    candidate = found(noisy(40 + 0.1 * X + 0.05 * Y + 22 * spot(kind), 1.5))
    assert candidate.kind == kind
    assert error(candidate) < 1.0
    assert candidate.contrast * 255 == pytest.approx(22, rel=0.35)


def test_over_exposed() -> None:
    image = noisy(15 + 500 * disc(TRUTH, 2.0))
    # Clipped at half its height the edge seems to be that much further out: Phi^-1(0.75) * 2 = 1.3 px.
    assert error(found(image)) < 2.0


@pytest.mark.parametrize(
    "truth",
    [
        Outline(300.3, 200.2, 8.0, 3.4, 0.4),
        Outline(300.3, 200.2, 14.0, 14.0, 0.0),
        Outline(310.0, 230.0, 220.0, 150.0, 0.2),
        Outline(310.0, 230.0, 90.0, 9.0, 1.0),
    ],
)
def test_small_large_and_flat(truth: Outline) -> None:
    candidate = found(noisy(20 + 180 * disc(truth, 2.0)))
    assert candidate.kind == "disc"
    # A narrow spot looks wider than it is: twice the blur over its own width, about half a pixel at its ends.
    assert error(candidate, truth) < 1.5


def test_a_soft_lamp_does_not_win() -> None:
    lamp = 220 * np.exp(-((X - 520) ** 2 + (Y - 380) ** 2) / 2 / 50**2)
    assert error(found(noisy(20 + lamp + 150 * disc(TRUTH)))) < 1.0


def test_a_soft_spot_alone_is_found() -> None:
    candidate = found(noisy(20 + 200 * np.exp(-((X - 300) ** 2 + (Y - 200) ** 2) / 2 / 30**2)))
    # Steepest at one standard deviation; from there on noise decides.
    assert np.hypot(candidate.outline.x - 300, candidate.outline.y - 200) < 3
    assert candidate.outline.size == pytest.approx(30, rel=0.35)


def test_something_brighter_touches_it() -> None:
    x, y = TRUTH.at(TRUTH.spaced(8))[0][1]
    rectangle = (np.abs(X - x) < 18) & (np.abs(Y - y) < 12)
    assert error(found(noisy(np.where(rectangle, 250.0, 20 + 120 * disc(TRUTH))))) < 1.0


def rig(radius: float = 5.0) -> Rig:
    return Rig(Camera((640, 480), 1500, 1500, 319.5, 239.5, (-0.1, 0.05, 0, 0, 0)), Beam(radius, (14.0, 9.0)))


def scene(z_L: float = 180.0, **tables: object) -> Scene:
    pose = SpotPose.canonical(5.0 / np.cos(0.5), z_L, 0.5, 0.8)
    return Scene.of(rig(), pose, **tables)


@pytest.mark.parametrize("seed", range(6))
def test_the_rig_tells_the_spot_from_distractors(seed: int) -> None:
    clutter = Clutter(count=12, height_range=(0.5, 1.2), size_range_px=(4.0, 40.0), keep_away_px=2.0)
    simulated = render(scene(clutter=clutter), seed)
    clean = found(render(scene()).image)
    candidate = found(simulated.image, rig=rig())
    assert np.hypot(candidate.outline.x - clean.outline.x, candidate.outline.y - clean.outline.y) < 1.0
    assert candidate.outline.size == pytest.approx(clean.outline.size, abs=1.0)


def test_what_is_off_the_beam_is_not_its_spot() -> None:
    image = noisy(20 + 150 * disc(Outline(120.0, 100.0, 40.0, 35.0, 0.3)))
    assert error(found(image), Outline(120.0, 100.0, 40.0, 35.0, 0.3)) < 1.0
    assert refusal(image, rig=rig()) in (NoSpotReason.OFF_BEAM, NoSpotReason.NO_CONTRAST)
    # On the beam's image, but too large for it.
    on = render(scene()).image
    assert refusal(on, rig=rig(2.5)) is NoSpotReason.OFF_BEAM


LEFT, RIGHT = Outline(150.0, 200.0, 40.0, 30.0, 0.2), Outline(470.0, 280.0, 40.0, 30.0, 0.2)
PAIR = noisy(20 + 150 * (disc(LEFT) + disc(RIGHT)))


def test_two_are_ambiguous_without_a_hint() -> None:
    assert refusal(PAIR) is NoSpotReason.SEVERAL
    assert error(found(PAIR, region=(0, 0, 300, 480)), LEFT) < 1.0
    assert error(found(PAIR, region=(300, 0, 640, 480)), RIGHT) < 1.0
    for previous in ((465.0, 275.0), RIGHT.at(RIGHT.spaced(20))[0] + 6):
        assert error(found(PAIR, previous=previous), RIGHT) < 1.0
    # Not where it was before: looked for everywhere.
    assert error(found(noisy(20 + 150 * disc(LEFT)), previous=(600.0, 440.0)), LEFT) < 1.0


@pytest.mark.parametrize("shape", [(1024, 1280), (3000, 4000)])
@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize(("radius", "height", "rivals"), [(20.0, 200.0, True), (30.0, 110.0, True), (3.8, 60.0, False)])
def test_a_small_rival_of_what_is_found_first(
    shape: tuple[int, int], kind: Kind, radius: float, height: float, rivals: bool
) -> None:
    # The large one shows on the smallest levels. By size times the root of the height, the others have 0.63, 0.70 and
    # 0.07 of its strength as a disc; a fine line is up to half as strong again, its edges are falls all the way down.
    image = np.full(shape, 20.0)
    image[:480, :640] += 80 * spot(kind, Outline(300.0, 220.0, 52.0, 48.0, 0.5))
    image[-480:, -640:] += height * disc(Outline(400.0, 300.0, radius + 0.5, radius - 0.5, 0.2))
    if rivals:
        assert refusal(noisy(image)) is NoSpotReason.SEVERAL
    else:
        assert error(found(noisy(image)), Outline(300.0, 220.0, 52.0, 48.0, 0.5)) < 1.0


def test_disc_and_ring_are_told_apart_by_the_kind_asked_for() -> None:
    image = noisy(20 + 150 * (disc(LEFT) + ring(RIGHT)))
    assert refusal(image) is NoSpotReason.SEVERAL
    assert error(found(image, "disc"), LEFT) < 1.0
    assert error(found(image, "ring"), RIGHT) < 1.0


@pytest.mark.parametrize(
    ("hints", "message"),
    [
        ({"region": (0, 0, 10)}, "four numbers"),
        ({"region": (0, 0, np.nan, 10)}, "four numbers"),
        ({"region": "left"}, "four numbers"),
        ({"region": (50, 50, 50, 90)}, "empty"),
        ({"region": (0, 0, 641, 480)}, "does not lie in the image of 640 x 480"),
        ({"previous": "there"}, "previous must be"),
        ({"previous": (1.0, 2.0, 3.0)}, "previous must be"),
        ({"previous": (np.inf, 2.0)}, "previous must be"),
    ],
)
def test_impossible_hints(hints: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        found(PAIR, **hints)  # pyright: ignore[reportArgumentType] - the mistake that is tested


@pytest.mark.parametrize("largest", [1e38, 1e300])
def test_huge_and_far_negative_floats(largest: float) -> None:
    image = (0.1 + 0.8 * disc(TRUTH)) * largest
    image[10:14, 20:30] = -largest
    assert error(found(image)) < 1.0
    image[10:14, 20:30] = -1e8 * largest
    assert error(found(image)) < 1.0


def test_a_round_thing_in_front_of_it_is_not_taken_for_it() -> None:
    clean = found(render(scene()).image)
    o = clean.outline
    x, y = (o.at(o.spaced(4))[0][0] + 10).tolist()
    front = Outline(x, y, o.size, o.size, 0.0)
    image = noisy(np.where(distances(front) < 0, 90.0, render(scene()).image))
    candidate = found(image, rig=rig())
    assert np.hypot(candidate.outline.x - o.x, candidate.outline.y - o.y) < 1.5


@pytest.mark.parametrize("inside", [0.8, 0.4])
def test_cut_by_the_border(inside: float) -> None:
    truth = Outline(SIZE[0] - 0.5 - 50 * inside, 240.0, 50.0, 50.0, 0.0)
    candidate = found(noisy(20 + 170 * disc(truth)))
    assert candidate.touches_border
    assert error(candidate, truth) < 2.0


@pytest.mark.parametrize("inside", [0.0, -0.4])
@pytest.mark.parametrize("corner", [False, True])
def test_half_of_it_is_not_enough(inside: float, corner: bool) -> None:
    y = SIZE[1] - 0.5 - 50 * inside if corner else 240.0
    image = noisy(20 + 170 * disc(Outline(SIZE[0] - 0.5 - 50 * inside, y, 50.0, 50.0, 0.0)))
    assert refusal(image) in (NoSpotReason.TOUCHES_BORDER, NoSpotReason.NOT_AN_ELLIPSE)


def blobs() -> Array:
    rng = np.random.default_rng(1)
    image = np.full(X.shape, 20.0)
    for _ in range(12):
        x, y = rng.uniform(60, 420, 2)
        image += rng.uniform(50, 150) * np.exp(-((X - x) ** 2 + (Y - y) ** 2) / 2 / rng.uniform(6, 30) ** 2)
    return image


def text() -> Array:
    image = np.full(X.shape, 20, np.uint8)
    for row in range(8):
        place, scale = (20, 60 + 50 * row), 0.6 + 0.15 * row
        cv2.putText(image, "Plane 0123 oooO 89", place, cv2.FONT_HERSHEY_SIMPLEX, scale, 220, 2, cv2.LINE_AA)
    return image.astype(np.float64)


def texture(grain: float) -> Array:
    field = np.asarray(cv2.GaussianBlur(np.random.default_rng(2).normal(size=X.shape), (0, 0), grain))
    return 120 + 40 * field / field.std()


def tilted_square() -> Array:
    u, v = np.abs((X - 300) * 0.8 + (Y - 200) * 0.6), np.abs((Y - 200) * 0.8 - (X - 300) * 0.6)
    return np.where(np.maximum(u, v) < 50, 200.0, 30.0)


EMPTY: dict[str, tuple[Callable[[], Array], set[NoSpotReason]]] = {
    "white noise": (lambda: np.full(X.shape, 100.0), {NoSpotReason.NO_CONTRAST}),
    "blobs": (blobs, {NoSpotReason.SEVERAL}),
    "text": (text, {NoSpotReason.SEVERAL}),
    "fine texture": (lambda: texture(3.0), {NoSpotReason.SEVERAL, NoSpotReason.NOT_AN_ELLIPSE}),
    "coarse texture": (lambda: texture(30.0), {NoSpotReason.SEVERAL, NoSpotReason.NOT_AN_ELLIPSE}),
    "seam": (lambda: 30 + 100.0 * (X > 300), {NoSpotReason.NOT_AN_ELLIPSE, NoSpotReason.TOUCHES_BORDER}),
    "square": (tilted_square, {NoSpotReason.NOT_AN_ELLIPSE}),
    "3 px": (lambda: 20 + 200 * disc(Outline(300, 200, 1.5, 1.5, 0), 1.0), {NoSpotReason.TOO_SMALL}),
}


@pytest.mark.parametrize("name", EMPTY)
def test_no_spot_has_a_reason(name: str) -> None:
    image, reasons = EMPTY[name]
    assert refusal(noisy(image(), 3.0)) in reasons


@pytest.mark.parametrize("view", ["view04.png", "view10.png"])
def test_the_spot_on_a_board_is_found(view: str) -> None:
    image = read_image(EXAMPLE / "session" / view)
    alone = found(image)
    told = found(image, rig=load_rig(EXAMPLE / "truth_rig.toml"))
    assert error(alone, told.outline) < 0.5
    assert alone.support > 0.9


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_twelve_megapixels(dtype: type) -> None:
    image = np.full((3000, 4000), 30, np.uint8)
    small = noisy(20 + 150 * disc(Outline(300.0, 200.0, 10.0, 8.0, 0.3)))
    image[1500:1980, 2500:3140] = np.maximum(small, 30)
    scale = {np.uint8: 1, np.uint16: 257, np.float32: 1 / 255}[dtype]
    candidate = found((image.astype(dtype) * dtype(scale)).astype(dtype))
    assert error(candidate, Outline(2800.0, 1700.0, 10.0, 8.0, 0.3)) < 1.0


def test_laser_off_image() -> None:
    bright = 30 + 60 * (((X // 40) + (Y // 40)) % 2) + 80 * disc(RIGHT)
    on, off = noisy(bright + 60 * disc(LEFT)), noisy(bright, seed=1)
    grey = to_grey(on, dark=off)
    candidate = find_candidate(grey, pixel_noise(grey.values, grey.quantum))
    assert error(candidate, LEFT) < 1.0
    assert candidate.contrast * 255 == pytest.approx(60, rel=0.1)


def test_colour_and_depth_of_a_simulated_sensor() -> None:
    truth = found(render(scene()).image)
    for sensor in (Sensor(bits=12), Sensor(color=True), Sensor(gamma=2.2)):
        candidate = found(render(scene(sensor=sensor)).image)
        assert error(candidate, truth.outline) < 1.0
