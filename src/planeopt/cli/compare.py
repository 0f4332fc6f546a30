"""`planeopt compare`: every formulation with every solver that suits it."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from planeopt.cli.files import output_folder, write_csv
from planeopt.cli.messages import complain, exit_status, tables
from planeopt.cli.rigs import load_measuring_rig
from planeopt.cli.tables import table

if TYPE_CHECKING:
    from rich.console import Console

    from planeopt.accuracy import Truth
    from planeopt.comparison import Comparison, FileComparison


def compare(
    *inputs: Annotated[str, Parameter(required=True)],
    rig: Path,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Solve each input by every formulation and solver from the same start: tables of answers, effort and residuals.

    With the truth beside an image (same name, .json) the errors are shown too. Failures stay in the table. Exit status
    as for pose, which is the first row.

    Parameters
    ----------
    inputs
        Images, or .csv files of boundary points (x_px,y_px[,sigma_px]).
    rig
        The rig file (rig.toml).
    output
        Folder for comparison.json and comparison.csv.
    force
        Write into an existing folder.
    """
    from planeopt.comparison import compare_file

    loaded = load_measuring_rig(rig)
    if output is None:
        return _show([compare_file(name, loaded) for name in inputs])
    with output_folder(output, force=force) as folder:
        results = [compare_file(name, loaded) for name in inputs]
        _write(folder, results)
    return _show(results)


def _show(results: Sequence["FileComparison"]) -> int:
    console = tables()
    for result in results:
        record = result.record
        if record.status == "error":
            complain(record.message)
        elif result.comparison is None:
            complain(f"{record.input}: {record.status}: {record.message}")
        else:
            _print_tables(console, record.input, result.comparison, result.truth)
    return exit_status(result.record.status for result in results)


_ANSWERS = [
    ("z_L mm", "z_L_mm", ".4f"),
    ("alpha deg", "alpha_deg", ".4f"),
    ("beta deg", "beta_deg", ".4f"),
    ("R mm", "R_mm", ".4f"),
    ("chi2", "chi2", ".3g"),
]
_FROM_CLOSED_FORM = [
    ("depth from closed form mm", "z_L_minus_closed_form_mm", "+.1e"),
    ("normal from it deg", "normal_to_closed_form_deg", ".1e"),
]
_ERRORS = [("depth error mm", "z_L_error_mm", "+.4f"), ("normal error deg", "normal_error_deg", ".4f")]
_EFFORT = [
    ("iterations", "iterations", "d"),
    ("evaluations", "evaluations", "d"),
    ("derivative evaluations", "derivative_evaluations", "d"),
    ("build ms", "build_ms", ".2f"),
    ("solve ms", "solve_ms", ".2f"),
    ("with checks and covariance ms", "total_ms", ".2f"),
]


def _print_tables(console: "Console", name: str, comparison: "Comparison", truth: "Truth | None") -> None:
    rows = [{"method": _method(row), **row} for row in comparison.to_dicts()]
    answers = table(f"{name}: answers", "method", rows, _ANSWERS, words=[("outcome", "outcome"), ("plane", "root")])
    console.print(answers)
    for row in rows:
        if row["status"] != "ok":
            console.print(f"{row['method']}: {row['message']}", markup=False, highlight=False)
    console.print(table("differences", "method", rows, _FROM_CLOSED_FORM + ([] if truth is None else _ERRORS)))
    console.print(table("effort", "method", rows, _EFFORT))
    equations = dict.fromkeys(equation for row in rows for equation in row["residuals"])
    residuals = [row | {equation: row["residuals"].get(equation) for equation in equations} for row in rows]
    columns = [(equation, equation, ".1e") for equation in equations]
    console.print(table("the ten equations at the solution, left minus right", "method", residuals, columns))


def _method(row: Mapping[str, Any]) -> str:
    solver = row["solver"]
    return row["formulation"] if solver == "none" else f"{row['formulation']} + {solver}"


def _write(folder: Path, results: Sequence["FileComparison"]) -> None:
    inputs = [
        {
            "record": result.record.to_dict(),
            "rows": [] if result.comparison is None else result.comparison.to_dicts(),
        }
        for result in results
    ]
    (folder / "comparison.json").write_text(f"{json.dumps(inputs, indent=1, allow_nan=False)}\n", encoding="utf-8")
    flat = [
        {"input": entry["record"]["input"], **{key: value for key, value in row.items() if key != "residuals"}}
        | {f"residual {equation}": value for equation, value in row["residuals"].items()}
        for entry in inputs
        for row in entry["rows"]
    ]
    keys = dict.fromkeys(key for row in flat for key in row)
    write_csv(folder / "comparison.csv", [{key: row.get(key) for key in keys} for row in flat])
