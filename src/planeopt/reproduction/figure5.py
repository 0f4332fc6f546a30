"""Figure 5: the image ellipse, and what rounding leaves of the points' distances from it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.conic import eccentric_angles, sampson_distances
from planeopt.plane import SpotPose
from planeopt.reproduction.results import Reproduction
from planeopt.reproduction.style import SECOND, TRUE, new_figure

Array = NDArray[np.floating]

_TURN = np.linspace(0, 2 * np.pi, 721)
_NANOMETRE = 1e-6  # in mm
_PLANE = {"color": TRUE, "lw": 5.0, "alpha": 0.45}
_OTHER = {"color": SECOND, "lw": 1.6, "ls": (0, (4, 2.5))}
_POINT = {"color": "black", "ls": "none", "marker": "o", "ms": 5.0, "mfc": "white", "mew": 1.1}


def figure5(result: Reproduction) -> Figure:
    """Draw Table 1's points, the images of both planes, and the distances of all three from the fitted ellipse (16)."""
    with new_figure(9.6, 8.0, "Figure 5: the image of the spot, which the second plane shares") as figure:
        image, distances = figure.subplots(2, 1, height_ratios=(1, 1.05))
        first = _image_of(eq.PaperVariables(*result.answers[0].found))
        second = _image_of(_variables(result.second_plane.from_table_1))
        _draw_image(image, first, second)
        _draw_distances(distances, first, second, result.problem.B)
        handles, labels = distances.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def _variables(pose: SpotPose) -> eq.PaperVariables:
    return eq.PaperVariables(pose.R, pose.z_L, pose.alpha, pose.beta or 0.0)


def _image_of(v: eq.PaperVariables) -> Array:
    """Image (n, 2) of a spot's boundary, mm."""
    return np.stack(eq.image_point(np, paper.SETUP, *eq.spot_point(np, v, paper.SETUP, _TURN)), axis=1)


def _draw_image(axes: Axes, first: Array, second: Array) -> None:
    axes.plot(*first.T, **_PLANE)
    axes.plot(*second.T, **_OTHER)
    axes.plot(*paper.table_1().T, **_POINT)
    axes.invert_yaxis()
    axes.grid()
    axes.set(aspect="equal", xlabel="$x_i$ (mm)", ylabel="$y_i$ (mm)")
    axes.set_title(f"On the image plane, z = f = {paper.SETUP.f:g} mm")


def _draw_distances(axes: Axes, first: Array, second: Array, B: Array) -> None:
    """Distances from the fitted ellipse against the angle round it; rounding moves a point within the grey band."""
    angle, reach = _round_the_ellipse(B, first, _largest_rounding(B, first))
    axes.fill_between(angle, -reach, reach, color="0.91", lw=0, label="reach of rounding")
    axes.axhline(0, color="black", lw=0.8, label="fitted ellipse (16)")
    axes.plot(*_round_the_ellipse(B, first, sampson_distances(B, first)), label="the plane", **_PLANE)
    axes.plot(*_round_the_ellipse(B, second, sampson_distances(B, second)), label="the second plane", **_OTHER)
    points = paper.table_1()
    axes.plot(*_round_the_ellipse(B, points, sampson_distances(B, points)), label="Table 1", **_POINT)
    axes.set(xlim=(-180, 180), xticks=range(-180, 181, 45))
    axes.set(xlabel="angle round the ellipse (deg)", ylabel="distance from it (nm)")
    axes.set_title("Outwards from the ellipse fitted to Table 1, whose last decimal is 100 nm")


def _round_the_ellipse(B: Array, points: Array, distances: Array) -> tuple[Array, Array]:
    """Angles round the ellipse (deg), rising, and the distances (nm) there."""
    angle = np.degrees(eccentric_angles(B, points))
    angle = np.remainder(angle + 180, 360) - 180
    order = np.argsort(angle)
    return angle[order], distances[order] / _NANOMETRE


def _largest_rounding(B: Array, points: Array) -> Array:
    """Largest distance (mm) along the normal that rounding both coordinates moves a point."""
    x, y = points.T
    gradient = np.stack([2 * x + B[0] * y + B[2], B[0] * x + 2 * B[1] * y + B[3]])
    return paper.ROUNDING * np.sum(np.abs(gradient), axis=0) / np.linalg.norm(gradient, axis=0)
