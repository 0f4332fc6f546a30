"""From a session's images to observations: corners and spots, and for each image what came of it and why."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.board import Board, Observations, SpotOnBoard, View
from planeopt.calibration.board_image import BoardImage, fit_board_image
from planeopt.calibration.corners import Corners, find_corners
from planeopt.calibration.detections_file import load_detections
from planeopt.calibration.diagnosis import why_no_corners
from planeopt.calibration.session import Session
from planeopt.calibration.spot_on_board import SpotRefused, find_spot_on_board
from planeopt.errors import InputError
from planeopt.executors import ordered_map
from planeopt.spot import Kind, Spot, SpotFlag, read_points
from planeopt.spot.files import load_image
from planeopt.spot.grey import to_grey

MIN_CORNERS = 6
"""With fewer a view says hardly more than where its board is."""

_TYPICAL_BLUR = 1.5  # px: where the corners are another detector's, who does not say


@dataclass(frozen=True)
class ImageStatus:
    """What came of an image.

    Parameters
    ----------
    name : str
        By which records speak of it: its path in the session's folder.
    status : {"ok", "refused"}
        Whether its corners are used.
    reason : str
        Why not: a sentence; empty where they are.
    n_corners : int
        Corners measured.
    spot_status : {"ok", "refused", "none"}
        Whether its spot is used; "none" where none is looked for.
    spot_reason : str
        Why not.
    spot_flags : tuple of SpotFlag
        What should be known about the spot.
    blur : float
        Standard deviation of the blur of the board's edges, px; 0 where it is not known.
    marker_share : float, optional
        Side of the markers over that of the squares, as seen.
    """

    name: str
    status: Literal["ok", "refused"]
    reason: str = ""
    n_corners: int = 0
    spot_status: Literal["ok", "refused", "none"] = "none"
    spot_reason: str = ""
    spot_flags: tuple[SpotFlag, ...] = ()
    blur: float = 0.0
    marker_share: float | None = None


@dataclass(frozen=True, eq=False)
class Detected:
    """What was seen in a session.

    Parameters
    ----------
    observations : Observations
        Of the images that are "ok".
    images : tuple of ImageStatus
        Of all of them, in order.
    """

    observations: Observations
    images: tuple[ImageStatus, ...]


@dataclass(frozen=True, eq=False)
class _Seen:
    status: ImageStatus
    view: View | None
    size: tuple[int, int] | None


def detect(
    session: Session, *, executor: Executor | None = None, progress: Callable[[int, int], object] | None = None
) -> Detected:
    """Measure the corners and spots of a session's images. An image without them costs itself only.

    Parameters
    ----------
    session : Session
    executor : Executor, optional
        Over whose workers the images are spread; the result is the same.
    progress : callable, optional
        Told how many images are done, of how many.

    Raises
    ------
    InputError
        If the session's file of detections cannot be used, or no image can be read.
    """
    known = None if session.detections is None else load_detections(session.detections, session.board)
    jobs = _jobs(session, known)
    seen: list[_Seen] = []
    for one in ordered_map(_looked_at, jobs, executor):
        seen.append(one)
        if progress is not None:
            progress(len(seen), len(jobs))
    size = _size_of(session, seen)
    seen = [_of_size(one, size) for one in seen]
    observations = Observations(
        board=session.board,
        image_size=size,
        views=tuple(one.view for one in seen if one.view is not None),
        spot=session.spot,
        pixel_pitch_mm=session.pixel_pitch_mm,
    )
    images = tuple(one.status for one in seen)
    return Detected(observations, images)


def detect_image(
    image: ArrayLike, board: Board, spot: SpotOnBoard = "none", *, dark: ArrayLike | None = None, name: str = "image"
) -> tuple[View | None, ImageStatus]:
    """Measure the corners, and the spot, in one image.

    Parameters
    ----------
    image : (H, W), (H, W, 3) or (H, W, 4) array
        Unsigned integers or floats; colour as OpenCV orders it.
    board : Board
    spot : {"disc", "ring", "none"}
    dark : array_like, optional
        The same view with the laser off.
    name : str

    Returns
    -------
    View or None
        ``None`` if the image is refused.
    ImageStatus

    Raises
    ------
    InputError
        If an array is not an image, or the laser-off image is not like the other.
    """
    values = to_grey(image).values if dark is None else to_grey(dark).values
    if dark is not None:
        to_grey(image, dark=dark)
    corners = find_corners(values, board)
    reason = _refusal(corners, values, board)
    status = ImageStatus(
        name,
        "refused" if reason else "ok",
        reason,
        len(corners),
        blur=corners.blur,
        marker_share=corners.marker_share(board),
    )
    if reason:
        unlooked = "the board was not found" if spot != "none" else ""
        return None, replace(status, spot_status="none" if spot == "none" else "refused", spot_reason=unlooked)
    if spot == "none" or corners.map is None:
        found = None
    else:
        found, status = _with_spot(np.asarray(image), corners.map, corners.blur, board, spot, dark, status)
    return View(name, corners.ids, corners.pixels, corners.sigma, found), status


def _with_spot(
    image: np.ndarray,
    mapped: BoardImage,
    blur: float,
    board: Board,
    kind: Kind,
    dark: ArrayLike | None,
    status: ImageStatus,
) -> tuple[Spot | None, ImageStatus]:
    off = None if dark is None else np.asarray(dark)
    try:
        found = replace(find_spot_on_board(image, board, mapped, blur, kind, off), source=status.name)
    except SpotRefused as refused:
        return None, replace(status, spot_status="refused", spot_reason=str(refused))
    return found, replace(status, spot_status="ok", spot_flags=found.flags)


def _refusal(corners: Corners, values: np.ndarray, board: Board) -> str:
    if len(corners) < MIN_CORNERS:
        return why_no_corners(values, board, corners)
    return _on_a_line(corners.ids, board)


def _on_a_line(ids: NDArray[np.int64], board: Board) -> str:
    columns = board.squares[0] - 1
    alone = len(np.unique(ids % columns)) < 2 or len(np.unique(ids // columns)) < 2
    return "the corners that were found lie on one line of the board" if alone else ""


@dataclass(frozen=True, eq=False)
class _Job:
    """One image: where it and its laser-off twin are, and what is known of it already."""

    name: str
    image: Path | None
    dark: Path | None
    board: Board
    spot: SpotOnBoard
    known: View | None
    detected: bool
    """Whether its corners are known, or known not to be."""
    boundary: Path | None


def _jobs(session: Session, views: Mapping[str, View] | None) -> list[_Job]:
    darks: Sequence[Path | None] = session.dark_images or (None,) * len(session.images)
    named = [(session.name_of(image), image, dark) for image, dark in zip(session.images, darks, strict=True)]
    if views is not None:
        if not named:
            named = [(name, None, None) for name in views]
        strangers = [name for name in views if name not in {name for name, _, _ in named}]
        if strangers:
            raise InputError(f"{session.detections}: {strangers[0]} is not among the session's images")
    return [
        _Job(
            name,
            image,
            dark,
            session.board,
            session.spot,
            None if views is None else views.get(name),
            views is not None,
            None if session.boundaries is None else session.boundaries / Path(name).with_suffix(".csv").name,
        )
        for name, image, dark in named
    ]


def _looked_at(job: _Job) -> _Seen:
    """Do one image; what is wrong with it is its status."""
    try:
        return _seen(job)
    except InputError as error:
        text = str(error).removeprefix(f"{job.image}: ")
        spot_status = "none" if job.spot == "none" else "refused"
        return _Seen(ImageStatus(job.name, "refused", text, spot_status=spot_status), None, None)


def _seen(job: _Job) -> _Seen:
    stored = None if job.image is None else load_image(job.image)
    image = None if stored is None else stored.pixels
    dark = None if job.dark is None else load_image(job.dark).pixels
    size = None if image is None else (image.shape[1], image.shape[0])
    from_image: SpotOnBoard = "none" if job.boundary is not None else job.spot
    if job.detected:
        view, status = _of_known(job, image, dark, from_image)
    elif image is not None:
        view, status = detect_image(image, job.board, from_image, dark=dark, name=job.name)
    else:
        raise InputError("there is neither an image nor corners of it")
    if view is not None and job.spot != "none" and job.boundary is not None:
        view, status = _with_boundary(view, status, job.boundary, job.spot)
    if view is not None and view.spot is not None and job.boundary is None and stored is not None and stored.encoded:
        spot = replace(view.spot, flags=(*view.spot.flags, SpotFlag.ENCODED))
        view, status = replace(view, spot=spot), replace(status, spot_flags=spot.flags)
    return _Seen(status, view, size)


def _of_known(
    job: _Job, image: np.ndarray | None, dark: np.ndarray | None, spot: SpotOnBoard
) -> tuple[View | None, ImageStatus]:
    """Take the corners as another detector found them, and the spot from the image."""
    view = job.known
    if view is None or len(view) < MIN_CORNERS:
        reason = f"{0 if view is None else len(view)} corners are known of it, and {MIN_CORNERS} are needed"
        return None, ImageStatus(job.name, "refused", reason, 0 if view is None else len(view))
    reason = _on_a_line(view.ids, job.board)
    status = ImageStatus(job.name, "refused" if reason else "ok", reason, len(view))
    if reason:
        return None, status
    if image is None or spot == "none":
        return view, status
    size = image.shape[1], image.shape[0]
    mapped = fit_board_image(job.board.corners[view.ids], view.corners, size, job.board.square_mm)
    if mapped is None:
        return None, replace(status, status="refused", reason="its corners are not laid out as those of the board")
    found, status = _with_spot(image, mapped, _TYPICAL_BLUR, job.board, spot, dark, status)
    return replace(view, spot=found), status


def _with_boundary(view: View, status: ImageStatus, file: Path, kind: SpotOnBoard) -> tuple[View, ImageStatus]:
    if not file.is_file():
        return view, replace(status, spot_status="refused", spot_reason=f"there is no {file.name} with its boundary")
    spot = replace(read_points(file), kind="ring" if kind == "ring" else "disc", source=status.name)
    return replace(view, spot=spot), replace(status, spot_status="ok", spot_flags=spot.flags)


def _size_of(session: Session, seen: list[_Seen]) -> tuple[int, int]:
    """Return the size of most images: of those that hold a board, if any do."""
    if session.image_size is not None:
        return session.image_size
    sizes = [one.size for one in seen if one.size is not None and one.view is not None]
    sizes = sizes or [one.size for one in seen if one.size is not None]
    if not sizes:
        raise InputError(f"{session.folder}: none of the images can be read: {seen[0].status.reason}")
    return Counter(sizes).most_common(1)[0][0]


def _of_size(one: _Seen, size: tuple[int, int]) -> _Seen:
    if one.size is None or one.size == size:
        return one
    reason = (
        f"it has {one.size[0]} x {one.size[1]} px, the session's other images {size[0]} x {size[1]} px: "
        "one camera's images, neither cropped nor resized, make a session"
    )
    return _Seen(replace(one.status, status="refused", reason=reason), None, one.size)
