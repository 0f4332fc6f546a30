"""`planeopt board`, end to end: what is written where, what is left alone, measurements into `board.toml`."""

from pathlib import Path

import pytest
from PIL import Image

from planeopt.board import Board, load_board
from planeopt.cli import main


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


def test_a_board_as_pdf_and_png_with_its_specification(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "deep"
    assert main(["board", "-o", str(out / "b.pdf"), "-o", str(out / "b.png")]) == 0
    said = capsys.readouterr().out
    assert "13 x 9 squares of 19 mm" in said
    assert "A4, lying; print at 100 %" in said
    assert names(out) == ["b.pdf", "b.png", "board.toml"]
    assert (out / "b.pdf").read_bytes().startswith(b"%PDF")
    with Image.open(out / "b.png") as picture:
        assert (picture.format, picture.mode) == ("PNG", "1")
    assert load_board(out / "board.toml").square_mm == (19.0, 19.0)
    assert "# As drawn." in (out / "board.toml").read_text()


def test_every_flag_of_the_specification(tmp_path: Path):
    flags = "--squares 8 6 --square-mm 20 20.5 --marker-mm 12 --dictionary DICT_6X6_250 --legacy --first-id 9"
    window = "--window-mm 40 41 80 41 --margin-mm 5 --paper 230x180"
    assert main(["board", "-o", str(tmp_path / "b.pdf"), *flags.split(), *window.split()]) == 0
    window_mm = (40.0, 41.0, 80.0, 41.0)
    assert load_board(tmp_path / "board.toml") == Board(
        (8, 6), (20.0, 20.5), 12.0, "DICT_6X6_250", legacy=True, first_id=9, window_mm=window_mm
    )
    assert main(["board", "-o", str(tmp_path / "n.toml"), "--no-window"]) == 0
    assert load_board(tmp_path / "n.toml").window_mm is None


def test_what_was_drawn_is_written_again_and_what_differs_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = str(tmp_path / "b.pdf")
    assert main(["board", "-o", file]) == 0
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(["board", "-o", file]) == 0
    capsys.readouterr()
    assert main(["board", "-o", file, "--paper", "A5"]) == 1
    assert "give --force" in one_line(capsys)
    # The drawing is new, but beside it lies the specification of another.
    assert main(["board", "-o", str(tmp_path / "c.pdf"), "--paper", "A5"]) == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == first
    assert main(["board", "-o", file, "--paper", "A5", "--force"]) == 0
    assert load_board(tmp_path / "board.toml").square_mm == (11.0, 11.0)


def test_measurements_go_into_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "board.toml"
    assert main(["board", "-o", str(tmp_path / "b.pdf")]) == 0
    drawn = (tmp_path / "b.pdf").read_bytes()
    assert main(["board", "--from", str(file), "--measured-size-mm", "246.87", "171.09"]) == 0
    assert "18.99 x 19.01 mm, -0.053 % and +0.053 %" in capsys.readouterr().out
    assert load_board(file).square_mm == pytest.approx((18.99, 19.01))
    assert "As drawn" not in file.read_text()
    assert (
        main(["board", "--from", str(file), "--measured-square-mm", "19.02", "19", "-o", str(tmp_path / "c.toml")]) == 0
    )
    assert load_board(tmp_path / "c.toml").square_mm == (19.02, 19.0)
    assert load_board(file).square_mm == pytest.approx((18.99, 19.01))
    assert (tmp_path / "b.pdf").read_bytes() == drawn
    # Straight away: what is drawn is not what was measured.
    assert main(["board", "-o", str(tmp_path / "d" / "b.pdf"), "--measured-size-mm", "246.87", "171.09"]) == 0
    assert (tmp_path / "d" / "b.pdf").read_bytes() == drawn
    assert load_board(tmp_path / "d" / "board.toml") == load_board(file)


def test_a_size_out_of_limits_leaves_the_file_and_measured_squares_have_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file = tmp_path / "board.toml"
    assert main(["board", "-o", str(file)]) == 0
    before = file.read_bytes()
    capsys.readouterr()
    # 80 %, as "fit to page" makes of it: a size that small is asked about, squares of it are believed.
    assert main(["board", "--from", str(file), "--measured-size-mm", "197.6", "136.8", "--force"]) == 1
    assert "--measured-square-mm" in one_line(capsys)
    assert file.read_bytes() == before
    assert main(["board", "--from", str(file), "--measured-square-mm", "15.2", "15.2"]) == 0
    assert load_board(file).square_mm == (15.2, 15.2)


def test_a_board_is_drawn_from_its_file(tmp_path: Path):
    assert main(["board", "-o", str(tmp_path / "b.pdf"), "--spot-mm", "12", "--view-mm", "95", "71"]) == 0
    before = (tmp_path / "board.toml").read_bytes()
    assert main(["board", "--from", str(tmp_path / "board.toml"), "-o", str(tmp_path / "e" / "b.pdf")]) == 0
    assert (tmp_path / "e" / "b.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert main(["board", "--from", str(tmp_path / "board.toml"), "-o", str(tmp_path / "f.png")]) == 0
    assert (tmp_path / "board.toml").read_bytes() == before


def test_a_board_smaller_than_the_view_is_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["board", "-o", str(tmp_path / "b.pdf"), "--view-mm", "400", "300", "--paper", "A4"]) == 0
    assert "0.57 times what the camera sees" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "say with -o"),
        ("-o b.jpg", "written as .pdf, .png or .toml"),
        ("-o b.pdf --square-mm 30 --paper A4", "does not fit A4"),
        ("-o b.pdf --square-mm 100", "does not fit A0"),
        ("-o b.pdf --square-mm 30 30 30", "one number or two"),
        ("-o b.pdf --square-mm 0", "Must be > 0"),
        ("-o b.pdf --square-mm nan", ""),
        ("-o b.pdf --paper A9", "paper 'A9' is not known"),
        ("-o b.pdf --paper 60x40", "at any size"),
        ("-o b.pdf --squares 2 9", "3 or more each"),
        ("-o b.pdf --dictionary DICT_9X9_9", "is not known"),
        ("-o b.pdf --no-window --spot-mm 3", "exclude each other"),
        ("-o b.pdf --window-mm 0 0 900 10", "does not lie on the board"),
        ("-o b.pdf --spot-mm 90", "a spot of 90 mm"),
        ("-o b.png --pixels-per-square 9", "too few"),
        ("-o b.pdf --measured-size-mm 24.7 17.1", "give mm, width first"),
        ("-o b.pdf --measured-size-mm 170.1 117.2", "-31.1 % and -31.5 % off the board's 247 x 171 mm: are width and"),
        ("-o b.pdf --measured-size-mm 171 247", "are width and height exchanged"),
        ("-o b.pdf --squares 9 9 --measured-size-mm 171 167", "from outer edge to outer edge of all 9 x 9 squares"),
        ("-o b.pdf --measured-size-mm 247 171 --measured-square-mm 19 19", "either"),
        ("--from nothing.toml --measured-size-mm 247 171", "there is no such file"),
        ("--from nothing.toml -o b.pdf --legacy", "leave out the flags"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    arguments: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert main(["board", *arguments.split()]) == 1
    assert message in one_line(capsys)
    assert names(tmp_path) == []


def test_a_folder_in_the_way_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "b.pdf").mkdir()
    assert main(["board", "-o", str(tmp_path / "b.pdf"), "--force"]) == 1
    assert "not a regular file" in one_line(capsys)
    assert names(tmp_path) == ["b.pdf"]
