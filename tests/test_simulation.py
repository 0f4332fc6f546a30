"""The simulator's geometry and light, held against integrals computed by other means."""

import math
import time
from typing import Literal

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ndtr

from planeopt.accuracy import Truth
from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.record import record_from_json
from planeopt.rig import SpotDefinition
from planeopt.simulation import (
    BeamProfile,
    Noise,
    Optics,
    Scene,
    Surface,
    Sweep,
    boundary_distances,
    clean_light,
    frame,
    frames,
    render,
    true_record,
)
from planeopt.simulation.profiles import irradiance
from simulation_cases import in_px, outline, rho, sharp_disc, smooth_light, spot_scene

# What the samples of a pixel cannot hold (light.py) leaves 5e-5 px at most; a boundary is to be measured to 0.02 px.
EDGE_PX, MEAN_PX = 1e-4, 1e-5

SHARP = {
    "small": spot_scene(8, 30),
    "small and flat": spot_scene(9, 65, offset=(170.0, -90.0), blur=0.7),
    "small, much blur": spot_scene(8, 0, blur=2.0),
    "a sliver": spot_scene(16, 66, offset=(250.0, 138.0), blur=0.7, size=(420, 400)),
    "medium, steep": spot_scene(24, 70, blur=0.5),
    "parallel, no distortion": spot_scene(40, 45, direction=(0.0, 0.0, 1.0), distortion=(0.0, 0.0, 0.0, 0.0, 0.0)),
    "far off the axis": spot_scene(60, 60, offset=(160.0, 120.0), blur=1.5),
    "little blur": spot_scene(30, 20, blur=0.25),
    "large": spot_scene(280, 40, blur=0.7),
}


@pytest.mark.parametrize("scene", SHARP.values(), ids=SHARP.keys())
def test_a_sharp_disc_is_the_integral_over_its_area(scene: Scene):
    light, points = clean_light(scene), outline(scene)
    error = light - sharp_disc(scene)
    length = np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1).sum()
    assert np.max(np.abs(in_px(error, scene))) < EDGE_PX
    assert abs(error.sum() / length) < MEAN_PX
    # No light is lost: the chords of 4096 points cut off (tau / 4096)^2 / 6 of the area.
    x, y = points.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert light.sum() == pytest.approx(area, rel=4.5e-7, abs=MEAN_PX * length)


def test_a_disc_cut_by_the_border_is_the_middle_of_a_larger_image():
    scene = spot_scene(40, 30)
    camera = scene.rig.camera
    whole = clean_light(scene)
    left = int(outline(scene)[:, 0].mean())
    moved = camera_at(scene, camera.cx - left, camera.cy, (300, 720))
    assert np.max(np.abs(clean_light(moved) - whole[:, left : left + 300])) < 1e-9
    assert 0.4 < (true_record(moved).arc_fraction or 0) < 0.6


def camera_at(scene: Scene, cx: float, cy: float, size: tuple[int, int]) -> Scene:
    """The scene with another part of the image plane on the sensor."""
    from dataclasses import replace

    camera = replace(scene.rig.camera, cx=cx, cy=cy, image_size=size)
    return msgspec.structs.replace(scene, rig=replace(scene.rig, camera=camera))


def edge_pixels(scene: Scene) -> np.ndarray:
    return np.unique(np.rint(outline(scene, 9)), axis=0)


@pytest.mark.parametrize(
    ("beam", "irradiance"),
    [
        (BeamProfile(height=1, edge_mm=0.4), lambda _, rho, r: ndtr((1 - rho) * r / 0.4)),
        (BeamProfile(height=1, edge_mm=0.03), lambda _, rho, r: ndtr((1 - rho) * r / 0.03)),
        (
            BeamProfile(height=1, edge_mm=0.4, level=0.3),
            lambda _, rho, r: ndtr((1 - rho) * r / 0.4 - 0.5244005127080407),
        ),
        (
            BeamProfile(height=1, kind="ring", line_mm=0.15),
            lambda _, rho, r: np.exp(-0.5 * ((rho - 1) * r / 0.15) ** 2),
        ),
        (BeamProfile(height=1, kind="gaussian", level=0.2), lambda _, rho, r: 0.2 ** (rho**2)),  # noqa: ARG005 - one signature for all
        (BeamProfile(height=1, kind="gaussian", order=8), lambda _, rho, r: 0.5 ** (rho**8)),  # noqa: ARG005 - the same
        (
            BeamProfile(height=1, edge_mm=0.3, slope=(0.2, -0.1), bowl=-0.2),
            lambda xi, rho, r: ndtr((1 - rho) * r / 0.3) * (1 + xi @ [0.2, -0.1] - 0.2 * rho**2),
        ),
        (
            BeamProfile(height=1, edge_mm=0.3, fringes=0.2, fringe_mm=2.0, fringe_deg=90),
            lambda xi, rho, r: ndtr((1 - rho) * r / 0.3) * (1 + 0.2 * np.cos(math.pi * r * xi[..., 1])),
        ),
    ],
    ids=["soft disc", "hardly soft disc", "level 0.3", "ring", "gaussian", "order 8", "uneven", "fringes"],
)
def test_profiles_are_the_integral_over_their_irradiance(beam: BeamProfile, irradiance):
    scene = spot_scene(24, 50, offset=(120.0, 40.0), beam=beam, blur=0.8)
    radius = scene.rig.require_beam().radius
    pixels = edge_pixels(scene)
    expected = smooth_light(scene, lambda xi, rho: irradiance(xi, rho, radius), pixels)
    found = clean_light(scene)[tuple(pixels[:, ::-1].astype(int).T)]
    assert np.max(np.abs(found - expected)) < EDGE_PX / 2


