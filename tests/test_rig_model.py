"""The rig: the rotation along the beam, the paper's equations in the turned frame, and planes there and back."""

import json
import math
from dataclasses import replace
from pathlib import Path

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planeopt.errors import InputError
from planeopt.plane import Plane, SpotPose
from planeopt.rig import PARAMETERS, Beam, Camera, Rig, RigCovariance, SpotDefinition, load_rig, rotation_to_axis

QUICK = settings(max_examples=40, derandomize=True, deadline=None)
EPS = float(np.finfo(float).eps)
EXAMPLE = Path(__file__).parents[1] / "calibration" / "example"

CAMERA = Camera((960, 720), 2181.8, 2190.3, 481.2, 357.6, (-0.163, 0.104, 0.0003, 0.0004, 0.0), 0.0055)
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
PAPERS = Rig(Camera((4000, 4000), 5000, 5000, 1000, 1000, NO_DISTORTION, 0.005), Beam(10, (30, 40)))

directions = st.builds(
    lambda tilt, turn: (math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt)),
    st.floats(0, math.radians(8)),
    st.floats(-math.pi, math.pi),
)
beams = st.builds(Beam, st.floats(0.5, 20), st.tuples(st.floats(-40, 40), st.floats(-40, 40)), directions)
rigs = st.builds(
    lambda beam, pitch: Rig(replace(CAMERA, pixel_pitch_mm=pitch), beam), beams, st.sampled_from([None, 0.0055])
)
tilts = st.floats(1e-3, math.radians(80))
turns = st.one_of(st.floats(-math.pi, math.pi, exclude_min=True), st.just(math.pi), st.just(0.0))


def grid(camera: Camera, n: int = 9) -> np.ndarray:
    width, height = camera.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, n), np.linspace(0, height - 1, n))
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def spot_on_plane(beam: Beam, plane: Plane, n: int = 40) -> np.ndarray:
    """Return where n of the cylinder's lines (which have no order that matters) meet the plane, camera frame (n, 3)."""
    d = np.array(beam.direction)
    across = np.linalg.svd(d[None])[2][1:]
    theta = np.linspace(0, 2 * math.pi, n, endpoint=False)
    start = np.array([*beam.offset, 0]) + beam.radius * np.stack([np.cos(theta), np.sin(theta)], axis=-1) @ across
    return start - (plane.distance_to(start) / (plane.normal @ d))[:, None] * d


def paper_conic(f: float, e: tuple[float, float], r: float, pose: SpotPose, z: float) -> np.ndarray:
    """Return the image conic (3, 3) by equations (5) and (6): cos^2 + sin^2 = 1 with the coefficients a1 to a9."""
    beta = pose.beta or 0.0
    ca, sa, cb, sb = math.cos(pose.alpha), math.sin(pose.alpha), math.cos(beta), math.sin(beta)
    cosine = np.array([z * cb * ca - e[1] * sa, z * sb * ca + e[0] * sa, -f * (e[0] * cb + e[1] * sb) * ca]) / r
    sine = np.array([-z * sb, z * cb, f * (e[0] * sb - e[1] * cb)]) / pose.R
    depth = np.array([sb * sa, -cb * sa, f * ca])
    return np.outer(cosine, cosine) + np.outer(sine, sine) - np.outer(depth, depth)


@given(directions)
@QUICK
def test_the_rotation_is_the_smallest_that_takes_the_beam_to_z(direction: tuple[float, float, float]) -> None:
    Q = np.array(rotation_to_axis(*Beam(1, (0, 0), direction).direction))
    np.testing.assert_allclose(Q @ direction, [0, 0, 1], rtol=0, atol=4 * EPS)
    # Another route to it: the turn from z to the direction, by axis and angle, the other way round.
    np.testing.assert_allclose(Q, Plane(np.array(direction), np.zeros(3)).matrix[:3, :3].T, rtol=0, atol=8 * EPS)


