"""A board before a rig: where its corners and the spot on it lie in the image, exactly, the board's bow included."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board
from planeopt.rig import Rig, distort

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Complex steps have no cancellation: any step that does not underflow gives derivatives to rounding.
_COMPLEX_STEP = 1e-30


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """Where a board was, view by view.

    Parameters
    ----------
    rotations : (V, 3, 3) ndarray
        From the board frame to the camera frame.
    translations : (V, 3) ndarray
        The board frame's origin in the camera frame, mm.
    """

    rotations: Array
    translations: Array

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.rotations)

    def some(self, chosen: slice | NDArray[np.intp] | Mask) -> "BoardPoses":
        """Return some of the poses, by index."""
        return BoardPoses(self.rotations[chosen], self.translations[chosen])


@dataclass(frozen=True, eq=False)
class BoardView:
    """One pose of a board before a rig.

    Parameters
    ----------
    rig : Rig
        Its covariance is not used; without a beam there is no spot.
    board : Board
    rotation : (3, 3) ndarray
        From the board frame to the camera frame.
    translation : (3,) ndarray
        mm.
    warp : (float, float)
        By how much the board's middle lies behind its edges along x and along y, mm, see `Board.bow`.
    divergence : float
        Growth of the beam's radius per length along its axis, from (e_x, e_y, 0) where it is the rig's radius.
    """

    rig: Rig
    board: Board
    rotation: Array
    translation: Array
    warp: tuple[float, float] = (0.0, 0.0)
    divergence: float = 0.0

    def in_space(self, points: Array) -> Array:
        """Return points (N, 3) in the camera frame, mm, of places (N, 2) on the board, mm."""
        depth = self.board.bow(points) @ np.array(self.warp)
        return np.concatenate([points, depth[:, None]], axis=1) @ self.rotation.T + self.translation

    def pixels(self, space: Array) -> tuple[Array, Mask]:
        """Return the raw pixels (N, 2) of points (N, 3) in the camera frame, and which of them the image shows.

        A point behind the camera or where the lens folds over has the pixel (-1e9, -1e9).
        """
        z = space[:, 2:]
        before = z[:, 0] > 0
        normalised = space[:, :2] / np.where(z > 0, z, 1.0)
        before &= np.hypot(normalised[:, 0], normalised[:, 1]) < self.rig.camera.invertible_radius
        px = np.where(before[:, None], self.rig.camera.project(np.where(before[:, None], normalised, 0.0)), -1e9)
        return px, self.in_image(px)

    def in_image(self, px: Array, margin: float = 0.0) -> Mask:
        """Whether pixels (N, 2) lie on the sensor, so many pixels away from its border."""
        low, high = -0.5 + margin, np.array(self.rig.camera.image_size) - 0.5 - margin
        return np.all((px >= low) & (px < high), axis=1)

    @cached_property
    def corners(self) -> tuple[Array, Mask]:
        """Raw pixels (K, 2) of the inner corners, and which of them are printed and in the image."""
        px, seen = self.pixels(self.in_space(self.board.corners))
        return px, seen & self.board.printed & self.faces

    @property
    def faces(self) -> bool:
        """Whether the camera looks at the board's printed side."""
        middle = self.in_space(np.array(self.board.size_mm)[None] / 2)[0]
        return bool(middle @ self.rotation[:, 2] > 0)

    def meet(self, origin: Array, direction: Array) -> Array:
        """Return where lines meet the bowed board, board frame (..., 3); NaN where they miss it.

        Parameters
        ----------
        origin, direction : ndarray, shape (..., 3)
            Camera frame, mm; real or complex.
        """
        a, b = (origin - self.translation) @ self.rotation, direction @ self.rotation
        half = np.array(self.board.size_mm) / 2
        w = np.array(self.warp)
        u, v = a[..., :2] / half - 1, b[..., :2] / half
        # The bow is a parabola, so the line's depth below it is quadratic; of its roots the one of the plane.
        c0 = a[..., 2] - (1 - u * u) @ w
        c1 = b[..., 2] + 2 * (u * v) @ w
        c2 = (v * v) @ w
        root = c1 * c1 - 4 * c0 * c2
        with np.errstate(invalid="ignore", divide="ignore"):
            along = -2 * c0 / (c1 + np.sign(c1.real) * np.sqrt(np.where(root.real > 0, root, np.nan)))
        return a + along[..., None] * b

    def spot_on_board(self, theta: Array, radii: float = 1.0) -> Array:
        """Return the spot's outline (N, 3), board frame, mm, at angles (N,) round the beam; see `BoardView.outline`."""
        beam = self.rig.require_beam()
        across = np.cos(theta)[:, None] * self.rig.Q[0] + np.sin(theta)[:, None] * self.rig.Q[1]
        start = np.array([*beam.offset, 0.0]) + radii * beam.radius * across
        return self.meet(start, np.array(beam.direction) + radii * self.divergence * across)

    def outline(self, theta: Array, radii: float = 1.0) -> tuple[Array, Array]:
        """Return the spot's boundary in the image.

        Parameters
        ----------
        theta : ndarray, shape (N,)
            Angles round the beam, from the laser-parallel frame's x.
        radii : float
            Of the mantle over the beam's radius.

        Returns
        -------
        px : ndarray, shape (N, 2)
            Raw pixels.
        normals : ndarray, shape (N, 2)
            Unit normals of the boundary in the image, outwards.
        """
        camera = self.rig.camera
        turned: Any = theta + 1j * _COMPLEX_STEP
        on_board: Any = self.spot_on_board(turned, radii)
        space = on_board @ self.rotation.T + self.translation
        xd, yd = distort(space[:, 0] / space[:, 2], space[:, 1] / space[:, 2], *camera.distortion)
        px: Any = np.stack([camera.fx * xd + camera.cx, camera.fy * yd + camera.cy], axis=1)
        tangent = px.imag / _COMPLEX_STEP
        normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
        return px.real, normals

    def spot_state(self, margin_mm: float = 0.0, margin_px: float = 0.0) -> str:
        """Return "seen" where the whole spot lies in the window and in the image, or else why not.

        On a board without a window the spot may lie anywhere on it.
        """
        theta = np.linspace(0, math.tau, 48, endpoint=False)
        on_board = self.spot_on_board(theta)
        x, y, width, height = self.board.window_mm or (0.0, 0.0, *self.board.size_mm)
        past = on_board[:, :2] - [x, y]
        if not np.all((past >= margin_mm) & (past <= np.array([width, height]) - margin_mm)):
            return "off the window" if self.board.window_mm else "off the board"
        space = on_board @ self.rotation.T + self.translation
        px, seen = self.pixels(space)
        lit = float(np.array(self.rig.require_beam().direction) @ self.rotation[:, 2]) > 0
        if not (self.faces and lit):
            return "behind the board"
        return "seen" if bool(np.all(seen & self.in_image(px, margin_px))) else "off the image"
