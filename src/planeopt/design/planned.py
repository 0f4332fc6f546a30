"""Predictions for a rig over distances and tilts, with what would help and what is wanted: for tables and files."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from planeopt.design.levers import Built, Sensitivity, Smallest, sensitivities, smallest
from planeopt.design.prediction import Prediction, plane_at, predict
from planeopt.design.quality import Quality
from planeopt.errors import InputError
from planeopt.rig import Rig

Array = NDArray[np.float64]

MOST_ROWS = 10_000
"""Planes of a table that are still a table."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What a rig would do.

    Attributes
    ----------
    rig : Rig
    quality : Pixels or Points
    distance_mm, tilt_deg, toward_deg : (M,)
        Of each plane, as of `plane_at`; an untilted plane has the direction 0.
    prediction : Prediction
        Of shape (M,).
    levers : tuple of Sensitivity
        Of the same planes.
    wanted : tuple of Smallest
        What reaches what is wanted, for each number that can be built otherwise; empty where nothing is wanted.
    """

    rig: Rig
    quality: Quality
    distance_mm: Array
    tilt_deg: Array
    toward_deg: Array
    prediction: Prediction
    levers: tuple[Sensitivity, ...]
    wanted: tuple[Smallest, ...]

    @property
    def hardest(self) -> int | None:
        """The plane whose z_L is known worst among those that can be measured; None where none can."""
        sigma = np.where(self.prediction.visible & np.isfinite(self.prediction.z_L_mm), self.prediction.z_L_mm, -np.inf)
        return int(np.argmax(sigma)) if np.any(self.prediction.visible) else None

    def rows(self) -> list[dict[str, Any]]:
        """Return a plane a row: its number None where there is none."""
        found = self.prediction
        columns = {
            "distance_mm": self.distance_mm,
            "tilt_deg": self.tilt_deg,
            "toward_deg": self.toward_deg,
            "sigma_z_L_mm": found.z_L_mm,
            "sigma_z_L_spot_mm": found.z_L_spot_mm,
            "sigma_normal_deg": found.normal_deg,
            "sigma_normal_spot_deg": found.normal_spot_deg,
            "sigma_tilt_deg": found.tilt_deg,
            "axis_px": found.axis_px,
            "margin_px": found.margin_px,
            "excess": found.excess,
        }
        columns |= {f"z_L_by_{lever.lever}": lever.z_L for lever in self.levers}
        columns |= {f"normal_by_{lever.lever}": lever.normal for lever in self.levers}
        return [
            {name: _number(values[row]) for name, values in columns.items()} | {"view": str(found.views[row])}
            for row in range(len(self.distance_mm))
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return all of it, for JSON."""
        camera, beam = self.rig.camera, self.rig.require_beam()
        rig: dict[str, Any] = {
            "image_size": list(camera.image_size),
            "f_px": [camera.fx, camera.fy],
            "centre_px": [camera.cx, camera.cy],
            "pixel_pitch_mm": camera.pixel_pitch_mm,
            "radius_mm": beam.radius,
            "offset_mm": list(beam.offset),
            "direction": list(beam.direction),
            "sigmas": {}
            if self.rig.covariance is None
            else dict(zip(self.rig.covariance.parameters, self.rig.covariance.sigmas.tolist(), strict=True)),
        }
        return {
            "rig": rig,
            "quality": asdict(self.quality),
            "planes": self.rows(),
            "wanted": [{key: _plain(value) for key, value in asdict(each).items()} for each in self.wanted],
        }


def plan(
    rig: Rig,
    quality: Quality,
    distances_mm: Sequence[float],
    tilts_deg: Sequence[float],
    toward_deg: Sequence[float],
    *,
    depth_mm: float | None = None,
    normal_deg: float | None = None,
) -> Plan:
    """Predict for all distances, tilts and directions of tilt.

    Parameters
    ----------
    rig : Rig
    quality : Pixels or Points
    distances_mm, tilts_deg, toward_deg : sequence of float
        As of `plane_at`; each combination once.
    depth_mm, normal_deg : float, optional
        Largest standard deviations wanted, over all of them.

    Raises
    ------
    InputError
        If there is nothing to predict or too much, or a number is impossible.
    """
    for name, values in (("distances", distances_mm), ("tilts", tilts_deg), ("directions of tilt", toward_deg)):
        if not len(values):
            raise InputError(f"there are no {name} to predict for")
    cases = [
        (distance, tilt, toward)
        for distance in dict.fromkeys(distances_mm)
        for tilt in dict.fromkeys(tilts_deg)
        for toward in (dict.fromkeys(toward_deg) if tilt else (0.0,))
    ]
    if len(cases) > MOST_ROWS:
        raise InputError(f"these are {len(cases)} planes: at most {MOST_ROWS} make a table")
    distance, tilt, toward = np.array(cases, dtype=float).T
    planes = plane_at(rig, distance, tilt, toward)
    wanted = {"depth_mm": depth_mm, "normal_deg": normal_deg}
    given = {name: value for name, value in wanted.items() if value is not None}
    return Plan(
        rig,
        quality,
        distance,
        tilt,
        toward,
        predict(rig, planes, quality),
        sensitivities(rig, planes, quality),
        _wanted(rig, planes, quality, given) if given else (),
    )


def _wanted(rig: Rig, planes: Array, quality: Quality, given: Mapping[str, float]) -> tuple[Smallest, ...]:
    levers: tuple[Built, ...] = get_args(Built)
    coaxial = not any(rig.require_beam().offset)
    return tuple(
        smallest(rig, planes, quality, lever, **given) for lever in levers if not (coaxial and lever == "offset")
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _plain(value: str | float | None) -> str | float | None:
    return _number(value) if isinstance(value, float) else value