def test_the_rotation_serves_casadi_as_well() -> None:
    d = casadi.SX.sym("d", 3)
    rows = rotation_to_axis(d[0], d[1], d[2])
    function = casadi.Function("Q", [d], [casadi.vertcat(*(casadi.horzcat(*row) for row in rows))])
    direction = Beam(1, (0, 0), (0.03, -0.05, math.sqrt(1 - 0.0034))).direction
    numeric = np.array(rotation_to_axis(*direction))
    np.testing.assert_allclose(function(list(direction)).full(), numeric, rtol=0, atol=4 * EPS)


def test_a_parallel_beam_changes_nothing() -> None:
    np.testing.assert_array_equal(PAPERS.Q, np.eye(3))
    assert PAPERS.laser_offset == (30, 40)
    assert PAPERS.axial_shift == 0
    assert PAPERS.focal_length == 25


def test_without_a_pixel_pitch_the_laser_plane_is_the_normalised_one() -> None:
    rig = Rig(replace(CAMERA, pixel_pitch_mm=None), Beam(6, (20, 15)))
    assert rig.focal_length == 1
    points, jacobian = rig.to_laser_plane(grid(CAMERA))
    normalised, inner = CAMERA.normalise(grid(CAMERA))
    np.testing.assert_array_equal(points, normalised)
    np.testing.assert_array_equal(jacobian, inner)


def test_the_papers_example() -> None:
    """(R, z_L, alpha, beta) = (20, 75, 60 deg, 30 deg): the paper's image ellipse, to its printed digits."""
    plane = PAPERS.plane_from_pose(SpotPose(20, 75, math.radians(60), math.radians(30)))
    np.testing.assert_allclose(plane.point, [30, 40, 75], rtol=0, atol=1e-13)
    spot = spot_on_plane(PAPERS.require_beam(), plane)
    image, _ = PAPERS.to_laser_plane(PAPERS.camera.project(spot[:, :2] / spot[:, 2:]))
    x, y = image.T
    conic = np.linalg.lstsq(np.stack([x * y, y * y, x, y, np.ones_like(x)], axis=-1), -x * x)[0]
    np.testing.assert_allclose(conic, [-3.989885, 8.886751, 31.445856, -194.045574, 1111.111111], rtol=0, atol=5e-7)
    found = PAPERS.pose_from_plane(plane)
    assert found.beta is not None
    assert (found.R, found.z_L, found.alpha, found.beta) == pytest.approx(
        (20, 75, math.radians(60), math.radians(30)), rel=1e-14
    )


@given(rigs, st.floats(150, 600), st.floats(0, math.radians(60)), turns)
@QUICK
def test_the_papers_equations_hold_in_the_turned_frame(rig: Rig, z_L: float, alpha: float, beta: float) -> None:
    beam = rig.require_beam()
    pose = SpotPose(beam.radius / math.cos(alpha), z_L, alpha, beta)
    spot = spot_on_plane(beam, rig.plane_from_pose(pose))
    normalised = spot[:, :2] / spot[:, 2:]
    image, _ = rig.to_laser_plane(rig.camera.project(normalised))
    conic = paper_conic(rig.focal_length, rig.laser_offset, beam.radius, pose, z_L + rig.axial_shift)
    points = np.column_stack([image, np.ones(len(image))])
    value = np.einsum("ni,ij,nj->n", points, conic, points)
    # First-order distance to the ellipse. The conic is what is left of squares of coordinates up to (|e| + r) / r = 115
    # times the radius: 115^2 roundings, times 3.
    distance = np.abs(value) / (2 * np.linalg.norm((points @ conic)[:, :2], axis=1))
    assert distance.max() <= 3 * 115**2 * EPS * rig.focal_length


@given(rigs)
@QUICK
def test_laser_plane_there_and_back(rig: Rig) -> None:
    pixels = grid(rig.camera)
    points, _ = rig.to_laser_plane(pixels)
    # A few roundings of the ray, times the focal length in pixels.
    np.testing.assert_allclose(rig.from_laser_plane(points), pixels, rtol=0, atol=16 * EPS * rig.camera.fy)


