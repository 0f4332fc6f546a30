"""`scene.toml`: what it accepts, what it refuses and how; its schema and its documentation are complete."""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
import tomli_w

import planeopt.simulation
from planeopt.errors import InputError
from planeopt.example import example_folder
from planeopt.plane import Plane
from planeopt.rig import save_rig
from planeopt.simulation import (
    BeamProfile,
    Clutter,
    Noise,
    Occlusion,
    Optics,
    Scene,
    Sensor,
    Surface,
    Sweep,
    load_scene,
    save_scene,
    scene_schema,
    scene_sources,
)
from planeopt.simulation.file import PlaneTable, SceneFile
from simulation_cases import spot_scene

EXAMPLE = example_folder() / "scene.toml"
FILES = (Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
TABLES = {
    "`[plane]`": PlaneTable,
    "`[sweep]`": Sweep,
    "`[beam]`": BeamProfile,
    "`[optics]`": Optics,
    "`[surface]`": Surface,
    "`[noise]`": Noise,
    "`[sensor]`": Sensor,
    "`[[occlusion]]`": Occlusion,
    "`[clutter]`": Clutter,
}

FULL = msgspec.structs.replace(
    spot_scene(20, 30, size=(200, 150)),
    beam=BeamProfile(kind="gaussian", slope=(0.1, 0.2), level=0.135),
    noise=Noise(full_well_electrons=0, speckle=0.3),
    sensor=Sensor(bits=12, color=True),
    occlusions=(Occlusion(share=0.2), Occlusion(shape="polygon", points_px=((0, 0), (9, 0), (0, 9)))),
    clutter=Clutter(count=2, kinds=("blob",)),
    sweep=Sweep(alpha_deg=(10, 20)),
    frames=5,
    laser_off=True,
    seed=2**53,
)


def write(folder: Path, mapping: dict[str, Any]) -> Path:
    save_rig(spot_scene().rig, folder / "rig.toml")
    path = folder / "scene.toml"
    path.write_text(tomli_w.dumps(mapping), encoding="utf-8")
    return path


SMALLEST = {"rig": "rig.toml", "plane": {"z_L_mm": 240.0}}


def test_the_smallest_scene_has_the_defaults(tmp_path: Path):
    scene = load_scene(write(tmp_path, SMALLEST))
    assert scene == Scene.of(spot_scene().rig, scene.pose)
    assert (scene.pose.z_L, scene.pose.alpha, scene.pose.beta) == (240, 0, None)


def test_a_written_scene_reads_back_equal(tmp_path: Path):
    save_rig(FULL.rig, tmp_path / "rig.toml")
    by_normal = msgspec.structs.replace(FULL, plane=FULL.true_plane)
    save_scene(by_normal, tmp_path / "scene.toml", "rig.toml")
    assert load_scene(tmp_path / "scene.toml") == by_normal
    save_scene(FULL, tmp_path / "scene.toml", "rig.toml")
    read = load_scene(tmp_path / "scene.toml")
    assert msgspec.structs.replace(read, plane=FULL.plane) == FULL
    assert read.pose.alpha == pytest.approx(FULL.pose.alpha, rel=4e-16)
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_the_rig_may_stand_in_the_scene(tmp_path: Path):
    path = write(tmp_path, SMALLEST)
    inline = tmp_path / "inline.toml"
    rig = tomllib.loads((tmp_path / "rig.toml").read_text())
    inline.write_text(tomli_w.dumps(SMALLEST | {"rig": rig}))
    assert load_scene(inline) == load_scene(path)
    assert scene_sources(path) == [path, tmp_path / "rig.toml"]
    assert scene_sources(inline) == [inline]


def test_a_plane_by_normal_and_point(tmp_path: Path):
    scene = load_scene(write(tmp_path, SMALLEST | {"plane": {"normal": [0, 0.5, -1], "point_mm": [1, 2, 230]}}))
    assert scene.plane == Plane([0, 0.5, -1], [1, 2, 230])  # type: ignore[arg-type]  # any array-like will do


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"rig": "rig.toml"}, "the file lacks the key 'plane'"),
    (SMALLEST | {"format": 2}, "format 2 is not known"),
    (SMALLEST | {"beem": {}}, "the file has the unknown key 'beem'"),
    (SMALLEST | {"beam": {"colour": 1}}, "[beam] has the unknown key 'colour'"),
    (SMALLEST | {"beam": {"height": "high"}}, "beam.height must be a number, not a text"),
    (SMALLEST | {"beam": {"height": 0.0}}, "beam.height must be above 0.0"),
    (SMALLEST | {"beam": {"slope": [0.0, math.nan]}}, "beam.slope must be a finite number, not nan"),
    (SMALLEST | {"beam": {"kind": "square"}}, "beam.kind cannot be 'square'"),
    (SMALLEST | {"beam": {"slope": [1.0]}}, "beam.slope must be a list of 2, not of 1"),
    (SMALLEST | {"sensor": {"bits": 9}}, "sensor.bits cannot be 9"),
    (SMALLEST | {"sensor": {"color": 1}}, "sensor.color must be true or false, not a whole number"),
    (SMALLEST | {"optics": 3}, "optics must be a table, not a whole number"),
    (SMALLEST | {"optics": {"halo": 2}}, "optics.halo must be at most 1.0"),
    (SMALLEST | {"occlusion": [{"shape": "bar"}]}, "occlusion: a bar takes either share or size_px"),
    (SMALLEST | {"occlusion": [{"share": 1.0}]}, "occlusion[0].share must be below 1.0"),
    (SMALLEST | {"sweep": {"z_L_mm": [3, 2]}}, "sweep.z_L_mm must be [lowest, highest], not [3.0, 2.0]"),
    (SMALLEST | {"frames": 0}, "frames must be at least 1"),
    (SMALLEST | {"seed": -1}, "seed must be at least 0"),
    (SMALLEST | {"plane": {}}, "plane: give z_L_mm"),
    (SMALLEST | {"plane": {"z_L_mm": 1.0, "normal": [0, 0, 1]}}, "plane: give z_L_mm"),
    (SMALLEST | {"plane": {"normal": [0, 0, 0], "point_mm": [0, 0, 1]}}, "the normal of a plane must not be zero"),
    (SMALLEST | {"plane": {"normal": [1, 0, 0], "point_mm": [0, 0, 1]}, "rig": "flat.toml"}, "parallel to the beam"),
    (SMALLEST | {"plane": {"z_L_mm": 5.0, "alpha_deg": 90.0}}, "plane.alpha_deg must be below 90.0"),
    (SMALLEST | {"rig": "none.toml"}, "none.toml: there is no such file"),
    (SMALLEST | {"rig": {"camera": {}}}, "scene.toml: rig: [camera] lacks the key"),
    (SMALLEST | {"rig": "camera.toml"}, "this rig is a camera alone"),
    (SMALLEST | {"rig": 3}, "rig must be a text or a table, not a whole number"),
]


