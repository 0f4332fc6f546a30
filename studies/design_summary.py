"""What the design study says, made from its tables."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from studies.design_cells import (
    DISTANCE_MM,
    F_MM,
    OFFSET_MM,
    PIXELS,
    RADIUS_MM,
    TILT_DEG,
    TOWARD_DEG,
    DrawRow,
    ImageRow,
    SweepRow,
)
from studies.design_laws import HumpRow, LawRow, law_of
from studies.statistics import LEVEL


@dataclass(frozen=True)
class CheckRow:
    """A check of the predictions, summed up.

    Attributes
    ----------
    check : str
        "draws": maximum likelihood on drawn points; "images": rendered images, found and solved.
    planes, times, lost : int
        Planes; draws or images of all of them; those without a plane.
    own_least, own_most : float
        Least and largest mean of the solutions' own sigma over the predicted one (of z_L and of the normal; images).
    squared, squared_least, squared_most : float
        Mean squared Mahalanobis distance over 3 by the predicted covariance: of all, and of the planes.
    outside : int
        Planes whose squared error, or that of z_L alone, is beyond chance: two-sided, family-wise over all (draws).
    """

    check: str
    planes: int
    times: int
    lost: int
    own_least: float
    own_most: float
    squared: float
    squared_least: float
    squared_most: float
    outside: int


def limits(draws: int, tests: int) -> tuple[float, float]:
    """Least and largest mean of as many squared normal errors that right predictions leave to chance."""
    tail = LEVEL / 2 / tests
    low, high = scipy.stats.chi2.ppf([tail, 1 - tail], draws)
    return float(low / draws), float(high / draws)


def outside(row: DrawRow, planes: int) -> bool:
    """Whether a plane's errors are beyond chance."""
    solved = row.draws - row.lost
    whole, depth = limits(3 * solved, 2 * planes), limits(solved, 2 * planes)
    return not (whole[0] <= row.squared <= whole[1] and depth[0] <= row.z_L_over**2 <= depth[1])


def checks(draws: Sequence[DrawRow], images: Sequence[ImageRow]) -> list[CheckRow]:
    """Sum both checks up."""
    own = [value for row in images for value in (row.z_L_own_over, row.normal_own_over)]
    drawn, taken = (
        np.array([row.draws - row.lost for row in draws]),
        np.array([row.images - row.refused for row in images]),
    )
    return [
        CheckRow(
            "draws",
            len(draws),
            sum(row.draws for row in draws),
            sum(row.lost for row in draws),
            np.nan,
            np.nan,
            float(np.average([row.squared for row in draws], weights=drawn)),
            min(row.squared for row in draws),
            max(row.squared for row in draws),
            sum(outside(row, len(draws)) for row in draws),
        ),
        CheckRow(
            "images",
            len(images),
            sum(row.images for row in images),
            sum(row.refused for row in images),
            min(own),
            max(own),
            float(np.average([row.squared for row in images], weights=taken)),
            min(row.squared for row in images),
            max(row.squared for row in images),
            0,
        ),
    ]


def reference_of(sweeps: Sequence[SweepRow]) -> SweepRow:
    """Return the row of the reference plane: of the tilt's sweep the nearest to it."""
    rows = [row for row in sweeps if row.sweep == "tilt_deg" and row.toward_deg == TOWARD_DEG]
    return min(rows, key=lambda row: abs(row.value - TILT_DEG))


def numbers(
    sweeps: Sequence[SweepRow], laws: Sequence[LawRow], humps: Sequence[HumpRow], found: Sequence[CheckRow]
) -> dict[str, float]:
    """Return the headline's numbers."""
    reference = reference_of(sweeps)
    drawn, taken = found
    worst = humps[0]
    made = {
        "offset_mm": OFFSET_MM,
        "radius_mm": RADIUS_MM,
        "f_mm": F_MM,
        "distance_mm": DISTANCE_MM,
        "tilt_deg": reference.value,
        "contrast_grey": PIXELS.contrast,
        "noise_grey": PIXELS.noise,
        "blur_px": PIXELS.blur_px,
        "sigma_z_L_um": reference.sigma_z_L_um,
        "sigma_normal_deg": reference.sigma_normal_deg,
    }
    for quantity in ("z_L", "normal"):
        for lever in ("distance", "offset", "radius", "f"):
            row = law_of(laws, quantity, lever)
            made |= {f"{quantity}_{lever}_power_least": row.least, f"{quantity}_{lever}_power_most": row.most}
    return made | {
        "worst_offset_over_radius": worst.worst_offset_over_radius,
        "worst_z_L_over_coaxial": worst.worst_over_coaxial,
        "even_offset_over_radius": worst.even_offset_over_radius,
        "draws": float(drawn.times),
        "draws_planes": float(drawn.planes),
        "draws_squared": drawn.squared,
        "draws_outside": float(drawn.outside),
        "images": float(taken.times),
        "images_own_least": taken.own_least,
        "images_own_most": taken.own_most,
        "images_squared": taken.squared,
    }


