"""The plane in a robot's frame: `[mount]` in the rig file, `mount` in the record."""

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from example_rig import example_rig, points_file, pose_at, spot_of
from planeopt.batch import measure
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.plane import Plane
from planeopt.record import MountRecord, from_solution, input_error, record_from_json
from planeopt.rig import Mount, load_rig, rig_from_dict, save_rig
from planeopt.simulation import Scene, render

IDENTITY = np.eye(4).tolist()

angles = st.floats(-math.pi, math.pi)
lengths = st.floats(-2000, 2000)
vectors = st.tuples(lengths, lengths, lengths)


def rotation(a: float, b: float, c: float) -> np.ndarray:
    """About z, y and z again."""

    def about(axis: int, angle: float) -> np.ndarray:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        made = np.eye(3)
        made[i, i] = made[j, j] = math.cos(angle)
        made[i, j], made[j, i] = -math.sin(angle), math.sin(angle)
        return made

    return about(2, a) @ about(1, b) @ about(2, c)


def pose(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(*turn), shift
    return matrix


poses = st.builds(pose, st.tuples(angles, angles, angles), vectors)


@settings(max_examples=50, derandomize=True)
@given(poses, poses, vectors, vectors)
def test_carrying_a_plane_is_a_rigid_motion(first: np.ndarray, second: np.ndarray, normal: tuple, point: tuple) -> None:
    """Points of the plane stay on it, distances stay, and two mounts one after the other are their product.

    To rounding: coordinates reach 2e3 mm through two frames, so 1e-9 mm is a thousand roundings.
    """
    if np.linalg.norm(normal) < 1e-3:
        normal = (0.0, 0.0, 1.0)
    plane = Plane(np.array(normal), np.array(point))
    there = Mount(first).carry(plane)
    probes = np.random.default_rng(0).normal(0, 500, (5, 3))
    carried = probes @ first[:3, :3].T + first[:3, 3]
    np.testing.assert_allclose(there.distance_to(carried), plane.distance_to(probes), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(there.normal), 1, atol=1e-14)
    twice, at_once = Mount(second).carry(there), Mount(second @ first).carry(plane)
    np.testing.assert_allclose(twice.normal, at_once.normal, atol=1e-12)
    np.testing.assert_allclose(twice.point, at_once.point, atol=1e-9)
    back = Mount(np.linalg.inv(first)).carry(there)
    np.testing.assert_allclose(back.normal, plane.normal, atol=1e-12)
    np.testing.assert_allclose(back.point, plane.point, atol=1e-9)


@settings(max_examples=25, derandomize=True)
@given(poses, st.text(st.characters(categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=12))
def test_a_file_reads_back_equal_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, matrix: np.ndarray, name: str
) -> None:
    if not name.isprintable():
        name = "tool"
    rig = replace(example_rig(), mount=Mount(matrix, name))
    file = tmp_path_factory.mktemp("mount") / "rig.toml"
    save_rig(rig, file)
    assert load_rig(file) == rig
    assert tomllib.loads(file.read_text(encoding="utf-8"))["mount"]["frame"] == name


@settings(max_examples=20, derandomize=True)
@given(poses)
def test_a_record_holds_the_plane_in_the_mounts_frame(solution_and_rig: tuple, matrix: np.ndarray) -> None:
    """Turning everything turns the answer: the camera's plane, its coordinates changed, and nothing else."""
    solution, rig = solution_and_rig
    record = from_solution("a", solution, replace(rig, mount=Mount(matrix, "flange")))
    bare = from_solution("a", solution, rig)
    assert bare.mount is None
    assert replace_mount(record) == bare
    found = record.mount
    assert isinstance(found, MountRecord)
    assert found.frame == "flange"
    plane = solution.plane
    np.testing.assert_allclose(found.normal, matrix[:3, :3] @ plane.normal, atol=1e-12)
    assert np.dot(found.normal, found.point_mm) == pytest.approx(found.d_mm, abs=1e-9)
    # The frame's origin, in the camera's coordinates, is as far from the plane as d says.
    origin = -matrix[:3, :3].T @ matrix[:3, 3]
    assert plane.distance_to(origin) == pytest.approx(-found.d_mm, abs=1e-9)
    assert record_from_json(record.to_json()) == record


def replace_mount(record):
    return type(record)(**{name: getattr(record, name) for name in record.__struct_fields__ if name != "mount"})


@pytest.fixture(scope="module")
def solution_and_rig() -> tuple:
    rig = example_rig()
    return solve(spot_of(pose_at()), rig), rig


def test_a_record_without_a_plane_has_no_mount() -> None:
    assert input_error("a", "no").mount is None


def test_measured_and_simulated_records_have_it(tmp_path: Path) -> None:
    """The two agree to what 0.05 px of noise leaves, over ten standard deviations: 0.5 mm and 0.01 rad."""
    rig = replace(example_rig(), mount=Mount(pose((0.3, 1.1, -2.0), (100, -20, 50)), "tool"))
    measured = measure(points_file(tmp_path), rig).record
    assert measured.mount is not None
    assert measured.mount.frame == "tool"
    truth = render(Scene.of(rig, pose_at())).truth
    assert truth.mount is not None
    assert measured.mount.d_mm - truth.mount.d_mm == pytest.approx(0, abs=0.5)
    np.testing.assert_allclose(measured.mount.normal, truth.mount.normal, atol=0.01)


def test_what_is_a_rotation_to_seven_digits_is_made_one() -> None:
    rounded = np.asarray(np.round(pose((0.3, 1.1, -2.0), (10, 20, 30)), 8), dtype=np.float64)
    matrix = Mount(rounded).matrix
    np.testing.assert_allclose(matrix, rounded, atol=3e-8)
    np.testing.assert_allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-15)
    assert not matrix.flags.writeable
    assert Mount(matrix) == Mount(matrix.copy())
    assert hash(Mount(matrix)) == hash(Mount(matrix.copy()))
    assert Mount(matrix) != Mount(matrix, "tool")