@pytest.mark.parametrize(("mapping", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_bad_scenes_are_refused_in_one_line_with_file_and_key(mapping: dict[str, Any], message: str, tmp_path: Path):
    path = write(tmp_path, mapping)
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "camera.toml").write_text(text.split("[laser]")[0])
    straight = spot_scene(direction=(0.0, 0.0, 1.0)).rig
    save_rig(straight, tmp_path / "flat.toml")
    with pytest.raises(InputError) as caught:
        _ = load_scene(path).pose
    said = str(caught.value)
    assert message in said
    assert "\n" not in said
    assert "`" not in said
    assert said.startswith(str(tmp_path))


def test_unreadable_scenes_are_refused(tmp_path: Path):
    for content, message in ((b"a = [", "not valid TOML"), (b"\xff\xfe", "not a text file in UTF-8")):
        (tmp_path / "scene.toml").write_bytes(content)
        with pytest.raises(InputError, match=message):
            load_scene(tmp_path / "scene.toml")
    with pytest.raises(InputError, match="this is a folder"):
        load_scene(tmp_path)
    with pytest.raises(InputError, match="there is no such file"):
        load_scene(tmp_path / "nothing.toml")
    with pytest.raises(InputError, match="cannot be written"):
        save_scene(FULL, tmp_path / "nothing" / "scene.toml", "rig.toml")


def test_the_example_is_a_scene():
    scene = load_scene(EXAMPLE)
    assert scene.frames == 3
    assert scene.rig.camera.image_size == (960, 720)


def test_the_shipped_schema_is_the_one_of_the_classes():
    shipped = Path(planeopt.simulation.__file__).with_name("scene.schema.json")
    assert json.loads(shipped.read_text(encoding="utf-8")) == json.loads(json.dumps(scene_schema()))


def test_every_key_of_the_schema_says_what_it_means():
    definitions = scene_schema()["$defs"]
    assert set(definitions) == {"SceneFile", *(table.__name__ for table in TABLES.values())}
    for name, definition in definitions.items():
        assert definition["additionalProperties"] is False
        for key, value in definition["properties"].items():
            assert "$ref" in value or len(value.get("description", "")) > 8, (name, key)


def default_of(field: msgspec.structs.FieldInfo) -> Any:
    return None if field.default is msgspec.NODEFAULT else field.default


def rows(heading: str) -> list[list[str]]:
    section = re.split(r"^#+ ", FILES.split(f" {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:3] == "| `"]


@pytest.mark.parametrize(("heading", "table"), TABLES.items(), ids=[table.__name__ for table in TABLES.values()])
def test_every_key_is_documented_with_its_unit_and_default(heading: str, table: type):
    listed = rows(heading)
    fields = msgspec.structs.fields(table)
    assert [row[0].strip("`") for row in listed] == [field.name for field in fields]
    for row, field in zip(listed, fields, strict=True):
        default = default_of(field)
        if isinstance(default, bool | int | float | str | tuple):
            assert json.loads(row[2]) == json.loads(json.dumps(default)), field.name
        suffix = {"mm": "mm", "deg": "deg", "px": "px", "electrons": "electrons", "radii": "radii"}
        assert row[1] == suffix.get(field.name.rsplit("_", 1)[-1], row[1]), field.name


def test_every_table_is_documented():
    listed = [key for row in rows("The scene: `scene.toml`") for key in re.findall(r"`(\w+)`", row[0])]
    assert set(listed) == {field.name for field in msgspec.structs.fields(SceneFile)}