@given(rigs)
@QUICK
def test_laser_plane_jacobian_against_central_differences(rig: Rig) -> None:
    pixels = grid(rig.camera)
    _, jacobian = rig.to_laser_plane(pixels)
    step = 1 / 8
    for axis in range(2):
        shifts = [np.eye(2)[axis] * step * k for k in (1, 2)]
        one, two = (
            (rig.to_laser_plane(pixels + s)[0] - rig.to_laser_plane(pixels - s)[0]) / (2 * s.sum()) for s in shifts
        )
        # As in the camera's test: three times the truncation, and 16 roundings of points of up to half a focal length.
        allowed = np.abs(two - one).max() + 8 * EPS * rig.focal_length / step
        np.testing.assert_allclose(one, jacobian[:, :, axis], rtol=0, atol=allowed)


@given(rigs, st.floats(-500, 1000), tilts, turns)
@QUICK
def test_pose_there_and_back(rig: Rig, z_L: float, alpha: float, beta: float) -> None:
    beam = rig.require_beam()
    pose = SpotPose(beam.radius / math.cos(alpha), z_L, alpha, beta)
    plane = rig.plane_from_pose(pose)
    d, e = np.array(beam.direction), np.array([*beam.offset, 0])
    assert float(plane.normal @ d) == pytest.approx(math.cos(alpha), abs=8 * EPS)
    np.testing.assert_allclose(plane.point, e + z_L * d, rtol=0, atol=8 * EPS * 1000)
    # The same plane by another point and the opposite normal.
    sideways = np.cross(plane.normal, [0.3, 0.4, 0.5]) * 100
    for other in (plane, Plane(-plane.normal, plane.point + sideways)):
        back = rig.pose_from_plane(other)
        assert back.beta is not None
        # Lengths of up to 1000 mm over the cosine; angles lose the cosine (alpha, R) and the sine (beta).
        assert back.z_L == pytest.approx(z_L, abs=64 * EPS * 1000 / math.cos(alpha))
        assert back.alpha == pytest.approx(alpha, abs=32 * EPS)
        assert abs(back.R / pose.R - 1) <= 64 * EPS / math.cos(alpha)
        assert math.remainder(back.beta - beta, math.tau) == pytest.approx(0, abs=32 * EPS / math.sin(alpha))


@given(rigs, st.floats(100, 1000))
@QUICK
def test_without_tilt_the_normal_is_the_beam(rig: Rig, z_L: float) -> None:
    beam = rig.require_beam()
    plane = rig.plane_from_pose(SpotPose(beam.radius, z_L, 0, None))
    np.testing.assert_allclose(plane.normal, beam.direction, rtol=0, atol=8 * EPS)
    back = rig.pose_from_plane(plane)
    assert (back.alpha, back.beta) == (0, None)
    np.testing.assert_allclose(back.R, beam.radius, rtol=8 * EPS)


@given(rigs, st.integers(0, 1000))
@QUICK
def test_many_planes_at_once(rig: Rig, seed: int) -> None:
    rng = np.random.default_rng(seed)
    z_L = rng.uniform(100, 500, size=(3, 4))
    p, q = rng.uniform(-2, 2, size=(2, 3, 4))
    normals, points = rig.plane_arrays(z_L, p, q)
    assert normals.shape == points.shape == (3, 4, 3)
    for value, there in zip(rig.slope_arrays(normals, points), (z_L, p, q), strict=True):
        np.testing.assert_allclose(value, there, rtol=0, atol=64 * EPS * (1 + np.abs(there).max()))
    pose = SpotPose.from_slopes(z_L[1, 2], p[1, 2], q[1, 2], rig.require_beam().radius)
    single = rig.plane_from_pose(pose)
    np.testing.assert_allclose(normals[1, 2], single.normal, rtol=0, atol=16 * EPS)
    np.testing.assert_allclose(points[1, 2], single.point, rtol=0, atol=16 * EPS * 500)