def headline(n: dict[str, float]) -> str:
    """Say it in a few sentences, from the numbers."""

    def power(quantity: str, lever: str) -> str:
        least, most = (f"{n[f'{quantity}_{lever}_power_{end}']:.2f}" for end in ("least", "most"))
        return least if least == most else f"{least} to {most}"

    return (
        f"A beam of {n['radius_mm']:.0f} mm radius, {n['offset_mm']:.0f} mm off a camera of {n['f_mm']:.0f} mm focal "
        f"length, is predicted to measure a plane {n['distance_mm']:.0f} mm away, tilted {n['tilt_deg']:.0f} degrees, "
        f"to {n['sigma_z_L_um']:.1f} um and {n['sigma_normal_deg']:.3f} degrees (edge of {n['contrast_grey']:.0f} grey "
        f"levels, noise {n['noise_grey']:.0f}, blur {n['blur_px']:.0f} px). Sigma of z_L goes with the distance to the "
        f"power {power('z_L', 'distance')}, the offset to {power('z_L', 'offset')}, the radius to "
        f"{power('z_L', 'radius')}, f to {power('z_L', 'f')}; that of the normal to {power('normal', 'distance')}, "
        f"{power('normal', 'offset')}, {power('normal', 'radius')}, {power('normal', 'f')}. An offset of "
        f"{n['worst_offset_over_radius']:.2f} radii measures a frontal plane's z_L {n['worst_z_L_over_coaxial']:.2f} "
        f"times worse than none, and only above {n['even_offset_over_radius']:.2f} radii better. Squared errors "
        f"of {n['draws']:.0f} drawn boundaries are {n['draws_squared']:.3f} times the predicted, "
        f"{n['draws_outside']:.0f} of {n['draws_planes']:.0f} planes beyond chance; solutions of {n['images']:.0f} "
        f"rendered images claim {n['images_own_least']:.2f} to {n['images_own_most']:.2f} times the predicted sigma, "
        f"and their squared errors are {n['images_squared']:.2f} times the predicted."
    )


def finding(n: dict[str, float], laws: Sequence[LawRow], humps: Sequence[HumpRow], found: Sequence[CheckRow]) -> str:
    """Say what was found; every number comes from the tables."""
    drawn, taken = found
    z_L, normal = humps
    return "\n".join(
        [
            "# What rig to build",
            "",
            f"**In short.** {headline(n)}",
            "",
            "`sweeps.csv` has the sigmas (the reference plane: `tilt_deg` swept, toward 90), `laws.csv` the powers, "
            "`humps.csv` the offsets, `checks.csv` the sums over `draws.csv` and `images.csv`.",
            "",
            "**Powers.** The closed form's, for a frontal plane and offsets that are large against the radius, and the "
            "least and the largest over planes of the reference rig at several distances, tilts and directions:",
            "",
            "| sigma of | goes with | law | least | most |",
            "|---|---|---|---|---|",
            *(f"| {row.quantity} | {row.lever} | {row.law:g} | {row.least:.3f} | {row.most:.3f} |" for row in laws),
            "",
            "**Offsets** (closed form, `humps.csv`). A frontal plane's z_L is measured worst with an offset of "
            f"{z_L.worst_offset_over_radius:.3f} radii, {z_L.worst_over_coaxial:.3f} times worse than with a coaxial "
            f"beam; from {z_L.even_offset_over_radius:.3f} radii on it is measured better. Its normal is worst "
            f"at {normal.worst_offset_over_radius:.3f} radii ({normal.worst_over_coaxial:.3f} times), and better from "
            f"{normal.even_offset_over_radius:.3f} radii on. `offsets.csv` has the same of tilted planes.",
            "",
            f"**Drawn points.** {drawn.planes} planes, {drawn.times} draws, {drawn.lost} without a plane: the squared "
            f"errors of (z_L, p, q) are {drawn.squared:.3f} times the predicted, {drawn.squared_least:.3f} to "
            f"{drawn.squared_most:.3f} plane by plane; {drawn.outside} planes are beyond chance (chi-squared, "
            f"two-sided, {LEVEL} family-wise, all of (z_L, p, q) and z_L alone).",
            "",
            f"**Images.** {taken.planes} planes, {taken.times} images, {taken.lost} refused: the solutions' own sigma "
            f"is {taken.own_least:.2f} to {taken.own_most:.2f} times the predicted, their squared errors "
            f"{taken.squared:.2f} times ({taken.squared_least:.2f} to {taken.squared_most:.2f} plane by plane). The "
            "prediction is a bound: what finding the spot costs beside it (a background and a plateau that may vary, "
            "points that count as independent) is not in it.",
        ]
    )
