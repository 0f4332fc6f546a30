"""The file of a comparison, `comparison.json`: its shape, its schema, and its rows as a flat table."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import msgspec
import numpy as np

from planeopt.comparison.problem import Case
from planeopt.comparison.summary import summarise
from planeopt.record import RecordStatus, degrees


class InSigmas(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An error of (z_L, p, q), each over the standard deviation of the Cramér-Rao bound."""

    z_L: float | None
    p: float | None
    q: float | None


class RowRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What one formulation with one solver gave on one input.

    `root` is the plane near which the search ended, also where its answer was refused: visible, other (the second exact
    solution) or elsewhere. `residuals` are the ten equations there, left minus right, by number and unit.
    `error_over_bound` and `closed_form_over_bound` are pooled over (z_L, p, q): 1 in the mean of squares at the bound.
    What a search took has no values where none was begun.
    """

    method: str
    formulation: str
    solver: str
    status: Literal["ok", "degraded", "refused"]
    outcome: str
    message: str
    z_L_mm: float | None
    alpha_deg: float | None
    beta_deg: float | None
    R_mm: float | None
    sigma_z_L_mm: float | None
    sigma_normal_deg: float | None
    root: Literal["visible", "other", "elsewhere"] | None
    z_L_minus_closed_form_mm: float | None
    normal_to_closed_form_deg: float | None
    closed_form_over_bound: float | None
    z_L_error_mm: float | None
    normal_error_deg: float | None
    error_over_bound: float | None
    error_in_bound_sigmas: InSigmas | None
    chi2: float | None
    p_value: float | None
    iterations: int | None
    evaluations: int | None
    first_derivatives: int | None
    second_derivatives: int | None
    build_ms: float | None
    solve_ms: float | None
    total_ms: float | None
    residuals: dict[str, float | None]


class StartRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where all searches of an input began; `z_L_mm` as in the equations."""

    R_mm: float
    z_L_mm: float
    alpha_deg: float
    beta_deg: float


class PlaneRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """(z_L, p, q) as in the equations, or standard deviations of them."""

    z_L_mm: float
    p: float
    q: float


class InputRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One input: what all its rows share, and the rows; `status` and `message` are those that `pose` gives it.

    `bound` are the standard deviations of the Cramér-Rao bound at the truth, or at the closed form's plane where no
    truth is known; `bound_reachable` says whether first order holds there, `noise_estimated` that the points came
    without sigma.
    """

    input: str
    status: RecordStatus
    message: str
    n_points: int
    noise_estimated: bool
    start: StartRecord | None
    truth: PlaneRecord | None
    bound: PlaneRecord | None
    bound_reachable: bool | None
    rows: tuple[RowRecord, ...]


class PooledRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Differences over the bound, pooled over inputs; `monte_carlo` is the standard deviation of `rms`."""

    count: int
    rms: float
    monte_carlo: float | None
    median: float
    z_L: float
    p: float
    q: float


class SummaryRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One method over all inputs: counts, errors pooled, medians of the effort, RMS of each equation's residual."""

    method: str
    formulation: str
    solver: str
    problems: int
    statuses: dict[str, int]
    outcomes: dict[str, int]
    roots: dict[str, int]
    reason: str | None
    error_over_bound: PooledRecord | None
    closed_form_over_bound: PooledRecord | None
    iterations: float | None
    evaluations: float | None
    first_derivatives: float | None
    second_derivatives: float | None
    build_ms: float | None
    solve_ms: float | None
    total_ms: float | None
    residuals: dict[str, float]


class ComparisonFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`comparison.json`."""

    format: Literal[1]
    planeopt: str
    settings: dict[str, str | int | float | None]
    summary: tuple[SummaryRecord, ...]
    inputs: tuple[InputRecord, ...]


def comparison_file(
    cases: Sequence[tuple[Case, RecordStatus, str]], version: str, settings: Mapping[str, str | int | float | None]
) -> ComparisonFile:
    """Return the file of some cases, each with the status and the message of its input."""
    content = {
        "format": 1,
        "planeopt": version,
        "settings": dict(settings),
        "summary": [summary.to_dict() for summary in summarise([case for case, _, _ in cases])],
        "inputs": [_input(*case) for case in cases],
    }
    return msgspec.convert(content, ComparisonFile)


def flat_rows(file: ComparisonFile) -> list[dict[str, Any]]:
    """Return all rows with their input, nested values in columns of their own, all rows with the same keys.

    An input without rows has one with nothing but its status and message.
    """
    rows: list[dict[str, Any]] = []
    for entry in file.inputs:
        of_methods = [_flat(msgspec.to_builtins(row), _IN_ROWS) for row in entry.rows]
        of_none = {"status": entry.status, "message": entry.message}
        rows += [{"input": entry.input} | row for row in of_methods or [of_none]]
    # In the order of rows that have them all.
    keys = dict.fromkeys(key for row in sorted(rows, key=len, reverse=True) for key in row)
    return [{key: row.get(key) for key in keys} for row in rows]


def flat_summary(file: ComparisonFile) -> list[dict[str, Any]]:
    """Return the summary likewise."""
    rows = [_flat(msgspec.to_builtins(summary), _IN_SUMMARY) for summary in file.summary]
    keys = dict.fromkeys(key for row in rows for key in row)
    return [{key: row.get(key) for key in keys} for row in rows]


def comparison_schema() -> dict[str, Any]:
    """Return the JSON schema of `comparison.json`, as it is shipped beside this module."""
    schema = msgspec.json.schema(ComparisonFile)
    for definition in schema["$defs"].values():
        definition["description"] = " ".join(definition["description"].split())
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "planeopt comparison", **schema}


def _input(case: Case, status: RecordStatus, message: str) -> dict[str, Any]:
    start = case.start
    paper = None if start is None else start.in_paper_variables
    return {
        "input": case.name,
        "status": status,
        "message": message,
        "n_points": case.n_points,
        "noise_estimated": case.scale_estimated,
        "start": None
        if paper is None
        else {
            "R_mm": float(paper[0]),
            "z_L_mm": float(paper[1]),
            "alpha_deg": math.degrees(paper[2]),
            "beta_deg": degrees(float(paper[3])),
        },
        "truth": None if case.truth is None else _plane(case.truth),
        "bound": None if case.bound is None else _plane(np.sqrt(np.diag(case.bound))),
        "bound_reachable": case.reachable,
        "rows": [row.to_dict() for row in case.rows],
    }


def _plane(values: np.ndarray) -> dict[str, float]:
    return dict(zip(("z_L_mm", "p", "q"), map(float, values), strict=True))


def _flat(row: Mapping[str, Any], nested: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if key == "residuals":
            flat |= {f"residual {equation}": size for equation, size in value.items()}
        elif key in nested and value is None:
            flat |= {f"{key}_{part}": None for part in nested[key]}
        elif isinstance(value, dict):
            flat |= {f"{key}_{part}": size for part, size in value.items()}
        else:
            flat[key] = value
    return flat


_IN_ROWS: dict[str, tuple[str, ...]] = {"error_in_bound_sigmas": InSigmas.__struct_fields__}
_IN_SUMMARY: dict[str, tuple[str, ...]] = dict.fromkeys(
    ("error_over_bound", "closed_form_over_bound"), PooledRecord.__struct_fields__
)
