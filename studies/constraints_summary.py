"""What the study of the constraints says, made from its tables."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.constraints_culprit import CulpritRow
from studies.constraints_estimates import ESTIMATORS, EstimateRow, TripleRow
from studies.constraints_ranks import EdgeRow, FreeRow, RankRow
from studies.constraints_subsets import SINGULAR, SubsetRow

LARGEST_PX = 15.0
INDEPENDENT = "R cos(alpha) = r"


@dataclass(frozen=True)
class Tables:
    """All tables of the study."""

    ranks: Sequence[RankRow]
    edge: Sequence[EdgeRow]
    free: Sequence[FreeRow]
    subsets: Sequence[SubsetRow]
    estimates: Sequence[EstimateRow]
    triples: Sequence[TripleRow]
    culprits: Sequence[CulpritRow]


def choices(rows: Sequence[SubsetRow]) -> list[SubsetRow]:
    """The choices of (11)-(15), without their independent form."""
    return [row for row in rows if row.rows != INDEPENDENT]


def independent_form(rows: Sequence[SubsetRow]) -> SubsetRow:
    """The row of ``R cos(alpha) = r``."""
    return next(row for row in rows if row.rows == INDEPENDENT)


def singular(row: SubsetRow) -> bool:
    """Whether the KKT matrix with the chosen rows is."""
    return row.kkt_smallest_over_largest < SINGULAR


def accepted(row: SubsetRow) -> bool:
    """Whether IPOPT begins to search in either form of the image block."""
    refused = "Not_Enough_Degrees_Of_Freedom"
    return refused not in (row.ipopt_with_slack, row.ipopt_with_objective)


def worst(rows: Sequence[EstimateRow], estimator: str) -> float:
    """Largest RMS over the bound of an estimator, over the scenes."""
    return max(row.rms_over_bound for row in rows if row.estimator == estimator)


def named_percent(rows: Sequence[CulpritRow], formulation: str, outlier: float) -> float:
    """Share of the draws, in percent, where the culprit is named."""
    own = [row for row in rows if (row.formulation, row.outlier_px) == (formulation, outlier)]
    return 100 * sum(row.named for row in own) / sum(row.draws for row in own)


def numbers(tables: Tables) -> dict[str, float]:
    """Return every number of the headline, by name."""
    laser, form = choices(tables.subsets), independent_form(tables.subsets)
    single, several = [row for row in laser if row.count == 1], [row for row in laser if row.count > 1]
    return {
        "planes": len(tables.ranks),
        "laser_rank_least": min(row.laser_rank for row in tables.ranks),
        "laser_rank_most": max(row.laser_rank for row in tables.ranks),
        "choices_of_several_rows": len(several),
        "choices_of_several_rows_with_singular_kkt": sum(singular(row) for row in several),
        "one_row_searches_off_the_beam_percent": _percent(single, "off_the_beam"),
        "several_rows_searches_on_the_plane_percent": _percent(several, "on_the_plane"),
        "independent_form_searches_on_the_plane_percent": _percent([form], "on_the_plane"),
        "weighted_slack_worst_over_bound": worst(tables.estimates, ESTIMATORS[0]),
        "unweighted_slack_worst_over_bound": worst(tables.estimates, ESTIMATORS[2]),
        "best_three_hard_rows_worst_over_bound": worst(tables.estimates, ESTIMATORS[7]),
        "outlier_px": LARGEST_PX,
        "elastic_names_percent": named_percent(tables.culprits, "Elastic", LARGEST_PX),
        "constrained_names_percent": named_percent(tables.culprits, "Constrained", LARGEST_PX),
    }


def _percent(rows: Sequence[SubsetRow], column: str) -> float:
    return 100 * sum(getattr(row, column) for row in rows) / max(1, sum(row.searches for row in rows))


def headline(said: Mapping[str, float]) -> str:
    """Say it in a sentence."""
    return (
        f"Over {said['planes']:.0f} planes the laser block has rank {laser_rank(said)}. One of its rows alone as a "
        f"hard constraint leaves {said['one_row_searches_off_the_beam_percent']:.0f} % of the searches at spots off "
        f"the beam; {said['choices_of_several_rows_with_singular_kkt']:.0f} of the "
        f"{said['choices_of_several_rows']:.0f} choices of several rows make the KKT matrix singular, and "
        f"{said['several_rows_searches_on_the_plane_percent']:.0f} % of the searches with them end at the plane, with "
        f"the independent form {said['independent_form_searches_on_the_plane_percent']:.0f} %. Over the bound, the "
        f"worst RMS error is {said['weighted_slack_worst_over_bound']:.2f} with slack weighted by its covariance, "
        f"{said['unweighted_slack_worst_over_bound']:.1f} without weights, "
        f"{said['best_three_hard_rows_worst_over_bound']:.1f} with the best three rows hard. The largest L1 slack "
        f"names the equation with an error of {said['outlier_px']:.0f} px in {said['elastic_names_percent']:.0f} % of "
        f"cases, the largest least-squares slack in {said['constrained_names_percent']:.0f} %."
    )


def laser_rank(said: Mapping[str, float]) -> str:
    """Say between which ranks the laser block is."""
    least, most = f"{said['laser_rank_least']:.0f}", f"{said['laser_rank_most']:.0f}"
    return least if least == most else f"{least} to {most}"


def finding(tables: Tables, said: Mapping[str, float]) -> str:
    """Say what was found; every number comes from the tables."""
    return "\n".join(
        [
            "# What the ten equations fix, and slack, elastic and hard rows",
            "",
            f"**In short.** {headline(said)}",
            "",
            *_of_ranks(tables),
            "",
            *_of_subsets(tables.subsets),
            "",
            *_of_estimates(tables),
            "",
            *_of_culprits(tables.culprits),
        ]
    )


def _of_ranks(tables: Tables) -> list[str]:
    tilted = [row for row in tables.ranks if row.alpha_deg > 0]
    frontal = [row for row in tables.ranks if row.alpha_deg == 0]
    at = list(dict.fromkeys(row.offset_mm for row in tables.free))
    lost = Counter(row.unknown for row in tables.free if row.changes_nothing)
    near, far = min(tables.edge, key=_intercept), max(tables.edge, key=_intercept)
    free = [row for row in tables.free if row.changes_nothing]
    offsets = [row.offset_mm for row in tables.ranks]
    return [
        f"**Rank** (`ranks.csv`). At all {len(tilted)} tilted planes, from cameras {min(offsets):g} to "
        f"{max(offsets):g} mm off the beam's axis, the ten have rank {_span(row.ten_rank for row in tilted)} and the "
        f"laser block {_span(row.laser_rank for row in tilted)}; at the {len(frontal)} planes without tilt "
        f"{_span(row.ten_rank for row in frontal)}: beta means nothing there. The condition number of the "
        f"whitened system is {min(row.condition for row in tables.ranks):.0f} to "
        f"{max(row.condition for row in tables.ranks):.0f}:",
        "",
        "| offset mm | planes | least condition | median | largest |",
        "|---|---|---|---|---|",
        *(
            f"| {offset:g} | {len(own)} | {min(own):.0f} | {np.median(own):.0f} | {max(own):.0f} |"
            for offset in dict.fromkeys(row.offset_mm for row in tables.ranks)
            if (own := [row.condition for row in tables.ranks if row.offset_mm == offset])
        ),
        "",
        "**Where rank is lost** (`edge.csv`). At planes through the camera the two planes of an image meet: from "
        f"c / z_L = {far.intercept_over_z_L:g} to {near.intercept_over_z_L:g} the smallest singular value of the "
        f"coefficients goes from {far.smallest_over_largest:.1e} to {near.smallest_over_largest:.1e} of the largest, "
        f"along the direction to the second plane, (r^2, e_x, e_y), to {near.from_second_plane_deg:.2f} deg. Whitened "
        f"it goes from {far.whitened_smallest_over_largest:.1e} to {near.whitened_smallest_over_largest:.1e}.",
        "",
        "With a number of the rig unknown as well (`free.csv`):",
        "",
        "| unknown | offset mm | changes no equation |",
        "|---|---|---|",
        *(f"| {row.unknown} | {row.offset_mm:g} | {row.changes_nothing} |" for row in free),
        "",
        f"Of {len(tables.free)} pairs of unknown and offset ({', '.join(f'{o:g}' for o in at)} mm) these are "
        f"{len(free)}: {'; '.join(f'{name} at {count} of {len(at)} offsets' for name, count in lost.items())}.",
    ]


def _intercept(row: EdgeRow) -> float:
    return row.intercept_over_z_L


def _span(values: Iterable[int]) -> str:
    return " or ".join(str(value) for value in sorted(set(values)))


def _of_subsets(rows: Sequence[SubsetRow]) -> list[str]:
    return [
        "**Hard laser rows** (`subsets.csv`, the worked example with noise of 0.3 px; image block with slack, or as "
        "the objective; searches from random starts, in the latter form).",
        "",
        "| rows | also hold, for any R, at beta deg | IPOPT, slack | at the plane | IPOPT, objective | at the plane | "
        "independent | KKT smallest/largest | searches: at the plane | off the beam | elsewhere | no minimum |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row.rows} | {row.also_hold_at_beta_deg.replace(' ', ', ')} | {row.ipopt_with_slack} | "
            f"{row.right_with_slack} | {row.ipopt_with_objective} | {row.right_with_objective} | {row.independent} | "
            f"{row.kkt_smallest_over_largest:.0e} | {row.on_the_plane} | {row.off_the_beam} | {row.elsewhere} | "
            f"{row.no_minimum} |"
            for row in rows
        ),
        "",
        _said_of_several(rows),
    ]


def _said_of_several(rows: Sequence[SubsetRow]) -> str:
    several = [row for row in choices(rows) if row.count > 1 and accepted(row)]
    refused = [row for row in choices(rows) if not accepted(row)]
    counts = {
        form: (
            sum(getattr(row, f"ipopt_with_{form}") == "Solve_Succeeded" for row in several),
            sum(getattr(row, f"right_with_{form}") == "yes" for row in several),
        )
        for form in ("slack", "objective")
    }
    reports = sorted({getattr(row, f"ipopt_with_{form}") for row in several for form in counts})
    return (
        f"Refused, by their count, are {', '.join(row.rows for row in refused) or 'none'}. Of the {len(several)} other "
        f"choices of several rows IPOPT, begun at the closed form, reports success in {counts['slack'][0]} with "
        f"slack and in {counts['objective'][0]} with the image block as objective, and stands at the plane in "
        f"{counts['slack'][1]} and {counts['objective'][1]}. Its reports: {', '.join(reports)}."
    )


def _of_estimates(tables: Tables) -> list[str]:
    scenes = list(dict.fromkeys(row.scene for row in tables.estimates))
    draws = tables.estimates[0].draws
    best = {scene: {row.chosen: row for row in tables.triples if row.scene == scene and row.chosen} for scene in scenes}
    return [
        f"**The estimate** (`estimates.csv`: RMS of (z_L, p, q) over the bound, pooled, and bias in brackets; {draws} "
        "draws, noise of 0.3 px).",
        "",
        f"| estimator | {' | '.join(scenes)} |",
        "|---|" + "---|" * len(scenes),
        *(
            f"| {name} | {' | '.join(_estimate(tables.estimates, scene, name) for scene in scenes)} |"
            for name in ESTIMATORS
        ),
        "",
        "**Three hard rows, to first order** (`triples.csv`).",
        "",
        "| scene | rows | RMS over the bound | chosen as |",
        "|---|---|---|---|",
        *(
            f"| {scene} | {row.rows} | {row.predicted_over_bound:.2f} | {chosen} |"
            for scene, ways in best.items()
            for chosen, row in ways.items()
        ),
    ]


def _estimate(rows: Sequence[EstimateRow], scene: str, name: str) -> str:
    row = next(row for row in rows if (row.scene, row.estimator) == (scene, name))
    lost = f", {row.lost} lost" if row.lost else ""
    return f"{row.rms_over_bound:.2f} ({row.bias_over_bound:.2f}{lost})"


def _of_culprits(rows: Sequence[CulpritRow]) -> list[str]:
    lines = [
        "**A gross error in one coefficient** (`culprits.csv`: the boundary moved by so many pixels RMS; named by the "
        "largest slack or residual in standard deviations; RMS error over the clean points' bound).",
        "",
        "| scene | px | formulation | named | RMS over the bound |",
        "|---|---|---|---|---|",
    ]
    for key in dict.fromkeys((row.scene, row.outlier_px, row.formulation) for row in rows):
        own = [row for row in rows if (row.scene, row.outlier_px, row.formulation) == key]
        named, draws = sum(row.named for row in own), sum(row.draws for row in own)
        rms = np.sqrt(np.mean([row.rms_over_bound**2 for row in own]))
        lines.append(f"| {key[0]} | {key[1]:g} | {key[2]} | {named} of {draws} | {rms:.3g} |")
    return lines
