"""An adjustment as it stands in `calibration.json`."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from planeopt.board import View
from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.ladder import parallelism
from planeopt.calibration.observed import pairs
from planeopt.calibration.record import (
    AdjustmentRecord,
    CovarianceRecord,
    ModelRecord,
    NoiseRecord,
    ParameterRecord,
    SectionRecord,
    Triple,
    ViewFit,
)
from planeopt.calibration.sections import BeamSection, beam_sections

Array = NDArray[np.float64]

WITHIN = 1.959963984540054
"""Standard deviations: 95 % of a Gaussian."""

_UNITS = {
    **dict.fromkeys(("f", "fx", "fy", "cx", "cy"), "px"),
    **dict.fromkeys(("warp_x", "warp_y", "e_x", "e_y", "radius"), "mm"),
}


def adjustment_record(adjustment: Adjustment) -> AdjustmentRecord:
    """Return an adjustment as it stands in the file."""
    before = adjustment.before
    model = adjustment.model
    return AdjustmentRecord(
        model=ModelRecord(
            focal=model.focal,
            distortion=model.distortion,
            warp=model.warp,
            beam=model.beam,
            divergence=model.divergence,
        ),
        parameters=tuple(_parameters(adjustment)),
        derived=tuple(_derived(adjustment)),
        covariance=CovarianceRecord(parameters=adjustment.names, matrix=_rows(adjustment.covariance)),
        with_all=() if before is None else tuple(_parameters(before)),
        noise=_noise(adjustment),
        iterations=adjustment.iterations,
        condition=float(adjustment.condition),
        views=_views(adjustment),
    )


def parameter(name: str, unit: str, value: float, sigma: float | None) -> ParameterRecord:
    """Return a number with the interval of 95 % that a Gaussian of its standard deviation has."""
    low, high = (None, None) if sigma is None else (value - WITHIN * sigma, value + WITHIN * sigma)
    return ParameterRecord(name=name, unit=unit, value=value, sigma=sigma, low95=low, high95=high)


def _parameters(adjustment: Adjustment) -> Iterable[ParameterRecord]:
    for name in adjustment.names:
        yield parameter(name, _UNITS.get(name, "1"), adjustment.value(name), adjustment.sigma(name))


def _derived(adjustment: Adjustment) -> Iterable[ParameterRecord]:
    """Give the focal length in mm and the beam's angles to the optical axis, where these are known."""
    pitch = adjustment.observations.pixel_pitch_mm
    for name in ("f", "fx", "fy") if pitch is not None else ():
        if name in adjustment.names and pitch is not None:
            yield parameter(f"{name}_mm", "mm", pitch * adjustment.value(name), pitch * adjustment.sigma(name))
    if adjustment.model.beam == "free":
        yield from _angles(adjustment)
    if adjustment.model.divergence:
        grown = adjustment.value("divergence")
        yield parameter(
            "divergence_mrad", "mrad", 1e3 * math.atan(grown), 1e3 * adjustment.sigma("divergence") / (1 + grown**2)
        )


def _angles(adjustment: Adjustment) -> Iterable[ParameterRecord]:
    """Give the beam's angles to the optical axis: towards x, towards y, and as a whole."""
    x, y, z = adjustment.state.direction.tolist()
    rows = [adjustment.names.index(name) for name in ("direction_x", "direction_y")]
    covariance = adjustment.covariance[np.ix_(rows, rows)]
    by_z = np.array([-x / z, -y / z])
    for name, i in (("angle_x", 0), ("angle_y", 1)):
        part = (x, y)[i]
        gradient = (z * np.eye(2)[i] - part * by_z) / (part**2 + z**2)
        yield parameter(f"{name}_mrad", "mrad", 1e3 * math.atan2(part, z), 1e3 * _spread(gradient, covariance))
    angle, sigma = parallelism(adjustment)
    # Of no angle at all the first order says nothing.
    yield parameter("angle_mrad", "mrad", 1e3 * angle, 1e3 * sigma if angle > 0 else None)


def _spread(gradient: Array, covariance: Array) -> float:
    return float(np.sqrt(gradient @ covariance @ gradient))


def _noise(adjustment: Adjustment) -> NoiseRecord:
    spotted = np.array([view.spot is not None for view in adjustment.observations.views])
    used = [np.count_nonzero(kept) for kept in adjustment.corner_used]
    seen = sum(len(view) for view in adjustment.observations.views)
    spots = int(np.count_nonzero(adjustment.spot_used))
    return NoiseRecord(
        corner_sigma_px=float(adjustment.corner_sigma),
        corner_factor=float(adjustment.noise.corners),
        spot_factor=float(adjustment.noise.spots),
        chi2_corners=float(adjustment.chi2_corners),
        dof_corners=float(adjustment.dof_corners),
        chi2_spots=float(adjustment.chi2_spots),
        dof_spots=float(adjustment.dof_spots),
        corners=int(sum(used)),
        corners_left_out=int(seen - sum(used)),
        spots=spots,
        spots_left_out=int(np.count_nonzero(spotted)) - spots if spots else 0,
    )


def _views(adjustment: Adjustment) -> tuple[ViewFit, ...]:
    sections = beam_sections(adjustment)
    half = np.array([*adjustment.observations.board.size_mm, 0.0]) / 2
    return tuple(
        _view(adjustment, row, view, half, section)
        for row, (view, section) in enumerate(zip(adjustment.observations.views, sections, strict=True))
    )


def _view(adjustment: Adjustment, row: int, view: View, half: Array, section: BeamSection | None) -> ViewFit:
    rotation, translation = adjustment.rotations[row], adjustment.translations[row]
    corners, used = adjustment.corner_residuals[row], adjustment.corner_used[row]
    spot, chi2 = adjustment.spot_residuals[row], float(adjustment.spot_chi2[row])
    normal = rotation[:, 2]
    return ViewFit(
        name=view.name,
        rotation=triples(rotation),
        translation_mm=triple(translation),
        depth_mm=float((rotation @ half + translation)[2]),
        tilt_deg=math.degrees(math.acos(min(abs(float(normal[2])), 1.0))),
        direction_deg=math.degrees(math.atan2(-normal[1] * normal[2], -normal[0] * normal[2])),
        corner_rms_px=_rms(corners[used]),
        corner_residuals_px=pairs(corners),
        corner_used=tuple(used.tolist()),
        spot_rms_px=_rms(spot),
        spot_residuals_px=tuple(spot.tolist()),
        spot_used=bool(adjustment.spot_used[row]),
        spot_chi2=chi2 if math.isfinite(chi2) else None,
        section=None if section is None else _section(section),
    )


def _section(found: BeamSection) -> SectionRecord:
    return SectionRecord(
        along_mm=found.along,
        centre_mm=triple(found.centre),
        axis_mm=triple(found.axis),
        radius_mm=found.radius,
        sigma_x_mm=float(found.sigma_centre[0]),
        sigma_y_mm=float(found.sigma_centre[1]),
        sigma_radius_mm=found.sigma_radius,
    )


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def triple(values: Sequence[float] | Array) -> Triple:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def triples(matrix: Array) -> tuple[Triple, Triple, Triple]:
    """Return the rows of a matrix (3, 3) as tuples."""
    first, second, third = (triple(row) for row in matrix)
    return first, second, third
