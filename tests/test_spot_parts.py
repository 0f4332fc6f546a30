"""The parts of the spot's measurement, each against what it should give exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from planeopt.errors import InputError
from planeopt.spot.grey import to_grey
from planeopt.spot.outline import Outline, fit
from planeopt.spot.profiles import half_level_crossings, ridge_peaks
from planeopt.spot.pyramid import pixel_noise
from planeopt.spot.scatter import Scatter, inflation_of, scatter_about_ellipse


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.8])
def test_inflation_of_a_known_process(phi: float) -> None:
    count, draws = 600, 40
    rng = np.random.default_rng(2)
    frequency = 2 * np.pi * np.fft.rfftfreq(count)
    filtered = 1 / np.abs(1 - phi * np.exp(-1j * frequency))
    series = np.fft.irfft(np.fft.rfft(rng.normal(size=(draws, count))) * filtered, count)
    series *= np.sqrt(1 - phi**2)
    found = [inflation_of(scattered(row)) ** 2 for row in series]
    # First-order autoregression of unit variance: (1 + phi) / (1 - phi). The sequence of positive pairs is cut where
    # noise ends it, and what chance may do is taken off: with M lags sqrt(2 (2 M + 1) / 600), 0.15 to 0.35 here.
    assert np.mean(found) == pytest.approx((1 + phi) / (1 - phi), rel=0.25)
    if phi == 0:
        # Of independent residuals as expected hardly one in six exceeds its own standard deviation.
        assert np.mean(np.array(found) > 1.02) < 0.4


@pytest.mark.parametrize("width", [0.6, 1.5, 2.5])
def test_crossings_and_peaks_are_a_start(width: float) -> None:
    t = np.arange(-10, 10.5, 0.5)
    position = np.random.default_rng(1).uniform(-1, 1, 40)
    x = (t - position[:, None]) / width
    for profiles, cross in (
        (0.1 + 0.6 * ndtr(-x), half_level_crossings),
        (0.1 + 0.6 * np.exp(-(x**2) / 2), ridge_peaks),
    ):
        found, height, spread = cross(profiles, t)
        # Samples half a pixel apart, at whose places a ridge peaks.
        assert np.abs(found - position).max() < 0.3
        np.testing.assert_allclose(height, 0.6, rtol=0.1)
        assert spread == pytest.approx(width, rel=0.4)
    assert np.all(np.isnan(half_level_crossings(np.ones((5, len(t))), t)[0]))


def scattered(residuals: np.ndarray, present: np.ndarray | None = None) -> Scatter:
    keep = np.ones(len(residuals), dtype=bool) if present is None else present
    factor = float(np.sqrt((residuals[keep] ** 2).sum() / (keep.sum() - 5)))
    return Scatter(Outline(0, 0, 2, 1, 0), keep, residuals, factor)


def test_inflation_does_not_depend_on_gaps() -> None:
    rng = np.random.default_rng(3)
    series = np.convolve(rng.normal(size=2000), np.ones(4) / 2, "same")
    present = rng.random(2000) < 0.7
    holed = np.where(present, series, 1e9)
    assert inflation_of(scattered(holed, present)) == pytest.approx(inflation_of(scattered(series)), rel=0.2)


def test_scatter_beyond_the_noise_inflates() -> None:
    residuals = 3.0 * np.random.default_rng(8).normal(size=1000)
    # 1,000 residuals: 4.5 % on the variance, and as much is taken off.
    assert inflation_of(scattered(residuals)) == pytest.approx(3.0, rel=0.1)


outlines = st.builds(
    Outline,
    x=st.floats(-50, 2000),
    y=st.floats(-50, 2000),
    a=st.floats(20, 100),
    b=st.floats(12, 20),
    angle=st.floats(-1.5, 1.5),
)


@settings(derandomize=True, max_examples=30, deadline=None)
@given(outline=outlines)
def test_outline_geometry(outline: Outline) -> None:
    points, normals, curvature = outline.at(outline.spaced(400))
    np.testing.assert_allclose(outline.radius_of(points), 1, atol=1e-9)
    np.testing.assert_allclose(outline.distances(points + 1e-3 * normals), 1e-3, rtol=1e-3)
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    # Chords of a curve of curvature k are k^2 s^2 / 24 shorter than their arcs s.
    assert np.ptp(steps) < steps.mean() * (0.01 + (curvature.max() * steps.mean()) ** 2 / 12)
    assert steps.sum() == pytest.approx(outline.perimeter, rel=2e-3)
    # Total curvature of a closed curve.
    assert (curvature * steps).sum() == pytest.approx(2 * np.pi, rel=0.02)
    found = fit(points, np.ones(400))
    assert found is not None
    np.testing.assert_allclose(
        [found.x, found.y, found.a, found.b], [outline.x, outline.y, outline.a, outline.b], atol=1e-5
    )


def test_outliers_are_left_out() -> None:
    rng = np.random.default_rng(4)
    points, normals, _ = Outline(60, 50, 40, 30, 0.2).at(Outline(60, 50, 40, 30, 0.2).spaced(200))
    offsets = rng.normal(0, 0.05, 200)
    offsets[50:56] += 2.0
    found = scatter_about_ellipse(points + offsets[:, None] * normals, np.full(200, 0.05), np.ones(200, dtype=bool))
    assert found is not None
    assert set(np.flatnonzero(~found.keep)) == set(range(50, 56))
    # 194 residuals: 5 % on a standard deviation; the robust one 8 %.
    assert found.factor == pytest.approx(1, abs=0.25)
    assert scatter_about_ellipse(np.stack([np.arange(20.0)] * 2, axis=1), np.ones(20), np.ones(20, dtype=bool)) is None


def test_noise_is_told_from_content() -> None:
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:200, :300]
    content = 0.2 + x / 600 + 0.3 * ((x // 40 + y // 40) % 2)
    image = (content + rng.normal(0, 0.01, content.shape)).astype(np.float32)
    # Edges are a twentieth of the second differences; 60,000 of them say 1 %.
    assert pixel_noise(image) == pytest.approx(0.01, rel=0.15)
    assert pixel_noise(np.zeros((5, 2), np.float32)) == 0


def test_grey() -> None:
    image = np.zeros((4, 5, 3), np.uint8)
    image[..., 2] = 255
    assert to_grey(image).values == pytest.approx(0.299)
    assert to_grey(image, "red").values == pytest.approx(1)
    assert to_grey(image, "blue").values == pytest.approx(0)
    grey = to_grey(image)
    assert grey.clipped is not None
    assert grey.clipped.all()
    dim = to_grey(np.full((2, 2), 128, np.uint8), gamma=2.0)
    assert dim.values == pytest.approx((128 / 255) ** 2, rel=1e-6)
    twelve = np.full((2, 2), 4095, np.uint16)
    assert to_grey(twelve).values == pytest.approx(1), "a full 12-bit value is full scale"
    assert to_grey(twelve - 1).values == pytest.approx(4094 / 65535)
    assert to_grey(np.full((2, 2), 0.5)).clipped is None
    for channel, gamma in (("infrared", 1.0), ("gray", 0.0), ("gray", np.nan)):
        with pytest.raises(InputError, match=r"channel|gamma"):
            to_grey(image, channel, gamma)
