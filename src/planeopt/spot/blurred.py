"""What a camera sees of an ellipse's edge, or of a bright line along it: the profile across the boundary, blurred.

Along a straight boundary it is an error function (a Gaussian). A curved one adds a shift, which is known to second
order (`curved`), and where the curvature is strong against the blur, a remainder that is computed by rendering the
ellipse (`rendered`).
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive, ndtr

from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind
from planeopt.spot.strip import pixels_inside, pixels_near

Array = NDArray[np.float64]

# Curvature times width: below, what the shift leaves moves the boundary by less than 5e-4 px.
_GENTLE = {"disc": 0.03, "ring": 0.015}
_SOFT = 1.2  # px: blur that a third of a pixel resolves
_TINY, _SMALL = 5_000, 10_000  # pixels
_THINNEST = 0.3  # px: a line that the rendered grid still resolves
_TOLD, _ROUGH = 0.8, 1e-4  # samples in a line's standard deviation; what a kernel's fourth cumulant may leave
_REACH = 5.5  # standard deviations: beyond, a line has 3e-7 of its light


def profile(kind: Kind, x: Array, width: Array) -> tuple[Array, Array]:
    """Return the profile (N,) at distances x (N,) outside the boundary, px, and its slope inwards, ``-d/dx`` (N,).

    Parameters
    ----------
    kind : {"disc", "ring"}
        Of a disc: 1 inside, 0 outside, 1/2 at the boundary; of a ring: 1 on it.
    x : (N,) array
    width : (N,) array
        Standard deviation, px.
    """
    q = x / width
    bell = np.exp(-(q**2) / 2)
    if kind == "disc":
        return ndtr(-q), bell / (np.sqrt(2 * np.pi) * width)
    return bell, bell * q / width


def curved(u: Array, curvature: Array, blur: Array | float) -> Array:
    """Return by how much blur makes points at distance `u` (N,) look further outside, px.

    A point displaced by an isotropic Gaussian of standard deviation ``blur`` is on average ``blur^2 / 2d`` further from
    the centre of curvature, ``d = 1/curvature + u``, than it was: the shift of a blurred circle's half height.

    Parameters
    ----------
    u : (N,) array
        Distance from the boundary, px, positive outside.
    curvature : (N,) array
        Of the boundary at the nearest point, 1/px.
    blur : (N,) array or float
        Of the camera alone, px.
    """
    # Inside by more than half the radius of curvature there is no edge to shift.
    return blur**2 / 2 * curvature / np.maximum(1 + curvature * u, 0.5)


def is_gentle(kind: Kind, outline: Outline, width: float) -> bool:
    """Whether `curved` says all there is to say."""
    return outline.a / outline.b**2 * width < _GENTLE[kind]


def rendered(kind: Kind, outline: Outline, blur: float, line: float, box: tuple[int, int, int, int]) -> Array:
    """Return the profile at each pixel of a box, from the rendered ellipse.

    Parameters
    ----------
    kind : {"disc", "ring"}
    outline : Outline
    blur : float
        Standard deviation of the camera's blur, pixel included, px.
    line : float
        Standard deviation of the beam's own edge or line, px, where its scale is the mean one; it grows in proportion
        to the scale, as a beam's does. A ring's is at least 0.3 px.
    box : tuple of int
        ``x0, y0, x1, y1``, upper ends excluded.

    Returns
    -------
    (y1 - y0, x1 - x0) array
        1 on a disc's plateau; of a ring, light of unit peak before the blur, divided by `line`.
    """
    x0, y0, x1, y1 = box
    factor = _fineness(kind, blur, line, (x1 - x0) * (y1 - y0))
    margin = int(np.ceil(4 * blur)) + 1
    # The same ellipse in a grid of sub-pixels, which begins a margin before the box.
    x, y = (factor * (place + margin) + (factor - 1) / 2 for place in (outline.x - x0, outline.y - y0))
    fine = Outline(x, y, factor * outline.a, factor * outline.b, outline.angle)
    whole = (0, 0, (x1 - x0 + 2 * margin) * factor, (y1 - y0 + 2 * margin) * factor)
    light = np.zeros((whole[3], whole[2]), dtype=np.float32)
    if kind == "disc":
        light[pixels_inside(fine, whole)] = 1.0
    sharp = kind == "disc" and line <= _THINNEST
    own, line = line, max(line, _THINNEST)
    reach = 1.0 if sharp else _REACH * factor * line * outline.a / outline.size
    rows, columns = pixels_near(fine, whole, reach, reach)
    p, q = (fine.local(np.stack([columns, rows], axis=1).astype(np.float64)) / [fine.a, fine.b]).T
    rho = np.sqrt(p * p + q * q)
    if kind == "ring":
        light[rows, columns] = np.exp(((rho - 1) * (outline.size / line)) ** 2 * -0.5) / line
    elif sharp:
        slope = np.sqrt((p / fine.a) ** 2 + (q / fine.b) ** 2) / np.maximum(rho, 1e-9)
        # The pixel's part inside, for a boundary that is straight within it; its own width is taken from the blur.
        light[rows, columns] = np.clip(0.5 - (rho - 1) / np.maximum(slope, 1e-12), 0.0, 1.0)
        blur = np.sqrt(max(blur**2 + own**2 - 1 / (12 * factor**2), 1e-4))
    else:
        light[rows, columns] = ndtr((1 - rho) * (outline.size / line))
    # One direction after the other, and of each only what is looked at.
    inside = slice(margin * factor + factor // 2, -margin * factor, factor)
    across = _kernel(float(blur * factor) ** 2)
    none = np.ones(1, dtype=np.float32)
    rows_done = cv2.sepFilter2D(light, cv2.CV_32F, across, none, borderType=cv2.BORDER_REPLICATE)[:, inside]
    done = cv2.sepFilter2D(np.ascontiguousarray(rows_done), cv2.CV_32F, none, across, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(done[inside], dtype=np.float64)


def _kernel(variance: float) -> NDArray[np.float32]:
    """Return a Gaussian (N,) in steps of 1; a narrow one has that variance exactly (Lindeberg's discrete Gaussian)."""
    half = int(np.ceil(4 * np.sqrt(variance))) + 1
    steps = np.arange(-half, half + 1)
    kernel = np.exp(-(steps**2) / (2 * variance)) if variance >= 1 else ive(np.abs(steps), variance)
    return (kernel / kernel.sum()).astype(np.float32)


def _fineness(kind: Kind, blur: float, line: float, pixels: int) -> int:
    """Return how many sub-pixels a pixel is rendered in; odd, so that one of them lies at its centre."""
    if kind == "ring":
        # A line is told by samples 1.25 of its standard deviations apart to 2 exp(-2 pi^2 / 1.25^2) = 7e-6; a kernel by
        # those one apart, and one that is narrower by its variance alone, where the line is smooth enough for that.
        line = max(line, _THINNEST)
        for factor in (1, 3):
            variance, width = (factor * blur) ** 2, factor * line
            if width >= _TOLD and (variance >= 1 or variance / (24 * width**4) < _ROUGH):
                return factor
        return 5
    # A sharp edge: the sub-pixels' own error, 1e-3 px, averages out along a long boundary.
    return 9 if pixels < _TINY else 5 if blur < _SOFT or pixels < _SMALL else 3
