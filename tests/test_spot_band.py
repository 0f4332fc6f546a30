"""The model of the band round a spot: against finite differences, dense algebra, and rendered images."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from planeopt.spot.adjustment import Fitted, fit_model, noise_law, solve, whitened
from planeopt.spot.band import Band, band_round
from planeopt.spot.blurred import curved, rendered
from planeopt.spot.model import N_ELLIPSE, Freedom, Model, Widths, see, terms_of
from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind
from planeopt.spot.segments import segments_of
from planeopt.spot.surfaces import surface, surface_slope, waves
from spot_scene import Scene

Array = NDArray[np.float64]

OUTLINE = Outline(60.3, 55.8, 30.0, 24.0, 0.4)
FREE = {
    "disc": Freedom(3, 2, 2, 4, 4, True, True, True, False, False, True),
    "ring": Freedom(3, 0, 2, 4, 4, False, True, True, True, True, False),
}


def band(outline: Outline = OUTLINE, values: Array | None = None) -> Band:
    image = np.zeros((110, 120)) if values is None else values
    return band_round(image.astype(np.float32), None, None, outline, 12.0, 9.0)


def model(kind: Kind, seed: int = 0) -> Model:
    free, rng = FREE[kind], np.random.default_rng(seed)
    ground, top = free.background_terms, 1 + 2 * max(free.plateau, free.plateau_waves) + N_ELLIPSE * free.plateau_slopes
    coefficients = rng.normal(0, 0.02, ground + top)
    coefficients[0], coefficients[ground] = 0.1, 0.6
    widths = Widths(1.4, 0.0, oval=(0.1, -0.15)) if kind == "disc" else Widths(1.1, 0.9, (0.1, -0.05))
    return Model(kind, free, widths, rng.normal(0, 0.2, 7), coefficients, np.array([1e-4, 2e-4, 3e-4]), 0.6)


def parameters(of: Model) -> Array:
    widths, free = of.widths, of.freedom
    tail = [widths.blur] * free.blur + [widths.line] * free.line
    tail += list(widths.lean) * free.lean + list(widths.oval) * free.oval
    return np.concatenate([of.offset, of.surface, tail])


def with_parameters(of: Model, values: Array) -> Model:
    n, m = len(of.offset), len(of.offset) + len(of.surface)
    tail = list(values[m:])
    blur = tail.pop(0)
    line = tail.pop(0) if of.freedom.line else of.widths.line
    lean = (tail[0], tail[1]) if of.freedom.lean else of.widths.lean
    oval = (tail[0], tail[1]) if of.freedom.oval else of.widths.oval
    return replace(of, offset=values[:n], surface=values[n:m], widths=Widths(blur, line, lean, oval))


@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_derivatives_of_all_parameters(kind: Kind) -> None:
    pixels = band()
    truth = model(kind)
    terms = terms_of(pixels, kind, truth.freedom, truth.widths)
    seen = see(terms, truth)
    # Whitened by a noise of 1, the derivatives themselves.
    plain = replace(truth, noise=np.array([1.0, 0.0, 0.0]))
    jacobian, _ = whitened(terms, plain, see(terms, plain))
    start, step = parameters(truth), 1e-5
    for row, place in zip(jacobian, range(len(start)), strict=True):
        ends = [start.copy(), start.copy()]
        ends[0][place] += step
        ends[1][place] -= step
        up, down = (see(terms, with_parameters(truth, end)).value for end in ends)
        # Central differences: truncation 1e-10, rounding 1e-11. Two terms are left out by design: of a plateau's own
        # slope by the boundary's place, and of that slope's share by the blur: both some slopes (0.02) over the size
        # (27) times the profile's (0.3).
        allowed = 2.5e-2 if place < len(truth.offset) or place >= len(truth.offset) + len(truth.surface) else 1e-8
        assert np.abs((up - down) / (2 * step) - row).max() < allowed * max(np.abs(row).max(), 0.1), place
    assert np.all(np.isfinite(seen.value))


@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_a_model_is_recovered_from_its_own_values(kind: Kind) -> None:
    pixels, truth = band(), model(kind)
    terms = terms_of(pixels, kind, truth.freedom, truth.widths)
    value = see(terms, truth).value
    start = replace(truth, offset=np.zeros(7), widths=Widths(2.0, 0.5 if kind == "ring" else 0.0))
    fitted = fit_model(replace(terms, values=value), start, steps=30, robust=False).model
    moved = (fitted.offset - truth.offset) @ terms.boundary
    # The weak prior on the surfaces and on a ring's split pulls by a millionth of what the pixels say.
    assert np.abs(moved).max() < 2e-3
    assert fitted.widths.mean == pytest.approx(truth.widths.mean, rel=2e-3)
    np.testing.assert_allclose(see(terms, fitted).value, value, atol=2e-4)


def test_segments_find_their_own_offset() -> None:
    pixels, truth = band(), model("disc")
    terms = terms_of(pixels, "disc", truth.freedom, truth.widths)
    own = 0.01 * np.sin(np.arange(pixels.count))
    shifted = replace(terms, u=terms.u - own[pixels.segment])
    segments = segments_of(
        pixels, replace(terms, values=see(shifted, truth).value), truth, see(terms, truth), np.ones(len(terms.u), bool)
    )
    # One step of Gauss-Newton: the next term is of relative size (offset / width)^2 = 7e-5; the plateau's own slope,
    # which the derivative leaves out, is of some thousandths of the profile's.
    np.testing.assert_allclose(segments.offset, own, atol=5e-5)
    nothing = segments_of(pixels, terms, truth, see(terms, truth), np.zeros(len(terms.u), dtype=bool))
    assert np.all(np.isinf(nothing.variance))
    assert np.all(nothing.offset == 0)


def test_variance_of_segments_is_that_of_draws() -> None:
    pixels, truth = band(), model("disc")
    terms = terms_of(pixels, "disc", truth.freedom, truth.widths)
    seen = see(terms, truth)
    variance = 1e-4 + 2e-4 * np.maximum(seen.height, 0) + 3e-4 * np.maximum(seen.height, 0) ** 2
    rng, draws = np.random.default_rng(1), 200
    keep = np.ones(len(terms.u), dtype=bool)
    ratios = []
    for _ in range(draws):
        noisy = replace(terms, values=seen.value + rng.normal(size=len(variance)) * np.sqrt(variance))
        found = segments_of(pixels, noisy, truth, see(noisy, truth), keep)
        ratios.append(found.offset**2 / found.variance)
    # 200 draws of about 170 independent segments: 1/sqrt(17,000) of a variance, 3.3 times.
    assert np.mean(ratios) == pytest.approx(1, abs=3.3 * np.sqrt(2 / (draws * pixels.count)))


def test_pruning_is_the_fit_without() -> None:
    """A group that is nought goes, and the rest follows as in a fit that never had it; one that is not stays."""
    pixels = band()
    even = replace(model("disc"), surface=np.zeros(28), widths=Widths(1.4))
    even.surface[0], even.surface[even.freedom.background_terms] = 0.1, 0.6
    terms = terms_of(pixels, "disc", even.freedom, even.widths)
    noise = np.random.default_rng(2).normal(0, 0.01, len(terms.u))
    flat = replace(even, noise=np.array([1e-4, 0.0, 0.0]))
    full = fit_model(replace(terms, values=see(terms, even).value + noise), flat, steps=8, robust=False)
    pruned = full.pruned()
    for group in even.freedom.groups:
        assert np.all(pruned.model.surface[group] == 0)
    small = replace(flat, freedom=Freedom(3, 0, 0, 0, 0, False, False, True, False, False, False))
    little = terms_of(pixels, "disc", small.freedom, small.widths)
    direct = fit_model(replace(little, values=see(terms, even).value + noise), small, steps=8, robust=False)
    # To first order in changes of some standard deviations of a well determined fit.
    np.testing.assert_allclose(pruned.model.offset, direct.model.offset, atol=3e-4)
    assert pruned.model.widths.blur == pytest.approx(direct.model.widths.blur, abs=2e-3)
    # The size pays for plateau, background and blur; nothing else is shared.
    assert 1 < pruned.shared_inflation(1.0) < full.shared_inflation(1.0)
    assert pruned.shared_inflation(1.0) == pytest.approx(direct.shared_inflation(1.0), rel=0.02)
    uneven = even.surface.copy()
    uneven[even.freedom.groups[1]] = 0.1
    bent = replace(terms, values=see(terms, replace(even, surface=uneven)).value + noise)
    kept = fit_model(bent, flat, steps=8, robust=False).pruned().model.surface[even.freedom.groups[1]]
    np.testing.assert_allclose(kept, 0.1, atol=0.05)


def test_shared_inflation_is_that_of_the_covariance() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(12, 12))
    truth = replace(model("disc"), offset=np.zeros(5), surface=np.zeros(6))
    truth = replace(truth, freedom=replace(truth.freedom, oval=False))
    information = root @ root.T
    fitted = Fitted(truth, information)
    free = np.linalg.inv(information)[:5, :5]
    ratios = np.linalg.eigvalsh(
        np.linalg.cholesky(information[:5, :5]).T @ free @ np.linalg.cholesky(information[:5, :5])
    )
    assert fitted.shared_inflation(1.0) == pytest.approx(np.sqrt((ratios.mean() + ratios.max()) / 2), rel=1e-9)
    more = 1 + 3 * (ratios - 1)
    assert fitted.shared_inflation(3.0) == pytest.approx(np.sqrt((more.mean() + more.max()) / 2), rel=1e-9)
    assert fitted.blur_sigma == pytest.approx(np.sqrt(np.linalg.inv(information)[-1, -1]), rel=1e-9)


@pytest.mark.parametrize("law", [(1e-4, 0, 0), (1e-4, 5e-4, 0), (2e-5, 0, 0.02)])
def test_the_law_of_the_noise(law: tuple[float, float, float]) -> None:
    pixels, truth = band(), model("disc")
    terms = terms_of(pixels, "disc", truth.freedom, truth.widths)
    seen = see(terms, truth)
    height = np.maximum(seen.height, 0)
    variance = law[0] + law[1] * height + law[2] * height**2
    residual = np.random.default_rng(4).normal(size=len(height)) * np.sqrt(variance)
    residual[:40] = 1.0  # one pixel in a hundred sees something else
    found = noise_law(seen, residual)
    predicted = found[0] + found[1] * height + found[2] * height**2
    # The median of 300 squares has a standard deviation of 13 %; a class of twelve may be out by three of them.
    assert np.quantile(np.abs(predicted / variance - 1), 0.9) < 0.4
    assert np.all(found >= 0)


def test_normal_equations_that_determine_little() -> None:
    design = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]])
    found = solve(design.T @ design, design.T @ np.array([3.0, 3.0]))
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(design @ found, 3.0, rtol=1e-6)
    assert found[2] == 0
    assert np.all(solve(np.zeros((2, 2)), np.zeros(2)) == 0)


@pytest.mark.parametrize("axis", [24.0, 9.0, 2.5])
def test_the_nearest_point_is_nearest(axis: float) -> None:
    outline = replace(OUTLINE, b=axis)
    points, normals, _ = outline.at(np.linspace(0, 6.2, 40))
    shift = np.linspace(-0.8 * axis**2 / outline.a, 15, 40)
    u, (cosine, sine) = outline.nearest(points + normals * shift[:, None])
    # Far outside a very flat ellipse the iteration has not quite ended.
    np.testing.assert_allclose(u, shift, atol=1e-5 if axis > 5 else 3e-3)
    near = np.abs(shift) < 1
    np.testing.assert_allclose(u[near], shift[near], atol=1e-6)
    np.testing.assert_allclose(outline.at(np.arctan2(sine, cosine))[0][near], points[near], atol=1e-3)
    for place in ([70.0, 50.0], [40.0, 90.0]):
        (distance,), _ = outline.nearest(np.array([place]))
        # Steps of 0.01 px along the boundary, whose distance is at least 5 px.
        grid = np.linalg.norm(outline.at(np.linspace(0, 2 * np.pi, 20001))[0] - place, axis=1).min()
        assert abs(distance) == pytest.approx(grid, abs=1e-4)


def test_a_band_holds_all_pixels_within_its_reach() -> None:
    for outline in (OUTLINE, replace(OUTLINE, b=4.0), replace(OUTLINE, a=40.0, b=10.0)):
        found = band(outline)
        y, x = np.mgrid[:110, :120]
        u, _ = outline.nearest(np.stack([x.ravel(), y.ravel()], axis=1).astype(float))
        # Right at the limits the iteration's last digits decide.
        assert abs(len(found.u) - int(((u >= -12) & (u <= 9)).sum())) <= 3
        assert found.segment.min() == 0
        assert found.segment.max() == found.count - 1
        some = band_round(np.zeros((110, 120), np.float32), None, None, outline, 12.0, 9.0, most=len(found.u) // 3)
        assert 0.1 < len(some.u) / len(found.u) < 0.5
        assert set(np.unique(some.segment)) <= set(np.flatnonzero(some.chosen))


@pytest.mark.parametrize("kind", ["disc", "ring"])
def test_rendered_profiles_are_those_of_the_image(kind: Kind) -> None:
    scene = Scene(semi_axes=(9.0, 6.0), kind=kind, blur=1.2, line=0.9, height=255.0, background=0.0)
    outline = Outline(60.3, 55.8, 9.0, 6.0, 0.4)
    made = rendered(kind, outline, float(np.sqrt(1.2**2 + 1 / 12)), 0.9 if kind == "ring" else 0.0, (40, 40, 80, 70))
    image = scene.clean(16)[40:70, 40:80] / 255 / (0.9 if kind == "ring" else 1.0)
    # A pixel's square is taken for a Gaussian of the same variance: its fourth cumulant, 1/120, is left out.
    assert np.abs(made - image).max() < 2e-3


def test_a_blurred_circle_looks_smaller() -> None:
    radius, blur = 20.0, 1.5
    y, x = np.mgrid[:80, :80]
    disc = rendered("disc", Outline(40, 40, radius, radius, 0.0), blur, 0.0, (0, 0, 80, 80))
    row = disc[40, 40:]
    half = np.interp(-0.5, -row, np.arange(40.0))
    shift = curved(np.array([half - radius]), np.array([1 / radius]), blur)
    # Next terms are of order blur^4 curvature^3, 6e-4; an error function, interpolated in steps of a pixel, has no
    # curvature at its half height.
    assert half + float(shift[0]) == pytest.approx(radius, abs=5e-3)
    assert float(shift[0]) == pytest.approx(blur**2 / (2 * radius), rel=0.01)
    assert x.shape == y.shape


def test_surfaces_and_their_slopes() -> None:
    rng = np.random.default_rng(6)
    places, angle = rng.normal(size=(2, 30)), rng.uniform(0, 6, 30)
    normals, step = np.stack([np.cos(angle), np.sin(angle)]), 1e-6
    for degree in (0, 1, 2):
        numeric = (surface(places + step * normals, degree) - surface(places - step * normals, degree)) / (2 * step)
        np.testing.assert_allclose(surface_slope(places, normals, degree), numeric, atol=1e-8)
    rows = waves(angle, 3)
    np.testing.assert_allclose(rows[5:7], [np.cos(3 * angle), np.sin(3 * angle)], atol=1e-14)
    # Harmonic polynomials on a circle are its waves.
    np.testing.assert_allclose(surface(normals, 2), waves(angle, 2), atol=1e-14)
