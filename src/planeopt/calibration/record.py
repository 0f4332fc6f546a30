"""`calibration.json`: what was observed, what came out of it and why it is believed; enough to compute all of it again.

Lengths are in mm and px, angles in degrees (mrad where a name says so); null stands for what is unknown or has no
value. Numbers are written so that they read back to the last bit.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from planeopt.errors import InputError
from planeopt.toml_files import FORMAT, as_tables

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Verdict = Literal["ok", "degraded", "refused"]


class BoardRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The board, in the words of `board.toml`."""

    squares: tuple[int, int]
    square_mm: Pair
    marker_mm: float
    dictionary: str
    legacy: bool
    first_id: int
    window_mm: tuple[float, float, float, float] | None


class SpotRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The boundary of the laser's spot on the board in one view, raw px."""

    points_px: tuple[Pair, ...]
    sigma_px: tuple[float, ...] | None
    kind: Literal["disc", "ring"] | None
    arc_fraction: float | None
    contrast: float | None
    blur_px: float | None
    saturation: float | None
    noise: float | None
    flags: tuple[str, ...]


class ViewRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The corners of the board in one view, raw px, and the spot on it."""

    name: str
    ids: tuple[int, ...]
    corners_px: tuple[Pair, ...]
    sigma_px: tuple[float, ...]
    spot: SpotRecord | None


class ObservationsRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that the calibration starts from: from this alone it can be computed again."""

    board: BoardRecord
    image_size: tuple[int, int]
    spot: Literal["disc", "ring", "none"]
    pixel_pitch_mm: float | None
    views: tuple[ViewRecord, ...]


class ImageRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What became of an image, its corners and its spot, and why.

    `blur_px` is that of the board's edges, `marker_share` the side of the markers over that of the squares, as seen.
    """

    name: str
    status: Literal["ok", "refused"]
    reason: str
    n_corners: int
    spot_status: Literal["ok", "refused", "none"]
    spot_reason: str
    spot_flags: tuple[str, ...]
    blur_px: float
    marker_share: float | None


class OptionsRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What was asked for; `expect` maps a name to a stated value and its tolerance."""

    focal: Literal["auto", "shared", "separate"] = "auto"
    distortion: Literal["auto", "none", "k1", "k2", "tangential", "k3"] = "auto"
    warp: bool = True
    beam: Literal["free", "parallel", "none"] = "free"
    corner_weights: Literal["measured", "equal"] = "measured"
    reject: bool = True
    expect: dict[str, Pair] = msgspec.field(default_factory=dict)


class ModelRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What was left free."""

    focal: str
    distortion: str
    warp: bool
    beam: str
    divergence: bool


class ParameterRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A number with its standard deviation and its interval of 95 %, in `unit`."""

    name: str
    unit: str
    value: float
    sigma: float | None
    low95: float | None
    high95: float | None


class CovarianceRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Joint covariance of the parameters that all views share; px, mm and 1, as the parameters have."""

    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


class SectionRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The spot of one view put back on the board: the section of the beam there, across its axis, camera frame.

    `along_mm` is measured along the axis from z = 0, `axis_mm` is where the fitted axis is there, `centre_mm` the
    middle of the measured section; the standard deviations are those of the boundary's noise alone.
    """

    along_mm: float
    centre_mm: Triple
    axis_mm: Triple
    radius_mm: float
    sigma_x_mm: float
    sigma_y_mm: float
    sigma_radius_mm: float


