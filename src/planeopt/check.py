"""The rig against images of planes: is it still as calibrated? Files in, a verdict and its record out."""

import json
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Literal, Protocol

import msgspec

from planeopt.batch import Search, StrPath, measure
from planeopt.estimation.drift import BLIND, Change, State, drift
from planeopt.estimation.sequence import Positions
from planeopt.executors import ordered_map
from planeopt.record import PoseRecord, RecordStatus, finite
from planeopt.rig import Rig
from planeopt.solution import Solution

CheckStatus = Literal["ok", "degraded", "refused"]
"""As calibrated, as far as images can test it; not so; nothing that could be tested."""


class ImageRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One image's own test: `status` and `message` of its pose, chi-squared with 2 degrees of freedom."""

    input: str
    status: RecordStatus
    message: str
    position: float | None
    z_L_mm: float | None
    chi2: float | None
    dof: int | None
    p_value: float | None
    used: bool
    flags: tuple[str, ...]


class TestedPart(Protocol):
    """One part of a test of a rig; the value of `part` is what it says where it is not ok."""

    @property
    def part(self) -> Enum: ...
    @property
    def chi2(self) -> float: ...
    @property
    def dof(self) -> float: ...
    @property
    def p_value(self) -> float: ...
    @property
    def ok(self) -> bool: ...


class PartRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One part of the test of all images: `pooled`, `shift`, `trend` or `rest`; with a board `spots` and no `trend`."""

    part: str
    chi2: float
    dof: float
    p_value: float
    ok: bool
    message: str

    @classmethod
    def of(cls, test: TestedPart) -> "PartRecord":
        return cls(
            part=test.part.name.lower(),
            chi2=test.chi2,
            dof=test.dof,
            p_value=test.p_value,
            ok=test.ok,
            message="Within what chance explains." if test.ok else test.part.value,
        )


class ChangeRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How far a number of the beam is from the rig's file, or has changed from the first image to the last."""

    name: str
    unit: str
    value: float
    sigma: float

    @classmethod
    def of(cls, change: Change) -> "ChangeRecord":
        return cls(name=change.name, unit=change.unit, value=change.value, sigma=change.sigma)


class Verdict(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every check of a rig says; `untested` is what was not tested."""

    rig: str
    status: CheckStatus
    message: str
    untested: str
    chi2: float | None
    dof: float | None
    p_value: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain JSON values, in the order of the keys."""
        return msgspec.to_builtins(self)

    def to_json(self) -> str:
        """Return the record in ASCII, with its line's end."""
        return f"{json.dumps(self.to_dict(), allow_nan=False, indent=2)}\n"


class CheckRecord(Verdict, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `planeopt check` found in images of planes."""

    tests: tuple[PartRecord, ...]
    shift: tuple[ChangeRecord, ...]
    trend: tuple[ChangeRecord, ...]
    worst: tuple[str, ...]
    images: tuple[ImageRecord, ...]


@dataclass(frozen=True, eq=False)
class Tested:
    """One image: its pose record, and the solution where there is one."""

    record: PoseRecord
    solution: Solution | None

    @property
    def input(self) -> str:
        return self.record.input

    @property
    def status(self) -> RecordStatus:
        return self.record.status

    @property
    def message(self) -> str:
        return self.record.message


def measure_for_check(
    paths: Iterable[StrPath], rig: Rig, *, search: Search | None = None, executor: Executor | None = None
) -> Iterable[Tested]:
    """Yield what each file shows, in the files' order, as they become ready."""
    work = partial(_tested, rig=rig, search=Search() if search is None else search)
    return ordered_map(work, paths, executor)


def _tested(path: StrPath, *, rig: Rig, search: Search) -> Tested:
    measured = measure(path, rig, search=search)
    return Tested(measured.record, measured.solution)


def check(tested: Sequence[Tested], rig: Rig, positions: Positions, rig_name: str) -> CheckRecord:
    """Test a rig with measured images.

    Parameters
    ----------
    tested : sequence of Tested
        From `measure_for_check`; what has no solution is listed and not used.
    rig : Rig
    positions : Positions
        Of the images in their sequence, for the trend.
    rig_name : str
        Of the rig file, for the record.

    Returns
    -------
    CheckRecord
        Its status is `refused` where no image can be used.
    """
    rows = [row for row, image in enumerate(tested) if image.solution is not None]
    solutions = [image.solution for image in tested if image.solution is not None]
    found = drift(solutions, rig, positions=[positions.values[row] for row in rows])
    used = {rows[index] for index in found.images}
    status: dict[State, CheckStatus] = {State.OK: "ok", State.DEGRADED: "degraded", State.UNTESTED: "refused"}
    return CheckRecord(
        rig=rig_name,
        status=status[found.state],
        message=with_lost(found.verdict, [(image.input, image.message) for image in tested if image.solution is None]),
        untested=BLIND,
        chi2=finite(found.chi2),
        dof=None if found.chi2 is None else found.dof,
        p_value=finite(found.p_value),
        tests=tuple(map(PartRecord.of, found.tests)),
        shift=tuple(map(ChangeRecord.of, found.shift)),
        trend=tuple(map(ChangeRecord.of, found.trend)),
        worst=tuple(tested[rows[index]].input for index in found.worst),
        images=tuple(
            _image_record(image.record, position, used=row in used)
            for row, (image, position) in enumerate(zip(tested, positions.values, strict=True))
        ),
    )


def with_lost(verdict: str, lost: Sequence[tuple[str, str]]) -> str:
    """Return a verdict, and what kept images out of it: a spot that is not where the beam can be says something too.

    Parameters
    ----------
    verdict : str
    lost : sequence of (str, str)
        Names of images, and why they are not in it.
    """
    if not lost:
        return verdict
    count = "1 image" if len(lost) == 1 else f"{len(lost)} images"
    name, reason = lost[0]
    return f"{verdict} Not in this: {count}, the first {name} ({reason})"


def _image_record(record: PoseRecord, position: float, *, used: bool) -> ImageRecord:
    return ImageRecord(
        input=record.input,
        status=record.status,
        message=record.message,
        position=finite(position),
        z_L_mm=record.z_L_mm,
        chi2=record.chi2,
        dof=record.dof,
        p_value=record.p_value,
        used=used,
        flags=record.flags,
    )
