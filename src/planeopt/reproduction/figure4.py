"""Figure 4: the spot in space, and why two planes have its image."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.closed_form import other_plane
from planeopt.plane import SpotPose
from planeopt.reproduction.results import Reproduction
from planeopt.reproduction.searches import stated_plane
from planeopt.reproduction.style import BEAM, SECOND, TRUE, new_figure

Array = NDArray[np.float64]

_DARK_SECOND = "#9c5300"  # for words, which are thinner than lines
_SECOND_DASHES = (0, (4, 1.5))
_TURN = np.linspace(0, 2 * np.pi, 181)


def figure4(result: Reproduction) -> Figure:
    """Draw camera, beam, spot and both planes in space, and their section through the optical axis and the beam's."""
    second = result.second_plane.pose
    with new_figure(13.0, 5.3, "Figure 4: the spot in space, and the two planes that have its image") as figure:
        space, section = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
        _draw_space(space, second)
        _draw_section(section)
    return figure


# --- In space --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _View:
    """Orthographic projection: seen from the camera's right, from above and a little from behind."""

    azimuth: float = np.radians(34)
    elevation: float = np.radians(36)

    def __call__(self, points: Array) -> tuple[Array, Array]:
        """Project points (..., 3) in mm to the page, mm."""
        towards = np.array(
            [
                np.cos(self.elevation) * np.cos(self.azimuth),
                -np.sin(self.elevation),
                -np.cos(self.elevation) * np.sin(self.azimuth),
            ]
        )
        right = np.cross(-towards, [0.0, -1.0, 0.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, -towards)
        return points @ right, points @ up


def _draw_space(axes: Axes, second: SpotPose) -> None:
    view = _View()
    spot, other = _spot(paper.TRUTH), _spot(_paper_variables(second))
    _draw_patch(axes, view, _paper_variables(second), (15, 44), {"color": SECOND, "ls": _SECOND_DASHES}, 0.10)
    _draw_patch(axes, view, paper.TRUTH, (24, 33), {"color": TRUE}, 0.16)
    _draw_beam(axes, view, spot)
    axes.fill(*view(spot), fc=BEAM, alpha=0.45, lw=0)
    axes.plot(*view(spot), color=TRUE, lw=2.0)
    axes.plot(*view(other), color=SECOND, lw=1.8, ls=_SECOND_DASHES)
    _draw_camera(axes, view, spot)
    _label_space(axes, view)
    axes.set_title("In space: camera, beam and spot; both planes, cut out round the spot", pad=14)
    axes.set(aspect="equal")
    axes.set_axis_off()


def _paper_variables(pose: SpotPose) -> eq.PaperVariables:
    return eq.PaperVariables(pose.R, pose.z_L, pose.alpha, pose.beta or 0.0)


def _spot(v: eq.PaperVariables) -> Array:
    """Boundary (n, 3) of the spot by (3)."""
    return np.stack(eq.spot_point(np, v, paper.SETUP, _TURN), axis=-1)


def _draw_patch(
    axes: Axes, view: _View, v: eq.PaperVariables, half: tuple[float, float], look: dict, alpha: float
) -> None:
    """Draw a piece of a plane round its spot: half sides along and across the tilt axis, mm."""
    centre = np.array([paper.SETUP.e_x, paper.SETUP.e_y, v.z_L])
    along = np.array([np.cos(v.beta), np.sin(v.beta), 0.0]) * half[0]
    across = np.array([-np.sin(v.beta) * np.cos(v.alpha), np.cos(v.beta) * np.cos(v.alpha), np.sin(v.alpha)]) * half[1]
    corners = np.array([centre + i * along + j * across for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))])
    axes.fill(*view(corners), fc=look["color"], alpha=alpha, lw=0)
    axes.plot(*view(corners), lw=1.2, **look)


