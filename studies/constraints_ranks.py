"""Rank and conditioning of the ten equations over rigs and planes, and where rank is lost."""

import itertools
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.executors import ordered_map
from planeopt.formulations import Problem, Start, identify
from planeopt.formulations.snooping import whitened_by_plane
from studies.study import Mode

Array = NDArray[np.float64]

F_MM, RADIUS_MM = paper.SETUP.f, paper.SETUP.r
NOISE_MM = 0.3 * 0.005
N_POINTS = 200
_AROUND = float(np.arctan2(paper.SETUP.e_y, paper.SETUP.e_x))

OFFSETS_MM = (0.0, 5.0, 10.0, 20.0, 50.0)
"""From a camera on the beam's axis over one on its surface (10 mm) to the paper's."""
DEPTHS_MM: dict[Mode, tuple[float, ...]] = {"full": (60.0, 100.0, 300.0, 1000.0), "quick": (100.0,)}
TILTS_DEG: dict[Mode, tuple[float, ...]] = {
    "full": (0.0, 5.0, 15.0, 30.0, 45.0, 60.0, 75.0),
    "quick": (0.0, 30.0, 60.0),
}
AZIMUTHS_DEG: dict[Mode, tuple[float, ...]] = {
    "full": tuple(-157.5 + 22.5 * i for i in range(16)),
    "quick": (-135.0, 0.0, 45.0),
}
INTERCEPTS = (0.3, 0.1, 3e-2, 1e-2, 3e-3, 1e-3)
"""Over the depth, down to planes through the camera."""


@dataclass(frozen=True)
class RankRow:
    """A plane that the camera sees.

    Attributes
    ----------
    offset_mm, z_L_mm, alpha_deg, beta_deg : float
        The beam's radius is 10 mm.
    intercept_over_z_L : float
        ``c / z_L``: 0 for a plane through the camera.
    laser_rank, image_rank, ten_rank : int
        In the paper's variables.
    repeated_laser_rows : int
    condition : float
        Of the one laser equation and the image block, whitened, by ``(R / r, z_L / depth, p, q)``.
    """

    offset_mm: float
    z_L_mm: float
    alpha_deg: float
    beta_deg: float
    intercept_over_z_L: float
    laser_rank: int
    image_rank: int
    ten_rank: int
    repeated_laser_rows: int
    condition: float


@dataclass(frozen=True)
class EdgeRow:
    """A plane on the way to one through the camera, tilted along the offset.

    Attributes
    ----------
    offset_mm, intercept_over_z_L : float
    smallest_over_largest : float
        Singular values of the image block, each row over the size of its coefficient, by ``(z_L / depth, p, q)``.
    whitened_smallest_over_largest : float
        The same with the rows whitened by the covariance of the coefficients.
    from_second_plane_deg : float
        Angle between the last right singular vector and ``(r^2, e_x, e_y)``, the direction to the second plane.
    """

    offset_mm: float
    intercept_over_z_L: float
    smallest_over_largest: float
    whitened_smallest_over_largest: float
    from_second_plane_deg: float


@dataclass(frozen=True)
class FreeRow:
    """What the image block fixes where a number of the rig is unknown as well.

    Attributes
    ----------
    unknown : str
        Besides the plane: nothing, the beam's radius, the focal length, or the rig's scale (``e`` and ``r`` together).
    offset_mm : float
    unknowns, rank : int
    smallest_over_largest : float
        Singular values by relative changes of lengths and by slopes.
    changes_nothing : str
        The direction that no equation sees, where rank is lost.
    """

    unknown: str
    offset_mm: float
    unknowns: int
    rank: int
    smallest_over_largest: float
    changes_nothing: str


def setup_at(offset: float) -> eq.Setup:
    """The paper's camera and beam, at another distance from each other."""
    return eq.Setup(F_MM, offset * np.cos(_AROUND), offset * np.sin(_AROUND), RADIUS_MM)


def exact_problem(setup: eq.Setup, plane: Array, noise: float = NOISE_MM) -> Problem:
    """The spot's exact boundary, with the weights of 0.3 px or of another noise in mm."""
    phi = 2 * np.pi * np.arange(N_POINTS) / N_POINTS
    point = eq.spot_point_in_slopes(np, eq.SlopeVariables(None, *plane), setup, phi)
    return Problem.from_points(np.stack(eq.image_point(np, setup, *point), axis=1), setup, noise)


def start_at(setup: eq.Setup, plane: Array, beta: float) -> Start:
    """The plane itself as a start."""
    z_L, p, q = (float(value) for value in plane)
    return Start(float(eq.long_axis(np, p, q, setup.r)), (z_L, p, q), beta)


# --- Over planes ------------------------------------------------------------------------------------------------------


def rank_rows(mode: Mode, executor: Executor | None) -> list[RankRow]:
    """Go over all planes of the grid that the camera sees."""
    items = list(itertools.product(OFFSETS_MM, DEPTHS_MM[mode], TILTS_DEG[mode]))
    work = [(offset, depth, tilt, AZIMUTHS_DEG[mode] if tilt else (0.0,)) for offset, depth, tilt in items]
    return list(itertools.chain.from_iterable(ordered_map(_ranks, work, executor)))