@pytest.mark.parametrize("number", range(6))
def test_the_example_targets_agree_with_their_own_truth(number: int) -> None:
    truth = json.loads((EXAMPLE / "targets" / f"target{number:02d}.json").read_text(encoding="utf-8"))
    rig = load_rig(EXAMPLE / "truth_rig.toml")
    alpha, beta = math.radians(truth["alpha_deg"]), math.radians(truth["beta_deg"])
    plane = rig.plane_from_pose(SpotPose(truth["R_mm"], truth["z_L_mm"], alpha, beta))
    np.testing.assert_allclose(plane.normal, truth["normal"], rtol=0, atol=1e-14)
    np.testing.assert_allclose(plane.point, truth["point_mm"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rig.pose_from_plane(plane).R, truth["R_mm"], rtol=1e-14)


def test_a_plane_parallel_to_the_beam_is_refused() -> None:
    with pytest.raises(InputError, match="parallel to the beam"):
        PAPERS.pose_from_plane(Plane(np.array([1.0, 0.0, 0.0]), np.zeros(3)))


def test_a_camera_alone_says_so() -> None:
    rig = Rig(CAMERA)
    plane = Plane(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 100.0]))
    for ask in (
        rig.require_beam,
        lambda: rig.Q,
        lambda: rig.laser_offset,
        lambda: rig.to_laser_plane([[1, 1]]),
        lambda: rig.pose_from_plane(plane),
        lambda: rig.plane_from_pose(SpotPose(1, 1, 0, None)),
        lambda: rig.parameter("radius"),
        lambda: rig.with_parameters({"e_x": 1.0}),
    ):
        with pytest.raises(InputError, match="camera alone"):
            ask()
    assert rig.with_parameters({"k2": 0.2}).camera.distortion[1] == 0.2


def test_rays_that_do_not_point_forward_are_refused_by_row() -> None:
    tilt = math.radians(50)
    rig = Rig(
        Camera((640, 480), 100, 100, 320, 240, NO_DISTORTION), Beam(5, (0, 0), (math.sin(tilt), 0, math.cos(tilt)))
    )
    with pytest.raises(InputError, match=r"ray of point 1 \(counted from 0\) does not point forward along the beam"):
        rig.to_laser_plane([[320, 240], [0, 240]])
    with pytest.raises(InputError, match=r"ray of point 1 \(counted from 0\) does not point forward in the camera"):
        rig.from_laser_plane([[0, 0], [2, 0]])


def test_a_point_beyond_the_fold_has_no_pixel() -> None:
    rig = Rig(Camera((640, 480), 500, 500, 320, 240, (-0.3, 0, 0, 0, 0)), Beam(5, (0, 0)))
    with pytest.raises(InputError, match=r"point 1 \(counted from 0\).*folds over"):
        rig.from_laser_plane([[1.0, 0.0], [1.1, 0.0]])


def covariance(*names: str) -> RigCovariance:
    return RigCovariance(names, np.diag(np.arange(1.0, 1 + len(names))))


def test_every_parameter_can_be_read_and_changed() -> None:
    square = replace(CAMERA, fy=CAMERA.fx)
    rig = Rig(
        square, Beam(6, (21, 15), (0.003, -0.004, math.sqrt(1 - 25e-6))), SpotDefinition("ring"), covariance("f", "e_x")
    )
    assert rig.with_parameters({name: rig.parameter(name) for name in PARAMETERS if name not in ("fx", "fy")}) == rig
    assert rig.with_parameters({}) == rig
    free = replace(rig, covariance=None)
    for name in PARAMETERS:
        changed = free.with_parameters({name: free.parameter(name) + 1e-3})
        assert changed.parameter(name) == free.parameter(name) + 1e-3
        coupled = {"f": {"f", "fx", "fy"}, "fx": {"f", "fx"}, "fy": {"f", "fy"}}.get(name, {name})
        for other in set(PARAMETERS) - coupled - ({"f"} if name in ("fx", "fy") else set()):
            assert changed.parameter(other) == free.parameter(other), (name, other)
        direction = changed.require_beam().direction
        assert math.hypot(*direction) == pytest.approx(1, abs=4 * EPS)
    both = rig.with_parameters({"f": 2000.0})
    assert (both.camera.fx, both.camera.fy) == (2000, 2000)
    assert both.covariance == rig.covariance
    assert both.spot == rig.spot


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"focal": 1.0}, "'focal' is not a parameter of a rig; known are f, fx"),
        ({"f": 1.0, "fx": 1.0}, "either 'f' or 'fx' and 'fy'"),
        ({"direction_x": 0.8, "direction_y": 0.7}, "leave no forward direction"),
        ({"radius": -1.0}, "laser.radius_mm must be positive"),
        ({"fx": 0.0}, "camera.fx must be positive"),
    ],
)
def test_impossible_parameters_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        PAPERS.with_parameters(values)


