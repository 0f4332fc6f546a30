"""What a camera sees of an ellipse's edge, or of a bright line along it: the profile across the boundary, blurred.

Along a straight boundary it is an error function (a Gaussian). A curved one adds a shift, which is known to second
order (`curved`), and where the curvature is strong against the blur, a remainder that is computed by rendering the
ellipse (`rendered`).
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from planeopt.spot.outline import Outline
from planeopt.spot.points import Kind

Array = NDArray[np.float64]

# Curvature times width: below, what the shift leaves moves the boundary by less than 5e-4 px.
_GENTLE = {"disc": 0.03, "ring": 0.015}
_SOFT = 1.2  # px: blur that a third of a pixel resolves
_TINY, _SMALL = 5_000, 10_000  # pixels
_THINNEST = 0.3  # px: a line that the rendered grid still resolves


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
    step, offset = 1.0 / factor, (factor - 1) / 2
    x = x0 - margin + (np.arange((x1 - x0 + 2 * margin) * factor) - offset) * step - outline.x
    y = (y0 - margin + (np.arange((y1 - y0 + 2 * margin) * factor) - offset) * step - outline.y)[:, None]
    (c, _), (s, _) = outline.axes
    p, q = (c * x + s * y) / outline.a, (c * y - s * x) / outline.b
    rho = np.hypot(p, q)
    if kind == "ring":
        line = max(line, _THINNEST)
        light = np.exp(-(((rho - 1) * outline.size / line) ** 2) / 2) / line
    elif line > _THINNEST:
        light = ndtr((1 - rho) * outline.size / line)
    else:
        slope = np.hypot(p / outline.a, q / outline.b) / np.maximum(rho, 1e-9)
        # The pixel's part inside, for a boundary that is straight within it; its own width is taken from the blur.
        light = np.clip(0.5 - (rho - 1) / np.maximum(slope, 1e-9) / step, 0.0, 1.0)
        blur = np.sqrt(max(blur**2 + line**2 - step**2 / 12, 1e-4))
    blurred = cv2.GaussianBlur(light.astype(np.float32), (0, 0), blur * factor, borderType=cv2.BORDER_REPLICATE)
    inside = slice(margin * factor + factor // 2, -margin * factor, factor)
    return np.asarray(blurred[inside, inside], dtype=np.float64)


def _fineness(kind: Kind, blur: float, line: float, pixels: int) -> int:
    """Return how many sub-pixels a pixel is rendered in; odd, so that one of them lies at its centre."""
    if kind == "ring":
        # A Gaussian is told by samples as far apart as its standard deviation, to 1e-8.
        return 2 * int(np.ceil((1 / min(blur, max(line, _THINNEST)) - 1) / 2)) + 1 if min(blur, line) < 1 else 1
    # A sharp edge: the sub-pixels' own error, 1e-3 px, averages out along a long boundary.
    return 9 if pixels < _TINY else 5 if blur < _SOFT or pixels < _SMALL else 3
