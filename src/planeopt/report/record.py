"""`poses.json`: the pose records with their posteriors, what was assumed, and where they come from."""

import json
import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from planeopt.check import ChangeRecord
from planeopt.comparison import Comparison
from planeopt.plane import SpotPose
from planeopt.posterior.record import PosteriorRecord
from planeopt.record import PoseRecord, RecordStatus, SigmaRecord, Slopes, Triple, degrees, finite
from planeopt.solution import Solution
from planeopt.uncertainty import Sigmas

FORMAT = 1


class Share(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A standard deviation of first order, and its parts, the spot's and the calibration's: their squares add up.

    The calibration's is null where the rig has no covariance.
    """

    sigma: float | None = None
    spot: float | None = None
    calibration: float | None = None


class FirstOrder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations of the solution; `normal_deg` is the RMS angle of the normal."""

    z_L_mm: Share = Share()
    alpha_deg: Share = Share()
    beta_deg: Share = Share()
    R_mm: Share = Share()
    p: Share = Share()
    q: Share = Share()
    normal_deg: Share = Share()


class Answer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What one formulation with one solver gave; `outcome` and `message` are the reason where there is no plane."""

    formulation: str
    solver: str
    status: RecordStatus
    outcome: str
    message: str
    z_L_mm: float | None
    alpha_deg: float | None
    beta_deg: float | None
    R_mm: float | None
    sigma_z_L_mm: float | None
    sigma_normal_deg: float | None
    root: str | None
    chi2: float | None
    iterations: int | None
    evaluations: int | None


class ReportRecord(PoseRecord, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pose record and what a report adds.

    `posterior` is null where none was asked for or none could be had: `posterior_missing` says why. `comparison` is
    empty where nothing was solved.
    """

    first_order: FirstOrder = FirstOrder()
    posterior: PosteriorRecord | None = None
    posterior_missing: str | None = None
    comparison: tuple[Answer, ...] = ()


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the posteriors were made."""

    seed: int
    draws: int | None
    robust_dof: float | None
    condition_on_rig: bool
    both_sides: bool


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a report comes from; `time` is UTC, as in RFC 3339."""

    versions: dict[str, str]
    rig_file: str
    rig_sha256: str
    command: str
    seed: int
    time: str


class PartRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One part of the evidence on the rig: `part` is pooled, shift, trend or rest."""

    part: str
    chi2: float
    dof: int
    p_value: float


class DriftRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Is the rig still as calibrated? `state` is ok, degraded or untested; `blind` is what no image can test."""

    state: str
    verdict: str
    blind: str
    tests: tuple[PartRecord, ...]
    shift: tuple[ChangeRecord, ...]
    trend: tuple[ChangeRecord, ...]


class CombinedRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All frames as one plane; `agreement` is alone, agree, scatter or alike, `ok` whether nothing contradicts it."""

    message: str
    agreement: str
    ok: bool
    n_frames: int
    z_L_mm: float | None
    alpha_deg: float | None
    beta_deg: float | None
    R_mm: float | None
    slopes: Slopes
    normal: Triple | None
    point_mm: Triple | None
    sigma: SigmaRecord
    first_order: FirstOrder
    chi2: float | None
    dof: int | None
    p_value: float | None
    outliers: tuple[int, ...]


class TrendRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a quantity changes along a sequence; mm, 1 or rad, per unit of the positions."""

    name: str
    unit: str
    slope: float
    slope_sigma: float
    slope_sigma_calibration: float
    p_value: float
    changes: bool
    message: str


class SequenceRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The inputs as a sequence: their `positions`, per `unit`, in the order of the records."""

    label: str
    unit: str
    positions: tuple[float, ...]
    message: str
    trends: tuple[TrendRecord, ...]


class Summary(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of all inputs; `outliers` are places in `records`, counted from 0."""

    counts: dict[str, int]
    outliers: tuple[int, ...] = ()
    drift: DriftRecord | None = None
    combined: CombinedRecord | None = None
    sequence: SequenceRecord | None = None


class ReportFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file as a whole; `prior` is a sentence."""

    format: int = FORMAT
    planeopt: str
    provenance: Provenance
    settings: Settings
    prior: str
    records: tuple[ReportRecord, ...]
    summary: Summary

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values, in the order of the keys."""
        return msgspec.to_builtins(self)

    def to_json(self) -> str:
        """Return the file's text, ASCII."""
        return f"{json.dumps(self.to_dict(), indent=1, allow_nan=False)}\n"


def report_record(
    record: PoseRecord,
    *,
    first_order: FirstOrder,
    posterior: PosteriorRecord | None,
    missing: str | None,
    comparison: Sequence[Answer],
) -> ReportRecord:
    """Return a pose record with what a report adds."""
    plain = {name: getattr(record, name) for name in record.__struct_fields__}
    return ReportRecord(
        **plain,
        first_order=first_order,
        posterior=posterior,
        posterior_missing=missing,
        comparison=tuple(comparison),
    )


def answers(comparison: Comparison) -> tuple[Answer, ...]:
    """Return the rows of a comparison without their times, which are others at each run."""
    rows = comparison.to_dicts()
    return tuple(Answer(**{name: row[name] for name in Answer.__struct_fields__}) for row in rows)


def first_order(solution: Solution) -> FirstOrder:
    """Return a solution's standard deviations and what of them is whose."""
    return shares(solution.pose, solution.sigma, solution.sigma_spot, solution.covariance, _spot(solution))


def _spot(solution: Solution) -> np.ndarray | None:
    return None if solution.uncertainty is None else solution.uncertainty.spot


def shares(
    pose: SpotPose | None,
    sigma: Sigmas | None,
    spot: Sigmas | None,
    covariance: np.ndarray | None,
    spot_covariance: np.ndarray | None,
) -> FirstOrder:
    """Return standard deviations and what of them is the spot's and the calibration's.

    Parameters
    ----------
    pose : SpotPose or None
    sigma, spot : Sigmas or None
        With and without the rig's part, mm and rad.
    covariance, spot_covariance : (3, 3) or None
        Of (z_L, p, q), likewise.
    """
    if pose is None or sigma is None or spot is None or covariance is None or spot_covariance is None:
        return FirstOrder()
    known = bool(np.any(covariance != spot_covariance))
    p, q = (
        _share(*(math.sqrt(max(float(c[i, i]), 0.0)) for c in (covariance, spot_covariance)), known=known)
        for i in (1, 2)
    )
    return FirstOrder(
        z_L_mm=_share(sigma.z_L, spot.z_L, known=known),
        alpha_deg=_share(degrees(sigma.alpha), degrees(spot.alpha), known=known),
        beta_deg=_share(degrees(sigma.beta), degrees(spot.beta), known=known),
        R_mm=_share(sigma.R, spot.R, known=known),
        p=p,
        q=q,
        normal_deg=_share(degrees(sigma.normal), degrees(spot.normal), known=known),
    )


def _share(total: float | None, spot: float | None, *, known: bool) -> Share:
    total, spot = finite(total), finite(spot)
    if total is None or spot is None:
        return Share()
    return Share(sigma=total, spot=spot, calibration=math.sqrt(max(total**2 - spot**2, 0.0)) if known else None)
