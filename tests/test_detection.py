"""From images to observations: reasons in words, spots, and a bad image that costs itself only."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planeopt.board import Board, load_board, save_board
from planeopt.calibration.detection import Detected, ImageStatus, detect, detect_image
from planeopt.calibration.detections_file import save_detections
from planeopt.calibration.gates_seen import marker_gate
from planeopt.calibration.session import load_session
from planeopt.errors import InputError
from planeopt.rig import Beam, Camera, Rig, load_rig
from planeopt.simulation import BoardScene, BoardSurface, BoardView, Noise, Optics, aimed, render_board
from planeopt.simulation import tables as looks
from planeopt.spot import Spot, read_image, write_points

EXAMPLE = Path(__file__).parents[1] / "calibration" / "example"
BOARD = load_board(EXAMPLE / "session" / "board.toml")
BARE = replace(BOARD, window_mm=None)


@cache
def example_image(name: str) -> NDArray[np.uint8]:
    return np.asarray(read_image(EXAMPLE / "session" / name), dtype=np.uint8)


def truth_of(name: str) -> BoardView:
    pose = json.loads((EXAMPLE / "truth_board_poses.json").read_text())[name.removesuffix(".png")]
    rotation = Rotation.from_rotvec(pose["rvec"]).as_matrix()
    return BoardView(load_rig(EXAMPLE / "truth_rig.toml"), BOARD, rotation, np.array(pose["tvec"]))


def off_outline(spot: Spot, truth: BoardView) -> NDArray[np.float64]:
    """Return how far the spot's points (N,) lie outside of the true outline, px."""
    px, normals = truth.outline(np.linspace(0, 2 * np.pi, 1440, endpoint=False))
    away = spot.points[:, None] - px[None]
    nearest = np.argmin((away**2).sum(axis=2), axis=1)
    return np.sum(away[np.arange(len(nearest)), nearest] * normals[nearest], axis=1)


@pytest.fixture(scope="module")
def wide() -> NDArray[np.uint8]:
    return example_image("view10.png")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            {"dictionary": "DICT_5X5_100"},
            "not of DICT_5X5_100: 36 of DICT_4X4_50, or a larger one of its kind, can be read",
        ),
        ({"squares": (9, 13), "window_mm": None}, "columns and rows exchanged: squares = [13, 9]"),
        ({"squares": (12, 9), "window_mm": None}, "as with 13 columns of squares, not 12"),
        ({"squares": (13, 7), "window_mm": None}, "not of a board of 13 x 7 squares: it has more rows"),
        ({"squares": (13, 10), "window_mm": None, "legacy": True}, "legacy = false"),
        ({"first_id": 13}, "first_id = 0 (or 13 less or more, and so on), not 13"),
        ({"first_id": 5}, "first_id = 0 (or 13 less or more, and so on), not 5"),
        ({"window_mm": (10.0, 10.0, 30.0, 20.0)}, "is seen where board.toml has the window: check window_mm"),
    ],
)
def test_a_board_that_is_not_as_board_toml_says_is_refused_in_words(
    wide: NDArray[np.uint8], change: dict[str, Any], reason: str
):
    found, status = detect_image(wide, replace(BOARD, **change))
    assert found is None
    assert status.status == "refused"
    assert reason in status.reason


def test_a_mirrored_image_is_refused_as_one(wide: NDArray[np.uint8]):
    for image in (wide[:, ::-1], wide[::-1]):
        found, status = detect_image(image, BOARD, "disc")
        assert found is None
        assert "mirrored" in status.reason
        assert status.spot_status == "refused"


@pytest.mark.parametrize("legacy", [False, True])
def test_even_rows_printed_the_other_way_are_told(legacy: bool):
    made = cv2.aruco.CharucoBoard((8, 6), 20.0, 14.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50))
    made.setLegacyPattern(legacy)
    drawn = np.asarray(made.generateImage((640, 480), marginSize=0))
    image = cv2.GaussianBlur(cv2.copyMakeBorder(drawn, 30, 30, 30, 30, cv2.BORDER_CONSTANT, value=(255,)), (0, 0), 0.8)
    board = Board((8, 6), (20.0, 20.0), 14.0, "DICT_5X5_50", legacy=not legacy)
    assert f"legacy = {str(legacy).lower()}" in detect_image(image, board)[1].reason
    assert detect_image(image, replace(board, legacy=legacy))[1].n_corners == 35


