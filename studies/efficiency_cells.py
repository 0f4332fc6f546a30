"""Errors of maximum likelihood over the Cramér-Rao bound, cell by cell of a grid of planes, rigs, noises and arcs."""

import zlib
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from itertools import product

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation import solve_points
from planeopt.estimation.efficiency import bounds, reach
from planeopt.estimation.feet import Boundary
from planeopt.executors import ordered_map
from studies.study import Mode

Array = NDArray[np.float64]

FOCAL_MM, PITCH_MM = 25.0, 0.005
"""The paper's camera; 5 um pixels."""

N_POINTS = 200
RADII_MM = (10.0, 2.5)
"""The paper's beam, and one whose spot is so small that the bound is out of reach in many cells."""

TILTS_DEG = (0.0, 30.0, 55.0, 70.0)
DEPTHS_MM = (100.0, 300.0, 1000.0)
NOISES_PX = (0.05, 0.2, 1.0)
ARCS = (1.0, 0.6, 0.3)
OFFSETS_MM = (0.0, 15.0, 40.0)

DRAWS: dict[Mode, int] = {"full": 2000, "quick": 100}
_NOTICED = 100

_FAR = 3.0
"""Times the criterion's limits beyond which a tenth of the draws shows well enough that a cell is out of reach."""


@dataclass(frozen=True)
class Cell:
    """One combination of the grid; the directions of tilt, offset and arc are drawn for each cell."""

    radius_mm: float
    tilt_deg: float
    depth_mm: float
    noise_px: float
    arc: float
    offset_mm: float


@dataclass(frozen=True)
class CellRow:
    """What a cell's draws gave.

    Attributes
    ----------
    radius_mm, tilt_deg, depth_mm, noise_px, arc, offset_mm
        The cell.
    sigma_over_axis, curvature, slope_sigma : float
        What the criterion looks at, at the true plane with the bound as covariance.
    excess : float
        By what factor the worst of them is over its limit: at most 1 where the bound can be reached.
    draws, lost : int
        Sets of points, and those among them without a plane.
    over_bound : float
        RMS error of ``(z_L, p, q)``, pooled by the bound: 1 at the bound. Noise is across the boundary.
    isotropic_over_bound : float
        The same where noise moves the points in all directions; half as many draws.
    covered_95 : float
        Share of the draws whose error is within the 95 % ellipsoid of their own covariance.
    noticed : float
        Share of the first draws that the criterion flags, at their own plane with their own covariance.
    """

    radius_mm: float
    tilt_deg: float
    depth_mm: float
    noise_px: float
    arc: float
    offset_mm: float
    sigma_over_axis: float
    curvature: float
    slope_sigma: float
    excess: float
    draws: int
    lost: int
    over_bound: float
    isotropic_over_bound: float
    covered_95: float
    noticed: float


@dataclass(frozen=True)
class Job:
    """A cell and its number of draws; a tenth of them where the bound is far out of reach."""

    cell: Cell
    draws: int


def cells_of(mode: Mode) -> list[Cell]:
    """Return the grid; quick: every so many cells of it, so that each value of each axis is there."""
    cells = [Cell(*values) for values in product(RADII_MM, TILTS_DEG, DEPTHS_MM, NOISES_PX, ARCS, OFFSETS_MM)]
    return cells if mode == "full" else cells[::40]


def run_cells(mode: Mode, executor: Executor | None) -> list[CellRow]:
    """Measure all cells."""
    return list(ordered_map(measure, [Job(cell, DRAWS[mode]) for cell in cells_of(mode)], executor))


@dataclass(frozen=True)
class Truth:
    """A cell's rig and plane, and the exact boundary."""

    setup: eq.Setup
    plane: Array
    points: Array
    """(N, 2), mm."""
    normals: Array
    """(N, 2), unit, outwards."""


def draw_truth(cell: Cell, rng: np.random.Generator) -> Truth:
    """Return a plane whose spot the camera sees whole and clear of the edge of what can be seen."""
    for _ in range(10_000):
        away, azimuth, begin = rng.uniform(-np.pi, np.pi, 3)
        setup = eq.Setup(FOCAL_MM, cell.offset_mm * np.cos(away), cell.offset_mm * np.sin(away), cell.radius_mm)
        slope = np.tan(np.radians(cell.tilt_deg))
        v = eq.SlopeVariables(None, cell.depth_mm, slope * np.cos(azimuth), slope * np.sin(azimuth))
        clear = cell.depth_mm - cell.radius_mm * slope > 0.1 * cell.depth_mm
        if clear and eq.lit_side_in_slopes(np, v, setup) > 0.1 * cell.depth_mm:
            phi = begin + 2 * np.pi * cell.arc * (np.arange(N_POINTS) + 0.5) / N_POINTS
            return Truth(setup, np.array(v[1:]), *outline(v, setup, phi))
    raise RuntimeError(f"no such plane can be seen: {cell}")


