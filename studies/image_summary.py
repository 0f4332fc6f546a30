"""What the images add up to: proportions, variances with their limits, and the finding in words."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from studies.image_cells import CellRow
from studies.image_flags import FlagRow
from studies.image_poses import MAHALANOBIS, PoseRow
from studies.image_sweeps import Setting, SweepRow
from studies.statistics import LEVEL

RIGHT = 0.98
KNOWN_PX = 0.005
"""Standard error below which a cell's bias is known."""

COMPONENTS = ("z_L", "p", "q")


@dataclass(frozen=True)
class CaseRow:
    """How the images of a case ended.

    Attributes
    ----------
    case : str
    images, right, refused, degraded, wrong, broken : int
    right_mahalanobis : int
        By the distance in three dimensions instead of each component.
    least_right : int
        Fewest that a probability of 0.98 explains, two-sided at the family-wise level of 0.001.
    reasons : str
        Why images were refused.
    """

    case: str
    images: int
    right: int
    refused: int
    degraded: int
    wrong: int
    broken: int
    right_mahalanobis: int
    least_right: int
    reasons: str


@dataclass(frozen=True)
class HonestyRow:
    """Errors of one component over their own sigma, in the plain images.

    Attributes
    ----------
    component : str
    images : int
    mean : float
    variance : float
        About zero.
    least_variance, largest_variance : float
        Chi-squared limits, two-sided at the family-wise level of 0.001.
    kolmogorov_p : float
        Of the standard normal distribution.
    """

    component: str
    images: int
    mean: float
    variance: float
    least_variance: float
    largest_variance: float
    kolmogorov_p: float


def cases_of(poses: Sequence[PoseRow]) -> list[CaseRow]:
    """Count the outcomes of each case."""
    names = list(dict.fromkeys(row.case for row in poses))
    rows = []
    for name in names:
        members = [row for row in poses if row.case == name]
        ends = Counter(row.outcome for row in members)
        reasons = Counter(row.reason for row in members if row.outcome == "refused")
        rows.append(
            CaseRow(
                case=name,
                images=len(members),
                right=ends["right"],
                refused=ends["refused"],
                degraded=ends["degraded"],
                wrong=ends["wrong"],
                broken=ends["broken"],
                right_mahalanobis=sum(row.mahalanobis <= MAHALANOBIS for row in members),
                least_right=int(scipy.stats.binom.ppf(LEVEL / 2 / len(names), len(members), RIGHT)),
                reasons=" ".join(f"{reason}:{count}" for reason, count in sorted(reasons.items())),
            )
        )
    return rows


def honesty_of(poses: Sequence[PoseRow]) -> list[HonestyRow]:
    """Test the variance of the plain images' errors."""
    rows = []
    for name in COMPONENTS:
        errors = np.array([getattr(row, f"{name}_sigmas") for row in poses if row.case == "plain"])
        errors = errors[np.isfinite(errors)]
        n = len(errors)
        tails = LEVEL / 2 / len(COMPONENTS)
        least, largest = scipy.stats.chi2.ppf([tails, 1 - tails], n) / n
        test = scipy.stats.kstest(errors, scipy.stats.norm.cdf)
        rows.append(
            HonestyRow(
                name,
                n,
                float(errors.mean()),
                float(np.mean(errors**2)),
                float(least),
                float(largest),
                float(test.pvalue),
            )
        )
    return rows


