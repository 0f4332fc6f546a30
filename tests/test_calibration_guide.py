"""`calibration/README.md`: its links lead somewhere, its commands are ones that there are, its session is read."""

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from planeopt.board import Wishes, design
from planeopt.calibration import calibrate, load_session
from planeopt.cli import build_app
from planeopt.example import example_folder
from planeopt.rig import load_rig
from planeopt.simulation import BoardPoses, aimed, simulated_session, tilted

FOLDER = Path(__file__).parents[1] / "calibration"
GUIDE = (FOLDER / "README.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^(?:\$|   ) (planeopt .*?)(?:\s+#.*)?$", GUIDE, re.MULTILINE)


def test_links_lead_somewhere():
    targets = re.findall(r"\]\(([^)]+)\)", GUIDE)
    assert {"boards", "charuco.py", "example"} <= set(targets)
    assert [target for target in targets if not (FOLDER / target).exists()] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_understood(command: str):
    function, bound, *_ = build_app().parse_args(command.split()[1:], exit_on_error=False, print_error=False)
    assert function.__name__ == command.split()[1]
    assert bound.arguments


def test_the_commands_of_a_calibration_are_all_there():
    assert {command.split()[1] for command in COMMANDS} == {"board", "calibrate", "check", "recalibrate"}


def test_the_session_that_is_shown_is_read(tmp_path: Path):
    text = next(text for text in re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL))
    (tmp_path / "session.toml").write_text(text)
    (tmp_path / "board.toml").write_bytes((example_folder() / "session" / "board.toml").read_bytes())
    for kind in ("view", "dark"):
        for number in range(2):
            (tmp_path / f"{kind}{number}.png").touch()
    session = load_session(tmp_path)
    assert (session.spot, len(session.images), session.dark_images) == ("disc", 2, ())
    (tmp_path / "session.toml").write_text(text.replace("# dark_images", "dark_images"))
    assert len(load_session(tmp_path).dark_images) == 2
    assert set(tomllib.loads(text)) == {"board", "images", "spot", "pixel_pitch_mm"}


def test_the_board_and_the_plan_of_the_guide_meet_every_condition():
    # Three distances, at each 35 deg up, down, left and right, turned on by 45 deg each time: without any more views.
    assert "(0.8, 1 and 1.25 times the working distance) tilt the board by 35 deg up, down" in " ".join(GUIDE.split())
    rig, middle = load_rig(example_folder() / "truth_rig.toml"), 236.0
    size = rig.camera.image_size
    view = (size[0] * middle / rig.camera.fx, size[1] * middle / rig.camera.fy)
    board, _ = design(Wishes(view_mm=view, spot_mm=2 * rig.require_beam().radius))
    assert board.window_mm is not None
    x, y, width, height = board.window_mm
    rotations = [tilted(math.radians(35), i % 4 * math.pi / 2, math.radians(45 * i)) for i in range(12)]
    depths = np.repeat([0.8 * middle, middle, 1.25 * middle], 4)
    at = np.array([x + width / 2, y + height / 2])
    places = [aimed(rig, rotation, depth, at) for rotation, depth in zip(rotations, depths, strict=True)]
    poses = BoardPoses(np.array(rotations), np.array(places))
    found = calibrate(simulated_session(rig, board, poses, corner_sigma=0.1, spot_sigma=0.1, seed=1))
    assert [gate.sentence for gate in found.gates if gate.state != "ok"] == []
    assert found.verdict == "ok"
    assert found.adjustment is not None
    # "f known to 0.1 % or better, the radius to some micrometres."
    assert found.adjustment.sigma("f") < 1e-3 * found.adjustment.value("f")
    assert found.adjustment.sigma("radius") < 3e-3
