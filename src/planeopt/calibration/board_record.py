"""The record of a check by new views of a board: images in, a verdict and its record out."""

import math
from typing import Literal

import msgspec

from planeopt.calibration.board_causes import Moved
from planeopt.calibration.board_check import check_board
from planeopt.calibration.board_verdict import BoardChange, BoardState, ViewTest
from planeopt.calibration.detection import Detected, ImageStatus
from planeopt.check import ChangeRecord, CheckStatus, PartRecord, Verdict, with_lost
from planeopt.record import finite
from planeopt.rig import Rig


class MovedRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A group of parameters, what its change explains of chi-squared, and that change."""

    group: str
    chi2: float
    dof: int
    p_value: float
    changes: tuple[ChangeRecord, ...]

    @classmethod
    def of(cls, moved: Moved) -> "MovedRecord":
        changes = tuple(ChangeRecord(name=n, unit=u, value=value, sigma=s) for n, u, value, s in moved.changes)
        return cls(group=moved.group, chi2=moved.chi2, dof=moved.dof, p_value=moved.p_value, changes=changes)


class ParameterCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One parameter: the file's and the update; `found_from` is null where no change would be found."""

    name: str
    unit: str
    before: float
    sigma_before: float
    after: float
    sigma_after: float
    sigmas: float
    found_from: float | None

    @classmethod
    def of(cls, change: BoardChange) -> "ParameterCheck":
        return cls(
            name=change.name,
            unit=change.unit,
            before=change.before,
            sigma_before=change.sigma_before,
            after=change.after,
            sigma_after=change.sigma_after,
            sigmas=change.sigmas,
            found_from=change.found_from if math.isfinite(change.found_from) else None,
        )


class ViewRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One image: what came of it, and its own tests of the rig, by its corners and by its spot (5 numbers)."""

    input: str
    status: Literal["ok", "refused"]
    message: str
    spot: Literal["ok", "refused", "none"]
    spot_message: str
    corners: int
    rms_px: float | None
    chi2: float | None
    dof: int | None
    p_value: float | None
    spot_chi2: float | None
    spot_p_value: float | None


class BoardCheckRecord(Verdict, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `planeopt check --board` found."""

    tests: tuple[PartRecord, ...]
    causes: tuple[MovedRecord, ...]
    instead: tuple[str, ...]
    groups: tuple[MovedRecord, ...]
    parameters: tuple[ParameterCheck, ...]
    corner_sigma_px: float | None
    images: tuple[ViewRecord, ...]


def check_detected(detected: Detected, rig: Rig, rig_name: str, *, bow_mm: float) -> BoardCheckRecord:
    """Test a rig with what was detected in images of a board.

    Parameters
    ----------
    detected : Detected
    rig : Rig
    rig_name : str
        Of the rig file, for the record.
    bow_mm : float
        As in `check_board`.

    Raises
    ------
    InputError
        As `check_board`.
    """
    found = check_board(detected.observations, rig, bow_mm=bow_mm)
    status: dict[BoardState, CheckStatus] = {
        BoardState.OK: "ok",
        BoardState.DEGRADED: "degraded",
        BoardState.UNTESTED: "refused",
    }
    first = found.tests[0] if found.tests else None
    views = {view.name: view for view in found.views}
    return BoardCheckRecord(
        rig=rig_name,
        status=status[found.state],
        message=with_lost(
            found.verdict, [(image.name, image.reason) for image in detected.images if image.status == "refused"]
        ),
        untested=found.untested,
        chi2=None if first is None else first.chi2,
        dof=None if first is None else first.dof,
        p_value=None if first is None else first.p_value,
        tests=tuple(map(PartRecord.of, found.tests)),
        causes=tuple(map(MovedRecord.of, found.causes)),
        instead=found.instead,
        groups=tuple(map(MovedRecord.of, found.groups)),
        parameters=tuple(map(ParameterCheck.of, found.changes)),
        corner_sigma_px=finite(found.corner_sigma),
        images=tuple(_view(image, views.get(image.name)) for image in detected.images),
    )


def _view(image: ImageStatus, view: ViewTest | None) -> ViewRecord:
    return ViewRecord(
        input=image.name,
        status=image.status,
        message=image.reason,
        spot=image.spot_status,
        spot_message=image.spot_reason,
        corners=image.n_corners,
        rms_px=None if view is None else view.rms_px,
        chi2=None if view is None else view.chi2,
        dof=None if view is None else view.dof,
        p_value=None if view is None else view.p_value,
        spot_chi2=None if view is None else view.spot_chi2,
        spot_p_value=None if view is None else view.spot_p_value,
    )
