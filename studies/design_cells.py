"""Predictions over what a rig can be built like, and the same planes drawn and rendered to check them."""

import zlib
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product

import msgspec
import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.design import Pixels, Points, Prediction, Rigs, View, plane_at, planned_rig, predict
from planeopt.design.outlines import outlines
from planeopt.estimation import solve, solve_points
from planeopt.executors import ordered_map
from planeopt.plane import SpotPose
from planeopt.rig import Rig, SpotDefinition
from planeopt.simulation import BeamProfile, Noise, Optics, Scene, Surface, render
from planeopt.spot import SpotNotFound, find_spot
from studies.study import Mode

Array = NDArray[np.float64]

OFFSET_MM, RADIUS_MM, F_MM, PITCH_UM, IMAGE = 25.0, 6.0, 12.0, 5.5, (1280, 960)
DISTANCE_MM, TILT_DEG, TOWARD_DEG = 250.0, 30.0, 90.0
"""The reference, of which one number at a time is changed."""

PIXELS = Pixels(contrast=120.0, noise=2.0, blur_px=1.0)
"""A usual image of 8 bits."""

RANGES = {
    "offset_mm": (3.0, 80.0),
    "radius_mm": (1.5, 15.0),
    "f_mm": (4.0, 35.0),
    "distance_mm": (100.0, 1000.0),
    "tilt_deg": (0.0, 75.0),
}
TILTS_DEG = (0.0, 30.0, 60.0)
DIRECTIONS_DEG = (0.0, 90.0, 180.0)
CHECKED = {
    "offset_mm": (3.0, 6.0, 12.0, 25.0, 50.0),
    "radius_mm": (1.5, 3.0, 6.0, 9.0, 15.0),
    "f_mm": (4.0, 8.0, 12.0, 18.0, 25.0),
    "distance_mm": (150.0, 250.0, 400.0, 650.0, 1000.0),
    "tilt_deg": (0.0, 15.0, 30.0, 50.0, 70.0),
}
RENDERED = {
    "offset_mm": (12.0, 50.0),
    "radius_mm": (3.0, 9.0),
    "f_mm": (8.0, 18.0),
    "distance_mm": (150.0, 400.0),
    "tilt_deg": (0.0, 60.0),
}

DRAWS: dict[Mode, int] = {"full": 800, "quick": 60}
IMAGES: dict[Mode, int] = {"full": 8, "quick": 1}
_PLACES = 26


@dataclass(frozen=True)
class Spec:
    """A rig and a plane: the reference but for what is given."""

    sweep: str
    value: float
    offset_mm: float = OFFSET_MM
    radius_mm: float = RADIUS_MM
    f_mm: float = F_MM
    distance_mm: float = DISTANCE_MM
    tilt_deg: float = TILT_DEG
    toward_deg: float = TOWARD_DEG

    @property
    def rig(self) -> Rig:
        """A parallel beam up and to the right of the camera, along the image's diagonal."""
        offset = (0.8 * self.offset_mm, 0.6 * self.offset_mm)
        rig = planned_rig(offset_mm=offset, radius_mm=self.radius_mm, f_mm=self.f_mm, pitch_um=PITCH_UM, image=IMAGE)
        return replace(rig, spot=SpotDefinition(kind="disc"))

    @property
    def plane(self) -> Array:
        """``(z_L, p, q)``."""
        return plane_at(self.rig, self.distance_mm, self.tilt_deg, self.toward_deg)


@dataclass(frozen=True)
class SweepRow:
    """A prediction from the pixels' noise; see `planeopt.design.Prediction`.

    Attributes
    ----------
    sweep : str
        What is changed from the reference; its value is `value`.
    sigma_tilt_deg : float
        NaN near tilt 0, where it has none of first order.
    excess : float
        Over the limits within which the bound is reached.
    view : str
        Why the plane cannot be measured, or that it can.
    """

    sweep: str
    value: float
    tilt_deg: float
    toward_deg: float
    sigma_z_L_um: float
    sigma_normal_deg: float
    sigma_tilt_deg: float
    excess: float
    view: str

    @property
    def measurable(self) -> bool:
        """Whether the spot is wholly in the image, seen, and large enough."""
        return self.view in (View.OK, View.BEYOND)


