"""The calibration study's answer in words; every number is made from the tables."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from studies.calibration_accuracy import BOUNDARY, SPOT_PX, AccuracyRow, typical_error, worst_in_sigmas
from studies.calibration_fits import POSE, QUANTITIES, of
from studies.calibration_images import ImageRow
from studies.calibration_judged import LEVELS, PLANES, Judged, groups_of, pooled
from studies.calibration_models import OBLIQUE, ModelRow
from studies.calibration_numbers import median_apart
from studies.calibration_repeats import ALL, DrawRow
from studies.calibration_sessions import DEFAULT, SessionRow
from studies.statistics import LEVEL

LABELS = {
    "f": "f",
    "cx": "cx",
    "cy": "cy",
    "e_x": "e_x",
    "e_y": "e_y",
    "radius": "r",
    "direction_x": "d_x",
    "direction_y": "d_y",
    "z_L": "z_L",
    "p": "p",
    "q": "q",
}


@dataclass(frozen=True)
class ModelSummary:
    """What came of one model in one case.

    Attributes
    ----------
    case, model : str
    sessions : int
    f_bias : float
        RMS error of f over f.
    f_relative : float
        Median of its standard deviation over f.
    covered_95 : float
        Share of all 95 % intervals that hold the truth, over the quantities that are free.
    worst : str
        The quantity whose intervals hold it least often.
    worst_95 : float
        How often those do.
    off_axis_mrad, off_axis_sigma_mrad : float
        Medians of the angle between beam and optical axis and of its standard deviation.
    z_L_error : float
        RMS error of z_L over z_L of a plane measured with the rig.
    normal_deg : float
        Median angle between its normal and the true one.
    """

    case: str
    model: str
    sessions: int
    f_bias: float
    f_relative: float
    covered_95: float
    worst: str
    worst_95: float
    off_axis_mrad: float
    off_axis_sigma_mrad: float
    z_L_error: float
    normal_deg: float


_TWO_SIDED_95 = 1.959964


def summarised(rows: Sequence[ModelRow]) -> list[ModelSummary]:
    """Return a row for each case and model."""
    found = []
    for case, model in dict.fromkeys((row.case, row.model) for row in rows):
        own = [row for row in rows if (row.case, row.model) == (case, model)]
        inside = {name: np.abs(of(own, f"{name}_sigmas")) <= _TWO_SIDED_95 for name in QUANTITIES}
        shares = {name: float(held.mean()) for name, held in inside.items() if held.size}
        worst = min(shares, key=lambda name: shares[name])
        found.append(
            ModelSummary(
                case,
                model,
                len(own),
                float(np.sqrt(np.mean(of(own, "f_error") ** 2))),
                float(np.median(of(own, "f_relative"))),
                float(np.mean(np.concatenate(list(inside.values())))),
                worst,
                shares[worst],
                float(np.median(of(own, "off_axis_mrad"))),
                float(np.median(of(own, "off_axis_sigma_mrad"))),
                float(np.sqrt(np.mean(of(own, "z_L_error") ** 2))),
                float(np.median(of(own, "normal_error_deg"))),
            )
        )
    return found


def finding(
    sessions: Sequence[SessionRow],
    images: Sequence[ImageRow],
    draws: Sequence[DrawRow],
    accuracy: Sequence[AccuracyRow],
    models: Sequence[ModelSummary],
    judged: Judged,
) -> str:
    """Return the answer in Markdown."""
    by_default = [row for row in sessions if row.model == DEFAULT]
    views = [row.views for row in by_default]
    noise = [row.corner_sigma_px for row in by_default]
    lines = [
        "# Calibration",
        "",
        f"**Sessions** (`sessions.csv`). {len(by_default)} of random rigs, boards and lenses, {min(views)} to "
        f"{max(views)} views each, "
        f"corners with noise of {min(noise):.2f} to {max(noise):.2f} px, boards bowed by 0.1 mm or so; "
        f"{_outcomes(sessions)}. Each is calibrated as it is unless told otherwise (every term free, with what all "
        "cameras have in common as prior), and with the terms that it was simulated with.",
        "",
        f"**Images** (`images.csv`). {len(images)} rendered sessions, detected and calibrated from their folders: "
        f"{_outcomes(images)}; {100 * np.mean(of(images, 'share')):.0f} % of the corners in view are found, "
        f"{1e3 * np.median(of(images, 'corner_px')):.1f} thousandths of a pixel from the truth (RMS of a coordinate, "
        f"median over sessions; largest {1e3 * np.max(of(images, 'corner_px')):.1f}).",
        "",
        "**Family** (`coverage.csv`, `joint.csv`, `repeats.csv`). "
        f"{judged.kept} of {judged.tests} tests are within two-sided limits at a family-wise level of "
        f"{LEVEL}{_outside(judged)}.",
        "",
        "**Coverage** (`coverage.csv`: `covered` over `sessions`), % of sessions whose interval holds the truth:",
        "",
        f"| group | sessions | level | {' | '.join(LABELS[name] for name in QUANTITIES)} |",
        f"|---|---|---|{'---|' * len(QUANTITIES)}",
        *_coverage(judged, QUANTITIES, list(groups_of(sessions, images))),
        "",
        "A plane at the working distance, measured with each rig from an exact boundary, so that only the calibration "
        "is uncertain:",
        "",
        f"| group | sessions | level | {' | '.join(LABELS[name] for name in POSE)} |",
        f"|---|---|---|{'---|' * len(POSE)}",
        *_coverage(judged, POSE, [PLANES]),
        "",
        "**Joint covariance** (`joint.csv`), all parameters at once; 1 is right:",
        "",
        "| sessions | number | chi-squared over its degrees of freedom | limits | uniformity of the p-values |",
        "|---|---|---|---|---|",
        *(
            f"| {row.group} | {row.sessions} | {row.over_dof:.3f} | {row.low:.3f} to {row.high:.3f} | "
            f"p = {row.ks_p:.2g} |"
            for row in judged.joint
        ),
        "",
        "**Repeats** (`draws.csv`; `repeats.csv`, `ratio`). "
        f"{len({row.session for row in draws})} sessions with new noise, {len(draws)} calibrations: "
        "reported standard deviation over scatter, pooled "
        f"(limits {_pooled_limits(judged)}): "
        + ", ".join(f"{LABELS[name]} {row.ratio:.3f}" for name, row in pooled(judged).items())
        + ".",
        "",
        "**One covariance** (`sessions.csv`: `z_L_apart_mm` over `z_L_sigma_mm`). "
        "With camera and beam taken as independent, each with its own covariance, the same planes' "
        f"standard deviation of z_L would be {median_apart(by_default):.0f} times as large in the median ("
        f"{np.median(of(by_default, 'z_L_apart_mm')):.2g} mm, not {np.median(of(by_default, 'z_L_sigma_mm')):.2g} mm), "
        f"and 95 % intervals would hold the truth in {_apart_coverage(by_default)} % of cases.",
        "",
        "**What the accuracy depends on** (`accuracy.csv`; medians of standard deviations, and the errors' own, as the "
        "median of their size tells it; corners 0.2 px, boundaries 0.1 px; 15 views, tilts to 40 degrees, depth ratio "
        "2 but where varied). The last columns are what the calibration costs a plane tilted by 30 degrees at the "
        f"working distance, and what the noise of its own spot does ({BOUNDARY} points known to {SPOT_PX:g} px):",
        "",
        "| varied | value | f (%) | error of f (%) | e (mm) | r (mm) | direction (mrad) | z_L (%) | of its spot | "
        "normal (deg) | of its spot |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
        *_accuracies(accuracy),
        "",
        f"{_flat(accuracy)}. `calibrate` refuses sessions without views tilted by 10 degrees or more.",
        "",
        "**Models** (`models.csv`, `summaries.csv`) that lack something, "
        "or are chosen by a test (RMS errors; medians of standard deviations):",
        "",
        "| there is | the model | f: error, own sigma (%) | 95 % intervals hold (%) | least often | "
        "beam off axis (mrad) | plane: z_L (%), normal (deg) |",
        "|---|---|---|---|---|---|---|",
        *_models(models),
    ]
    return "\n".join(lines)


def _outcomes(rows: Sequence[SessionRow] | Sequence[ImageRow]) -> str:
    return ", ".join(f"{count} {outcome}" for outcome, count in sorted(Counter(row.outcome for row in rows).items()))


def _outside(judged: Judged) -> str:
    bad = [f"{row.group}, {LABELS[row.quantity]}, {100 * row.level:.0f} %" for row in judged.coverage if not row.within]
    bad += [f"chi-squared of {row.group}" for row in judged.joint if not row.within]
    bad += [f"scatter of {LABELS[row.quantity]}, session {row.session}" for row in judged.repeats if not row.within]
    return f"; outside are: {'; '.join(bad)}" if bad else ""


def _coverage(judged: Judged, names: Sequence[str], groups: Sequence[str]) -> Iterator[str]:
    rows = {(row.group, row.level, row.quantity): row for row in judged.coverage}
    for group in groups:
        for level in LEVELS:
            own = [rows[group, level, name] for name in names]
            cells = " | ".join(f"{100 * row.share:.1f}" for row in own)
            yield f"| {group} | {own[0].sessions} | {100 * level:.0f} | {cells} |"


def _pooled_limits(judged: Judged) -> str:
    row = next(row for row in judged.repeats if row.session == ALL)
    return f"{row.least:.2f} to {row.most:.2f}"


def _apart_coverage(rows: Sequence[SessionRow]) -> str:
    shares = [100 * float(np.mean(np.abs(of(rows, f"{name}_apart")) <= _TWO_SIDED_95)) for name in POSE]
    low, high = f"{min(shares):.0f}", f"{max(shares):.0f}"
    return low if low == high else f"{low} to {high}"


_VARIED = {"views": "views", "tilt": "largest tilt (deg)", "depths": "depth ratio"}


def _accuracies(rows: Sequence[AccuracyRow]) -> Iterator[str]:
    for varied, value in dict.fromkeys((row.varied, row.value) for row in rows):
        own = [row for row in rows if (row.varied, row.value) == (varied, value)]
        f, offset, radius, direction = (
            float(np.median(of(own, name))) for name in ("f_relative", "offset_mm", "radius_mm", "direction_mrad")
        )
        z_L, of_spot = (100 * float(np.median(of(own, name))) for name in ("z_L_relative", "z_L_spot_relative"))
        normal, turned = (float(np.median(of(own, name))) for name in ("normal_deg", "normal_spot_deg"))
        yield (
            f"| {_VARIED[varied]} | {value:g} | {100 * f:.2g} | "
            f"{100 * typical_error(rows, varied, value):.2g} | {offset:.2g} | {radius:.2g} | {direction:.2g} | "
            f"{z_L:.2g} | {of_spot:.2g} | {normal:.2g} | {turned:.2g} |"
        )


def _flat(rows: Sequence[AccuracyRow]) -> str:
    tilts = sorted({row.value for row in rows if row.varied == "tilt"})
    worst = [f"{worst_in_sigmas(rows, 'tilt', tilt):.1f} at {tilt:g}" for tilt in tilts]
    return f"The worst f is off by so many own standard deviations (at tilts to, in degrees): {', '.join(worst)}"


def _models(rows: Sequence[ModelSummary]) -> Iterator[str]:
    for row in rows:
        off = (
            f"{row.off_axis_mrad:.2f} ± {row.off_axis_sigma_mrad:.2f}"
            if row.case == OBLIQUE and row.off_axis_sigma_mrad > 0
            else ""
        )
        yield (
            f"| {row.case} | {row.model} | {100 * row.f_bias:.2g}, {100 * row.f_relative:.2g} | "
            f"{100 * row.covered_95:.0f} | {LABELS[row.worst]}: {100 * row.worst_95:.0f} % | {off} | "
            f"{100 * row.z_L_error:.2g}, {row.normal_deg:.2g} |"
        )
