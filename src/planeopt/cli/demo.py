"""`planeopt demo`: the bundled session calibrated, the bundled targets measured with that rig, all beside the truth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.types import PositiveInt

from planeopt.cli.clock import now, stated_time
from planeopt.cli.files import output_folder, write_csv
from planeopt.cli.messages import complain, exit_status, stages, tables
from planeopt.cli.messages import report as progress
from planeopt.cli.tables import table, text_table

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rich.table import Table

    from planeopt.accuracy import Score
    from planeopt.batch import Measurement
    from planeopt.calibration.routine import Calibration
    from planeopt.rig import Rig

CALIBRATION, REPORT = "calibration", "report"
RECORDS, TABLE, PARAMETERS, FIGURE = "poses.jsonl", "poses.csv", "parameters.csv", "accuracy.png"
_NONE = Parameter(negative="")


@dataclass(frozen=True, eq=False)
class Shot:
    """A target, what was measured, and how far that is from the truth; no score where there is no plane."""

    path: Path
    measured: "Measurement"
    score: "Score | None"


def demo(
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    posterior: bool = True,
    jobs: PositiveInt = 1,
    force: Annotated[bool, _NONE] = False,
) -> int:
    """Calibrate on the bundled session, measure the bundled targets with that rig, show all beside the truth.

    In the folder: calibration/ as planeopt calibrate writes it, report/ as planeopt report does, the records
    (poses.jsonl), poses and rig beside the truth (poses.csv, parameters.csv), and the errors drawn (accuracy.png).

    Parameters
    ----------
    output
        Folder for all that.
    posterior
        Whether the report samples posteriors, which takes most of the time.
    jobs
        Processes to work in.
    force
        Write into an existing folder.
    """
    from planeopt.example import example_folder
    from planeopt.executors import processes
    from planeopt.rig import load_rig

    truth = load_rig(example_folder() / "truth_rig.toml")
    with processes(jobs) as executor:
        if output is None:
            calibration = _calibrated(executor)
            shots = _shots(calibration.rig, executor)
        else:
            with output_folder(output, force=force) as folder:
                calibration = _calibrated(executor)
                _write_calibration(folder / CALIBRATION, calibration)
                shots = _shots(calibration.rig, executor)
                _write(folder, calibration.rig, truth, shots)
                _report(folder, output, calibration.rig, executor, posterior=posterior)
    _show(calibration, truth, shots)
    if output is not None:
        written = ", ".join(str(output / name) for name in (CALIBRATION, REPORT, RECORDS, TABLE, PARAMETERS, FIGURE))
        tables().print(f"written: {written}", soft_wrap=True, highlight=False, markup=False)
    return exit_status([calibration.verdict, *(shot.measured.record.status for shot in shots)])


def _calibrated(executor: "Executor | None") -> "Calibration":
    from planeopt.calibration.routine import calibrate
    from planeopt.example import example_folder

    with stages() as tell:
        return calibrate(example_folder() / "session", executor=executor, progress=tell)


def _shots(rig: "Rig", executor: "Executor | None") -> list[Shot]:
    from planeopt.accuracy import Score, read_truth
    from planeopt.batch import measure
    from planeopt.example import example_targets
    from planeopt.executors import ordered_map

    paths = example_targets()
    shots = []
    for path, measured in zip(paths, ordered_map(partial(measure, rig=rig), paths, executor), strict=True):
        truth = read_truth(path.with_suffix(".json"))
        score = None if measured.solution is None else Score.of(path.stem, measured.solution, truth)
        shots.append(Shot(path, measured, score))
    return shots


_POSES = [
    (title, key, style)
    for name, measured, style in (
        ("z_L mm", "z_L_mm", ".3f"),
        ("alpha deg", "alpha_deg", ".3f"),
        ("beta deg", "beta_deg", ".3f"),
        ("R mm", "R_mm", ".3f"),
    )
    for title, key in ((name, measured), ("true", f"true_{measured}"))
]
_ERRORS = [
    ("depth mm", "z_L_error_mm", "+.4f"),
    ("sigma", "sigma_z_L_mm", ".4f"),
    ("spot's", "sigma_spot_z_L_mm", ".4f"),
    ("in sigmas", "z_L_error_sigmas", "+.2f"),
    ("normal deg", "normal_error_deg", ".4f"),
    ("sigma", "sigma_normal_deg", ".4f"),
    ("spot's", "sigma_spot_normal_deg", ".4f"),
    ("in sigmas", "normal_error_sigmas", ".2f"),
]


def _show(calibration: "Calibration", truth: "Rig", shots: Sequence[Shot]) -> None:
    """Print the rig, the poses and their errors, each beside the truth."""
    from planeopt.accuracy import rig_chi2

    console = tables()
    for shot in shots:
        if shot.score is None:
            complain(shot.measured.record.message)
    console.print(_rig_table(calibration.rig, truth))
    chi2, count = rig_chi2(calibration.rig, truth)
    for line in (
        f"{calibration.verdict.upper()}: {calibration.message}",
        f"All {count} errors together, by their joint covariance: chi-squared {chi2:.1f}, where {count} is expected.\n",
    ):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    rows = [_row(shot.score, shot.measured) for shot in shots if shot.score is not None]
    console.print(table("poses", "target", rows, _POSES))
    console.print(table("errors, beside their standard deviations", "target", rows, _ERRORS))


def _rig_table(rig: "Rig", truth: "Rig") -> "Table":
    """Return the rig beside the truth, each number to the second digit of its standard deviation."""
    from planeopt.accuracy import rig_scores
    from planeopt.report.words import number

    columns: list[tuple[str, Literal["left", "right"]]] = [
        ("parameter", "left"),
        ("calibrated", "right"),
        ("true", "right"),
        ("error", "right"),
        ("sigma", "right"),
        ("in sigmas", "right"),
    ]
    rows = [
        (
            score.name,
            *(number(value, score.sigma) for value in (score.value, score.truth)),
            f"{score.error:+.1e}",
            f"{score.sigma:.1e}",
            f"{score.sigmas:+.2f}",
        )
        for score in rig_scores(rig, truth)
    ]
    return text_table("the rig, px, mm and 1", columns, rows)


def _parameters(rig: "Rig", truth: "Rig") -> list[dict[str, Any]]:
    from planeopt.accuracy import rig_scores

    return [
        {
            "parameter": score.name,
            "value": score.value,
            "true": score.truth,
            "error": score.error,
            "sigma": score.sigma,
            "error_sigmas": score.sigmas,
        }
        for score in rig_scores(rig, truth)
    ]


def _row(score: "Score", measurement: "Measurement") -> dict[str, Any]:
    """Return a score as a row of the table on disk: mm, degrees, errors also in standard deviations."""
    measured, true, sigma, error = score.pose, score.truth.pose, score.sigma, score.error
    spot = None if measurement.solution is None else measurement.solution.sigma_spot
    return {
        "target": score.name,
        "z_L_mm": measured.z_L,
        "true_z_L_mm": true.z_L,
        "alpha_deg": math.degrees(measured.alpha),
        "true_alpha_deg": math.degrees(true.alpha),
        "beta_deg": None if measured.beta is None else math.degrees(measured.beta),
        "true_beta_deg": None if true.beta is None else math.degrees(true.beta),
        "R_mm": measured.R,
        "true_R_mm": true.R,
        "z_L_error_mm": error.depth,
        "sigma_z_L_mm": None if sigma is None else sigma.z_L,
        "sigma_spot_z_L_mm": None if spot is None else spot.z_L,
        "z_L_error_sigmas": score.depth_sigmas,
        "normal_error_deg": math.degrees(error.normal),
        "sigma_normal_deg": None if sigma is None else math.degrees(sigma.normal),
        "sigma_spot_normal_deg": None if spot is None else math.degrees(spot.normal),
        "normal_error_sigmas": score.normal_sigmas,
    }


def _write_calibration(folder: Path, calibration: "Calibration") -> None:
    from planeopt.report.calibration_files import write_calibration

    folder.mkdir()
    # Where the package lies is of no interest in a result.
    command = "planeopt calibrate calibration/example/session"
    write_calibration(calibration, folder, session="calibration/example/session", command=command, when=stated_time())


def _write(folder: Path, rig: "Rig", truth: "Rig", shots: Sequence[Shot]) -> None:
    import msgspec

    records = (msgspec.structs.replace(shot.measured.record, input=shot.path.name) for shot in shots)
    (folder / RECORDS).write_text("".join(f"{record.to_json()}\n" for record in records), encoding="ascii")
    write_csv(folder / TABLE, [_row(shot.score, shot.measured) for shot in shots if shot.score is not None])
    write_csv(folder / PARAMETERS, _parameters(rig, truth))
    scores = [shot.score for shot in shots if shot.score is not None]
    if scores:
        _draw(folder / FIGURE, shots, scores)


def _draw(path: Path, shots: Sequence[Shot], scores: Sequence["Score"]) -> None:
    """Draw all scores, and the target that is tilted most."""
    from planeopt.report import accuracy_figure
    from planeopt.spot import read_image

    steepest = max(scores, key=lambda score: score.truth.pose.alpha)
    shot = next(shot for shot in shots if shot.score is steepest)
    if shot.measured.spot is not None:
        accuracy_figure(read_image(shot.path), shot.measured.spot, scores, shot.path.name).savefig(path)


def _report(folder: Path, output: Path, rig: "Rig", executor: "Executor | None", *, posterior: bool) -> None:
    """Write what `planeopt report` writes of the targets."""
    import msgspec

    from planeopt.cli.report import kept_as_they_come
    from planeopt.example import example_targets
    from planeopt.report.build import assemble
    from planeopt.report.calibration_files import RIG
    from planeopt.report.examine import Examined, Options, examine_many
    from planeopt.report.provenance import provenance

    rig_file = str(output / CALIBRATION / RIG)
    words = ["planeopt", "report", "calibration/example/targets/*.png", "--rig", rig_file, "-o", str(output / REPORT)]
    command = " ".join(words if posterior else [*words, "--no-posterior"])
    came = provenance(folder / CALIBRATION / RIG, command=command, seed=0, when=now())
    options = Options() if posterior else Options(draws=None)
    examined: list[Examined] = []
    paths = example_targets()
    progress(kept_as_they_come(examine_many(paths, rig, options, executor=executor), examined), len(paths), "report")
    named = [
        replace(one, record=msgspec.structs.replace(one.record, input=path.name))
        for one, path in zip(examined, paths, strict=True)
    ]
    (folder / REPORT).mkdir()
    assemble(named, rig, msgspec.structs.replace(came, rig_file=rig_file), options).write(folder / REPORT)
