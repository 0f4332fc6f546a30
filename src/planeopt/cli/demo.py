"""`planeopt demo`: the bundled targets, beside their truth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from planeopt.cli.files import output_folder, write_csv
from planeopt.cli.messages import complain, exit_status, tables
from planeopt.cli.tables import table

if TYPE_CHECKING:
    from planeopt.accuracy import Score
    from planeopt.batch import Measurement
    from planeopt.rig import Rig

RECORDS, TABLE, FIGURE = "poses.jsonl", "poses.csv", "accuracy.png"


@dataclass(frozen=True, eq=False)
class Shot:
    """A target, what was measured, and how far that is from the truth; no score where there is no plane."""

    path: Path
    measured: "Measurement"
    score: "Score | None"


def demo(
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Measure the bundled targets and show each pose beside its truth.

    Parameters
    ----------
    output
        Folder for poses.jsonl, poses.csv (with the truth) and accuracy.png.
    force
        Write into an existing folder.
    """
    from planeopt.example import example_folder, example_targets
    from planeopt.rig import load_rig

    rig = load_rig(example_folder() / "truth_rig.toml")
    if output is None:
        shots = [_shoot(path, rig) for path in example_targets()]
    else:
        with output_folder(output, force=force) as folder:
            shots = [_shoot(path, rig) for path in example_targets()]
            _write(folder, shots)
    for shot in shots:
        if shot.score is None:
            complain(shot.measured.record.message)
    console = tables()
    rows = [_row(shot.score) for shot in shots if shot.score is not None]
    console.print(table("poses", "target", rows, _POSES))
    console.print(table("errors, beside their standard deviations", "target", rows, _ERRORS))
    if output is not None:
        written = ", ".join(str(output / name) for name in (RECORDS, TABLE, FIGURE))
        console.print(f"written: {written}", soft_wrap=True, highlight=False, markup=False)
    return exit_status(shot.measured.record.status for shot in shots)


def _shoot(path: Path, rig: "Rig") -> Shot:
    from planeopt.accuracy import Score, read_truth
    from planeopt.batch import measure

    measured = measure(path, rig)
    truth = read_truth(path.with_suffix(".json"))
    return Shot(path, measured, None if measured.solution is None else Score.of(path.stem, measured.solution, truth))


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
    ("in sigmas", "z_L_error_sigmas", "+.2f"),
    ("normal deg", "normal_error_deg", ".4f"),
    ("sigma", "sigma_normal_deg", ".4f"),
    ("in sigmas", "normal_error_sigmas", ".2f"),
]


def _row(score: "Score") -> dict[str, Any]:
    """Return a score as a row of the table on disk: mm, degrees, errors also in standard deviations."""
    measured, true, sigma, error = score.pose, score.truth.pose, score.sigma, score.error
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
        "z_L_error_sigmas": score.depth_sigmas,
        "normal_error_deg": math.degrees(error.normal),
        "sigma_normal_deg": None if sigma is None else math.degrees(sigma.normal),
        "normal_error_sigmas": score.normal_sigmas,
    }


def _write(folder: Path, shots: Sequence[Shot]) -> None:
    import msgspec

    # Where the package lies is of no interest in a result.
    records = (msgspec.structs.replace(shot.measured.record, input=shot.path.name) for shot in shots)
    (folder / RECORDS).write_text("".join(f"{record.to_json()}\n" for record in records), encoding="ascii")
    scores = [shot.score for shot in shots if shot.score is not None]
    write_csv(folder / TABLE, [_row(score) for score in scores])
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