def outline(v: eq.SlopeVariables, setup: eq.Setup, phi: Array) -> tuple[Array, Array]:
    """(5) of (3) at angles (N,) round the beam: points (N, 2), mm, and unit normals there, outwards."""
    x, y, z = eq.spot_point_in_slopes(np, v, setup, phi)
    dx, dy = -setup.r * np.sin(phi), setup.r * np.cos(phi)
    points = setup.f * np.stack([x, y], axis=1) / z[:, None]
    dz = v.p * dx + v.q * dy
    tangents = (setup.f * np.stack([dx, dy], axis=1) - points * dz[:, None]) / z[:, None]
    normals = np.stack([tangents[:, 1], -tangents[:, 0]], axis=1)
    return points, normals / np.linalg.norm(normals, axis=1)[:, None]


def measure(job: Job) -> CellRow:
    """Solve a cell's draws, with noise across the boundary, as edge detectors have it, and with isotropic noise."""
    cell = job.cell
    rng = np.random.default_rng(zlib.crc32(repr(cell).encode()))
    truth, sigma = draw_truth(cell, rng), cell.noise_px * PITCH_MM
    exact = Boundary.of(truth.points[None], np.full((1, N_POINTS), sigma))
    bound = bounds(truth.setup, truth.plane[None], exact)[0]
    wanted = reach(truth.setup, truth.plane[None], bound[None], exact, np.array([sigma]))
    draws = job.draws if wanted.excess[0] <= _FAR else job.draws // 10
    across = truth.points + sigma * rng.standard_normal((draws, N_POINTS, 1)) * truth.normals
    found = solve_points(across, sigma, truth.setup)
    solved = np.isfinite(found.covariance).all(axis=(1, 2))
    error = (found.planes - truth.plane)[solved]
    own = squared_errors(error, found.covariance[solved])
    some = np.flatnonzero(solved)[:_NOTICED]
    there = Boundary.of(across[some], sigma)
    at_own = reach(truth.setup, found.planes[some], found.covariance[some], there, np.full(len(some), sigma))
    isotropic = truth.points + sigma * rng.standard_normal((draws // 2, N_POINTS, 2))
    other = solve_points(isotropic, sigma, truth.setup).planes - truth.plane
    numbers = {
        "sigma_over_axis": float(wanted.sigma_over_axis[0]),
        "curvature": float(wanted.curvature[0]),
        "slope_sigma": float(wanted.slope_sigma[0]),
        "excess": float(wanted.excess[0]),
        "over_bound": _over(error, bound),
        "isotropic_over_bound": _over(other[np.isfinite(other).all(axis=1)], bound),
        "covered_95": float(np.mean(own < scipy.stats.chi2.ppf(0.95, 3))) if len(own) else np.nan,
        "noticed": float(np.mean(~at_own.ok)) if len(some) else np.nan,
    }
    # As the table holds them, so that what is said of a cell at the very edge is what the table says.
    rounded = {name: float(f"{value:.6g}") for name, value in numbers.items()}
    return CellRow(**asdict(cell), draws=draws, lost=draws - len(error), **rounded)


def squared_errors(error: Array, covariance: Array) -> Array:
    """Squared errors (M,) over covariances (M, 3, 3) or (3, 3)."""
    size = np.sqrt(np.einsum("...ii->...i", covariance))
    normed, scaled = covariance / (size[..., :, None] * size[..., None, :]), error / size
    return np.sum(scaled * np.linalg.solve(normed, scaled[..., None])[..., 0], axis=-1)


def _over(error: Array, bound: Array) -> float:
    """RMS error over the bound, pooled over the three components."""
    return float(np.sqrt(np.mean(squared_errors(error, bound)) / 3)) if len(error) else np.nan


def within(rows: Sequence[CellRow]) -> list[CellRow]:
    """Return the cells where the criterion says that the bound can be reached."""
    return [row for row in rows if row.excess <= 1]
