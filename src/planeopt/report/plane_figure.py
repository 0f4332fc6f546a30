"""The plane in space, with the camera, the beam, the spot, the second plane, and how well the normal is known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.stats
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import NDArray

from planeopt.look import DARK, LIGHT, RED
from planeopt.plane import Plane
from planeopt.report.content import Picture
from planeopt.report.style import ELLIPSE, PAGE_WIDTH, page_figure, picture
from planeopt.rig import Rig
from planeopt.solution import Solution

Array = NDArray[np.float64]

_CAMERA, _BEAM, _PLANE, _SPOT, _OTHER, _NORMAL = "black", RED, "#8fb4d9", ELLIPSE, LIGHT, DARK
_AROUND = np.linspace(0, 2 * np.pi, 73)
_FAR = 2.5  # times the depth: a second plane farther off, or behind the camera, is left out of the picture
_CONE = 14.0  # deg: half opening at which the cone of the normal is drawn, at most
CONE_LEVEL = 0.95


def magnification(opening: float) -> float:
    """Return a round number by which a cone's half opening (rad) grows to what can be seen; 1 where it can be."""
    wanted = np.radians(_CONE) / max(opening, 1e-12)
    if wanted <= 1:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(digit for digit in (1, 2, 5) if digit * power <= wanted * (1 + 1e-9)))


def opening(covariance: Array) -> float:
    """Return the largest half opening of the 95 % cone of a normal with this covariance (3, 3), rad."""
    return float(np.sqrt(scipy.stats.chi2.ppf(CONE_LEVEL, 2) * np.max(np.linalg.eigvalsh(covariance))))


def plane_figure(rig: Rig, solution: Solution) -> Picture | None:
    """Draw the plane of a solution in the camera frame; None where it has none."""
    pose, plane, other = solution.pose, solution.plane, solution.other_plane
    if pose is None or plane is None:
        return None
    beam = rig.require_beam()
    shown = other is not None and 0 < other.pose.z_L < _FAR * pose.z_L
    with page_figure(PAGE_WIDTH, 4.1, constrained=False) as figure:
        scene: Any = figure.add_axes((-0.03, 0.12, 0.6, 0.88), projection="3d", computed_zorder=False)
        near: Any = figure.add_axes((0.59, 0.12, 0.38, 0.88), projection="3d", computed_zorder=False)
        reach = max(3 * pose.R, 0.16 * pose.z_L)
        drawn = [_square(plane, reach), *([_square(other.plane, 0.8 * reach)] if shown and other is not None else [])]
        end = 1.05 * max(float(np.max(corners[:, 2])) for corners in drawn)
        _camera(scene, rig, 0.13 * pose.z_L)
        if shown and other is not None:
            _faces(scene, drawn[1:], _OTHER, 0.25, 1, edge=_OTHER)
            _outline(scene, rig, other.plane, end, 2)
        _faces(scene, drawn[:1], _PLANE, 0.45, 3, edge=_PLANE)
        _beam(scene, rig, 0.0, pose.z_L, 4)
        _spot(scene, rig, plane, _SPOT, 5)
        _axis(scene, plane, 0.22 * pose.z_L, 6)
        middle = np.array([beam.offset[0] / 2, beam.offset[1] / 2])
        side = max(0.17 * end, 1.45 * reach)
        # A box that is nearly a cube would reach into the legend.
        zoom = 1.3 * min(1.0, 0.62 + 0.08 * end / side)
        _frame(scene, (0.0, end), (middle[0] - side, middle[0] + side), (middle[1] - side, middle[1] + side), zoom=zoom)
        scene.view_init(elev=24, azim=-52)
        span = 2.0 * pose.R
        _faces(near, [_square(plane, 0.93 * span)], _PLANE, 0.4, 1, edge=_PLANE)
        _beam(near, rig, pose.z_L - 1.6 * span, pose.z_L, 2)
        _spot(near, rig, plane, _SPOT, 3)
        times = _cone(near, solution, plane, 0.95 * span)
        _axis(near, plane, 1.05 * span, 5)
        centre = plane.point
        _frame(
            near,
            (centre[2] - span, centre[2] + span),
            (centre[0] - span, centre[0] + span),
            (centre[1] - span, centre[1] + span),
            zoom=0.96,
        )
        near.view_init(elev=24, azim=-52)
        _legend(figure, shown=shown, cone=times)
        return picture(figure, "The plane in space, with camera, beam and spot; on the right the spot, larger")


