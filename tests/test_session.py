"""session.toml: what is taken, and one clear line for all that is not."""

from pathlib import Path

import pytest

import planeopt.calibration.session as room
from planeopt.board import Board, save_board
from planeopt.errors import InputError

EXAMPLE = Path(__file__).parents[1] / "calibration" / "example" / "session"
BOARD = Board((7, 5), (10, 10), 7.5, "DICT_4X4_50", window_mm=(20, 20, 30, 10))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_board(BOARD, tmp_path / "board.toml")
    for name in ("b2.png", "a10.png", "a9.png", "dark1.png", "dark2.png", "dark3.png"):
        (tmp_path / name).touch()
    (tmp_path / "corners.csv").touch()
    (tmp_path / "spots").mkdir()
    return tmp_path


def session(folder: Path, text: str) -> room.Session:
    (folder / "session.toml").write_text(text)
    return room.load_session(folder)


def test_example_by_its_folder_and_by_its_file():
    found = room.load_session(EXAMPLE)
    assert room.load_session(EXAMPLE / "session.toml") == found
    assert [found.name_of(image) for image in found.images] == [f"view{k:02d}.png" for k in range(12)]
    assert (found.spot, found.pixel_pitch_mm, found.board.squares) == ("disc", 0.0055, (13, 9))


def test_patterns_are_sorted_names_keep_their_place_and_twins_pair_in_order(folder: Path):
    found = session(
        folder, 'board = "board.toml"\nspot = "ring"\nimages = ["b2.png", "a*.png"]\ndark_images = ["dark?.png"]'
    )
    assert [image.name for image in found.images] == ["b2.png", "a10.png", "a9.png"]
    assert [image.name for image in found.dark_images] == ["dark1.png", "dark2.png", "dark3.png"]


def test_images_in_folders_are_named_by_their_paths(folder: Path):
    (folder / "in").mkdir()
    (folder / "in" / "x.png").touch()
    found = session(folder, 'board = "board.toml"\nspot = "none"\nimages = ["in/*.png"]')
    assert found.name_of(found.images[0]) == "in/x.png"


def test_detections_need_no_images(folder: Path):
    found = session(
        folder,
        'board = "board.toml"\nspot = "disc"\ndetections = "corners.csv"\n'
        'boundaries = "spots"\nimage_size = [640, 480]',
    )
    assert found.images == ()
    assert found.image_size == (640, 480)


GOOD = 'board = "board.toml"\nspot = "disc"\nimages = ["a*.png"]\n'


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("board = ", "not valid TOML"),
        (GOOD + "colour = 1", "unknown key 'colour'"),
        (GOOD + "format = 2", "format 2 is not known"),
        ('spot = "disc"\nimages = ["a*.png"]', "lacks the key 'board'"),
        ('board = "board.toml"\nimages = ["a*.png"]', "lacks the key 'spot'"),
        ('board = "other.toml"\nspot = "disc"\nimages = ["a*.png"]', "other.toml: there is no such file"),
        (GOOD.replace("disc", "blob"), "spot must be"),
        (GOOD + "pixel_pitch_mm = 0", "pixel_pitch_mm must be a positive number"),
        (GOOD + "pixel_pitch_mm = nan", "pixel_pitch_mm must be a positive number"),
        (GOOD.replace("a*.png", "z*.png"), "'z*.png' matches no file"),
        (GOOD.replace("a*.png", "z.png"), "no file 'z.png'"),
        (GOOD.replace("a*.png", "../a*.png"), "within the session's folder"),
        (GOOD.replace('"a*.png"', '"a*.png", "a9.png"'), "a9.png is named more than once"),
        (GOOD + 'dark_images = ["dark1.png"]', "there are 1 for 2"),
        (GOOD + 'dark_images = ["a*.png"]', "among the images and the dark_images"),
        (GOOD + 'detections = "none.csv"', "no file 'none.csv'"),
        (GOOD + 'boundaries = "none"', "no folder 'none'"),
        (GOOD + "image_size = [3]", "image_size must be two whole numbers"),
        ('board = "board.toml"\nspot = "disc"', "lacks the key 'images'"),
        ('board = "board.toml"\nspot = "disc"\nimages = []', "images is empty"),
        ('board = "board.toml"\nspot = "none"\ndetections = "corners.csv"', "'image_size'"),
        (
            'board = "board.toml"\nspot = "disc"\ndetections = "corners.csv"\nimage_size = [640, 480]',
            "need the key 'boundaries'",
        ),
    ],
)
def test_what_is_wrong_is_one_line_that_names_it(folder: Path, text: str, complaint: str):
    with pytest.raises(InputError) as error:
        session(folder, text)
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)
    assert ".toml" in str(error.value)


def test_a_folder_without_a_session(tmp_path: Path):
    with pytest.raises(InputError, match=r"a folder with session\.toml"):
        room.load_session(tmp_path)


def test_a_spot_on_a_board_without_window_needs_twins(folder: Path):
    save_board(Board((7, 5), (10, 10), 7.5, "DICT_4X4_50"), folder / "board.toml")
    with pytest.raises(InputError, match="without window_mm needs dark_images"):
        session(folder, GOOD)
    assert session(folder, GOOD + 'dark_images = ["dark1.png", "dark2.png"]').spot == "disc"
