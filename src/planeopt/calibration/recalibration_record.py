"""The record of a field recalibration: files in, an update and its record out."""

import json
from collections.abc import Sequence
from typing import Any, Literal

import msgspec

from planeopt.batch import Measurement
from planeopt.calibration.recalibration import Moves, Recalibration, Updated, recalibrate
from planeopt.check import PartRecord
from planeopt.estimation.sequence import Positions
from planeopt.record import RecordStatus, finite
from planeopt.rig import Rig
from planeopt.spot import Spot

RecalibrationStatus = Literal["ok", "refused"]


class UpdatedRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One number before and after; `sigmas` is null where the change has no standard deviation to be counted in."""

    name: str
    unit: str
    before: float
    sigma_before: float
    after: float
    sigma_after: float
    change: float
    sigmas: float | None

    @classmethod
    def of(cls, row: Updated) -> "UpdatedRecord":
        return cls(
            name=row.name,
            unit=row.unit,
            before=row.before,
            sigma_before=row.sigma_before,
            after=row.after,
            sigma_after=row.sigma_after,
            change=row.change,
            sigmas=finite(row.sigmas),
        )


class UpdateImage(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One image: its pose with the old rig, and chi-squared with 2 degrees of freedom with the old and the new one."""

    input: str
    status: RecordStatus
    message: str
    position: float | None
    chi2_before: float | None
    chi2_after: float | None
    used: bool
    flags: tuple[str, ...]


class RecalibrationRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `planeopt recalibrate` found; `kept` is what no image can update, `outcome` the reason in one word."""

    rig: str
    status: RecalibrationStatus
    outcome: str
    message: str
    kept: str
    moved_mm: float
    turned_mrad: float
    chi2_before: float | None
    p_value_before: float | None
    chi2_after: float | None
    dof: int | None
    tests: tuple[PartRecord, ...]
    seen: tuple[UpdatedRecord, ...]
    parameters: tuple[UpdatedRecord, ...]
    covariance: tuple[tuple[float, ...], ...]
    worst: tuple[str, ...]
    images: tuple[UpdateImage, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain JSON values, in the order of the keys."""
        return msgspec.to_builtins(self)

    def to_json(self) -> str:
        """Return the record in ASCII, with its line's end."""
        return f"{json.dumps(self.to_dict(), allow_nan=False, indent=2)}\n"


def recalibrate_measured(
    measured: Sequence[Measurement], rig: Rig, positions: Positions, rig_name: str, moves: Moves
) -> tuple[RecalibrationRecord, Recalibration]:
    """Update a rig with measured images.

    Parameters
    ----------
    measured : sequence of Measurement
        From `planeopt.batch.measure` with this rig; what has no solution is listed and not used.
    rig : Rig
        With a covariance.
    positions : Positions
        Of the images in their sequence.
    rig_name : str
        Of the rig file, for the record.
    moves : Moves
        How far the beam may have moved.

    Raises
    ------
    InputError
        As `recalibrate`.
    """
    rows: list[int] = []
    spots: list[Spot] = []
    for row, image in enumerate(measured):
        if image.spot is not None and image.solution is not None:
            rows.append(row)
            spots.append(image.spot)
    result = recalibrate(spots, rig, positions=[positions.values[row] for row in rows], moves=moves)
    return _record(result, measured, rows, positions, rig_name), result


def _record(
    result: Recalibration, measured: Sequence[Measurement], rows: Sequence[int], positions: Positions, rig_name: str
) -> RecalibrationRecord:
    after = {} if result.image_chi2 is None else dict(zip(result.images, result.image_chi2.tolist(), strict=True))
    used = {rows[index]: after.get(index) for index in result.images}
    before = result.before
    covariance = result.rig.covariance_matrix.tolist()
    return RecalibrationRecord(
        rig=rig_name,
        status="ok" if result.ok else "refused",
        outcome=result.outcome.name.lower(),
        message=result.message,
        kept=result.kept,
        moved_mm=result.moves.offset_mm,
        turned_mrad=1e3 * result.moves.direction_rad,
        chi2_before=finite(before.chi2),
        p_value_before=finite(before.p_value),
        chi2_after=finite(result.chi2),
        dof=before.dof or None,
        tests=tuple(map(PartRecord.of, result.tests)),
        seen=tuple(map(UpdatedRecord.of, result.seen)),
        parameters=tuple(map(UpdatedRecord.of, result.parameters)),
        covariance=tuple(map(tuple, covariance)),
        worst=tuple(measured[rows[index]].record.input for index in result.worst),
        images=tuple(
            _image(image, position, chi2_after=used.get(row), used=row in used)
            for row, (image, position) in enumerate(zip(measured, positions.values, strict=True))
        ),
    )


def _image(image: Measurement, position: float, *, chi2_after: float | None, used: bool) -> UpdateImage:
    record = image.record
    return UpdateImage(
        input=record.input,
        status=record.status,
        message=record.message,
        position=finite(position),
        chi2_before=record.chi2,
        chi2_after=finite(chi2_after),
        used=used,
        flags=record.flags,
    )