def numbers(
    cells: Sequence[CellRow], cases: Sequence[CaseRow], honesty: Sequence[HonestyRow], sweeps: Sequence[SweepRow]
) -> dict[str, float]:
    """Return the headline's numbers; `finding` names the tables and columns that they come from."""
    plain = [c for c in cells if c.over == 1]
    known = [c for c in plain if c.bias_error_px < KNOWN_PX]
    hard = [case for case in cases if case.case != "plain"]
    variances = [h.variance for h in honesty]
    speckled = max(sweeps, key=lambda row: row.value if row.axis == "speckle" else -1.0)
    return {
        "largest_bias_px": max(abs(c.bias_px) for c in known),
        "known_to_px": KNOWN_PX,
        "largest_points_over_bound": max(c.points_over_bound for c in plain),
        "speckle": speckled.value,
        "largest_bias_sweeps_px": _largest_bias([row for row in sweeps if row.axis != "speckle"]),
        "largest_bias_speckle_px": _largest_bias([row for row in sweeps if row.axis == "speckle"]),
        "speckle_bias_known_to_px": max(
            (row.bias_error_px for row in sweeps if row.axis == "speckle" and np.isfinite(row.bias_px)), default=np.nan
        ),
        "largest_points_speckle_px": max(row.points_px for row in sweeps if row.axis == "speckle"),
        "hard_images": sum(c.images for c in hard),
        "hard_right": sum(c.right for c in hard),
        "hard_wrong": sum(c.images - c.right - c.refused for c in hard),
        "least_variance": min(variances),
        "largest_variance": max(variances),
    }


def headline(n: Mapping[str, float]) -> str:
    """Say it in a sentence."""
    return (
        f"The boundary's mean bias over sizes, blurs, contrasts and noises is at most {n['largest_bias_px']:.3f} px "
        f"(in the cells that know it to {n['known_to_px']:g} px), the noise of its points at most "
        f"{n['largest_points_over_bound']:.2f} times the Cramér-Rao bound; along blur, contrast and over-exposure the "
        f"bias is at most {n['largest_bias_sweeps_px']:.3f} px, with speckle up to {n['speckle']:g} at most "
        f"{n['largest_bias_speckle_px']:.3f} px (known to {n['speckle_bias_known_to_px']:.3f} px), where the points "
        f"scatter by {n['largest_points_speckle_px']:.2f} px; of {n['hard_images']:.0f} hard images "
        f"{n['hard_right']:.0f} give the right plane and {n['hard_wrong']:.0f} a wrong one; the errors' variance over "
        f"their own is {n['least_variance']:.2f} to {n['largest_variance']:.2f}."
    )


def finding(
    cells: Sequence[CellRow],
    cases: Sequence[CaseRow],
    honesty: Sequence[HonestyRow],
    flags: Sequence[FlagRow],
    sweeps: Sequence[SweepRow],
) -> str:
    """Say what was found; every number comes from the tables."""
    plain, over = [c for c in cells if c.over == 1], [c for c in cells if c.over > 1]
    known = [c for c in plain if c.bias_error_px < KNOWN_PX]
    noisy = [c for c in plain if c.bias_error_px >= KNOWN_PX]
    noise = [
        f"{what} {np.nanmedian(over_bound):.2f} times in the median cell, {np.nanmax(over_bound):.2f} in the worst"
        for what, over_bound in (
            ("of the points", np.array([c.points_over_bound for c in cells])),
            ("of centre and axes", np.array([c.shape_over_bound for c in cells])),
            ("of the size", np.array([c.size_over_bound for c in cells])),
        )
    ]
    hard = [case for case in cases if case.case != "plain"]
    images, right = sum(c.images for c in hard), sum(c.right for c in hard)
    lines = [
        "# The boundary in an image",
        "",
        f"**Bias** (`cells.csv`). Of {len(plain)} cells ({sum(c.images for c in plain)} images) {len(known)} know the "
        f"mean signed distance of the boundary to {KNOWN_PX} px: the largest is {_worst(known)}. Of the noisier others "
        f"it is {_worst(noisy)}. The largest over its standard error is {_most_significant(plain)}. "
        f"Over-exposed twice ({len(over)} cells) the largest is {_worst(over)}.",
        "",
        f"**Noise over the Cramér-Rao bound** (`cells.csv`), RMS: {'; '.join(noise)}.",
        "",
        f"**Refused** in these cells: {_refusals(cells)}.",
        "",
        *_of_sweeps(sweeps),
        "",
        f"**Hard cases** (`cases.csv`). {right} of {images} planes are right within 4 of their own standard "
        f"deviations, {sum(c.refused for c in hard)} refused, {sum(c.degraded for c in hard)} off with a warning, "
        f"{sum(c.wrong for c in hard)} wrong, {sum(c.broken for c in hard)} broken:",
        "",
        "| case | images | right | refused | degraded | wrong | broken | right by Mahalanobis |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {c.case} | {c.images} | {c.right} | {c.refused} | {c.degraded} | {c.wrong} | {c.broken} "
            f"| {c.right_mahalanobis} |"
            for c in cases
        ),
        "",
        "**Honesty** (`honesty.csv`). "
        + "; ".join(
            f"the variance of {h.component} over its own is {h.variance:.2f} "
            f"(right code: {h.least_variance:.2f} to {h.largest_variance:.2f} in 999 of 1,000 runs)"
            for h in honesty
        )
        + f", over {honesty[0].images} images.",
        "",
        "**Flags** (`flags.csv`). Images with something to say about them, or refused:",
        "",
        "| what is wrong | images | said | refused | flags and reasons given |",
        "|---|---|---|---|---|",
        *(f"| {f.fault} | {f.images} | {f.said} | {f.refused} | {f.raised or '-'} |" for f in flags),
    ]
    return "\n".join(lines)