class ViewFit(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The pose of the board in one view (X_camera = R X_board + t) and what is left of its observations.

    Residuals are observed minus predicted, px: of corners in x and y, of the spot's boundary across it, outwards.
    `tilt_deg` is the angle between the optical axis and the board's normal, `direction_deg` where the board's far side
    lies in the image, 0 right, 90 down; `depth_mm` is the z of the board's middle.
    """

    name: str
    rotation: tuple[Triple, Triple, Triple]
    translation_mm: Triple
    depth_mm: float
    tilt_deg: float
    direction_deg: float
    corner_rms_px: float | None
    corner_residuals_px: tuple[Pair, ...]
    corner_used: tuple[bool, ...]
    spot_rms_px: float | None
    spot_residuals_px: tuple[float, ...]
    spot_used: bool
    spot_chi2: float | None
    section: SectionRecord | None


class NoiseRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How well the model describes the observations.

    `corner_sigma_px` is the standard deviation of a corner's coordinate, from the residuals; `corner_factor` it over
    the sigma that was given; `spot_factor` what the boundaries' sigma was multiplied by.
    """

    corner_sigma_px: float
    corner_factor: float
    spot_factor: float
    chi2_corners: float
    dof_corners: float
    chi2_spots: float
    dof_spots: float
    corners: int
    corners_left_out: int
    spots: int
    spots_left_out: int


class AdjustmentRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The joint adjustment of camera, board and beam; `with_all` are the parameters before anything was left out."""

    model: ModelRecord
    parameters: tuple[ParameterRecord, ...]
    derived: tuple[ParameterRecord, ...]
    covariance: CovarianceRecord
    with_all: tuple[ParameterRecord, ...]
    noise: NoiseRecord
    iterations: int
    condition: float
    views: tuple[ViewFit, ...]


class TestRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A model against a smaller one that lacks some terms, by an F test.

    `dof` are the number of terms and the degrees of freedom of the noise; `used` says whether the calibration has the
    terms; `smaller` and `larger` are the free parameters of either model, each with its standard deviation.
    """

    name: str
    statistic: float
    dof: Pair
    p_value: float
    used: bool
    sentence: str
    smaller: dict[str, Pair]
    larger: dict[str, Pair]


class GateRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One condition of a good session; `limits` are those of a warning and of a refusal.

    Of a `symptom` something else is the cause as a rule.
    """

    name: str
    state: Literal["ok", "warn", "refuse"]
    value: float | None
    limits: tuple[float | None, float | None]
    sentence: str
    symptom: bool


class NextViewRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The view that would help most; `gain` is by what share the uncertainty at the working distance would shrink."""

    sentence: str
    rotation: tuple[Triple, Triple, Triple] | None
    translation_mm: Triple | None
    gain: float | None


class FoldRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The views of one fold, left out, predicted by a calibration from the others: corners, then spots.

    `largest_shift` is the largest change of a parameter (which is named) from its value with all views, over the
    standard deviation of such a difference.
    """

    views: tuple[str, ...]
    error_px: float | None
    expected_px: float | None
    spot_error_px: float | None
    spot_expected_px: float | None
    largest_shift: float | None
    parameter: str | None


class HeldOutRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Observations that had no say, predicted by the others: half of each view's corners by the other half; folds."""

    ok: bool
    sentence: str
    error_px: float | None
    expected_px: float | None
    folds: tuple[FoldRecord, ...]


class CostRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the calibration alone costs a plane: standard deviations from the joint covariance.

    Those of `independent` are what would come out if camera and beam were taken as independent of each other, those of
    `offset` from the standard deviations of e_x and e_y alone: wrong, and shown for that.
    """

    z_L_mm: float
    alpha_deg: float
    beta_deg: float | None
    sigma_z_L_mm: float
    sigma_normal_deg: float
    independent_z_L_mm: float
    independent_normal_deg: float
    offset_z_L_mm: float
    offset_normal_deg: float


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a calibration comes from; `time` is that of SOURCE_DATE_EPOCH, null where this is not set."""

    versions: dict[str, str]
    session: str
    command: str
    seed: int
    time: str | None


class CalibrationFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file as a whole; `adjustment` is null where none could be made."""

    format: int = FORMAT
    planeopt: str
    provenance: Provenance
    verdict: Verdict
    message: str
    forced: bool
    gates: tuple[GateRecord, ...]
    next_view: NextViewRecord | None
    options: OptionsRecord
    images: tuple[ImageRecord, ...]
    adjustment: AdjustmentRecord | None
    ladder: tuple[TestRecord, ...]
    tests: dict[str, TestRecord]
    held_out: HeldOutRecord | None
    cost: tuple[CostRecord, ...]
    observations: ObservationsRecord

    @property
    def has_rig(self) -> bool:
        """Whether a `rig.toml` goes with it: there is one that was not refused, or it was asked for all the same."""
        return self.adjustment is not None and (self.verdict != "refused" or self.forced)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values, in the order of the keys."""
        return msgspec.to_builtins(self)

    def to_json(self) -> str:
        """Return the file's text, ASCII: a line for each list of plain values."""
        return f"{_text(self.to_dict(), 0)}\n"


def load_record(path: str | os.PathLike[str]) -> CalibrationFile:
    """Read a `calibration.json`.

    Raises
    ------
    InputError
        If the file is missing, unreadable or not such a file: one line with the file, the key and what is wrong.
    """
    file = Path(path)
    try:
        data = json.loads(file.read_bytes())
    except FileNotFoundError as error:
        raise InputError(f"{file}: there is no such file") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{file}: not valid JSON: {error}") from error
    if not isinstance(data, Mapping):
        raise InputError(f"{file}: not a calibration.json: it must hold an object")
    return as_tables(data, CalibrationFile, str(file))


def calibration_schema() -> dict[str, Any]:
    """Return the JSON schema of `calibration.json`, as it is shipped beside this module."""
    schema = msgspec.json.schema(CalibrationFile)
    for definition in schema["$defs"].values():
        definition["description"] = " ".join(definition["description"].split())
        # All keys are always there, whatever has a default in Python.
        definition["required"] = list(definition["properties"])
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "planeopt calibration", **schema}


def _text(value: Any, depth: int) -> str:
    """Return JSON with one line for each list of plain values: readable, and a tenth of the lines."""
    inner, outer = " " * (depth + 1), " " * depth
    if isinstance(value, Mapping) and value:
        lines = [f"{inner}{json.dumps(key)}: {_text(item, depth + 1)}" for key, item in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{outer}}}"
    if isinstance(value, (list, tuple)) and any(isinstance(item, (list, tuple, Mapping)) for item in value):
        return "[\n" + ",\n".join(f"{inner}{_text(item, depth + 1)}" for item in value) + f"\n{outer}]"
    return json.dumps(value, allow_nan=False)
