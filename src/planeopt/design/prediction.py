"""The standard deviations that a rig will measure planes with: the Cramér-Rao bound, before anything is built.

The image's boundary is known across itself with a standard deviation; a plane moves it by `outlines.Outlines.by_plane`.
The inverse of what the boundary says together is the least covariance of ``(z_L, p, q)`` (docs/model.md, section 9),
and maximum likelihood reaches it where `Prediction.excess` is at most 1. What the calibration leaves uncertain is added
to first order, as in `planeopt.solve`.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt import equations as eq
from planeopt.design.outlines import (
    SMALLEST,
    Outlines,
    by_numbers,
    camera_normals,
    laser_offsets,
    normals_by_numbers,
    outlines,
)
from planeopt.design.quality import Quality
from planeopt.design.rigs import NUMBERS, Rigs
from planeopt.errors import InputError
from planeopt.estimation.efficiency import minor_axes, reach
from planeopt.estimation.feet import Boundary
from planeopt.estimation.reservations import NONLINEAR_ANGLE_SHARE, slope_sigmas
from planeopt.rig import Rig

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

ANGLES = 128
"""Places round the beam; sums over them are integrals to rounding but for planes close to the edge of what is seen."""


class View(StrEnum):
    """Why a plane cannot be measured, or that it can; in the order in which they are asked."""

    BEHIND = "part of the spot is behind the camera"
    DARK = "the camera is on the plane's dark side"
    BLANK = "the image hardly changes with the plane, or its numbers overflow"
    FOLDED = "the spot lies where the lens's distortion folds over"
    OUT = "the spot is not wholly in the image"
    SMALL = "the spot is too small for its blur"
    BEYOND = "errors will exceed the bound, and intervals be too short"
    OK = "ok"


VIEWS = tuple(View)


@dataclass(frozen=True, eq=False)
class Prediction:
    """What planes will be measured with; leading shape (...) of rigs and planes together.

    A plane that the camera cannot see has NaN; one out of the image, or too small, has the numbers that it would have.

    Attributes
    ----------
    planes : (..., 3)
        ``(z_L, p, q)``, ``z_L`` along the beam; mm, 1, 1.
    spot, rig : (..., 3, 3)
        Covariances of the planes from the boundary and from the calibration.
    normal_spot, normal_rig : (...)
        RMS angles of the normal, rad.
    axis_px : (...)
        Shorter semi-axis of the image ellipse.
    length_px : (...)
        Of the boundary that is seen.
    margin_px : (...)
        Of the boundary from the image's border; negative outside.
    excess : (...)
        By what factor the plane is over the limits within which the bound is reached
        (`planeopt.estimation.efficiency.Reach`).
    codes : (...) of int
        Index into `VIEWS`.
    """

    planes: Array
    spot: Array
    rig: Array
    normal_spot: Array
    normal_rig: Array
    axis_px: Array
    length_px: Array
    margin_px: Array
    excess: Array
    codes: NDArray[np.int64]

    @property
    def covariance(self) -> Array:
        """Of ``(z_L, p, q)``, boundary and calibration together, (..., 3, 3)."""
        return self.spot + self.rig

    @property
    def z_L_mm(self) -> Array:
        """Standard deviation of z_L, (...)."""
        return np.sqrt(self.covariance[..., 0, 0])

    @property
    def z_L_spot_mm(self) -> Array:
        """The boundary's part of it, (...)."""
        return np.sqrt(self.spot[..., 0, 0])

    @property
    def normal_deg(self) -> Array:
        """RMS angle of the normal, (...)."""
        return np.degrees(np.hypot(self.normal_spot, self.normal_rig))

    @property
    def normal_spot_deg(self) -> Array:
        """The boundary's part of it, (...)."""
        return np.degrees(self.normal_spot)

    @property
    def tilt_deg(self) -> Array:
        """Standard deviation of alpha, (...); NaN where it has none of first order, near alpha = 0."""
        slopes = self.planes[..., 1:]
        tangent = np.hypot(slopes[..., 0], slopes[..., 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            to_alpha = slopes / (tangent * (1 + tangent**2))[..., None]
            sigma = np.sqrt(np.einsum("...i,...ij,...j", to_alpha, self.covariance[..., 1:, 1:], to_alpha))
        known = (
            slope_sigmas(self.covariance.reshape(-1, 3, 3)).reshape(tangent.shape) <= NONLINEAR_ANGLE_SHARE * tangent
        )
        return np.where(known, np.degrees(sigma), np.nan)

    @property
    def visible(self) -> Bools:
        """Whether the spot is wholly in the image and large enough, (...)."""
        return self.codes >= VIEWS.index(View.BEYOND)

    @property
    def ok(self) -> Bools:
        """Whether that is so and the bound can be reached, (...)."""
        return self.codes == VIEWS.index(View.OK)

    @property
    def views(self) -> NDArray[np.object_]:
        """A `View` each, (...)."""
        return np.array(VIEWS, dtype=object)[self.codes]


def plane_at(rig: Rig | Rigs, distance_mm: ArrayLike, tilt_deg: ArrayLike, toward_deg: ArrayLike = 0.0) -> Array:
    """Return planes ``(z_L, p, q)`` (..., 3) by their tilt and its direction against the beam's offset.

    Parameters
    ----------
    rig : Rig or Rigs
    distance_mm : (...)
        z_L.
    tilt_deg : (...)
        alpha, the angle between the plane's normal and the beam.
    toward_deg : (...)
        Direction in which the plane recedes, from that of the offset: at 0 it is farther on the beam's far side, at 180
        on the camera's side. The arguments broadcast with each other and with the rigs.

    Raises
    ------
    InputError
        If a number is impossible.
    """
    distance, tilt, toward = (np.asarray(value, dtype=float) for value in (distance_mm, tilt_deg, toward_deg))
    possible = np.isfinite(distance) & (distance > 0)
    if not np.all(possible):
        raise InputError(f"distances must be positive numbers of mm, not {_first(distance, ~possible)}")
    if not np.all((tilt >= 0) & (tilt < 90)):
        raise InputError(
            f"tilts must be at least 0 and below 90 degrees, not {_first(tilt, ~((tilt >= 0) & (tilt < 90)))}"
        )
    if not np.all(np.isfinite(toward)):
        raise InputError(f"directions of tilt must be finite angles, not {_first(toward, ~np.isfinite(toward))}")
    rigs = _rigs(rig)
    offset = laser_offsets(rigs.numbers.reshape(-1, len(NUMBERS))).reshape(*rigs.numbers.shape[:-1], 3)
    azimuth = np.arctan2(offset[..., 1], offset[..., 0]) + np.radians(toward)
    slope = np.tan(np.radians(tilt))
    try:
        return np.stack(np.broadcast_arrays(distance, slope * np.cos(azimuth), slope * np.sin(azimuth)), axis=-1)
    except ValueError as error:
        shapes = ", ".join(str(np.shape(value)) for value in (distance, tilt, azimuth))
        raise InputError(f"distances, tilts and directions of shapes {shapes} do not broadcast") from error


def predict(
    rig: Rig | Rigs, planes: ArrayLike, quality: Quality, *, angles: int = ANGLES, criterion: bool = True
) -> Prediction:
    """Predict what planes will be measured with.

    Parameters
    ----------
    rig : Rig or Rigs
        One rig, or many; their leading shape broadcasts with that of the planes.
    planes : (..., 3)
        ``(z_L, p, q)`` as of `plane_at`.
    quality : Pixels or Points
        How well the boundary is seen.
    angles : int
        Places on the arc.
    criterion : bool
        False leaves `excess` out, which takes most of the time where rigs are many: it is NaN, and no plane is
        `View.BEYOND`.

    Raises
    ------
    InputError
        If the rig has no beam, or the shapes do not fit.
    """
    rigs, wanted = _rigs(rig), np.asarray(planes, dtype=float)
    if wanted.ndim == 0 or wanted.shape[-1] != 3:
        raise InputError(f"planes must be (z_L, p, q), of shape (..., 3), not {wanted.shape}")
    try:
        shape = np.broadcast_shapes(rigs.numbers.shape[:-1], wanted.shape[:-1])
    except ValueError as error:
        raise InputError(f"rigs {rigs.numbers.shape[:-1]} and planes {wanted.shape[:-1]} do not broadcast") from error
    numbers = np.broadcast_to(rigs.numbers, (*shape, len(NUMBERS))).reshape(-1, len(NUMBERS))
    flat_planes = np.broadcast_to(wanted, (*shape, 3)).reshape(-1, 3)
    with np.errstate(all="ignore"):  # what cannot be seen, or overflows, is told by its view
        flat = _predicted(numbers, flat_planes, rigs, quality, angles, criterion=criterion)
    parts: dict[str, Any] = {name: value.reshape((*shape, *value.shape[1:])) for name, value in vars(flat).items()}
    for value in parts.values():
        value.setflags(write=False)
    return Prediction(**parts)


def _first(values: Array, wrong: Bools) -> float:
    return float(values[wrong].flat[0])


def _rigs(rig: Rig | Rigs) -> Rigs:
    return Rigs.of(rig) if isinstance(rig, Rig) else rig


def _predicted(numbers: Array, planes: Array, rigs: Rigs, quality: Quality, n: int, *, criterion: bool) -> Prediction:
    offset = laser_offsets(numbers)
    in_laser_frame = planes + np.pad(offset[:, 2:], ((0, 0), (0, 2)))
    setup = eq.Setup(numbers[:, 0] * rigs.pitch_mm, offset[:, 0], offset[:, 1], numbers[:, NUMBERS.index("radius")])
    v = eq.SlopeVariables(None, *in_laser_frame.T)
    lit = eq.lit_side_in_slopes(np, v, setup) > 0
    angles = _angles(offset, quality, n)
    seen = outlines(numbers, planes, angles)
    behind = ~(eq.in_front_in_slopes(np, v, setup) > 0) | np.any(~(seen.depth > 0), axis=-1) | ~(planes[:, 0] > 0)
    length = seen.length * (2 * np.pi * quality.arc / n)
    total = np.sum(length, axis=-1)
    noise = quality.at(seen.by_radius, total)
    weight = np.sqrt(length) / noise.per_pixel
    rows = seen.by_plane * weight[..., None]
    lost = ~np.all(np.isfinite(rows), axis=(-1, -2)) | np.any(np.linalg.norm(rows, axis=1) < SMALLEST, axis=-1)
    gone = behind | ~lit | lost
    weight = np.where(gone[:, None], 1.0, weight)
    rows = np.where(gone[:, None, None], np.eye(3)[np.arange(n) % 3], rows)
    spot, by_rig = _covariances(numbers, planes, angles, seen, rows, weight, 1 / noise.size_cost, rigs, gone)
    normal_spot, normal_rig, rig_part = _carried(numbers, planes, spot, by_rig, rigs)
    harmless = np.pad(1e3 * setup.r[:, None], ((0, 0), (0, 2)))
    axis = minor_axes(setup, np.where(gone[:, None], harmless, in_laser_frame)) / rigs.pitch_mm
    border = np.minimum(seen.pixels + 0.5, rigs.image_size - 0.5 - seen.pixels)
    margin = np.min(border, axis=(-1, -2), initial=np.inf, where=np.isfinite(border))
    excess = _excess(numbers, in_laser_frame, spot, seen, weight, noise.point_sigma, rigs, ~gone & criterion)
    tests = (
        behind,
        ~lit,
        lost,
        ~seen.unfolded,
        ~(margin >= quality.margin_px),
        ~(axis >= quality.least_axis_px),
        ~(excess <= 1) & criterion,
    )
    codes = np.select(tests, range(len(tests)), len(tests))

    def blank(value: Array) -> Array:
        return np.where(gone.reshape(-1, *[1] * (value.ndim - 1)), np.nan, value)

    return Prediction(
        planes.copy(),
        *map(blank, (spot, rig_part, normal_spot, normal_rig, axis, total, margin, excess)),
        codes=codes.astype(np.int64),
    )


def _angles(offset: Array, quality: Quality, n: int) -> Array:
    middle = np.arctan2(offset[:, 1], offset[:, 0]) + np.radians(quality.arc_deg)
    return middle[:, None] + 2 * np.pi * quality.arc * ((np.arange(n) + 0.5) / n - 0.5)


def _covariances(
    numbers: Array,
    planes: Array,
    angles: Array,
    seen: Outlines,
    rows: Array,
    weight: Array,
    keep: Array,
    rigs: Rigs,
    gone: Bools,
) -> tuple[Array, Array]:
    """The boundary's part (M, 3, 3), and the derivative (M, 3, n) of the planes by the calibration's parameters.

    `rows` (M, n, 3) are the boundary's movements over their noise; `keep` (M,) what is left of their mean.
    """
    # Height and blur of the edge are measured as well: what is lost is the boundary's mean position, in part.
    together = weight / np.linalg.norm(weight, axis=-1, keepdims=True)
    mean = np.einsum("mn,mnk->mk", together, rows)
    informative = rows - (1 - keep)[:, None, None] * together[..., None] * mean[:, None, :]
    triangle = np.linalg.inv(np.linalg.qr(informative, mode="r"))
    spot = triangle @ np.swapaxes(triangle, -1, -2)
    if rigs.covariance is None:
        return spot, np.zeros((len(planes), 3, 0))
    moved = by_numbers(numbers, planes, angles, seen.normals, rigs.covariance.parameters) * weight[..., None]
    moved = np.where(gone[:, None, None], 0.0, moved)
    # The points stay where they are: what the rig moves the boundary by, the plane has to move it back.
    basis, upper = np.linalg.qr(rows)
    return spot, -np.linalg.solve(upper, np.swapaxes(basis, -1, -2) @ moved)


def _carried(numbers: Array, planes: Array, spot: Array, by_rig: Array, rigs: Rigs) -> tuple[Array, Array, Array]:
    """RMS angles (M,) of the normal by boundary and by calibration, and the calibration's part (M, 3, 3)."""
    slopes = planes[:, 1:]
    length2 = 1 + np.sum(slopes**2, axis=-1)
    # In the laser-parallel frame n = (-p, -q, 1)/|.|, whose two rows by (p, q) have the squares that this metric holds.
    metric = (np.eye(2) - slopes[:, :, None] * slopes[:, None, :] / length2[:, None, None]) / length2[:, None, None]
    normal_spot = np.sqrt(np.einsum("mij,mij->m", metric, spot[:, 1:, 1:]))
    if rigs.covariance is None:
        return normal_spot, np.zeros(len(planes)), np.zeros_like(spot)
    sigma = rigs.covariance.matrix
    from_slopes = _normals_by_slopes(numbers, planes) @ by_rig[:, 1:]
    turned = from_slopes + normals_by_numbers(numbers, planes, rigs.covariance.parameters)
    normal_rig = np.sqrt(np.einsum("mik,kl,mil->m", turned, sigma, turned))
    return normal_spot, normal_rig, by_rig @ sigma @ np.swapaxes(by_rig, -1, -2)


def _normals_by_slopes(numbers: Array, planes: Array) -> Array:
    """Derivative (M, 3, 2) of the unit normals in the camera frame by ``(p, q)``."""
    steps = 1j * SMALLEST * np.eye(3)[1:]
    return np.stack([camera_normals(numbers, planes + step).imag / SMALLEST for step in steps], axis=-1)


def _excess(
    numbers: Array,
    planes: Array,
    spot: Array,
    seen: Outlines,
    weight: Array,
    sigma_px: Array,
    rigs: Rigs,
    wanted: Bools,
) -> Array:
    """`planeopt.estimation.efficiency.Reach.excess` (M,): rigs one after the other, the planes of each at once."""
    made = np.full(len(planes), np.nan)
    _, group = np.unique(numbers, axis=0, return_inverse=True)
    for which in range(group.max(initial=-1) + 1):
        rows = np.flatnonzero((group.reshape(-1) == which) & wanted)
        if not len(rows):
            continue
        number = numbers[rows[0]]
        f, offset = number[0] * rigs.pitch_mm, laser_offsets(number[None])[0]
        setup = eq.Setup(f, offset[0], offset[1], number[NUMBERS.index("radius")])
        # Distortion and rotation change the scale of the noise by some per cent, which does not matter to a limit.
        boundary = Boundary.of(f * seen.laser_plane[rows], rigs.pitch_mm / weight[rows])
        made[rows] = reach(setup, planes[rows], spot[rows], boundary, rigs.pitch_mm * sigma_px[rows]).excess
    return made
