"""The boundary over a grid of sizes, blurs, contrasts and noises: bias, noise over the bound, honesty of sigma."""

import dataclasses
import zlib
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import product

import numpy as np

from planeopt.executors import ordered_map
from planeopt.simulation import boundary_distances, render
from planeopt.spot import SpotNotFound, find_spot
from planeopt.spot.points import Kind
from studies.boundaries import Deviation, deviation
from studies.draws import Lit, Look, Range, View, draw_scene
from studies.study import Mode

RADII_PX = (8.0, 20.0, 60.0, 300.0)
BLURS_PX = (0.7, 1.2, 2.0)
LIGHTS = ((20.0, 1.0), (20.0, 4.0), (80.0, 2.0), (230.0, 1.0), (230.0, 4.0))
"""Contrast and noise, grey levels."""

_DRAWS = {8.0: 24, 20.0: 16, 60.0: 12, 300.0: 4}
"""More where one image says less: what remains of the noise in a cell's mean is to be well below 0.02 px."""


@dataclass(frozen=True)
class Cell:
    """One combination of the grid; tilt, distortion, rig and place are drawn for each image."""

    kind: Kind
    over: float
    radius_px: float
    blur_px: float
    contrast: float
    noise: float


@dataclass(frozen=True)
class CellRow:
    """What the images of a cell gave.

    Attributes
    ----------
    kind, over, radius_px, blur_px, contrast, noise
        The cell; `over` is the light over full scale, 1 where it is not over-exposed.
    images, refused : int
    bias_px, bias_error_px : float
        Mean signed distance of the points from the true boundary, and its standard error from the images' scatter.
    least_error_px : float
        The least that this error could be.
    points_over_bound : float
        RMS distance of the points from their mean over its least.
    size_over_bound, shape_over_bound : float
        RMS error of the size, and of centre and axes, over its least.
    own : float
        Mean squared Mahalanobis distance of size, centre and axes over 5, by the points' own sigma.
    own_error : float
        Standard error of `own` from the images' scatter.
    reasons : str
        Why images were refused.
    """

    kind: str
    over: float
    radius_px: float
    blur_px: float
    contrast: float
    noise: float
    images: int
    refused: int
    bias_px: float
    bias_error_px: float
    least_error_px: float
    points_over_bound: float
    size_over_bound: float
    shape_over_bound: float
    own: float
    own_error: float
    reasons: str


@dataclass(frozen=True)
class Image:
    """One image of a cell."""

    cell: Cell
    draw: int


def grid() -> list[Cell]:
    """Return all cells: the lights for discs and rings, and twice over-exposed ones."""
    kinds: tuple[Kind, ...] = ("disc", "ring")
    normal = [
        Cell(kind, 1.0, radius, blur, contrast, noise)
        for kind, radius, blur, (contrast, noise) in product(kinds, RADII_PX, BLURS_PX, LIGHTS)
    ]
    saturated = [
        Cell(kind, 2.0, radius, blur, 480.0, 2.0) for kind, radius, blur in product(kinds, RADII_PX[:3], BLURS_PX)
    ]
    return normal + saturated


def cells_of(mode: Mode) -> list[tuple[Cell, int]]:
    """Return the cells with their numbers of images; quick: small spots at the ends of the grid."""
    if mode == "full":
        return [(cell, _DRAWS[cell.radius_px]) for cell in grid()]
    ends = ((8.0, 0.7, 20.0, 1.0), (60.0, 2.0, 230.0, 4.0))
    quick = [
        cell
        for cell in grid()
        if (cell.radius_px, cell.blur_px, cell.contrast, cell.noise) in ends
        or (cell.over > 1 and (cell.radius_px, cell.blur_px) == (60.0, 0.7))
    ]
    return [(cell, 2) for cell in quick]


def run_cells(cells: Sequence[tuple[Cell, int]], executor: Executor | None) -> list[CellRow]:
    """Measure the images of all cells."""
    images = [Image(cell, draw) for cell, count in cells for draw in range(count)]
    measured = ordered_map(measure_image, images, executor)
    return [summary(cell, [next(measured) for _ in range(count)]) for cell, count in cells]


def measure_image(image: Image) -> Deviation | str:
    """Measure one image of a cell, see `measure`."""
    cell = image.cell
    rng = np.random.default_rng([_number(cell), image.draw])
    look = Look(
        Range.at(cell.contrast),
        Range.at(cell.noise),
        Range.at(cell.blur_px),
        line_px=Range.at(1.2),
        over=cell.over,
    )
    return measure(draw_scene(View(Range.at(cell.radius_px), kind=cell.kind), look, rng))


def measure(lit: Lit) -> Deviation | str:
    """Render, measure and compare one scene; the reason where there is no spot to be measured."""
    scene = lit.scene
    try:
        spot = find_spot(render(scene).image, scene.rig, camera_blur=lit.known_blur)
    except SpotNotFound as refusal:
        return refusal.reason.name.lower()
    except (ArithmeticError, ValueError, RuntimeError) as broken:
        return f"broken:{type(broken).__name__}"
    return deviation(spot, boundary_distances(scene, spot.points), lit)


def summary(cell: Cell, outcomes: Sequence[Deviation | str]) -> CellRow:
    """Return the row of a cell; its numbers are NaN where all images were refused."""
    added = add_up(outcomes)
    return CellRow(
        **{name: getattr(cell, name) for name in Cell.__dataclass_fields__},
        images=len(outcomes),
        refused=len(outcomes) - added.found,
        bias_px=added.mean.bias,
        bias_error_px=added.error.bias,
        least_error_px=float(np.sqrt(added.mean.least_variance / added.found)) if added.found else np.nan,
        points_over_bound=float(np.sqrt(added.mean.points)),
        size_over_bound=float(np.sqrt(added.mean.size)),
        shape_over_bound=float(np.sqrt(added.mean.shape)),
        own=added.mean.own,
        own_error=added.error.own,
        reasons=added.reasons,
    )


@dataclass(frozen=True)
class Added:
    """Mean of deviations, its standard error from their scatter, their number, and why there were no others."""

    mean: Deviation
    error: Deviation
    found: int
    reasons: str


def add_up(outcomes: Sequence[Deviation | str]) -> Added:
    """Take means over images; NaN where there are none, or for an error only one."""
    found = [outcome for outcome in outcomes if isinstance(outcome, Deviation)]
    reasons = sorted({outcome for outcome in outcomes if isinstance(outcome, str)})
    columns = np.array([dataclasses.astuple(d) for d in found]).reshape(len(found), -1)
    nothing = np.full(len(dataclasses.fields(Deviation)), np.nan)
    mean = columns.mean(axis=0) if found else nothing
    error = columns.std(axis=0, ddof=1) / np.sqrt(len(found)) if len(found) > 1 else nothing
    return Added(Deviation(*mean.tolist()), Deviation(*error.tolist()), len(found), " ".join(reasons))


def _number(cell: Cell) -> int:
    """Return a seed that goes with the cell, whatever other cells there are."""
    return zlib.crc32(repr(cell).encode())