def test_an_image_without_a_board(wide: NDArray[np.uint8]):
    assert "blank" in detect_image(np.full((480, 640), 128, np.uint8), BOARD)[1].reason
    noise = np.random.default_rng(0).integers(0, 255, (240, 320)).astype(np.uint8)
    assert "none of the board's markers" in detect_image(noise, BOARD)[1].reason
    assert "too small" in detect_image(wide[:20, :200], BOARD)[1].reason


def test_a_wrong_size_of_the_markers_is_seen(tmp_path: Path):
    folder = copied(tmp_path, "view10.png", "view05.png")
    save_board(replace(BOARD, marker_mm=6.0), folder / "board.toml")
    found = detect(load_session(folder))
    assert len(found.observations.views) == 2
    gate = marker_gate(found.images, found.observations.board)
    assert gate is not None
    assert gate.state == "refuse"
    assert "0.60 in board.toml, but 0.7" in gate.sentence
    right = marker_gate(found.images, BOARD)
    assert right is not None
    assert right.state == "ok"


def same(one: Detected, other: Detected) -> bool:
    return one.images == other.images and all(
        a.name == b.name and np.array_equal(a.corners, b.corners) and np.array_equal(a.sigma, b.sigma)
        for a, b in zip(one.observations.views, other.observations.views, strict=True)
    )


def copied(folder: Path, *names: str, spot: str = "disc", more: str = "") -> Path:
    for name in (*names, "board.toml"):
        shutil.copy(EXAMPLE / "session" / name, folder / name)
    (folder / "session.toml").write_text(f'board = "board.toml"\nimages = ["view*"]\nspot = "{spot}"\n{more}')
    return folder


def test_depth_and_channels_make_no_difference(wide: NDArray[np.uint8]):
    plain, _ = detect_image(wide, BOARD, "disc")
    assert plain is not None
    assert plain.spot is not None
    colour = np.repeat(wide[:, :, None], 3, axis=2)
    alpha = np.concatenate([colour, np.full((*wide.shape, 1), 255, np.uint8)], axis=2)
    for image in (wide.astype(np.uint16) * 257, wide / 255.0, colour, alpha):
        found, _ = detect_image(image, BOARD, "disc")
        assert found is not None
        assert found.spot is not None
        np.testing.assert_array_equal(found.ids, plain.ids)
        np.testing.assert_allclose(found.corners, plain.corners, atol=2e-3)
        np.testing.assert_allclose(np.mean(found.spot.points, axis=0), np.mean(plain.spot.points, axis=0), atol=0.05)


@pytest.mark.parametrize("name", ["view00.png", "view05.png", "view10.png"])
def test_the_spot_in_the_window_is_where_it_is(name: str):
    view, status = detect_image(example_image(name), BOARD, "disc", name=name)
    assert view is not None
    assert view.spot is not None
    assert (status.spot_status, view.spot.source, view.spot.kind) == ("ok", name, "disc")
    off = off_outline(view.spot, truth_of(name))
    # Independent by the contract of sigma: the mean of so many, 4.5 standard deviations.
    assert abs(off.mean()) < 4.5 * np.median(sigma_of(view.spot)) / np.sqrt(len(off))
    assert np.sqrt(np.mean((off / sigma_of(view.spot)) ** 2)) < 1.3


def test_order_executor_and_repetition_make_no_difference(tmp_path: Path):
    session = load_session(copied(tmp_path, "view03.png", "view08.png", "view10.png"))
    told: list[tuple[int, int]] = []
    first = detect(session, progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]
    with ThreadPoolExecutor(2) as pool:
        assert same(first, detect(session, executor=pool))


