"""From an image in memory to boundary points, beside one Gaussian blur of the same image, on one core.

Times are never asserted, since they are the machine's; that the boundary is the true one is.
"""

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.special import ndtr

from planeopt.rig import Camera, Rig, SpotDefinition
from planeopt.spot import find_spot
from planeopt.spot.points import Kind

SIZES = {"1.3 MP": (1280, 1024), "12 MP": (4000, 3000)}
BLUR, NOISE, LINE = 1.2, 2.0, 1.5
SHARES = (0.06, 0.15)
"""Radii of the spot over the height of the image: the time goes by the length of the boundary as well."""


def radius(size: str, share: float) -> float:
    return share * SIZES[size][1]


def centre(size: str) -> tuple[float, float]:
    width, height = SIZES[size]
    return 0.56 * width + 0.3, 0.47 * height - 0.2


@cache
def image(size: str, kind: Kind, share: float) -> NDArray[np.uint8]:
    """A round spot over a sloping background, with white noise."""
    width, height = SIZES[size]
    x0, y0 = centre(size)
    x, y = np.arange(width, dtype=np.float32) - np.float32(x0), np.arange(height, dtype=np.float32) - np.float32(y0)
    away = np.hypot(x, y[:, None]) - np.float32(radius(size, share))
    light = ndtr(-away / np.float32(BLUR)) if kind == "disc" else np.exp(-((away / np.float32(LINE)) ** 2) / 2)
    noise = np.random.default_rng(1).standard_normal(away.shape, dtype=np.float32)
    grey = 25 + 10 * x / width + 160 * light + np.float32(NOISE) * noise
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def rig(size: str, kind: Kind) -> Rig:
    width, height = SIZES[size]
    return Rig(Camera(SIZES[size], width, width, width / 2, height / 2, (0, 0, 0, 0, 0)), spot=SpotDefinition(kind))


@pytest.fixture(autouse=True)
def _one_core() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


@pytest.mark.parametrize("kind", ["disc", "ring"])
@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("size", SIZES)
def test_find_spot(benchmark: BenchmarkFixture, size: str, kind: Kind, share: float) -> None:
    spot = benchmark(find_spot, image(size, kind, share), rig(size, kind))
    benchmark.group = f"From array to points, {size}, one core"
    benchmark.extra_info["what"] = f"find_spot, a {kind} of {radius(size, share):.0f} px radius"
    x, y = centre(size)
    away = np.hypot(spot.points[:, 0] - x, spot.points[:, 1] - y) - radius(size, share)
    # The noise allows 0.03 px a point and 1e-3 px of their mean; blur on a curve moves the half height by 0.01 px.
    assert abs(np.mean(away)) < 0.01


@pytest.mark.parametrize("size", SIZES)
def test_gaussian_blur(benchmark: BenchmarkFixture, size: str) -> None:
    blurred = benchmark(cv2.GaussianBlur, image(size, "disc", SHARES[0]), (0, 0), 1.5)
    benchmark.group = f"From array to points, {size}, one core"
    benchmark.extra_info["what"] = "cv2.GaussianBlur"
    assert blurred.shape == SIZES[size][::-1]