def _placed(points: Array) -> tuple[Array, Array, Array]:
    """Camera coordinates as the axes take them: z to the right, x into the picture, y down."""
    return points[..., 2], points[..., 0], points[..., 1]


def _faces(axes: Axes3D, faces: Sequence[Array], colour: str, alpha: float, order: int, edge: str = "none") -> None:
    collection = Poly3DCollection(
        [np.stack(_placed(face), axis=-1) for face in faces], facecolor=colour, edgecolor=edge, linewidth=0.8
    )
    collection.set_alpha(alpha)
    collection.set_zorder(order)
    axes.add_collection3d(collection)


def _square(plane: Plane, half: float) -> Array:
    """Corners (4, 3) of a square of a plane about its point, one side of it level."""
    first, second = _directions(plane)
    corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * half
    return np.asarray(plane.point + corners @ np.stack([first, second]), dtype=np.float64)


def _directions(plane: Plane) -> tuple[Array, Array]:
    """Two unit vectors of a plane at right angles: the first has no y, so that the square stands upright."""
    level = np.array([plane.normal[2], 0.0, -plane.normal[0]])
    first = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return first, np.cross(plane.normal, first)


def _section(rig: Rig) -> Array:
    """Points (73, 3) of the beam's cross-section about its axis."""
    beam = rig.require_beam()
    ring = np.stack([np.cos(_AROUND), np.sin(_AROUND), np.zeros_like(_AROUND)], axis=1)
    return np.asarray(beam.radius * ring @ rig.Q, dtype=np.float64)


def _beam(axes: Axes3D, rig: Rig, begin: float, end: float, order: int) -> None:
    beam = rig.require_beam()
    axis, start = np.array(beam.direction), np.array([*beam.offset, 0.0])
    ring = _section(rig)
    low, high = start + begin * axis + ring, start + end * axis + ring
    strips = [np.stack([low[i], low[i + 3], high[i + 3], high[i]]) for i in range(0, len(ring) - 3, 3)]
    _faces(axes, strips, _BEAM, 0.16, order)


def _meeting(rig: Rig, plane: Plane) -> Array:
    """Points (73, 3) where the beam's cylinder meets a plane."""
    ring, axis = plane.point + _section(rig), np.array(rig.require_beam().direction)
    along = (plane.point - ring) @ plane.normal / (axis @ plane.normal)
    return np.asarray(ring + along[:, None] * axis, dtype=np.float64)


def _spot(axes: Axes3D, rig: Rig, plane: Plane, colour: str, order: int) -> None:
    _faces(axes, [_meeting(rig, plane)], colour, 0.55, order, edge=colour)


def _outline(axes: Axes3D, rig: Rig, plane: Plane, end: float, order: int) -> None:
    """Draw the second plane's spot as far as the picture reaches: at a grazing plane it is very long."""
    edge = _meeting(rig, plane)
    seen = (edge[:, 2] > 0) & (edge[:, 2] < end)
    axes.plot(*_placed(np.where(seen[:, None], edge, np.nan)), color=_OTHER, lw=1.1, zorder=order)


def _axis(axes: Axes3D, plane: Plane, length: float, order: int) -> None:
    """Draw the normal on the lit side, which the camera sees."""
    tip = plane.point - length * plane.normal
    axes.plot(*_placed(np.stack([plane.point, tip])), color=_NORMAL, lw=1.8, zorder=order)