def _ranks(work: tuple[float, float, float, tuple[float, ...]]) -> list[RankRow]:
    offset, depth, tilt, azimuths = work
    setup = setup_at(offset)
    return [row for beta in azimuths if (row := _rank(setup, offset, depth, tilt, beta)) is not None]


def _rank(setup: eq.Setup, offset: float, depth: float, tilt: float, azimuth: float) -> RankRow | None:
    alpha, beta = np.radians(tilt), np.radians(azimuth)
    v = eq.PaperVariables(setup.r / np.cos(alpha), depth, alpha, beta)
    intercept = eq.lit_side(np, v, setup) / np.cos(alpha) / depth
    # Clear of the edges, where the image is a line or no ellipse.
    if intercept < 0.05 or eq.in_front(np, v, setup) < 0.05 * depth * np.cos(alpha):
        return None
    plane = np.array([depth, *eq.slopes(np, v)])
    found = identify(exact_problem(setup, plane), start_at(setup, plane, beta))
    values = found.singular_values
    return RankRow(
        offset,
        depth,
        tilt,
        azimuth,
        float(intercept),
        found.laser_rank,
        found.image_rank,
        found.rank,
        len(found.dependent_rows),
        values[0] / values[-1],
    )


# --- Towards planes through the camera --------------------------------------------------------------------------------


def edge_rows() -> list[EdgeRow]:
    """Tilt the plane along the offset until it goes through the camera: for cameras outside the beam only."""
    offsets = [offset for offset in OFFSETS_MM if offset > RADIUS_MM]
    return [_edge(offset, intercept) for offset in offsets for intercept in INTERCEPTS]


def _edge(offset: float, intercept: float) -> EdgeRow:
    setup, depth = setup_at(offset), 100.0
    e = np.array([setup.e_x, setup.e_y])
    plane = np.array([depth, *(depth * (1 - intercept) * e / (e @ e))])
    size = np.array([depth, 1.0, 1.0])
    # So little noise that it leaves the image an ellipse where it is almost a line.
    problem = exact_problem(setup, plane, NOISE_MM / 1000)
    plain = image_derivatives(setup, plane, ("z_L", "p", "q")) / problem.natural_B[:, None] * size
    whitened = whitened_by_plane(problem, plane) * size
    values, right = np.linalg.svd(plain)[1:]
    other = np.linalg.svd(whitened, compute_uv=False)
    towards = np.array([setup.r**2, *e]) / size
    cosine = abs(right[-1] @ towards) / np.linalg.norm(towards)
    angle = float(np.degrees(np.arctan2(np.sqrt(max(0.0, 1 - cosine**2)), cosine)))
    return EdgeRow(offset, intercept, float(values[-1] / values[0]), float(other[-1] / other[0]), angle)


# --- With unknowns of the rig -----------------------------------------------------------------------------------------

_UNKNOWNS: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "r": ("r",),
    "f": ("f",),
    "e and r": ("scale",),
}
FREE = 1e-9
"""Smallest over largest singular value below which a direction is free."""


def free_rows() -> list[FreeRow]:
    """At a plane of ordinary tilt, for each offset: with nothing else unknown, and with a number of the rig."""
    return [_free(unknown, offset) for unknown in _UNKNOWNS for offset in OFFSETS_MM]


def _free(unknown: str, offset: float) -> FreeRow:
    setup, plane = setup_at(offset), np.array([100.0, 0.2, 0.3])
    names = ("z_L", "p", "q", *_UNKNOWNS[unknown])
    sizes = {"z_L": plane[0], "p": 1.0, "q": 1.0, "r": setup.r, "f": setup.f, "scale": 1.0}
    rows = image_derivatives(setup, plane, names) * np.array([sizes[name] for name in names])
    rows /= exact_problem(setup, plane).natural_B[:, None]
    values, right = np.linalg.svd(rows)[1:]
    rank = int(np.sum(values > FREE * values[0]))
    words = "" if rank == len(names) else _in_words(names, right[-1])
    return FreeRow(unknown, offset, len(names), rank, float(values[-1] / values[0]), words)


def _in_words(names: tuple[str, ...], direction: Array) -> str:
    """Relative changes of lengths, changes of slopes; the largest is 1."""
    direction = direction / direction[np.argmax(np.abs(direction))]
    what = {"p": "p", "q": "q", "scale": "e and r by their parts"}
    return " ".join(
        f"{value:+.3g} {what.get(name, f'{name} by its part')}"
        for name, value in zip(names, direction, strict=True)
        if abs(value) > 1e-6
    )


_STEP = 1e-30


def image_derivatives(setup: eq.Setup, plane: Array, names: tuple[str, ...]) -> Array:
    """Derivatives (5, n) of ``b_i/b_0`` by named unknowns, by complex steps; "scale" multiplies ``e`` and ``r``."""
    columns = []
    for name in names:
        step = {other: 1j * _STEP * (other == name) for other in ("z_L", "p", "q", "r", "f", "scale")}
        v = eq.SlopeVariables(None, plane[0] + step["z_L"], plane[1] + step["p"], plane[2] + step["q"])
        grown = 1 + step["scale"]
        k = eq.Setup(setup.f + step["f"], setup.e_x * grown, setup.e_y * grown, (setup.r + step["r"]) * grown)
        b = eq.image_conic_in_slopes(np, v, k)
        columns.append(np.imag([b_i / b[0] for b_i in b[1:]]) / _STEP)
    return np.stack(columns, axis=1)
