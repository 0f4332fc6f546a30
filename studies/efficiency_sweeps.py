"""One axis at a time about a base case, the paper's rig: settings, their true planes, and noisy boundary points."""

import zlib
from dataclasses import dataclass, replace

import numpy as np

from planeopt import equations as eq
from planeopt.estimation.efficiency import bounds, reach
from planeopt.estimation.feet import Boundary
from studies.efficiency_cells import FOCAL_MM, PITCH_MM, Array, Truth, outline, squared_errors
from studies.study import Mode

RADIUS_MM = 10.0
OFFSET_TOWARDS = (0.6, 0.8)
BETA = float(np.radians(30.0))
"""The paper's beam, the direction of its offset, and its plane's direction of tilt; arcs begin where the beam's
cross-section has its largest x."""


@dataclass(frozen=True)
class Setting:
    """One case: noise across the boundary, the plane, the share of the turn that the points cover, and the beam."""

    noise_px: float = 0.2
    tilt_deg: float = 30.0
    depth_mm: float = 300.0
    arc: float = 1.0
    points: int = 200
    offset_mm: float = 50.0


BASE = Setting()

AXES: dict[str, tuple[float, ...]] = {
    "noise_px": (0.02, 0.05, 0.1, 0.2, 0.5, 1.0),
    "tilt_deg": (0.0, 15.0, 30.0, 45.0, 60.0, 70.0),
    "depth_mm": (100.0, 200.0, 300.0, 600.0, 1000.0),
    "arc": (0.3, 0.4, 0.6, 0.8, 1.0),
    "points": (20, 50, 100, 200, 500, 1000),
    "offset_mm": (0.0, 10.0, 20.0, 50.0, 100.0),
}
"""Values of each axis, the base case's among them. An offset of 10 mm is the beam's radius."""


@dataclass(frozen=True)
class Step:
    """A place on an axis."""

    axis: str
    value: float

    @property
    def setting(self) -> Setting:
        return replace(BASE, **{self.axis: self.value})


def steps_of(mode: Mode) -> list[Step]:
    """Return all steps; quick: the base case and the end of each axis that asks most."""
    if mode == "full":
        return [Step(axis, value) for axis, values in AXES.items() for value in values]
    ends = {"noise_px": 1.0, "tilt_deg": 70.0, "depth_mm": 1000.0, "arc": 0.4, "points": 20, "offset_mm": 10.0}
    return [Step(axis, value) for axis in ends for value in (getattr(BASE, axis), ends[axis])]


@dataclass(frozen=True, eq=False)
class Sample:
    """Points with noise, many draws of a setting.

    Attributes
    ----------
    truth : Truth
    sigma : float
        Of the points, across the boundary, mm.
    points : (D, N, 2) array
        On the laser-parallel image plane, mm.
    bound : (3, 3) array
        Cramér-Rao bound of ``(z_L, p, q)``.
    excess : float
        By what factor the criterion's worst number is over its limit: at most 1 where the bound can be reached.
    """

    truth: Truth
    sigma: float
    points: Array
    bound: Array
    excess: float


def draw(setting: Setting, draws: int) -> Sample:
    """Return so many draws of a setting; fewer of them are the first of more."""
    e_x, e_y = (setting.offset_mm * part for part in OFFSET_TOWARDS)
    setup = eq.Setup(FOCAL_MM, e_x, e_y, RADIUS_MM)
    slope = float(np.tan(np.radians(setting.tilt_deg)))
    v = eq.SlopeVariables(None, setting.depth_mm, -slope * float(np.sin(BETA)), slope * float(np.cos(BETA)))
    phi = 2 * np.pi * setting.arc * (np.arange(setting.points) + 0.5) / setting.points
    truth = Truth(setup, np.array(v[1:]), *outline(v, setup, phi))
    sigma = setting.noise_px * PITCH_MM
    exact = Boundary.of(truth.points[None], np.full((1, setting.points), sigma))
    bound = bounds(setup, truth.plane[None], exact)[0]
    excess = reach(setup, truth.plane[None], bound[None], exact, np.array([sigma])).excess[0]
    rng = np.random.default_rng(zlib.crc32(repr(setting).encode()))
    noise = rng.standard_normal((draws, setting.points, 1))
    return Sample(truth, sigma, truth.points + sigma * noise * truth.normals, bound, held(excess))


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of planes (D, 3) over the bound; NaN where there is no plane.

    Attributes
    ----------
    failed : int
    over_bound : float
        RMS of ``(z_L, p, q)``, pooled by the bound: 1 at the bound.
    median_over_bound : float
        Median distance by the bound over that of a normal law, which a few planes far off do not move.
    bias_over_bound : float
        Of the mean error, as `over_bound`; chance leaves about one over the root of the draws.
    z_L_over_bound, slopes_over_bound : float
        RMS errors of z_L, and of p and q each over its own bound.
    """

    failed: int
    over_bound: float
    median_over_bound: float
    bias_over_bound: float
    z_L_over_bound: float
    slopes_over_bound: float


MEDIAN_DISTANCE = 1.5381722544550522
"""Median of the root of chi-squared with 3 degrees of freedom."""


def errors_of(planes: Array, sample: Sample) -> Errors:
    """Compare planes with the truth."""
    found = np.isfinite(planes).all(axis=1)
    if not found.any():
        nan = np.nan
        return Errors(
            failed=len(planes),
            over_bound=nan,
            median_over_bound=nan,
            bias_over_bound=nan,
            z_L_over_bound=nan,
            slopes_over_bound=nan,
        )
    error = planes[found] - sample.truth.plane
    distance = np.sqrt(squared_errors(error, sample.bound))
    single = np.sqrt(np.mean(error**2, axis=0) / np.diag(sample.bound))
    return Errors(
        failed=int(np.sum(~found)),
        over_bound=held(rms(distance) / np.sqrt(3)),
        median_over_bound=held(float(np.median(distance)) / MEDIAN_DISTANCE),
        bias_over_bound=held(np.sqrt(squared_errors(error.mean(axis=0)[None], sample.bound)[0] / 3)),
        z_L_over_bound=held(single[0]),
        slopes_over_bound=held(rms(single[1:])),
    )


def held(value: float) -> float:
    """Return a number as tables hold it, so that what is said of it is what the table says."""
    return float(f"{value:.6g}")


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