def _cone(axes: Axes3D, solution: Solution, plane: Plane, length: float) -> float | None:
    """Draw the cone that holds the normal with 95 %; return by how much it is widened, None where none is known."""
    if solution.uncertainty is None:
        return None
    covariance = solution.uncertainty.normal_spot + solution.uncertainty.normal_rig
    if not np.all(np.isfinite(covariance)):
        return None
    times = magnification(opening(covariance))
    first, second = _directions(plane)
    basis = np.stack([first, second])
    values, vectors = np.linalg.eigh(basis @ covariance @ basis.T)
    size = np.minimum(np.sqrt(scipy.stats.chi2.ppf(CONE_LEVEL, 2) * np.maximum(values, 0)) * times, np.pi / 2)
    away = size * np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=1)
    angle = np.linalg.norm(away, axis=1, keepdims=True)
    sideways = away / np.maximum(angle, 1e-12) @ vectors.T @ basis
    edge = plane.point + length * (np.sin(angle) * sideways - np.cos(angle) * plane.normal)
    sides = [np.stack([plane.point, edge[i], edge[i + 3]]) for i in range(0, len(edge) - 3, 3)]
    _faces(axes, sides, _NORMAL, 0.22, 4)
    axes.plot(*_placed(edge), color=_NORMAL, lw=0.9, zorder=4)
    return times


def _camera(axes: Axes3D, rig: Rig, depth: float) -> None:
    """Draw the camera's pyramid of sight up to a depth, mm."""
    camera = rig.camera
    width, height = camera.image_size
    across = depth * (np.array([-0.5, width - 0.5]) - camera.cx) / camera.fx
    down = depth * (np.array([-0.5, height - 0.5]) - camera.cy) / camera.fy
    corners = np.array([(across[i], down[j], depth) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    lines = [np.stack([np.zeros(3), corner]) for corner in corners]
    lines += [np.stack([corners[i], corners[(i + 1) % 4]]) for i in range(4)]
    collection = Line3DCollection([np.stack(_placed(line), axis=-1) for line in lines], colors=_CAMERA, linewidths=1.0)
    collection.set_zorder(7)
    axes.add_collection3d(collection)


def _frame(axes: Any, z: tuple[float, float], x: tuple[float, float], y: tuple[float, float], *, zoom: float) -> None:
    axes.set(xlim=z, ylim=x[::-1], zlim=y[::-1])
    axes.set_box_aspect((z[1] - z[0], x[1] - x[0], y[1] - y[0]), zoom=zoom)
    axes.set_xlabel("z (mm)", labelpad=2 + 4 * (z[1] - z[0]) / (x[1] - x[0]))
    axes.set_ylabel("x (mm)", labelpad=2)
    axes.set_zlabel("y (mm)", labelpad=0 if z[0] else -4)
    axes.tick_params(pad=1, labelsize=8)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        axis.set_pane_color((1, 1, 1, 0))
    axes.grid(True)
    axes.patch.set_visible(False)  # it would cover the other panel's labels


def _legend(figure: Any, *, shown: bool, cone: float | None) -> None:
    handles: list[Any] = [
        Line2D([], [], color=_CAMERA, lw=1, label="camera"),
        Patch(color=_BEAM, alpha=0.3, label="beam"),
        Patch(color=_PLANE, alpha=0.6, label="plane"),
        Patch(color=_SPOT, alpha=0.7, label="spot"),
    ]
    if shown:
        handles.append(Patch(color=_OTHER, alpha=0.35, label="second plane, excluded"))
    handles.append(Line2D([], [], color=_NORMAL, lw=1.8, label="normal"))
    if cone is not None:
        widened = "" if cone == 1 else f", {cone:g} times as wide"
        handles.append(Patch(color=_NORMAL, alpha=0.3, label=f"95 % cone{widened}"))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False)
