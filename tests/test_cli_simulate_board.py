"""`planeopt simulate` of a session of board views, and what a calibration reads of it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planeopt.board import load_board
from planeopt.calibration.session import load_session
from planeopt.cli import main
from planeopt.rig import load_rig
from planeopt.simulation import BoardView, load_board_session

RIG = """
[camera]
image_size = [480, 360]
fx = 700.0
fy = 700.0
cx = 241.0
cy = 178.0
distortion = [-0.1, 0.02, 0.0003, -0.0002, 0.0]
pixel_pitch_mm = 0.0055
[laser]
radius_mm = 6.0
offset_mm = [18.0, -9.0]
direction = [0.003, -0.002, 0.9999934999788749]
"""
SCENE = """
rig = "rig.toml"
laser_off = true
seed = 5
warp_mm = [0.2, 0.1]
[board]
squares = [11, 9]
square_mm = 10.0
marker_mm = 7.5
dictionary = "DICT_4X4_100"
window_mm = [30.0, 30.0, 50.0, 30.0]
[shooting]
views = 2
depths_mm = [180.0, 260.0]
tilt_deg = [10.0, 30.0]
[optics]
blur_px = 0.8
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def test_a_session_with_its_truth(scene: Path, tmp_path: Path):
    out = tmp_path / "session"
    assert main(["simulate", str(scene), "-o", str(out)]) == 0
    images = [f"{kind}_{number}.png" for kind in ("dark", "view") for number in ("01", "02")]
    others = ["board.toml", "session.toml", "truth_board_poses.json", "truth_rig.toml"]
    assert sorted(path.name for path in out.iterdir()) == sorted([*images, *others])
    session = load_session(out)
    assert session.spot == "disc"
    assert session.pixel_pitch_mm == 0.0055
    assert [path.name for path in session.dark_images] == images[:2]
    given = load_board_session(scene)
    assert session.board == given.scene.board == load_board(out / "board.toml")
    assert load_rig(out / "truth_rig.toml") == given.scene.rig
    truth = json.loads((out / "truth_board_poses.json").read_text())
    assert truth["warp_mm"] == [0.2, 0.1]
    poses = given.poses()
    for index, name in enumerate(("view_01", "view_02")):
        R = Rotation.from_rotvec(truth["views"][name]["rvec"]).as_matrix()
        assert np.max(np.abs(R - poses.rotations[index])) < 1e-12
        t = np.array(truth["views"][name]["tvec"])
        view = BoardView(given.scene.rig, session.board, R, t, given.scene.warp)
        assert view.spot_state() == "seen"
        lit, dark = (cv2.imread(str(out / f"{kind}{name[4:]}.png"), cv2.IMREAD_GRAYSCALE) for kind in ("view", "dark"))
        assert lit is not None
        assert dark is not None
        # The laser's light is where the truth says: its centre of mass is the outline's, to the perspective's shift.
        light = np.clip(lit.astype(float) - dark - 20, 0, None)
        y, x = np.mgrid[: light.shape[0], : light.shape[1]]
        centre = np.array([np.sum(light * x), np.sum(light * y)]) / light.sum()
        outline = view.outline(np.linspace(0, 2 * np.pi, 400, endpoint=False))[0]
        hull = cv2.moments(outline.astype(np.float32))
        assert centre == pytest.approx([hull["m10"] / hull["m00"], hull["m01"] / hull["m00"]], abs=0.1)


def test_seed_and_views(scene: Path, tmp_path: Path):
    for folder, seed in (("a", "7"), ("b", "7"), ("c", "8")):
        assert main(["simulate", str(scene), "-o", str(tmp_path / folder), "--seed", seed, "--frames", "1"]) == 0
    first, same, other = ((tmp_path / folder / "view_01.png").read_bytes() for folder in "abc")
    assert first == same
    assert first != other
    assert not (tmp_path / "a" / "view_02.png").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("views = 2", "views = 0", "views"),
        ("depths_mm = [180.0, 260.0]", "depths_mm = [260.0, 180.0]", "shooting.depths_mm must be [lowest, highest]"),
        ("depths_mm = [180.0, 260.0]", "depths_mm = [18.0, 19.0]", "no pose at"),
        ("seed = 5", "sed = 5", "sed"),
        ("square_mm = 10.0", "square_mm = -10.0", "square_mm"),
        ('rig = "rig.toml"', 'rig = "none.toml"', "none.toml"),
        ("laser_off", "plane = {z_L_mm = 3.0}\nlaser_off", "plane"),
    ],
)
def test_what_is_wrong_is_named(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: str
):
    scene.write_text(scene.read_text().replace(old, new))
    message = refused(["simulate", str(scene), "-o", str(tmp_path / "out")], capsys)
    assert "scene.toml" in message or "none.toml" in message
    assert words in message
    assert not (tmp_path / "out").exists()


def test_a_camera_alone_has_no_session(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG[: RIG.index("[laser]")])
    assert "laser" in refused(["simulate", str(scene), "-o", str(tmp_path / "out")], capsys)


def test_what_is_read_is_not_written_over(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "rig.toml").rename(tmp_path / "truth_rig.toml")
    scene.write_text(SCENE.replace("rig.toml", "truth_rig.toml"))
    message = refused(["simulate", str(scene), "-o", str(tmp_path), "--force"], capsys)
    assert "would be written over" in message