@pytest.mark.parametrize("kind", ["disc", "ring", "gaussian"])
def test_a_dirty_beam_is_a_circle_at_its_level_and_an_ellipse_at_others(kind: Literal["disc", "ring", "gaussian"]):
    beam = BeamProfile(kind=kind, edge_mm=1.0, line_mm=1.0, level=0.4, astigmatism=0.1, astigmatism_deg=30)
    round_level = 1.0 if kind == "ring" else 0.4

    def light(rho: float, degrees: float) -> float:
        angle = math.radians(degrees)
        return float(irradiance(beam, 6.0, np.array(rho * math.cos(angle)), np.array(rho * math.sin(angle))))

    assert [light(1.0, degrees) for degrees in (0, 30, 77, 200)] == pytest.approx([round_level] * 4, abs=1e-12)
    for level in (0.2, 0.3, 0.6, 0.8):
        inner = 1.0 if kind == "ring" else 0.01
        axes = [float(brentq(lambda rho, d=d, q=level: light(rho, d) - q, inner, 3)) for d in (30, 120)]  # type: ignore[arg-type]  # without full_output it is a number
        # To first order: the level meant is that of the beam without the dirt, up to 0.05 radii away.
        assert math.log(axes[0] / axes[1]) == pytest.approx(2 * 0.1 * (level - round_level), rel=0.25)


@settings(max_examples=15, derandomize=True, deadline=None)
@given(
    radius=st.floats(8, 250), tilt=st.floats(0, 65), x=st.floats(-150, 150), y=st.floats(-150, 150), seed=st.integers(0)
)
def test_distances_from_the_boundary(radius: float, tilt: float, x: float, y: float, seed: int):
    scene = spot_scene(radius, tilt, offset=(x, y))
    points = outline(scene, 500)
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
    normal *= np.sign(np.sum(normal * (points - points.mean(axis=0)), axis=1))[:, None]
    moved = np.random.default_rng(seed % 2**32).uniform(-1, 1, 500)
    # The secant's direction is off by the square of its angle: 1e-4, which is second order in the distance.
    found = boundary_distances(scene, points + moved[:, None] * normal)
    assert np.max(np.abs(boundary_distances(scene, points))) < 1e-9
    assert np.max(np.abs(found - moved)) < 1e-6


def test_distances_are_those_of_a_dense_outline():
    scene = spot_scene(20, 65, offset=(170.0, -90.0))
    dense = outline(scene, 200_000)
    points = dense.mean(axis=0) + np.random.default_rng(1).uniform(-40, 40, (40, 2))
    nearest = np.linalg.norm(points[:, None] - dense[None, ::10], axis=2).min(axis=1)
    found = boundary_distances(scene, points)
    assert np.max(np.abs(np.abs(found) - nearest)) < 1e-4
    assert np.array_equal(found < 0, rho(scene, points)[1] < 1)


@pytest.mark.parametrize("points", [[1.0, 2.0], [[1.0, np.nan]], [[1.0, 2.0, 3.0]]])
def test_distances_of_no_points_are_refused(points: list):
    with pytest.raises(InputError, match="pairs of pixels"):
        boundary_distances(spot_scene(), points)


