"""What the images add up to: proportions, variances with their limits, and the finding in words."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from studies.image_cells import CellRow
from studies.image_flags import FlagRow
from studies.image_poses import MAHALANOBIS, PoseRow
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


def headline(cells: Sequence[CellRow], cases: Sequence[CaseRow], honesty: Sequence[HonestyRow]) -> str:
    """Say it in a sentence."""
    plain = [c for c in cells if c.over == 1]
    known = [c for c in plain if c.bias_error_px < KNOWN_PX]
    hard = [case for case in cases if case.case != "plain"]
    variances = [h.variance for h in honesty]
    return (
        f"The boundary's mean bias over sizes, blurs, contrasts and noises is at most "
        f"{max(abs(c.bias_px) for c in known):.3f} px (in the cells that know it to {KNOWN_PX} px), the noise "
        f"of its points at most {max(c.points_over_bound for c in plain):.2f} times the Cramér-Rao bound; of "
        f"{sum(c.images for c in hard)} hard images {sum(c.right for c in hard)} give the right plane and "
        f"{sum(c.images - c.right - c.refused for c in hard)} a wrong one; the errors' variance over their own is "
        f"{min(variances):.2f} to {max(variances):.2f}."
    )


def finding(
    cells: Sequence[CellRow], cases: Sequence[CaseRow], honesty: Sequence[HonestyRow], flags: Sequence[FlagRow]
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
        f"**Bias.** Of {len(plain)} cells ({sum(c.images for c in plain)} images) {len(known)} know the mean signed "
        f"distance of the boundary to {KNOWN_PX} px: it is at most {_worst(known)}. In the noisier others it is at "
        f"most {_worst(noisy)}. The largest over its standard error is {_most_significant(plain)}. Over-exposed "
        f"twice ({len(over)} cells) it is at most {_worst(over)}.",
        "",
        f"**Noise over the Cramér-Rao bound**, RMS: {'; '.join(noise)}.",
        "",
        f"**Refused** in these cells: {_refusals(cells)}.",
        "",
        f"**Hard cases.** {right} of {images} planes are right within 4 of their own standard deviations, "
        f"{sum(c.refused for c in hard)} refused, {sum(c.degraded for c in hard)} off with a warning, "
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
        "**Honesty.** "
        + "; ".join(
            f"the variance of {h.component} over its own is {h.variance:.2f} "
            f"(right code: {h.least_variance:.2f} to {h.largest_variance:.2f} in 999 of 1,000 runs)"
            for h in honesty
        )
        + f", over {honesty[0].images} images.",
        "",
        "**Flags.** Images with something to say about them, or refused:",
        "",
        "| what is wrong | images | said | refused | flags and reasons given |",
        "|---|---|---|---|---|",
        *(f"| {f.fault} | {f.images} | {f.said} | {f.refused} | {f.raised or '-'} |" for f in flags),
    ]
    return "\n".join(lines)


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