def test_a_bad_image_costs_itself_only(tmp_path: Path):
    folder = copied(tmp_path, "view03.png", "view10.png")
    (folder / "view04.png").write_bytes(b"no image")
    cv2.imwrite(str(folder / "view05.png"), np.full((720, 960), 99, np.uint8))
    cv2.imwrite(str(folder / "view06.png"), example_image("view06.png")[:600])
    cv2.imwrite(str(folder / "view07.png"), example_image("view10.png")[:, ::-1])
    found = detect(load_session(folder))
    assert [image.status for image in found.images] == ["ok", "refused", "refused", "refused", "refused", "ok"]
    reasons = [image.reason for image in found.images if image.reason]
    for reason, word in zip(reasons, ("not an image", "blank", "960 x 600 px", "mirrored"), strict=True):
        assert word in reason
        assert "\n" not in reason
    assert [view.name for view in found.observations.views] == ["view03.png", "view10.png"]
    assert found.observations.image_size == (960, 720)


def test_a_session_without_a_readable_image_is_an_error(tmp_path: Path):
    folder = copied(tmp_path)
    (folder / "view04.png").write_bytes(b"no image")
    with pytest.raises(InputError, match="none of the images can be read"):
        detect(load_session(folder))


def test_corners_and_boundaries_of_others_are_taken_as_they_are(tmp_path: Path):
    folder = copied(tmp_path, "view03.png", "view10.png")
    first = detect(load_session(folder))
    save_detections(first.observations.views, folder / "corners.csv")
    (folder / "spots").mkdir()
    for view in first.observations.views:
        assert view.spot is not None
        write_points(view.spot, folder / "spots" / f"{Path(view.name).stem}.csv")
    text = (folder / "session.toml").read_text()
    (folder / "session.toml").write_text(text + 'detections = "corners.csv"\n')
    from_images = detect(load_session(folder))
    assert [image.spot_status for image in from_images.images] == ["ok", "ok"]
    (folder / "session.toml").write_text(
        'board = "board.toml"\nspot = "disc"\n'
        'detections = "corners.csv"\nboundaries = "spots"\nimage_size = [960, 720]\n'
    )
    (folder / "spots" / "view10.csv").unlink()
    alone = detect(load_session(folder))
    assert "view10.csv" in alone.images[1].spot_reason
    for other in (from_images, alone):
        assert other.observations.image_size == (960, 720)
        for view, before in zip(other.observations.views, first.observations.views, strict=True):
            np.testing.assert_array_equal(view.corners, before.corners)
    spot, before = alone.observations.views[0].spot, first.observations.views[0].spot
    assert spot is not None
    assert before is not None
    np.testing.assert_array_equal(spot.points, before.points)


def test_detections_of_an_image_that_is_not_there(tmp_path: Path):
    folder = copied(tmp_path, "view03.png", spot="none", more='detections = "corners.csv"\n')
    (folder / "corners.csv").write_text("image,id,x_px,y_px\nother.png,1,2,3\n")
    with pytest.raises(InputError, match=r"other\.png is not among the session's images"):
        detect(load_session(folder))


CAMERA = Camera((640, 480), 1100.0, 1100.0, 325.0, 236.0, (-0.25, 0.12, 0.0005, -0.0004, 0.0))
RIG = Rig(CAMERA, Beam(5.0, (14.0, -4.0), (0.0, 0.0, 1.0)))
SMALL = Board((9, 7), (10.0, 10.0), 7.5, "DICT_4X4_50", window_mm=(30.0, 20.0, 30.0, 30.0))


def aimed_at(x: float, y: float, tilt: float, *, board: Board = SMALL) -> tuple[BoardScene, BoardView]:
    rotation = np.asarray((Rotation.from_euler("z", 0.3) * Rotation.from_euler("x", tilt)).as_matrix())
    translation = aimed(RIG, rotation, 150.0, np.array([x, y]))
    scene = BoardScene(
        RIG,
        board,
        surface=BoardSurface(white=0.3),
        beam=looks.BeamProfile(height=0.5),
        noise=Noise(read=0.004, full_well_electrons=12000.0),
        optics=Optics(blur_px=0.8),
    )
    return scene, scene.view(rotation, translation)


