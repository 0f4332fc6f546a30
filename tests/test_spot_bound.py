"""The bound of the boundary's position against the Fisher information of images, by finite differences."""

import numpy as np
import pytest
from numpy.typing import NDArray

from planeopt.spot.bound import boundary_sigma, least_covariance, point_sigma, size_cost
from planeopt.spot.points import Kind
from spot_scene import Scene

Array = NDArray[np.float64]

RADIUS, HEIGHT, BACKGROUND, NOISE, BLUR, LINE = 40.0, 180.0, 30.0, 3.0, 1.2, 1.5
PERIMETER = 2 * np.pi * RADIUS


def image(kind: Kind, radius: float = RADIUS, x: float = 0.0, clip: float = np.inf) -> Array:
    scene = Scene(
        centre=(55.3 + x, 55.8),
        semi_axes=(radius, radius),
        blur=BLUR,
        background=BACKGROUND,
        height=HEIGHT,
        size=(112, 112),
        kind=kind,
        line=LINE,
    )
    return np.minimum(scene.clean(6), clip)


def width(kind: Kind) -> float:
    return float(np.sqrt(BLUR**2 + 1 / 12 + (LINE**2 if kind == "ring" else 0)))


def peak(kind: Kind) -> float:
    """Height of a ridge after blurring: its light is spread over its new width."""
    return HEIGHT if kind == "disc" else HEIGHT * LINE / width(kind)


def information(kind: Kind, clip: float, variance: float | Array) -> Array:
    """Of (radius, x) in the image, (2, 2)."""
    h = 0.05
    level = BACKGROUND + clip * peak(kind)
    by_radius = (image(kind, RADIUS + h, clip=level) - image(kind, RADIUS - h, clip=level)) / (2 * h)
    by_x = (image(kind, x=h, clip=level) - image(kind, x=-h, clip=level)) / (2 * h)
    both = np.stack([by_radius.ravel(), by_x.ravel()])
    return (both / np.broadcast_to(np.asarray(variance), by_x.shape).ravel()) @ both.T


@pytest.mark.parametrize("clip", [np.inf, 0.7, 0.5])
@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_the_bound_is_the_information_of_the_image(kind: Kind, clip: float) -> None:
    found = information(kind, clip, NOISE**2)
    sigma = boundary_sigma(kind, peak(kind), NOISE, width(kind), clip=clip)
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    moves = np.stack([np.ones_like(angle), np.cos(angle)], axis=1)
    bound = least_covariance(moves, np.full(500, PERIMETER / 500), sigma)
    # A pixel is a square, not a Gaussian, and the boundary is curved: (w / radius)^2 = 0.003. A clipping level leaves
    # the outer half of the profile, w / radius = 0.03 longer, and cuts whole pixels, of which some hundred lie at it.
    tolerance = 0.01 if clip > 1 else 0.03
    np.testing.assert_allclose(np.diag(np.linalg.inv(found)), np.diag(bound), rtol=tolerance)
    assert abs(found[0, 1]) < tolerance * found[0, 0]
    assert bound[0, 0] == pytest.approx(sigma**2 / PERIMETER)
    assert bound[1, 1] == pytest.approx(2 * sigma**2 / PERIMETER)


@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_noise_that_grows_with_the_level(kind: Kind) -> None:
    bright = 4 * NOISE
    level = (image(kind) - BACKGROUND) / peak(kind)
    found = information(kind, np.inf, NOISE**2 + (bright**2 - NOISE**2) * level)
    sigma = boundary_sigma(kind, peak(kind), NOISE, width(kind), noise_bright=bright)
    # Noise at the bright side moves the weight outwards, where the boundary is longer: by about half of w / radius.
    assert found[0, 0] == pytest.approx(PERIMETER / sigma**2, rel=0.02)


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize("clip", [0.05, 0.5, 0.9, 1.0, np.inf])
def test_the_integral_is_the_closed_form(kind: Kind, clip: float) -> None:
    closed = boundary_sigma(kind, 100.0, 2.0, 1.3, clip=clip)
    np.testing.assert_allclose(boundary_sigma(kind, 100.0, 2.0, 1.3, clip=clip, noise_bright=2.0), closed, rtol=1e-9)


@pytest.mark.parametrize(("radius", "clip", "tolerance"), [(8.0, np.inf, 0.02), (40.0, np.inf, 0.02), (40.0, 0.8, 0.1)])
def test_the_cost_of_an_unknown_height_and_blur(radius: float, clip: float, tolerance: float) -> None:
    at = {"radius": radius, "blur": BLUR, "height": HEIGHT}
    h = 0.05

    def disc(**changes: float) -> Array:
        now = at | changes
        shape = {"centre": (55.3, 55.8), "size": (112, 112), "semi_axes": (now.pop("radius"),) * 2}
        return Scene(background=0, **shape, **now).clean(6).ravel()  # pyright: ignore[reportArgumentType] - a test's dict

    J = np.array([(disc(**{name: x + h}) - disc(**{name: x - h})) / (2 * h) for name, x in at.items()])
    J = np.where(disc() < clip * HEIGHT, J, 0.0)
    information = J @ J.T
    cost = np.sqrt(np.linalg.inv(information)[0, 0] * information[0, 0])
    # The square pixel counts as a Gaussian; where a clipped edge is nearly one parameter's, its tail's shape matters.
    assert size_cost(radius, width("disc"), clip=clip) == pytest.approx(cost, rel=tolerance)


def test_the_cost_is_that_of_the_size_alone() -> None:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    moves, lengths = np.stack([np.ones_like(angle), np.cos(angle)], axis=1), np.full(400, 0.5)
    free, paid = least_covariance(moves, lengths, 0.1), least_covariance(moves, lengths, 0.1, size_cost=3.0)
    np.testing.assert_allclose(paid, free * [[9, 1], [1, 1]], atol=1e-12)


def test_known_values() -> None:
    # blur 1.5 px, contrast 180, noise 2: 0.0256 px.
    assert boundary_sigma("disc", 180, 2, 1.5) == pytest.approx(2 / 180 * np.sqrt(2 * np.sqrt(np.pi) * 1.5))
    # Clipped at half its height a step keeps half of its information, below it less; clipped away it keeps nothing.
    assert boundary_sigma("disc", 180, 2, 1.5, clip=0.5) == pytest.approx(
        np.sqrt(2) * boundary_sigma("disc", 180, 2, 1.5)
    )
    assert np.isinf(boundary_sigma("disc", 180, 2, 1.5, clip=0.0))
    assert np.isinf(boundary_sigma("ring", 180, 2, 1.5, clip=0.0))
    # Two points for each pixel of boundary know half as much each.
    assert point_sigma(0.02, 0.5) == pytest.approx(0.02 * np.sqrt(2))
    assert boundary_sigma("ring", [50, 100], 2, 1).shape == (2,)
