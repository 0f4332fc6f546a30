"""`planeopt compare`: every formulation with every solver that suits it."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from planeopt.cli.files import output_folder, write_csv
from planeopt.cli.messages import complain, exit_status, tables
from planeopt.cli.rigs import load_measuring_rig

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

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


def _print_tables(console: "Console", name: str, comparison: "Comparison", truth: "Truth | None") -> None:
    rows = comparison.to_dicts()
    console.print(_answers(name, rows, truth))
    for row in rows:
        if row["status"] != "ok":
            console.print(f"{row['formulation']} + {row['solver']}: {row['message']}", markup=False, highlight=False)
    console.print(_effort(rows))
    console.print(_residuals(rows))


def _answers(name: str, rows: Sequence[dict[str, Any]], truth: "Truth | None") -> "Table":
    table = _table(f"{name}: answers", ["formulation", "solver", "outcome", "plane"])
    columns = [
        ("z_L mm", "z_L_mm", ".4f"),
        ("alpha deg", "alpha_deg", ".4f"),
        ("beta deg", "beta_deg", ".4f"),
        ("R mm", "R_mm", ".4f"),
        ("chi2", "chi2", ".3g"),
        ("z_L - closed form", "z_L_minus_closed_form_mm", "+.1e"),
        ("normal to it deg", "normal_to_closed_form_deg", ".1e"),
    ]
    if truth is not None:
        columns += [("z_L error mm", "z_L_error_mm", "+.4f"), ("normal error deg", "normal_error_deg", ".4f")]
    for title, _, _ in columns:
        table.add_column(title, justify="right")
    for row in rows:
        words = [row["formulation"], row["solver"], row["outcome"], row["root"] or "-"]
        table.add_row(*words, *(_number(row[key], style) for _, key, style in columns))
    return table


def _effort(rows: Sequence[dict[str, Any]]) -> "Table":
    table = _table("effort", ["formulation", "solver"])
    columns = [
        ("iterations", "iterations", "d"),
        ("evaluations", "evaluations", "d"),
        ("derivative evaluations", "derivative_evaluations", "d"),
        ("build ms", "build_ms", ".2f"),
        ("solve ms", "solve_ms", ".2f"),
        ("all, with checks and covariance, ms", "total_ms", ".2f"),
    ]
    for title, _, _ in columns:
        table.add_column(title, justify="right")
    for row in rows:
        table.add_row(row["formulation"], row["solver"], *(_number(row[key], style) for _, key, style in columns))
    return table


def _residuals(rows: Sequence[dict[str, Any]]) -> "Table":
    table = _table("the ten equations at the solution, left minus right", ["formulation", "solver"])
    equations = next((list(row["residuals"]) for row in rows if row["residuals"]), [])
    for equation in equations:
        table.add_column(equation, justify="right")
    for row in rows:
        values = (_number(row["residuals"].get(equation), ".1e") for equation in equations)
        table.add_row(row["formulation"], row["solver"], *values)
    return table


def _table(title: str, words: Sequence[str]) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for word in words:
        table.add_column(word)
    return table


def _number(value: float | None, style: str) -> str:
    return "-" if value is None else format(value, style)


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
