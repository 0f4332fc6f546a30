"""Files that commands write: whole or not at all, through links to what they lead to, and over nothing but files."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from example_rig import RIG_FILE, points_file
from planeopt.cli import main
from planeopt.cli.files import output_folder
from planeopt.errors import InputError
from planeopt.whole_files import place_of, write_text

POSE = ["--rig", str(RIG_FILE), "--formulation", "closed-form", "--force"]


@pytest.fixture
def to_a_pipe(tmp_path: Path) -> Iterator[Path]:
    """A link as that of standard output into a pipe: what it leads to can be opened and has no name."""
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("files that are open have no names here")
    ends = os.pipe()
    link = tmp_path / "stdout"
    link.symlink_to(f"/proc/self/fd/{ends[1]}")
    yield link
    for end in ends:
        os.close(end)


def test_a_pipe_is_not_replaced(to_a_pipe: Path) -> None:
    before = to_a_pipe.readlink()
    assert not to_a_pipe.resolve().exists()
    with pytest.raises(InputError, match="not a regular file"):
        write_text(to_a_pipe, "text")
    assert to_a_pipe.readlink() == before
    assert list(to_a_pipe.parent.iterdir()) == [to_a_pipe]


@pytest.mark.parametrize("command", ["pose", "export"])
def test_commands_do_not_replace_a_pipe(
    command: str, to_a_pipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = to_a_pipe.readlink()
    points = str(points_file(tmp_path))
    arguments = [points, *POSE] if command == "pose" else ["--rig", str(RIG_FILE), "--to", "ros", "--force"]
    assert main([command, *arguments, "-o", str(to_a_pipe)]) == 1
    assert f"{to_a_pipe}: is not a regular file" in capsys.readouterr().err
    assert to_a_pipe.readlink() == before
    assert {path.name for path in tmp_path.iterdir()} == {"stdout", Path(points).name}


def test_a_file_that_is_open_and_gone_has_no_place(tmp_path: Path) -> None:
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("files that are open have no names here")
    with (tmp_path / "gone").open("w") as file:
        (tmp_path / "gone").unlink()
        (tmp_path / "link").symlink_to(f"/proc/self/fd/{file.fileno()}")
        with pytest.raises(InputError, match="without a name"):
            write_text(tmp_path / "link", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


@pytest.mark.parametrize("there", [True, False], ids=["there", "to be"])
def test_a_link_stays_and_its_target_is_written(there: bool, tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    target, link, second = tmp_path / "far" / "target", tmp_path / "link", tmp_path / "second"
    link.symlink_to(Path("far") / "target")
    second.symlink_to("link")
    if there:
        target.write_text("old")
    write_text(second, "new")
    assert (second.is_symlink(), link.is_symlink(), target.is_symlink()) == (True, True, False)
    assert target.read_text() == "new"
    assert place_of(target) == target
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["far", "link", "second", "target"]


def test_records_go_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    points, target, link = str(points_file(tmp_path)), tmp_path / "far" / "poses.jsonl", tmp_path / "link"
    link.symlink_to(target)
    for _ in range(2):
        assert main(["pose", points, *POSE, "-o", str(link)]) == 0
        assert link.readlink() == target
        assert target.read_bytes().count(b"\n") == 1
        assert list(target.parent.iterdir()) == [target]


def test_records_begun_in_a_link_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, target = str(points_file(tmp_path)), tmp_path / "target"
    target.write_text("kept")
    (tmp_path / "poses.jsonl.part").symlink_to(target)
    assert main(["pose", points, *POSE, "-o", str(tmp_path / "poses.jsonl")]) == 1
    assert "poses.jsonl.part: is a link" in capsys.readouterr().err
    assert target.read_text() == "kept"


def test_a_folder_is_written_through_links(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    folder, target = tmp_path / "out", tmp_path / "target"
    folder.symlink_to("far")
    (folder / "a").symlink_to(target)
    with output_folder(folder, force=True) as staging:
        (staging / "a").write_text("A")
        (staging / "sub").mkdir()
        (staging / "sub" / "b").write_text("B")
    assert (folder.is_symlink(), (folder / "a").readlink()) == (True, target)
    assert (target.read_text(), (tmp_path / "far" / "sub" / "b").read_text()) == ("A", "B")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["far", "out", "target"]


def test_a_folder_to_be_is_made_where_a_link_leads(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.symlink_to("far")
    with output_folder(folder, force=False) as staging:
        (staging / "a").write_text("A")
    assert (tmp_path / "far" / "a").read_text() == "A"


def test_a_folder_with_a_pipe_in_it_is_left_alone(to_a_pipe: Path) -> None:
    folder = to_a_pipe.parent

    def write() -> None:
        with output_folder(folder, force=True) as staging:
            (staging / "a").write_text("A")
            (staging / "stdout").write_text("B")

    with pytest.raises(InputError, match="not a regular file"):
        write()
    assert list(folder.iterdir()) == [to_a_pipe]
