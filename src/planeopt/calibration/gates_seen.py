"""Gates on what was seen, before anything is adjusted: images, mirror, views, coverage, spots."""

import re
from collections import Counter
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board, Observations, View
from planeopt.calibration.gate import Gate, at_least

Array = NDArray[np.float64]

VIEWS_WANTED = 10
"""Standard deviations go as one over the root of the number; below this they are also poorly known themselves."""
VIEWS_NEEDED = 5
"""A tilt to each of four sides, and a view by which the others can be judged."""
SPOTS_NEEDED = 5

_CELLS = 8
_COVERED = 0.5
_REACHED = 0.7
_MOST_REFUSED = 0.25
_OTHER_SHARE = 0.08  # of the markers' share of a square: OpenCV places a marker's corners to half a pixel
_COMMON = 0.5
"""Of the refused images: a reason that so many share is the session's."""


class Image(Protocol):
    """What is asked of `planeopt.calibration.detection.ImageStatus`."""

    @property
    def name(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def reason(self) -> str: ...
    @property
    def marker_share(self) -> float | None: ...


def image_gate(images: Sequence[Image]) -> Gate | None:
    """Judge how many images show the board; the reason that most of the others share is the session's."""
    if not images:
        return None
    refused = [image for image in images if image.status != "ok"]
    share = len(refused) / len(images)
    limits = (_MOST_REFUSED, _COMMON)
    if not refused:
        return Gate("images", "ok", 0.0, limits, f"The board was found in all {len(images)} images.")
    # What a reason says after its first sentence is about the one image.
    # Counts of markers and the like differ from image to image; the reason does not.
    heads = Counter(_head(image.reason) for image in refused)
    kind, count = heads.most_common(1)[0]
    named = names([image.name for image in refused])
    # What is left may be enough for a calibration all the same.
    lost = share >= _COMMON and len(images) - len(refused) < VIEWS_WANTED
    state = "refuse" if lost else "warn" if share > _MOST_REFUSED else "ok"
    told = f"{len(refused)} of {len(images)} images could not be used ({named})"
    if count > _COMMON * len(refused) or len(refused) == 1:
        whole = next(image.reason for image in refused if _head(image.reason) == kind).rstrip(".")
        return Gate("images", state, share, limits, f"{told}: {whole}.")
    firsts = {_head(image.reason): image.reason.split(". ")[0].rstrip(".") for image in reversed(refused)}
    reasons = "; ".join(f"{number} x {firsts[head]}" for head, number in heads.most_common(3))
    return Gate("images", state, share, limits, f"{told}, for several reasons: {reasons}.")


def _head(reason: str) -> str:
    """Return the first sentence of a reason without its numbers."""
    return re.sub(r"[0-9]+", "#", reason.split(". ")[0].rstrip("."))


def marker_gate(images: Sequence[Image], board: Board) -> Gate | None:
    """Judge whether the markers are as large beside the squares as stated: if not, one of the two sizes is wrong."""
    shares = [image.marker_share for image in images if image.marker_share is not None]
    if not shares:
        return None
    seen, stated = float(np.median(shares)), board.marker_mm / min(board.square_mm)
    off = abs(seen / stated - 1)
    if off <= _OTHER_SHARE:
        return Gate("marker size", "ok", off, (None, _OTHER_SHARE), "Markers and squares have the proportion stated.")
    return Gate(
        "marker size",
        "refuse",
        off,
        (None, _OTHER_SHARE),
        f"marker_mm over square_mm is {stated:.2f} in board.toml, but {seen:.2f} in the images: one of them is wrong, "
        "and all lengths follow square_mm. Measure many squares and a marker with a ruler, and state what they are.",
    )


def mirror_gate(observations: Observations) -> Gate | None:
    """Judge whether the views show the board's face and not its mirror image."""
    if not observations.views:
        return None
    mirrored = [view.name for view in observations.views if len(view) >= 3 and _turn(observations, view) < 0]
    share = len(mirrored) / len(observations.views)
    limits = (0.0, 0.0)
    if not mirrored:
        return Gate("mirror", "ok", 0.0, limits, "The board is seen from its printed side in every view.")
    many = "The images are" if len(mirrored) == len(observations.views) else f"{names(mirrored)} look"
    return Gate(
        "mirror",
        "refuse",
        share,
        limits,
        f"{many} mirrored: the board's corners run round the other way. Turn off the mirroring (flip) in the camera's "
        "settings or in the program that saved the images, and shoot again.",
    )


def view_gate(observations: Observations) -> Gate:
    """Judge the number of views."""
    count = len(observations.views)
    state = at_least(count, VIEWS_WANTED, VIEWS_NEEDED)
    noun = "1 view shows" if count == 1 else f"{count} views show"
    tail = {
        "ok": ".",
        "warn": f"; {VIEWS_WANTED} or more are asked for, since fewer leave the camera less certain and cannot tell "
        f"how uncertain it is. Shoot {VIEWS_WANTED - count} more, in different tilts and at different distances.",
        "refuse": f": too few views. {VIEWS_NEEDED} are needed at least (the board tilted to each of four sides, and "
        f"one view to judge the others by) and {VIEWS_WANTED} are asked for. Shoot {VIEWS_WANTED - count} more, in "
        "different tilts and at different distances.",
    }[state]
    return Gate("views", state, float(count), (VIEWS_WANTED, VIEWS_NEEDED), f"{noun} the board{tail}")


def coverage_gates(observations: Observations) -> tuple[Gate, ...]:
    """Judge how much of the image the corners cover, and how far they reach out."""
    if not observations.views:
        return ()
    width, height = observations.image_size
    points = np.concatenate([view.corners for view in observations.views])
    size = np.array([width, height])
    cells = np.array([_CELLS, max(1, round(_CELLS * height / width))])
    inside = np.clip(((points + 0.5) / size * cells).astype(int), 0, cells - 1)
    covered = len(np.unique(inside, axis=0)) / int(cells.prod())
    away = np.linalg.norm(points - (size - 1) / 2, axis=1) / np.linalg.norm((size - 1) / 2)
    reach = float(away.max(initial=0.0))
    state = at_least(covered, _COVERED, None)
    told = f"Corners were seen in {100 * covered:.0f} % of the image's cells ({cells[0]} x {cells[1]})"
    advice = (
        ""
        if state == "ok"
        else (
            f"; {100 * _COVERED:.0f} % are asked for. Where there are none the lens is not known: bring the board to "
            "the parts of the image that are empty."
        )
    )
    first = Gate("coverage", state, covered, (_COVERED, None), told + (advice or "."))
    state = at_least(reach, _REACHED, None)
    told = f"Corners reach {100 * reach:.0f} % of the way from the image's middle to its corners"
    advice = (
        ""
        if state == "ok"
        else (
            f"; {100 * _REACHED:.0f} % are asked for. The lens's distortion is told by the outer parts of the image: "
            "bring the board to the image's corners, or nearer to the camera."
        )
    )
    return first, Gate("border", state, reach, (_REACHED, None), told + (advice or "."))


def spot_gate(observations: Observations, used: Sequence[bool] | None = None) -> Gate | None:
    """Judge in how many views there is a spot to calibrate the beam from."""
    if observations.spot == "none" or not observations.views:
        return None
    count, views = sum(view.spot is not None for view in observations.views), len(observations.views)
    left_out = 0 if used is None else count - sum(used)
    seen = count - left_out
    limits = (float(VIEWS_WANTED), float(SPOTS_NEEDED))
    told = f"The laser's spot was measured in {seen} of {views} views"
    if left_out:
        told += f" ({left_out} more did not fit and {'was' if left_out == 1 else 'were'} left out)"
    missing = 2 * seen < views
    advice = (
        " See the reason beside each image; the beam must be on, meet the board's blank window and be neither faint "
        "nor over-exposed."
    )
    if seen < SPOTS_NEEDED or (missing and seen < VIEWS_WANTED):
        why = "it is missing in most of them" if missing else f"the beam needs {SPOTS_NEEDED} at least"
        return Gate("spots", "refuse", float(seen), limits, f"{told}: {why}.{advice}")
    if missing or seen < min(VIEWS_WANTED, 0.75 * views):
        return Gate(
            "spots",
            "warn",
            float(seen),
            limits,
            f"{told}; {VIEWS_WANTED} or more, and most of the views, are asked for.{advice}",
        )
    return Gate("spots", "ok", float(seen), limits, f"{told}.")


def names(found: Sequence[str], most: int = 4) -> str:
    """Return a list of names in words, cut where it is long."""
    if len(found) <= most:
        return ", ".join(found)
    return f"{', '.join(found[: most - 1])} and {len(found) - most + 1} more"


def _turn(observations: Observations, view: View) -> float:
    """Return the determinant of the affine map from board to image that fits best: negative for a mirror image."""
    board = observations.board.corners[view.ids]
    design = board - board.mean(axis=0)
    found = np.linalg.lstsq(design, view.corners - view.corners.mean(axis=0), rcond=None)[0]
    return float(np.linalg.det(found))
