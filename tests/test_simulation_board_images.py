"""Images of boards: corners, print and spot are where the truth says, by other means than a detector."""

from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from planeopt.board import Board
from planeopt.errors import InputError
from planeopt.plane import Plane
from planeopt.rig import Beam, Camera, Rig
from planeopt.simulation import (
    BeamProfile,
    BoardPoses,
    BoardScene,
    BoardSurface,
    Noise,
    Optics,
    Scene,
    Sensor,
    Surface,
    aimed,
    board_light,
    clean_light,
    render_board,
    render_session,
    tilted,
)
from simulation_cases import DISTORTION, SILENT, SLANTED, in_px, kernel

Array = NDArray[np.float64]

RIG = Rig(Camera((480, 360), 680.0, 680.0, 248.0, 177.0, DISTORTION), Beam(6.0, (18.0, -9.0), SLANTED))
BOARD = Board((11, 9), (10.0, 10.0), 7.5, "DICT_4X4_100", window_mm=(30.0, 30.0, 50.0, 30.0))
AT = np.array([54.0, 45.5])
FLAT, SURFACE = (0.0, 0.0), BoardSurface(white=0.5, black=0.06)


def scene(**parts: object) -> BoardScene:
    plain = BoardScene(RIG, BOARD, SURFACE, optics=Optics(blur_px=0.8), noise=SILENT)
    return replace(plain, **parts)


def pose(tilt: float = 35.0, direction: float = 50.0, turn: float = 12.0, depth: float = 190.0) -> tuple[Array, Array]:
    R = tilted(*np.radians([tilt, direction, turn]))
    return R, aimed(RIG, R, depth, AT)


def opencv_pixels(R: Array, t: Array, space: Array) -> Array:
    camera = RIG.camera
    px, _ = cv2.projectPoints(space, cv2.Rodrigues(R)[0], t, camera.matrix, np.array(camera.distortion))
    return np.asarray(px, dtype=np.float64).reshape(-1, 2)


def saddle(light: Array, at: Array, half: float = 4.0) -> Array:
    """The centre of point symmetry of the light near a place: what a corner is to first order, whatever its blur."""
    x0, y0 = np.rint(at).astype(int)
    m = 12
    box = light[y0 - m : y0 + m + 1, x0 - m : x0 + m + 1]
    spline = RectBivariateSpline(np.arange(y0 - m, y0 + m + 1), np.arange(x0 - m, x0 + m + 1), box)
    dx, dy = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(-half, half, 33)]))
    weight = np.exp(-(dx**2 + dy**2) / (2 * (half / 2) ** 2))
    c = at.copy()
    for _ in range(10):
        ahead, behind = (spline(c[1] + sign * dy, c[0] + sign * dx, grid=False) for sign in (1, -1))
        # What is odd about the place must vanish; its derivative with the place, by differences of the light.
        slopes = [
            spline(c[1] + dy, c[0] + dx, dx=order[0], dy=order[1], grid=False)
            - spline(c[1] - dy, c[0] - dx, dx=order[0], dy=order[1], grid=False)
            for order in ((0, 1), (1, 0))
        ]
        # odd(d) = light(c + d) - light(c - d), and moving c changes it by the difference of the slopes.
        A = np.stack(slopes, axis=1) * weight[:, None]
        step = np.linalg.lstsq(A, -(ahead - behind) * weight, rcond=None)[0]
        c = c + step
        if np.linalg.norm(step) < 1e-6:
            break
    return c


@pytest.mark.parametrize("warp", [FLAT, (0.6, -0.4)])
def test_corners_are_where_the_pose_puts_them(warp: tuple[float, float]):
    R, t = pose()
    light = board_light(scene(warp=warp), R, t, laser=False)
    view = scene(warp=warp).view(R, t)
    space = np.column_stack([BOARD.corners, BOARD.bow(BOARD.corners) @ warp])
    expected = opencv_pixels(R, t, space)
    seen = view.corners[1] & view.in_image(expected, 15.0)
    assert np.count_nonzero(seen) > 40
    errors = np.array([saddle(light, at) - at for at in expected[seen]])
    # Under perspective a blurred corner is not quite symmetric: to second order in its blur over the depth.
    assert np.max(np.abs(errors)) < 0.02
    assert np.linalg.norm(errors.mean(axis=0)) < 0.003


def test_the_spot_is_that_of_the_plane_simulator():
    """On a flat board's white window: the same light as `clean_light`, written for planes by other means."""
    R, t = pose()
    lit = scene(surface=SURFACE)
    on_board = board_light(lit, R, t) - board_light(lit, R, t, laser=False)
    plane = Scene.of(
        RIG,
        Plane(R[:, 2], t),
        beam=lit.beam,
        optics=lit.optics,
        surface=Surface(background=0.0),
        noise=SILENT,
    )
    difference = on_board - clean_light(plane)
    assert np.max(np.abs(in_px(difference / lit.beam.height, plane))) < 1e-3
    # A soft edge, and a ring.
    for beam in (BeamProfile(edge_mm=0.1), BeamProfile(edge_mm=0.6), BeamProfile(kind="ring", line_mm=0.35)):
        lit = scene(beam=beam)
        on_board = board_light(lit, R, t) - board_light(lit, R, t, laser=False)
        difference = on_board - clean_light(msgspec.structs.replace(plane, beam=beam))
        assert np.max(np.abs(difference)) < 1e-3 * beam.height