@dataclass(frozen=True)
class DrawRow:
    """Errors of maximum likelihood on drawn points, one for each pixel of the boundary, with the noise of its edge.

    Attributes
    ----------
    points, draws, lost : int
        Points of a draw; draws; draws without a plane.
    excess : float
        Over the limits within which the bound is reached.
    sigma_z_L_um, sigma_normal_deg : float
        Predicted for these points.
    z_L_over, normal_over : float
        RMS error over that.
    squared : float
        Mean squared Mahalanobis distance of ``(z_L, p, q)`` over 3, by the predicted covariance: 1 where it is right.
    """

    sweep: str
    value: float
    tilt_deg: float
    toward_deg: float
    points: int
    draws: int
    lost: int
    excess: float
    sigma_z_L_um: float
    sigma_normal_deg: float
    z_L_over: float
    normal_over: float
    squared: float


@dataclass(frozen=True)
class ImageRow:
    """What `find_spot` and `solve` make of rendered images of one plane.

    Attributes
    ----------
    images, refused : int
    sigma_z_L_um, sigma_normal_deg : float
        Predicted from the pixels' noise.
    z_L_own_over, normal_own_over : float
        The solutions' own standard deviations over that, mean.
    squared : float
        Mean squared Mahalanobis distance of their errors over 3, by the predicted covariance.
    points_over_length : float
        Boundary points over the predicted pixels of boundary.
    """

    sweep: str
    value: float
    tilt_deg: float
    toward_deg: float
    images: int
    refused: int
    sigma_z_L_um: float
    sigma_normal_deg: float
    z_L_own_over: float
    normal_own_over: float
    squared: float
    points_over_length: float


def sweeps() -> list[SweepRow]:
    """Predict everything that is drawn, at once."""
    specs = list(_swept())
    rigs = [Rigs.of(spec.rig) for spec in specs]
    together = replace(rigs[0], numbers=np.stack([rig.numbers for rig in rigs]))
    found = predict(together, np.stack([spec.plane for spec in specs]), PIXELS)
    return [
        SweepRow(
            spec.sweep,
            spec.value,
            spec.tilt_deg,
            spec.toward_deg,
            1000 * float(found.z_L_mm[place]),
            float(found.normal_deg[place]),
            float(found.tilt_deg[place]),
            float(found.excess[place]),
            str(found.views[place]),
        )
        for place, spec in enumerate(specs)
    ]


def _swept() -> Iterator[Spec]:
    for sweep, (low, high) in RANGES.items():
        linear = sweep == "tilt_deg"
        values = np.linspace(low, high, _PLACES) if linear else np.geomspace(low, high, _PLACES)
        others = ([{"toward_deg": d} for d in DIRECTIONS_DEG]) if linear else ([{"tilt_deg": t} for t in TILTS_DEG])
        for value, other in product(values.tolist(), others):
            yield Spec(sweep, value, **{sweep: value}, **other)


@dataclass(frozen=True)
class Job:
    """A plane to be drawn or rendered so many times."""

    spec: Spec
    times: int


def checked(mode: Mode) -> list[Spec]:
    """Return the planes that are drawn; quick: two of each sweep."""
    values = {name: many if mode == "full" else many[1:4:2] for name, many in CHECKED.items()}
    return [
        Spec(sweep, value, **{sweep: value}, **({"toward_deg": other} if sweep == "tilt_deg" else {"tilt_deg": other}))
        for sweep, many in values.items()
        for value in many
        for other in ((90.0, 180.0) if sweep == "tilt_deg" else (0.0, 60.0))
    ]


def rendered(mode: Mode) -> list[Spec]:
    """Return the planes that are rendered; quick: the first of two sweeps."""
    specs = [Spec(sweep, value, **{sweep: value}) for sweep, many in RENDERED.items() for value in many]
    return specs if mode == "full" else specs[:8:6]


def run_draws(mode: Mode, executor: Executor | None) -> list[DrawRow]:
    """Draw and solve."""
    return list(ordered_map(draw, [Job(spec, DRAWS[mode]) for spec in checked(mode)], executor))


def run_images(mode: Mode, executor: Executor | None) -> list[ImageRow]:
    """Render, find and solve."""
    return list(ordered_map(photograph, [Job(spec, IMAGES[mode]) for spec in rendered(mode)], executor))