def test_the_truth_is_the_plane_and_survives_its_file():
    scene = spot_scene(30, 40)
    record = record_from_json(true_record(scene, "a.png").to_json())
    assert record == true_record(scene, "a.png")
    assert record.input == "a.png"
    truth = Truth(scene.pose, scene.true_plane)
    assert record.z_L_mm == truth.pose.z_L
    assert record.alpha_deg == math.degrees(truth.pose.alpha)
    assert record.beta_deg == math.degrees(truth.pose.beta or 0)
    assert record.R_mm == truth.pose.R
    assert record.normal == tuple(truth.plane.normal)
    assert record.point_mm == tuple(truth.plane.point)
    assert (record.slopes.p, record.slopes.q) == truth.pose.slopes
    assert record.intercepts_mm.c == truth.plane.intercepts[2]
    assert record.arc_fraction == 1
    assert record.sigma.z_L_mm is None
    flat = true_record(msgspec.structs.replace(scene, plane=SpotPose.from_slopes(200, 0, 0, 1)))
    assert (flat.alpha_deg, flat.beta_deg) == (0, None)


def test_a_plane_and_its_pose_are_one_scene():
    scene = spot_scene(30, 40)
    same = Scene.of(scene.rig, Plane(-3 * scene.true_plane.normal, scene.true_plane.point))
    assert same.pose.z_L == pytest.approx(scene.pose.z_L, rel=1e-14)
    assert same.pose.alpha == pytest.approx(scene.pose.alpha, rel=1e-13)
    assert np.allclose(same.true_plane.normal, scene.true_plane.normal, rtol=0, atol=1e-15)


def test_a_scene_takes_kind_and_level_from_the_rig():
    from dataclasses import replace

    scene = spot_scene()
    rig = replace(scene.rig, spot=SpotDefinition("ring", 0.3))
    assert Scene.of(rig, scene.pose).beam == BeamProfile(kind="ring", level=0.3)
    assert Scene.of(rig, scene.pose, beam=BeamProfile()).beam.kind == "disc"


UNSEEN = [
    ({"plane": SpotPose.from_slopes(-50.0, 0, 0, 1.0)}, "meets the plane behind the camera"),
    ({"plane": SpotPose.from_slopes(3.0, 3.0, 3.0, 1.0)}, "cannot see its lit side"),
    ({"plane": SpotPose.from_slopes(9.0, -3.0, -3.0, 1.0)}, "part of the spot lies behind the camera"),
    ({"plane": SpotPose.from_slopes(20.0, 0, 0, 1.0)}, "outside of the image"),
    ({"plane": SpotPose.from_slopes(240.0, 14.8, 3.6422, 1.0)}, "seen so much from the side"),
    ({"beam": BeamProfile(kind="ring", line_mm=0.001)}, "beam.line_mm: the ring's line"),
]


@pytest.mark.parametrize(("changes", "message"), UNSEEN, ids=[message for _, message in UNSEEN])
def test_what_cannot_be_seen_is_refused_in_one_line(changes: dict, message: str):
    scene = spot_scene(30, 20)
    with pytest.raises(InputError, match=message) as caught:
        render(msgspec.structs.replace(scene, **changes))
    assert "\n" not in str(caught.value)


def test_a_spot_where_the_lens_folds_over_is_refused():
    scene = spot_scene(30, 20, offset=(200.0, 0.0), distortion=(-0.6, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="folds over"):
        render(scene)


def test_a_series_draws_its_planes_and_repeats_them():
    scene = msgspec.structs.replace(
        spot_scene(), frames=40, seed=5, sweep=Sweep(z_L_mm=(200, 260), alpha_deg=(5, 60), beta_deg=(-180, 180))
    )
    series = list(frames(scene))
    assert series == [frame(scene, i) for i in range(40)]
    assert len({single.seed for single in series}) == 40
    tilts = [math.degrees(single.pose.alpha) for single in series]
    # The extremes of 40 uniform draws leave out more than 18 % at an end with a probability of 4e-4.
    assert 5 <= min(tilts) < 15
    assert 50 < max(tilts) <= 60
    assert all(200 <= single.pose.z_L <= 260 for single in series)
    same_plane = msgspec.structs.replace(scene, sweep=None)
    assert all(single.plane == scene.plane for single in frames(same_plane))
    with pytest.raises(InputError, match="sweep: none of 1000 planes"):
        frame(msgspec.structs.replace(scene, sweep=Sweep(z_L_mm=(20, 30))), 0)


def test_speed():
    # Hundreds are rendered in statistical tests. The limits are five times what a core of this decade takes.
    for scene, limit in ((spot_scene(60, 40), 0.3), (spot_scene(280, 40), 2.5)):
        noisy = msgspec.structs.replace(
            scene, noise=Noise(), surface=Surface(), optics=Optics(blur_px=1.0), beam=BeamProfile()
        )
        render(noisy)
        start = time.process_time()
        render(noisy)
        assert time.process_time() - start < limit