def with_entry(row: int, column: int, value: float) -> list[list[float]]:
    matrix = np.eye(4)
    matrix[row, column] = value
    return matrix.tolist()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "[mount] lacks the key 'matrix'"),
        ({"matrix": IDENTITY, "unit": "m"}, "[mount] has the unknown key 'unit'"),
        ({"matrix": IDENTITY, "frame": 3}, "mount.frame must be a text"),
        ({"matrix": IDENTITY, "frame": ""}, "mount.frame must be a name"),
        ({"matrix": IDENTITY, "frame": "a\nb"}, "mount.frame must be a name"),
        ({"matrix": np.eye(3).tolist()}, "mount.matrix must be 4 x 4, not 3 x 3"),
        ({"matrix": [[1.0, 0.0], [0.0]]}, "mount.matrix must have 4 rows of 4 numbers"),
        ({"matrix": with_entry(0, 3, math.nan)}, "mount.matrix must hold finite numbers"),
        ({"matrix": with_entry(3, 0, 1.0)}, "the last row of mount.matrix must be [0, 0, 0, 1]"),
        ({"matrix": with_entry(0, 0, 2.0)}, "must be a rotation, but R'R is off the identity by 3"),
        ({"matrix": with_entry(0, 1, 1e-4)}, "must be a rotation, but R'R is off the identity by 0.0001"),
        ({"matrix": with_entry(2, 2, -1.0)}, "is a reflection"),
    ],
)
def test_what_is_no_mount_is_refused_in_one_line(tmp_path: Path, table: dict, words: str) -> None:
    file = tmp_path / "rig.toml"
    save_rig(example_rig(), file)
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    with pytest.raises(InputError) as refused:
        rig_from_dict(content | {"mount": table}, "rig.toml")
    assert words in str(refused.value)
    assert str(refused.value).startswith("rig.toml: ")
    assert "\n" not in str(refused.value)
