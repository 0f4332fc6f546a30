"""Does a calibration know how good it is, and what makes it good?

1. **Coverage.** Of simulated sessions (points) with random rigs, lenses, boards and poses: how often do 95 % intervals
   of f, cx, cy, e_x, e_y, r and the beam's direction hold the truth; is the joint covariance's chi-squared right? The
   same of rendered sessions through the whole chain: images, detection, adjustment.
2. **Repeats.** Do the parameters of fixed sessions scatter as reported?
3. **One covariance.** What does a plane measured with the rig get from the joint covariance, and what if camera and
   beam are taken as independent?
4. **What it depends on.** The number of views, their tilts, their depths; and what of it a plane suffers that is
   measured with the rig, beside the noise of its own spot.
5. **Models.** What do a bow, a tangential distortion and a tilt of the beam cost if the model has no place for them, or
   if a test decides whether it has?
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from studies.calibration_accuracy import AccuracyRow, run_accuracy
from studies.calibration_accuracy_figures import accuracy_figure, cost_figure
from studies.calibration_figures import coverage_figure, models_figure, repeats_figure
from studies.calibration_images import ImageRow, run_images
from studies.calibration_judged import groups_of, judge
from studies.calibration_models import ModelRow, run_models
from studies.calibration_numbers import headline, numbers
from studies.calibration_repeats import DrawRow, run_repeats
from studies.calibration_sessions import SessionRow, run_sessions
from studies.calibration_summary import finding, summarised
from studies.study import Mode, Result, read_rows, rounded


@dataclass(frozen=True)
class _Size:
    """How many sessions, rendered sessions, repeated sessions, repeats of each, sessions a cell and a case."""

    sessions: int
    images: int
    repeated: int
    draws: int
    cell: int
    case: int
    every: int = 1
    """Of the accuracy's cells only every so many-th."""


_SIZES: dict[Mode, _Size] = {"full": _Size(200, 20, 6, 100, 6, 20), "quick": _Size(4, 1, 2, 4, 1, 1, 6)}


def run(mode: Mode, executor: Executor | None = None) -> Result:
    """Answer the five questions."""
    size = _SIZES[mode]
    return result_of(
        run_sessions(size.sessions, executor),
        run_images(size.images, mode, executor),
        run_repeats(size.repeated, size.draws, executor),
        run_accuracy(size.cell, executor, every=size.every),
        run_models(size.case, executor),
    )


def result_of(
    sessions: Sequence[SessionRow],
    images: Sequence[ImageRow],
    draws: Sequence[DrawRow],
    accuracy: Sequence[AccuracyRow],
    models: Sequence[ModelRow],
) -> Result:
    """Return the tables, figures and words of what was simulated."""
    sessions = rounded(sessions)
    images = rounded(images)
    draws = rounded(draws)
    accuracy = rounded(accuracy)
    models = rounded(models)
    judged, summaries = judge(sessions, images, draws), summarised(models)
    said = numbers(sessions, accuracy, judged)
    return Result(
        tables={
            "sessions": sessions,
            "images": images,
            "draws": draws,
            "accuracy": accuracy,
            "models": models,
            "coverage": judged.coverage,
            "joint": judged.joint,
            "repeats": judged.repeats,
            "summaries": summaries,
        },
        headline=headline(said),
        finding=finding(sessions, images, draws, accuracy, summaries, judged),
        figures={
            "coverage": coverage_figure(groups_of(sessions, images), judged),
            "repeats": repeats_figure(judged),
            "accuracy": accuracy_figure(accuracy),
            "pose_cost": cost_figure(accuracy),
            "models": models_figure(models, summaries, sessions),
        },
        numbers=said,
    )


def from_tables(folder: Path) -> Result:
    """Return the words and figures of tables that were written."""
    return result_of(
        read_rows(folder / "sessions.csv", SessionRow),
        read_rows(folder / "images.csv", ImageRow),
        read_rows(folder / "draws.csv", DrawRow),
        read_rows(folder / "accuracy.csv", AccuracyRow),
        read_rows(folder / "models.csv", ModelRow),
    )