@pytest.mark.parametrize(("warp", "divergence"), [(FLAT, 0.0), ((1.5, -1.0), 3e-3)])
def test_the_spots_boundary_is_at_half_of_its_light(warp: tuple[float, float], divergence: float):
    """Across the outline of a large spot, on a bowed board and in a divergent beam; less what blur moves it."""
    R, t = pose(tilt=25.0)
    bowed = scene(warp=warp, divergence=divergence)
    light = board_light(bowed, R, t) - board_light(bowed, R, t, laser=False)
    theta = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    px, normals = bowed.view(R, t).outline(theta)
    height, width = light.shape
    spline = RectBivariateSpline(np.arange(height), np.arange(width), light / bowed.beam.height)
    reach = np.linspace(-4, 4, 161)
    across = px[:, None] + reach[:, None] * normals[:, None]
    profile = spline(across[..., 1], across[..., 0], grid=False)
    # The area under the profile is where a sharp edge of height 1 would be.
    place = np.trapezoid(profile, reach, axis=1) + reach[0]
    variance = bowed.optics.blur_px**2 + 1 / 12
    radius = np.linalg.norm(px - px.mean(axis=0), axis=1)
    assert np.max(np.abs(place)) < 0.02 + variance / (2 * radius.min())
    assert abs(np.mean(place)) < 0.003 + variance / (2 * radius.mean())
    if warp != FLAT:
        flat = scene().view(R, t).outline(theta)[0]
        assert np.max(np.linalg.norm(flat - px, axis=1)) > 1.0


def test_the_print_is_opencvs():
    """Pixels by hard sampling of the image that OpenCV draws of the board, far more finely than the renderer."""
    R, t = pose(depth=230.0)
    cell = 40
    charuco = cv2.aruco.CharucoBoard(
        BOARD.squares, 10.0, 7.5, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    )
    drawn = charuco.generateImage((BOARD.squares[0] * cell, BOARD.squares[1] * cell)) > 127
    light = board_light(scene(), R, t, laser=False) / SURFACE.white
    rng = np.random.default_rng(0)
    # Pixels of the first two rows of squares, where there is no window.
    space = np.column_stack([rng.uniform(5, 105, 60), rng.uniform(5, 15, 60), np.zeros(60)])
    pixels = np.rint(opencv_pixels(R, t, space)).astype(int)
    pixels = pixels[np.all((pixels > 10) & (pixels < [470, 350]), axis=1)]
    per, span = 12, 5
    offsets = (np.arange(2 * span * per) + 0.5) / per - span
    weights = kernel(offsets, 0.8) / per
    for x, y in pixels:
        grid = np.stack(np.meshgrid(x + offsets, y + offsets), axis=-1)
        rays = np.concatenate([RIG.camera.normalise(grid)[0], np.ones((*grid.shape[:2], 1))], axis=-1) @ R
        depth = (t @ R)[2] / rays[..., 2]
        place = rays[..., :2] * depth[..., None] - (t @ R)[:2]
        inside = np.all((place >= 0) & (place < BOARD.size_mm), axis=-1)
        index = np.where(inside[..., None], place / 10.0 * cell, 0).astype(int)
        reflectance = np.where(inside & ~drawn[index[..., 1], index[..., 0]], SURFACE.black, 1.0)
        # Hard samples, 12 a pixel: the edge through a pixel is known to 1/24 px or so on average over its length.
        assert light[y, x] == pytest.approx(float(weights @ reflectance @ weights), abs=0.006)


def test_light_noise_and_twins():
    R, t = pose()
    noisy = scene(noise=Noise(full_well_electrons=8000.0, read=0.003), sensor=Sensor(bits=8))
    first, again = (render_board(noisy, R, t, seed=3) for _ in range(2))
    assert first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert not np.array_equal(first, render_board(noisy, R, t, seed=4))
    dark = render_board(noisy, R, t, laser=False, seed=3)
    x, y = np.rint(noisy.view(R, t).outline(np.linspace(0, 6, 12))[0].mean(axis=0)).astype(int)
    assert first[y, x] > dark[y, x] + 60
    far = np.ones(first.shape, dtype=bool)
    far[y - 60 : y + 60, x - 60 : x + 60] = False
    assert abs(float(first[far].mean()) - float(dark[far].mean())) < 0.05
    assert not np.array_equal(first[far], dark[far])
    deep = render_board(scene(sensor=Sensor(bits=12)), R, t)
    assert deep.dtype == np.uint16
    colour = render_board(scene(sensor=Sensor(color=True)), R, t)
    assert colour.shape == (360, 480, 3)
    assert colour[y, x, 2] > colour[y, x, 0] + 40
    one, other = list(render_session(noisy, BoardPoses(np.stack([R, R]), np.stack([t, t])), seed=1))
    assert not np.array_equal(one, other)


def test_the_laser_lights_what_it_meets():
    R, t = pose()
    # On a board without a window the print shows under the spot.
    plain = replace(BOARD, window_mm=None)
    light = board_light(scene(board=plain), R, t) - board_light(scene(board=plain), R, t, laser=False)
    inside = light[light > 0.001]
    assert np.percentile(inside, 20) < 0.1 * inside.max()
    away = t + 400 * R[:, 0]
    assert np.array_equal(board_light(scene(), R, away), board_light(scene(), R, away, laser=False))
    camera_only = scene(rig=Rig(RIG.camera))
    assert np.array_equal(board_light(camera_only, R, t), board_light(scene(), R, t, laser=False))


def test_what_cannot_be_sampled_is_refused():
    R, t = pose()
    with pytest.raises(InputError, match="narrowest"):
        board_light(scene(beam=BeamProfile(kind="ring", line_mm=0.01)), R, t)
    thin = Rig(RIG.camera, replace(RIG.require_beam(), radius=0.2))
    with pytest.raises(InputError, match="tips"):
        board_light(scene(rig=thin), R, t)