def _largest_bias(rows: Sequence[SweepRow]) -> float:
    return max((abs(row.bias_px) for row in rows if np.isfinite(row.bias_px)), default=np.nan)


def _of_sweeps(sweeps: Sequence[SweepRow]) -> list[str]:
    base = Setting("disc")
    return [
        f"**One axis at a time** (`sweeps.csv`), about a radius of {base.radius_px:g} px, a blur of {base.blur_px:g} "
        f"px, a contrast of {base.contrast:g} and noise of {base.noise:g} grey levels: largest bias, RMS distance of "
        "the points from their mean at both ends, the same over the bound of the pixels' noise, the "
        "largest squared error of size, centre and axes over their own variance (column `own`), refusals:",
        "",
        "| axis | kind | largest bias (px) | at | noise of points (px) | over the bound | own | refused |",
        "|---|---|---|---|---|---|---|---|",
        *(
            _sweep_line([row for row in sweeps if (row.axis, row.kind) == pair])
            for pair in dict.fromkeys((row.axis, row.kind) for row in sweeps)
        ),
    ]


def _sweep_line(rows: Sequence[SweepRow]) -> str:
    first, last = rows[0], rows[-1]
    found = [row for row in rows if np.isfinite(row.bias_px)]
    images = f"{sum(row.refused for row in rows)} of {sum(row.images for row in rows)}"
    if not found:
        return f"| {first.axis} | {first.kind} | - | - | - | - | - | {images} |"
    worst = max(found, key=lambda row: abs(row.bias_px))
    own = max(row.own for row in found)
    over = f"{first.points_over_bound:.2f} to {last.points_over_bound:.2f}"
    return (
        f"| {first.axis} | {first.kind} | {worst.bias_px:+.4f} +- {worst.bias_error_px:.4f} | {worst.value:g} | "
        f"{first.points_px:.3f} to {last.points_px:.3f} | {over} | {own:.2f} | {images} |"
    )


def _refusals(cells: Sequence[CellRow]) -> str:
    faint = [c for c in cells if c.contrast < 10 * c.noise]
    others = [c for c in cells if c.contrast >= 10 * c.noise]
    return (
        f"{sum(c.refused for c in faint)} of {sum(c.images for c in faint)} images with a contrast below ten times the "
        f"noise, {sum(c.refused for c in others)} of the {sum(c.images for c in others)} others"
    )


def _worst(cells: Sequence[CellRow]) -> str:
    found = [c for c in cells if np.isfinite(c.bias_px)]
    return _bias(max(found, key=lambda c: abs(c.bias_px))) if found else "unknown"


def _most_significant(cells: Sequence[CellRow]) -> str:
    found = [c for c in cells if c.bias_error_px > 0]
    if not found:
        return "unknown"
    row = max(found, key=lambda c: abs(c.bias_px) / c.bias_error_px)
    return f"{abs(row.bias_px) / row.bias_error_px:.1f} ({_bias(row)})"


def _bias(row: CellRow) -> str:
    return (
        f"{row.bias_px:+.4f} +- {row.bias_error_px:.4f} px ({row.kind}, radius {row.radius_px:g} px, blur "
        f"{row.blur_px:g} px, contrast {row.contrast:g}, noise {row.noise:g})"
    )
