"""`calibration/README.md`: its links lead somewhere, its commands are ones that there are, its session is read."""

import re
import tomllib
from pathlib import Path

import pytest

from planeopt.calibration.session import load_session
from planeopt.cli import build_app
from planeopt.example import example_folder

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