def draw(job: Job) -> DrawRow:
    """Solve drawn points of one plane."""
    spec, rig, plane = job.spec, job.spec.rig, job.spec.plane
    rng = np.random.default_rng(zlib.crc32(repr(spec).encode()))
    per_pixel, n = _per_pixel(), round(float(predict(rig, plane, PIXELS).length_px))
    found = predict(rig, plane, Points(per_pixel, n))
    angles = 2 * np.pi * (np.arange(n) + 0.5) / n
    seen = outlines(Rigs.of(rig).numbers[None], plane[None], angles[None])
    # Even angles are not evenly along the boundary: each point has the noise of its piece.
    pitch = PITCH_UM / 1000
    sigma = pitch * per_pixel * np.sqrt(seen.length[0].mean() / seen.length[0])
    across = rng.normal(size=(job.times, n, 1)) * (sigma[:, None] * seen.normals[0])
    points = rig.focal_length * seen.laser_plane[0] + across
    setup = eq.Setup(rig.focal_length, *rig.laser_offset, spec.radius_mm)
    solved = solve_points(points, np.broadcast_to(sigma, (job.times, n)), setup)
    good = np.isfinite(solved.planes).all(axis=1)
    error = solved.planes[good] - plane
    return DrawRow(
        spec.sweep,
        spec.value,
        spec.tilt_deg,
        spec.toward_deg,
        n,
        job.times,
        int(np.sum(~good)),
        float(found.excess),
        1000 * float(found.z_L_mm),
        float(found.normal_deg),
        float(np.sqrt(np.mean(error[:, 0] ** 2)) / found.z_L_mm),
        float(np.degrees(np.sqrt(np.mean(_angles(solved.planes[good], plane) ** 2))) / found.normal_deg),
        float(np.mean(_squares(error, found)) / 3),
    )


def _per_pixel() -> float:
    """Standard deviation of one pixel of the edge, px."""
    return float(PIXELS.at(np.ones((1, 1)), np.ones(1)).per_pixel[0, 0])


def _squares(error: Array, found: Prediction) -> Array:
    return np.einsum("mi,ij,mj->m", error, np.linalg.inv(found.covariance), error)


def _angles(planes: Array, truth: Array) -> Array:
    """Between normals, rad."""
    one, other = (np.stack([-p[..., 1], -p[..., 2], np.ones(p.shape[:-1])], axis=-1) for p in (planes, truth))
    return np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), one @ other)


def photograph(job: Job) -> ImageRow:
    """Measure rendered images of one plane."""
    spec, rig, plane = job.spec, job.spec.rig, job.spec.plane
    found = predict(rig, plane, PIXELS)
    scene = Scene.of(
        rig,
        SpotPose.from_slopes(plane[0], plane[1], plane[2], spec.radius_mm),
        beam=BeamProfile(height=PIXELS.contrast / 255),
        optics=Optics(blur_px=PIXELS.blur_px),
        surface=Surface(background=15 / 255),
        noise=Noise(full_well_electrons=None, read=PIXELS.noise / 255),
    )
    seen: list[tuple[float, float, float, float]] = []
    refused = 0
    for time in range(job.times):
        seed = zlib.crc32(repr((spec, time)).encode()) % 2**31
        try:
            spot = find_spot(render(msgspec.structs.replace(scene, seed=seed)).image, rig)
        except SpotNotFound:
            refused += 1
            continue
        solution = solve(spot, rig)
        if solution.pose is None or solution.uncertainty is None:
            refused += 1
            continue
        error = np.array([solution.pose.z_L, *solution.pose.slopes]) - plane
        own = solution.uncertainty
        normal = np.degrees(np.sqrt(np.trace(own.normal_spot)))
        seen.append(
            (
                float(np.sqrt(own.spot[0, 0]) / found.z_L_mm),
                float(normal / found.normal_deg),
                float(_squares(error[None], found)[0] / 3),
                float(len(spot.points) / found.length_px),
            )
        )
    mean = np.mean(seen, axis=0) if seen else np.full(4, np.nan)
    return ImageRow(
        spec.sweep,
        spec.value,
        spec.tilt_deg,
        spec.toward_deg,
        job.times,
        refused,
        1000 * float(found.z_L_mm),
        float(found.normal_deg),
        *mean.tolist(),
    )
