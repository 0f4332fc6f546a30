"""Corners against the truth: no bias, honest sigmas; what is not a corner of the board is left out."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planeopt.board import Board, load_board
from planeopt.calibration.charuco import find_board, marker_corners
from planeopt.calibration.corners import Corners, find_corners
from planeopt.rig import Camera, Rig, load_rig
from planeopt.simulation import BoardScene, BoardSurface, BoardView, Noise, Optics, render_board
from planeopt.spot import read_image
from planeopt.spot.grey import to_grey

Image = NDArray[np.float32]
EXAMPLE = Path(__file__).parents[1] / "calibration" / "example"
BOARD = load_board(EXAMPLE / "session" / "board.toml")
CAMERA = Camera((640, 480), 1100.0, 1100.0, 325.0, 236.0, (-0.25, 0.12, 0.0005, -0.0004, 0.0))
SMALL = Board((9, 7), (10.0, 10.0), 7.5, "DICT_4X4_50", window_mm=(30.0, 20.0, 30.0, 30.0))


def grey_of(name: str) -> Image:
    return to_grey(read_image(EXAMPLE / "session" / name)).values


def truth_of(name: str) -> BoardView:
    pose = json.loads((EXAMPLE / "truth_board_poses.json").read_text())[name.removesuffix(".png")]
    rotation = Rotation.from_rotvec(pose["rvec"]).as_matrix()
    return BoardView(load_rig(EXAMPLE / "truth_rig.toml"), BOARD, rotation, np.array(pose["tvec"]))


def errors(found: Corners, truth: BoardView) -> NDArray[np.float64]:
    return found.pixels - truth.corners[0][found.ids]


@pytest.fixture(scope="module")
def example() -> list[tuple[Corners, BoardView]]:
    names = [f"view{k:02d}.png" for k in range(0, 12, 2)]
    return [(find_corners(grey_of(name), BOARD), truth_of(name)) for name in names]


def test_corners_of_the_example_have_no_bias_and_honest_sigmas(example: list[tuple[Corners, BoardView]]):
    off = np.concatenate([errors(found, truth) for found, truth in example])
    sigma = np.concatenate([found.sigma for found, _ in example])
    # Six images by a renderer of others: 4 standard deviations of a mean of so many, whatever sign.
    assert np.all(np.abs(off.mean(axis=0)) < 4 * sigma.mean() / np.sqrt(len(off)))
    assert np.sqrt(np.mean(off**2)) < 0.01
    assert 0.8 < np.sqrt(np.mean((off / sigma[:, None]) ** 2)) < 1.35
    assert np.abs(off).max() < 0.04


def test_nearly_every_corner_in_sight_is_found(example: list[tuple[Corners, BoardView]]):
    for found, truth in example:
        px, seen = truth.corners
        inside = np.flatnonzero(seen & truth.in_image(px, 8.0))
        assert len(np.setdiff1d(inside, found.ids)) <= 1
        assert len(found) > len(found.found.ids)
        assert np.all(truth.board.printed[found.ids])


def view(tilt: float, turn: float = 0.3, z: float = 145.0, camera: Camera = CAMERA, board: Board = SMALL) -> BoardView:
    rotation = (Rotation.from_euler("z", turn) * Rotation.from_euler("x", tilt)).as_matrix()
    middle = np.array([*board.size_mm, 0.0]) / 2
    return BoardView(Rig(camera), board, rotation, np.array([0.0, 0.0, z]) - rotation @ middle)


def rendered(
    truth: BoardView, *, blur: float = 0.8, read: float = 0.004, white: float = 0.5, black: float = 0.08
) -> Image:
    scene = BoardScene(
        truth.rig,
        truth.board,
        surface=BoardSurface(white=white, black=black),
        noise=Noise(read=read),
        optics=Optics(blur_px=blur),
    )
    return to_grey(render_board(scene, truth.rotation, truth.translation, seed=3)).values


@pytest.mark.parametrize(
    ("tilt", "turn", "blur", "read", "white"),
    [
        (0.0, 0.0, 0.5, 0.002, 0.5),
        (0.7, 0.5, 0.8, 0.004, 0.5),
        (-0.9, 2.0, 1.5, 0.01, 0.6),
        (0.5, 4.0, 0.8, 0.002, 0.06),
    ],
)
def test_no_bias_whatever_the_pose_the_blur_and_the_light(
    tilt: float, turn: float, blur: float, read: float, white: float
):
    truth = view(tilt, turn)
    found = find_corners(rendered(truth, blur=blur, read=read, white=white), SMALL)
    off = errors(found, truth)
    assert len(found) > 20
    # 4.5: of the four means two ways, at a level of 1e-4; 0.002 px: the renderer's samples.
    assert np.all(np.abs(off.mean(axis=0)) < 4.5 * np.median(found.sigma) / np.sqrt(len(off)) + 0.002)
    assert np.sqrt(np.mean((off / found.sigma[:, None]) ** 2)) < 1.5


def test_over_exposed_paper_moves_no_corner():
    truth = view(0.6, 1.0)
    found = find_corners(rendered(truth, white=1.6, black=0.03), SMALL)
    off = errors(found, truth)
    assert len(found) > 20
    assert np.all(np.abs(off.mean(axis=0)) < 0.006)
    assert np.sqrt(np.mean(off**2)) < 0.03


def test_stronger_lens_than_the_map_knows():
    camera = Camera((640, 480), 420.0, 420.0, 335.0, 250.0, (-0.30, 0.09, 0.002, -0.002, 0.0))
    truth = view(0.4, 0.2, z=62.0, camera=camera)
    found = find_corners(rendered(truth), SMALL)
    off = errors(found, truth)
    assert len(found) > 15
    assert np.sqrt(np.mean(off**2)) < 0.02


def test_half_turned_image_gives_half_turned_corners():
    image = rendered(view(0.6, 0.4))
    found, turned = find_corners(image, SMALL), find_corners(np.ascontiguousarray(image[::-1, ::-1]), SMALL)
    np.testing.assert_array_equal(found.ids, turned.ids)
    np.testing.assert_allclose(np.array([639, 479]) - turned.pixels, found.pixels, atol=0.002)


def test_what_is_covered_is_left_out_and_moves_nothing_else():
    image = rendered(view(0.5, 0.3))
    whole = find_corners(image, SMALL)
    hidden = image.copy()
    middle = whole.pixels[10]
    x, y = np.rint(middle).astype(int)
    hidden[y - 25 : y + 25, x - 40 : x + 3] = 0.3
    found = find_corners(hidden, SMALL)
    assert whole.ids[10] not in found.ids
    far = np.linalg.norm(whole.pixels - middle, axis=1) > 90
    kept, at, before = np.intersect1d(found.ids, whole.ids[far], return_indices=True)
    assert len(kept) == far.sum()
    np.testing.assert_allclose(found.pixels[at], whole.pixels[far][before], atol=0.002)
    near = np.abs(found.pixels - whole.pixels[np.searchsorted(whole.ids, found.ids)])
    assert near.max() < 0.05


def test_light_on_a_corner_costs_that_corner():
    image = rendered(view(0.5, 0.3))
    whole = find_corners(image, SMALL)
    lit = image.copy()
    place = tuple(np.rint(whole.pixels[5] + 4).astype(int).tolist())
    light = cv2.circle(np.zeros_like(image), place, 14, (0.4,), -1, cv2.LINE_AA)
    found = find_corners(lit + np.asarray(light), SMALL)
    assert whole.ids[5] not in found.ids
    off = found.pixels - whole.pixels[np.searchsorted(whole.ids, found.ids)]
    assert np.abs(off).max() < 0.05


def test_a_part_of_the_board_is_enough():
    image = rendered(view(0.3, 0.2))
    part = find_corners(np.ascontiguousarray(image[:200, :260]), SMALL)
    whole = find_corners(image, SMALL)
    assert 4 <= len(part) < len(whole)
    kept, at, before = np.intersect1d(part.ids, whole.ids, return_indices=True)
    assert len(kept) == len(part)
    # So few corners, in a part whose middle is not the lens's, hardly say how edges bend.
    assert np.abs(part.pixels[at] - whole.pixels[before]).max() < 0.03


def test_sigma_tells_noise_from_noise():
    truth = view(0.4, 0.3)
    quiet, noisy = (find_corners(rendered(truth, read=read), SMALL) for read in (0.004, 0.03))
    assert 3 < np.median(noisy.sigma) / np.median(quiet.sigma) < 8
    off = errors(noisy, truth) / noisy.sigma[:, None]
    # Chi-squared over its 2 x 40 or so: 0.5 to 1.6 holds all but 1e-5.
    assert 0.5 < np.mean(off**2) < 1.6


@pytest.mark.parametrize("legacy", [False, True])
def test_the_board_is_opencvs_own(legacy: bool):
    board = Board((6, 8), (20.0, 20.0), 14.0, "DICT_5X5_100", legacy=legacy, first_id=7)
    made = cv2.aruco.CharucoBoard(
        (6, 8), 20.0, 14.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100), np.arange(7, 31, dtype=np.int32)
    )
    made.setLegacyPattern(legacy)
    ours = marker_corners(board)
    for number, four in zip(np.ravel(made.getIds()).tolist(), made.getObjPoints(), strict=True):
        np.testing.assert_allclose(ours[number], np.asarray(four)[:, :2], atol=1e-4)
    np.testing.assert_allclose(board.corners, np.asarray(made.getChessboardCorners())[:, :2], atol=1e-4)
    drawn = np.asarray(made.generateImage((600, 800), marginSize=0))
    image = cv2.GaussianBlur(cv2.copyMakeBorder(drawn, 30, 30, 30, 30, cv2.BORDER_CONSTANT, value=(255,)), (0, 0), 0.8)
    found = find_corners(to_grey(image).values, board)
    assert len(found) == 35
    # Edges between pixels: a square of 100 px begins at a multiple of 100, less half a pixel.
    np.testing.assert_allclose(found.pixels, 29.5 + 5 * board.corners, atol=0.003)


def test_nothing_found_has_the_shapes_of_something():
    found = find_board(np.full((100, 120), 90, dtype=np.uint8), BOARD)
    assert found.corners.shape == (0, 2)
    assert found.markers.corners.shape == (0, 4, 2)
    assert len(find_corners(np.full((100, 120), 0.4, dtype=np.float32), BOARD)) == 0