def test_parameters_that_are_not_there_are_refused() -> None:
    with pytest.raises(InputError, match="'z' is not a parameter"):
        PAPERS.parameter("z")
    with pytest.raises(InputError, match="no single 'f'"):
        Rig(CAMERA).parameter("f")
    with pytest.raises(InputError, match="'f' needs"):
        Rig(CAMERA, covariance=covariance("f"))
    with pytest.raises(InputError, match=r"'e_y' is a parameter of the beam, but there is no \[laser\]"):
        Rig(CAMERA, covariance=covariance("cx", "e_y"))


def test_covariance_gives_sigmas_and_correlation() -> None:
    joint = RigCovariance(("cx", "e_x"), np.array([[4.0, -0.6], [-0.6 - 1e-8, 0.1]]))
    np.testing.assert_array_equal(joint.matrix, joint.matrix.T)
    np.testing.assert_allclose(joint.sigmas, [2, math.sqrt(0.1)], rtol=4 * EPS)
    np.testing.assert_allclose(joint.correlation[0, 1], joint.matrix[0, 1] / joint.sigmas.prod(), rtol=4 * EPS)
    assert hash(joint) == hash(RigCovariance(joint.parameters, joint.matrix))
    assert joint != "covariance"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"radius": 0.0}, r"laser.radius_mm must be positive \(mm\), not 0.0"),
        ({"offset": (1.0, math.nan)}, "laser.offset_mm must be a finite number"),
        ({"offset": (1.0,)}, r"laser.offset_mm must be two numbers \[e_x, e_y\], not 1"),
        ({"direction": (0.0, 1.0)}, r"laser.direction must be three numbers \[l_x, l_y, l_z\], not 2"),
        ({"direction": (0.0, 0.0, math.inf)}, "laser.direction must be a finite number"),
        ({"direction": (0.0, 0.1, 1.0)}, "must be a unit vector, but its length is 1.00498756"),
        ({"direction": (0.0, 0.0, 0.0)}, "must be a unit vector, but its length is 0"),
        ({"direction": (0.0, 0.0, -1.0)}, r"must point forward, away from the camera \(l_z > 0\), but l_z is -1"),
        ({"direction": (0.0, 1.0, 0.0)}, "must point forward"),
        ({"direction": (0.0, 0.96, 0.28)}, "is 73.74 degrees off the optical axis; at most 60 are accepted"),
    ],
)
def test_impossible_beams_are_refused(values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Beam(**({"radius": 6.0, "offset": (20.0, 15.0)} | values))


def test_a_direction_written_to_a_few_digits_becomes_unit() -> None:
    direction = Beam(6, (20, 15), (0.0035, -0.005, 0.999981)).direction
    assert math.hypot(*direction) == pytest.approx(1, abs=2 * EPS)
    assert Beam(6, (20, 15), direction).direction == direction


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "square"}, "spot.kind must be one of disc, ring, not 'square'"),
        ({"level": 1.0}, "spot.level must be a fraction between 0 and 1, not 1.0"),
        ({"level": math.nan}, "spot.level must be a finite number"),
        ({"channel": "infrared"}, "spot.channel must be one of gray, red, green, blue, not 'infrared'"),
        ({"gamma": 0.0}, "spot.gamma must be positive"),
    ],
)
def test_impossible_spot_definitions_are_refused(values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SpotDefinition(**values)