def image_of(scene: BoardScene, view: BoardView, *, laser: bool = True) -> NDArray[np.uint8]:
    return render_board(scene, view.rotation, view.translation, laser=laser, seed=5).astype(np.uint8)


def sigma_of(spot: Spot) -> NDArray[np.float64]:
    assert spot.sigma is not None
    return spot.sigma


@pytest.mark.parametrize("tilt", [0.0, 0.8])
def test_a_spot_anywhere_in_the_window_is_measured_and_one_over_its_edge_is_refused(tilt: float):
    scene, view = aimed_at(45.0, 35.0, tilt)
    found, status = detect_image(image_of(scene, view), SMALL, "disc")
    assert found is not None
    assert found.spot is not None, status.spot_reason
    off = off_outline(found.spot, view)
    assert abs(off.mean()) < 4.5 * np.median(sigma_of(found.spot)) / np.sqrt(len(off)) + 0.002
    for x in (57.0, 61.0):
        _, status = detect_image(image_of(*aimed_at(x, 35.0, tilt)), SMALL, "disc")
        assert status.status == "ok"
        assert status.spot_status == "refused"
        assert "window's edge" in status.spot_reason


def test_a_spot_beside_the_window_or_none_is_refused():
    for scene, view in (aimed_at(15.0, 35.0, 0.2), aimed_at(45.0, 35.0, 0.2)):
        laser = view.spot_state() != "seen"
        _, status = detect_image(image_of(scene, view, laser=laser), SMALL, "disc")
        assert (status.status, status.spot_status) == ("ok", "refused")
        assert status.spot_reason


def test_without_a_window_the_twin_tells_the_spot_from_the_print():
    bare = replace(SMALL, window_mm=None)
    scene, view = aimed_at(44.0, 33.0, 0.4, board=bare)
    image, dark = image_of(scene, view), image_of(scene, view, laser=False)
    found, status = detect_image(image, bare, "disc", dark=dark)
    assert found is not None
    assert found.spot is not None, status.spot_reason
    off = off_outline(found.spot, view)
    assert abs(off.mean()) < 4.5 * np.median(sigma_of(found.spot)) / np.sqrt(len(off))
    _, status = detect_image(image, bare, "disc")
    assert "laser off" in status.spot_reason


def test_twins_and_a_window_together(tmp_path: Path):
    scene, view = aimed_at(45.0, 35.0, 0.3)
    cv2.imwrite(str(tmp_path / "on.png"), image_of(scene, view))
    cv2.imwrite(str(tmp_path / "off.png"), image_of(scene, view, laser=False))
    save_board(SMALL, tmp_path / "board.toml")
    (tmp_path / "session.toml").write_text(
        'board = "board.toml"\nimages = ["on.png"]\ndark_images = ["off.png"]\nspot = "disc"\n'
    )
    found = detect(load_session(tmp_path)).observations.views[0]
    assert found.spot is not None
    assert np.sqrt(np.mean((off_outline(found.spot, view) / sigma_of(found.spot)) ** 2)) < 1.5


@given(st.integers(0, 2**32 - 1), st.sampled_from([(40, 33), (64, 200), (130, 90)]))
@settings(max_examples=15, derandomize=True, deadline=None)
def test_whatever_is_in_an_image_there_is_a_status_for_it(seed: int, shape: tuple[int, int]):
    rng = np.random.default_rng(seed)
    image = example_image("view10.png")
    y, x = rng.integers(0, 720 - shape[0]), rng.integers(0, 960 - shape[1])
    part = image[y : y + shape[0], x : x + shape[1]] * rng.uniform(0.05, 3)
    part = np.clip(part + rng.normal(0, rng.uniform(0, 40), shape), 0, 255).astype(np.uint8)
    found, status = detect_image(part, BOARD, "disc")
    assert isinstance(status, ImageStatus)
    assert (found is None) == (status.status == "refused") == bool(status.reason)
    assert found is None or np.all(np.isfinite(found.corners))
