"""Sessions on disk that need no image: corners and boundary points as another detector would give them."""

from dataclasses import replace
from pathlib import Path

import tomli_w

from planeopt.board import Observations, save_board
from planeopt.calibration.detections_file import save_detections
from planeopt.spot import write_points


def write_points_session(observations: Observations, folder: Path) -> Path:
    """Write `session.toml`, `board.toml`, `corners.csv` and `spots/*.csv`; return the folder."""
    folder.mkdir(parents=True)
    save_board(observations.board, folder / "board.toml")
    save_detections(observations.views, folder / "corners.csv")
    table = {
        "board": "board.toml",
        "spot": observations.spot,
        "detections": "corners.csv",
        "image_size": list(observations.image_size),
    }
    if observations.pixel_pitch_mm is not None:
        table["pixel_pitch_mm"] = observations.pixel_pitch_mm
    if observations.spot != "none":
        table["boundaries"] = "spots"
        (folder / "spots").mkdir()
        for view in observations.views:
            if view.spot is not None:
                write_points(view.spot, folder / "spots" / Path(view.name).with_suffix(".csv").name)
    (folder / "session.toml").write_text(tomli_w.dumps(table), encoding="utf-8")
    return folder


def first_views(observations: Observations, count: int) -> Observations:
    return replace(observations, views=observations.views[:count])