def _draw_beam(axes: Axes, view: _View, spot: Array) -> None:
    """Draw the cylinder from z = 0 to the spot, by its two outermost lines on the page."""
    foot = spot * [1, 1, 0]
    u, v = view(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    along = np.array([u[1] - u[0], v[1] - v[0]])
    side = np.stack(view(foot), axis=-1) @ np.array([-along[1], along[0]])
    ends = [int(np.argmin(side)), int(np.argmax(side))]
    for i in ends:
        axes.plot(*view(np.array([foot[i], spot[i]])), color=BEAM, lw=1.2)
    axes.plot(*view(foot), color=BEAM, lw=1.0)
    first, last = sorted(ends)
    near = np.concatenate([foot[first : last + 1], spot[last : first - 1 if first else None : -1]])
    axes.fill(*view(near), fc=BEAM, alpha=0.10, lw=0)
    axis = np.array([[paper.SETUP.e_x, paper.SETUP.e_y, 0.0], [paper.SETUP.e_x, paper.SETUP.e_y, paper.TRUTH.z_L]])
    axes.plot(*view(axis), color=BEAM, lw=0.9, ls=(0, (8, 2, 1, 2)))


def _draw_camera(axes: Axes, view: _View, spot: Array) -> None:
    """Draw the optical axis with its scale, the image plane with the image, and rays to the spot."""
    f = paper.SETUP.f
    image = spot * (f / spot[:, 2:])
    for point in spot[:-1:30]:
        axes.plot(*view(np.array([np.zeros(3), point])), color="0.55", lw=0.6, zorder=1.5)
    frame = np.array([[-4, -4, f], [24, -4, f], [24, 24, f], [-4, 24, f], [-4, -4, f]], dtype=float)
    axes.fill(*view(frame), fc="white", alpha=0.75, lw=0)
    axes.plot(*view(frame), color="0.35", lw=1.0)
    axes.fill(*view(image), fc=BEAM, alpha=0.55, lw=0)
    axes.plot(*view(image), color="black", lw=1.0)
    axes.plot(*view(np.array([[0.0, 0, 0], [0, 0, 120]])), color="black", lw=1.0)
    axes.plot(*view(np.zeros((1, 3))), "o", color="black", ms=6)


def _label_space(axes: Axes, view: _View) -> None:
    for z in (50, 75, 100):
        tick = np.array([[0.0, -1.2, z], [0.0, 1.2, z]])
        axes.plot(*view(tick), color="black", lw=1.0)
        _text(axes, view, (0, -2.5, z), str(z), ha="center", va="bottom", fontsize=9)
    _arrow(axes, view, (0, 0, 120), "z (mm)", ha="right", va="bottom", shift=(0, 6))
    _arrow(axes, view, (22, 0, 0), "x", ha="right", va="top")
    _arrow(axes, view, (0, 22, 0), "y", ha="center", va="top")
    _text(axes, view, (0, 0, 0), "camera", ha="right", va="bottom", shift=(-5, 4))
    _text(axes, view, (-4, -4, 25), "image, z = f = 25 mm", ha="center", va="bottom", shift=(0, 4))
    _text(axes, view, (paper.SETUP.e_x, paper.SETUP.e_y, 0), "beam", ha="right", va="top", shift=(-20, -20), color=BEAM)


def _arrow(axes: Axes, view: _View, tip: tuple, text: str, **place: Any) -> None:
    (x0, x1), (y0, y1) = view(np.array([np.zeros(3), tip], dtype=float))
    axes.annotate(
        "",
        (x1, y1),
        (x0, y0),
        arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.0, "shrinkA": 0, "shrinkB": 0},
    )
    _text(axes, view, tip, text, **place)


def _text(axes: Axes, view: _View, at: tuple, text: str, *, shift: tuple = (0, 0), **look: Any) -> None:
    x, y = view(np.array(at, dtype=float))
    axes.annotate(text, (float(x), float(y)), shift, textcoords="offset points", **look)


# --- In section ------------------------------------------------------------------------------------------------------


def _draw_section(axes: Axes) -> None:
    """Draw the plane of the optical axis and the beam's axis, where each plane is a line and the beam a strip."""
    k = paper.SETUP
    distance = float(np.hypot(k.e_x, k.e_y))
    direction = np.array([k.e_x, k.e_y]) / distance
    near, far = distance - k.r, distance + k.r
    first, second = stated_plane(), other_plane(stated_plane(), k)
    z_of = [lambda s, plane=plane: plane[0] + (plane[1:] @ direction) * (s - distance) for plane in (first, second)]
    s = np.array([-14.0, 74.0])
    axes.fill([-30, -30, z_of[0](far), z_of[0](near)], [near, far, far, near], fc=BEAM, alpha=0.16, lw=0)
    for edge in (near, far):
        axes.plot([-30, z_of[0](edge)], [edge, edge], color=BEAM, lw=1.2)
        axes.plot([z_of[0](edge), 118], [edge, edge], color=BEAM, lw=0.9, ls=(0, (1, 2)))
    for edge in (near, far):
        reach = 112 / max(z_of[0](edge), 1)
        axes.plot([0, reach * z_of[0](edge)], [0, reach * edge], color="0.45", lw=0.9)
    axes.plot(z_of[1](s), s, color=SECOND, lw=2.0, ls=_SECOND_DASHES)
    axes.plot(z_of[0](s), s, color=TRUE, lw=2.4)
    for z, colour in zip(z_of, (TRUE, SECOND), strict=True):
        axes.plot([z(near), z(far)], [near, far], "o", color=colour, ms=5, zorder=3)
        axes.plot(z(0.0), 0.0, "s", color=colour, ms=6, zorder=3)
    axes.plot(0, 0, "o", color="black", ms=7, zorder=4)
    axes.axhline(0, color="black", lw=0.8)
    axes.set(aspect="equal", xlim=(-54, 124), ylim=(78, -20))
    axes.set(xlabel="z (mm)", ylabel="distance from the optical axis (mm)")
    axes.set_title("In section: rays and beam meet in four corners; each plane joins two")
    _label_section(axes, first, second)


def _label_section(axes: Axes, first: Array, second: Array) -> None:
    offset = np.array([paper.SETUP.e_x, paper.SETUP.e_y])
    c, c_second = first[0] - first[1:] @ offset, second[0] - second[1:] @ offset
    notes = (
        (0.0, 0.0, "camera", (-5, -14), "black", "right"),
        (c, 0.0, f"the plane, $c = {c:.1f}$ mm:\ncamera and beam\non one side", (12, 6), TRUE, "left"),
        (
            c_second,
            0.0,
            f"the second, $c' = {c_second:.1f}$ mm:\ncamera behind it, beam before it",
            (0, 10),
            _DARK_SECOND,
            "left",
        ),
        (-30.0, 50.0, "beam", (6, -3), BEAM, "left"),
    )
    for x, y, text, shift, colour, side in notes:
        axes.annotate(
            text, (x, y), shift, textcoords="offset points", color=colour, ha=side, va="baseline", fontsize=9.5
        )
