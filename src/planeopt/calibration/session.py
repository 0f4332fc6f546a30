"""A session: the folder of board images that a rig is calibrated from, and `session.toml` that says what is in it."""

import os
from dataclasses import dataclass
from pathlib import Path

import msgspec

from planeopt.board import Board, SpotOnBoard, load_board
from planeopt.errors import InputError
from planeopt.toml_files import FORMAT, as_tables, read_toml

SESSION_FILE = "session.toml"
_SPOTS = ("disc", "ring", "none")


class _File(msgspec.Struct, forbid_unknown_fields=True):
    board: str
    spot: str
    images: list[str] | None = None
    format: int = FORMAT
    pixel_pitch_mm: float | None = None
    dark_images: list[str] | None = None
    detections: str | None = None
    boundaries: str | None = None
    image_size: list[int] | None = None


@dataclass(frozen=True)
class Session:
    """What `session.toml` says, its files found.

    Parameters
    ----------
    folder : Path
    board : Board
    images : tuple of Path
        In the order of their names; empty where `detections` alone say what was seen.
    spot : {"disc", "ring", "none"}
        What the laser draws on the board.
    pixel_pitch_mm : float, optional
    dark_images : tuple of Path
        Taken with the laser off, one for each image in their order, or none.
    detections : Path, optional
        Corners that another detector found: CSV with the header ``image,id,x_px,y_px`` or
        ``image,id,x_px,y_px,sigma_px``.
    boundaries : Path, optional
        Folder with the spots' boundary points: ``NAME.csv`` for the image ``NAME.png``.
    image_size : tuple of int, optional
        Width and height, px, where there are no images to tell it.
    """

    folder: Path
    board: Board
    images: tuple[Path, ...]
    spot: SpotOnBoard
    pixel_pitch_mm: float | None = None
    dark_images: tuple[Path, ...] = ()
    detections: Path | None = None
    boundaries: Path | None = None
    image_size: tuple[int, int] | None = None

    def name_of(self, image: Path) -> str:
        """Return the name by which records speak of an image: its path in the session's folder."""
        return image.relative_to(self.folder).as_posix() if image.is_relative_to(self.folder) else image.as_posix()


def load_session(path: str | os.PathLike[str]) -> Session:
    """Read a session.

    Parameters
    ----------
    path : path-like
        The folder with `session.toml`, or that file.

    Raises
    ------
    InputError
        If a file is missing or unreadable, a key is missing, unknown or impossible, or the images and those with the
        laser off do not pair: one line with the file, the key and what is wrong.
    """
    file = Path(path)
    if file.is_dir():
        file = file / SESSION_FILE
        if not file.is_file():
            raise InputError(f"{path}: a session is a folder with {SESSION_FILE}, and there is none in this one")
    folder = file.parent
    tables = as_tables(read_toml(file, "session"), _File, str(file))
    board = load_board(folder / tables.board)
    if tables.spot not in _SPOTS:
        raise InputError(f'{file}: spot must be "disc", "ring" or "none", not {tables.spot!r}')
    spot: SpotOnBoard = "disc" if tables.spot == "disc" else "ring" if tables.spot == "ring" else "none"
    if tables.pixel_pitch_mm is not None and not 0 < tables.pixel_pitch_mm < float("inf"):
        raise InputError(f"{file}: pixel_pitch_mm must be a positive number, not {tables.pixel_pitch_mm:g}")
    images = _files(tables.images, folder, f"{file}: images")
    dark = _files(tables.dark_images, folder, f"{file}: dark_images")
    _check_pairs(images, dark, str(file))
    detections = _existing(tables.detections, folder, f"{file}: detections", folder_wanted=False)
    boundaries = _existing(tables.boundaries, folder, f"{file}: boundaries", folder_wanted=True)
    _check_sources(tables, images, spot, str(file))
    if spot != "none" and board.window_mm is None and not dark and boundaries is None:
        raise InputError(
            f'{file}: spot = "{spot}" on a board without window_mm needs dark_images: the same views with the laser off'
        )
    return Session(
        folder=folder,
        board=board,
        images=images,
        spot=spot,
        pixel_pitch_mm=tables.pixel_pitch_mm,
        dark_images=dark,
        detections=detections,
        boundaries=boundaries,
        image_size=None if tables.image_size is None else (tables.image_size[0], tables.image_size[1]),
    )


def _files(patterns: list[str] | None, folder: Path, where: str) -> tuple[Path, ...]:
    """Return the files that names and patterns stand for, each pattern's in the order of their names."""
    found: list[Path] = []
    for pattern in patterns or []:
        if not pattern or Path(pattern).is_absolute() or ".." in Path(pattern).parts:
            raise InputError(f"{where}: {pattern!r} must be a path or pattern within the session's folder")
        if any(sign in pattern for sign in "*?["):
            try:
                files = sorted(file for file in folder.glob(pattern) if file.is_file())
            except ValueError as error:
                raise InputError(f"{where}: {pattern!r} is no pattern ({error})") from None
            if not files:
                raise InputError(f"{where}: {pattern!r} matches no file in {folder}")
        else:
            files = [folder / pattern]
            if not files[0].is_file():
                raise InputError(f"{where}: there is no file {pattern!r} in {folder}")
        found += files
    for file in found:
        if found.count(file) > 1:
            raise InputError(f"{where}: {file.relative_to(folder).as_posix()} is named more than once")
    return tuple(found)


def _check_pairs(images: tuple[Path, ...], dark: tuple[Path, ...], where: str) -> None:
    both = set(images) & set(dark)
    if both:
        name = min(both).name
        raise InputError(f"{where}: {name} is among the images and the dark_images; narrow the pattern of one of them")
    if dark and len(dark) != len(images):
        raise InputError(
            f"{where}: dark_images are paired with the images in order, but there are {len(dark)} for {len(images)}"
        )


def _existing(name: str | None, folder: Path, where: str, *, folder_wanted: bool) -> Path | None:
    if name is None:
        return None
    path = folder / name
    if not (path.is_dir() if folder_wanted else path.is_file()):
        raise InputError(f"{where}: there is no {'folder' if folder_wanted else 'file'} {name!r} in {folder}")
    return path


def _check_sources(tables: _File, images: tuple[Path, ...], spot: SpotOnBoard, where: str) -> None:
    size = tables.image_size
    if size is not None and (len(size) != 2 or min(size) < 1):
        raise InputError(f"{where}: image_size must be two whole numbers of pixels, [width, height], not {size}")
    if images:
        return
    if tables.images is not None:
        raise InputError(f"{where}: images is empty: name the board's images")
    if tables.detections is None:
        raise InputError(f"{where}: lacks the key 'images' (or 'detections', corners that were found already)")
    if size is None:
        raise InputError(f"{where}: without images the key 'image_size' = [width, height] is needed")
    if spot != "none" and tables.boundaries is None:
        raise InputError(f"{where}: without images the spots need the key 'boundaries', a folder of boundary points")
