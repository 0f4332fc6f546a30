"""From samples of an image to places on a board, bowed or not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.rig import Camera
from planeopt.simulation.board_views import BoardView
from planeopt.simulation.sampling import Sampling

Array = NDArray[np.float64]
Box = tuple[slice, slice]

_STRIP = 64
"""Rows of pixels to invert the lens at, at a time."""
# Of the board: beyond so many times its size nothing of it is near.
_BEYOND = 20.0


@dataclass(frozen=True, eq=False)
class Grid:
    """The samples of an image, s a pixel and axis, with a margin round it.

    Attributes
    ----------
    sampling : Sampling
    rays : (2, s (H + 2 m), s (W + 2 m)) ndarray
        Normalised coordinates.
    """

    sampling: Sampling
    rays: Array

    def box(self, left: int, top: int, right: int, bottom: int) -> Box:
        """Return rows and columns of the samples that the pixels of a box take light from."""
        s, margin = self.sampling.factor, self.sampling.margin
        return slice(top * s, (bottom + 2 * margin) * s), slice(left * s, (right + 2 * margin) * s)


def grid_of(camera: Camera, sampling: Sampling) -> Grid:
    """Return the samples of a camera's image.

    Raises
    ------
    InputError
        If the lens cannot be inverted over the image and the margin round it.
    """
    s, margin = sampling.factor, sampling.margin
    width, height = camera.image_size
    rows, columns = height + 2 * margin, width + 2 * margin
    rays = np.empty((2, rows, s, columns, s))
    for top in range(0, rows, _STRIP):
        bottom = min(top + _STRIP, rows)
        # A row more on either side, for the derivatives.
        y, x = np.mgrid[top - margin - 1 : bottom - margin + 1, -margin - 1 : columns - margin + 1].astype(np.float64)
        normalised, jacobian = camera.normalise(np.stack([x, y], axis=-1))
        # The lens is smooth: to second order over half a pixel it is exact to 1e-9 px.
        by_x, by_y = jacobian[..., 0], jacobian[..., 1]
        xx, xy, yy = np.gradient(by_x, axis=1), np.gradient(by_x, axis=0), np.gradient(by_y, axis=0)
        terms = [np.moveaxis(part[1:-1, 1:-1], -1, 0) for part in (normalised, by_x, by_y, xx / 2, xy, yy / 2)]
        for i, dy in enumerate(sampling.offsets):
            for j, dx in enumerate(sampling.offsets):
                weights = (1.0, dx, dy, dx * dx, dx * dy, dy * dy)
                rays[:, top:bottom, i, :, j] = sum(weight * term for weight, term in zip(weights, terms, strict=True))
    return Grid(sampling, rays.reshape(2, rows * s, columns * s))


@dataclass(frozen=True, eq=False)
class Cast:
    """Where rays meet the board.

    Attributes
    ----------
    x, y : (h, w) ndarray
        Board frame, mm; far off where a ray does not meet the board's front.
    depth : (h, w) ndarray
        z in the camera frame, mm; 0 where a ray does not meet the board's front.
    """

    x: Array
    y: Array
    depth: Array


def cast(view: BoardView, x: Array, y: Array) -> Cast:
    """Return where rays with normalised coordinates x, y (h, w) meet the board of a view."""
    R = view.rotation
    origin = -view.translation @ R
    size = np.array(view.board.size_mm)
    half, w = size / 2, np.array(view.warp)
    b = [R[0, k] * x + R[1, k] * y + R[2, k] for k in range(3)]
    if view.warp == (0.0, 0.0):
        c0, slope = float(origin[2]), b[2]
        met = (slope > 0) & (c0 < 0)
        depth = np.where(met, -c0 / np.where(met, slope, 1.0), 0.0)
    else:
        # As in `BoardView.meet`: the bow is a parabola, the depth below it quadratic along the ray.
        u, v = origin[:2] / half - 1, [b[0] / half[0], b[1] / half[1]]
        c0 = float(origin[2] - (1 - u * u) @ w)
        c1 = b[2] + 2 * (w[0] * u[0] * v[0] + w[1] * u[1] * v[1])
        root = c1 * c1 - 4 * c0 * (w[0] * v[0] * v[0] + w[1] * v[1] * v[1])
        met = (c1 > 0) & (root > 0) & (c0 < 0)
        depth = np.where(met, -2 * c0 / np.where(met, c1 + np.sqrt(np.where(met, root, 1.0)), 1.0), 0.0)
    across, down = (
        np.where(met, np.clip(origin[k] + depth * b[k], -_BEYOND * size[k], _BEYOND * size[k]), _BEYOND * size[k])
        for k in range(2)
    )
    return Cast(across, down, depth)
