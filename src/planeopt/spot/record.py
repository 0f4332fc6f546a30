"""The spot record: what one image gave, as plain JSON values with every key always present.

Lengths are in px, angles in degrees, `None` (JSON's null) stands for what is unknown or has no value.
"""

import json
import math
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from planeopt.spot.fitted import FittedEllipse, ellipse_of
from planeopt.spot.points import Spot, SpotFlag, SpotNotFound

SpotStatus = Literal["ok", "degraded", "refused", "error"]
"""A boundary; one with a reservation; no spot that can be measured; an image that cannot be used."""

HARMLESS = frozenset(
    {
        SpotFlag.RING_ASSUMED,
        SpotFlag.LOW_CONTRAST,
        SpotFlag.PARTIAL_ARC,
        SpotFlag.MANY_OUTLIERS,
        SpotFlag.SIGMA_UNKNOWN,
    }
)
"""Flags of which the points' sigma knows: any other one says that the boundary may be off by more than that."""

Pair = tuple[float, float]


class EllipseSigma(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations of first order."""

    centre_px: Pair | None = None
    semi_axes_px: Pair | None = None
    angle_deg: float | None = None


class EllipseRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ellipse fitted to the boundary points; `angle_deg` is the major axis's, from +x to +y."""

    centre_px: Pair | None = None
    semi_axes_px: Pair | None = None
    angle_deg: float | None = None
    sigma: EllipseSigma = EllipseSigma()


class SpotRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One line of `spots.jsonl`; `docs/files.md` explains each key."""

    input: str
    status: SpotStatus
    message: str
    points_file: str | None = None
    picture_file: str | None = None
    kind: str | None = None
    n_points: int | None = None
    n_rejected: int | None = None
    arc_fraction: float | None = None
    ellipse: EllipseRecord = EllipseRecord()
    sigma_px: float | None = None
    blur_px: float | None = None
    contrast: float | None = None
    noise: float | None = None
    full_scale: float | None = None
    saturation: float | None = None
    flags: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain JSON values, in the order of the keys."""
        return msgspec.to_builtins(self)

    def to_json(self) -> str:
        """Return the record on one line, in ASCII, without the line's end."""
        return json.dumps(self.to_dict(), allow_nan=False)


def spot_record(name: str, spot: Spot, full_scale: float | None = None) -> SpotRecord:
    """Return the record of a measured spot: `degraded` where a flag says more than its sigma does.

    Parameters
    ----------
    name : str
        Of the image, as the user gave it.
    spot : Spot
    full_scale : float, optional
        The stored value that is 1 in `contrast` and `noise`.
    """
    doubts = [flag for flag in spot.flags if flag not in HARMLESS]
    what = "spot" if spot.kind is None else spot.kind
    covered = "" if spot.arc_fraction is None else f", which cover {100 * spot.arc_fraction:.0f} % of the ellipse"
    found = f"The boundary of a {what} was measured at {len(spot)} points{covered}."
    return SpotRecord(
        input=name,
        status="degraded" if doubts else "ok",
        message=" ".join([found, *(flag.value for flag in doubts[:1])]),
        kind=spot.kind,
        n_points=len(spot),
        n_rejected=len(spot.rejected),
        arc_fraction=spot.arc_fraction,
        ellipse=_ellipse(ellipse_of(spot)),
        sigma_px=None if spot.sigma is None else float(np.median(spot.sigma)),
        blur_px=spot.blur,
        contrast=spot.contrast,
        noise=spot.noise,
        full_scale=full_scale,
        saturation=spot.saturation,
        flags=tuple(flag.name.lower() for flag in spot.flags),
        sentences=tuple(flag.value for flag in spot.flags),
    )


def no_spot(name: str, reason: SpotNotFound, full_scale: float | None = None) -> SpotRecord:
    """Return the `refused` record of an image without a spot that can be measured; its one flag names the reason."""
    return SpotRecord(
        input=name,
        status="refused",
        message=str(reason),
        full_scale=full_scale,
        flags=(reason.reason.name.lower(),),
        sentences=(reason.reason.value,),
    )


def unusable(name: str, message: str) -> SpotRecord:
    """Return the `error` record of an image that cannot be read or used."""
    return SpotRecord(input=name, status="error", message=message)


def _ellipse(fitted: FittedEllipse | None) -> EllipseRecord:
    if fitted is None:
        return EllipseRecord()
    known = fitted.sigma_centre is None or fitted.sigma_angle is not None
    return EllipseRecord(
        centre_px=_pair(fitted.centre),
        semi_axes_px=_pair(fitted.semi_axes),
        angle_deg=math.degrees(fitted.angle) if known else None,
        sigma=EllipseSigma(
            centre_px=_pair(fitted.sigma_centre),
            semi_axes_px=_pair(fitted.sigma_semi_axes),
            angle_deg=None if fitted.sigma_angle is None else math.degrees(fitted.sigma_angle),
        ),
    )


def _pair(values: NDArray[np.float64] | None) -> Pair | None:
    if values is None:
        return None
    x, y = values.tolist()
    return x, y
