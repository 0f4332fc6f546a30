"""What the study of the paper says, made from its tables."""

from collections.abc import Mapping, Sequence

import numpy as np

from planeopt.reproduction.searches import second_pose
from studies.paper_rows import AnswerRow, MisprintRow, Tables


def numbers(tables: Tables) -> dict[str, float]:
    """Return every number of the headline, by name."""
    methods = list(dict.fromkeys(row.method for row in tables.answers))
    within = [name for name in methods if all(row.error_over_worst <= 1 for row in _of(tables.answers, name))]
    as_printed = tables.consequences[-1]
    repeats = {row.method: row for row in tables.repeats}
    return {
        "methods": len(methods),
        "methods_within_rounding": len(within),
        "largest_error_over_what_rounding_allows": max(row.error_over_worst for row in tables.answers),
        "tables_that_round_alike": repeats["Penalty + Swift"].tables,
        "swift_J_0_on_the_plane": repeats["Penalty + Swift"].on_the_plane,
        "swift_image_objective_on_the_plane": repeats["Penalty(image objective) + Swift"].on_the_plane,
        "constrained_on_the_plane": repeats["Constrained + Ipopt"].on_the_plane,
        "misprints": len({row.where for row in tables.misprints}),
        "numbers_that_decide": sum(decides(row) for row in tables.misprints),
        "corrected_largest_deviation_over_rounding": max(row.right_over_allowed for row in tables.misprints),
        "printed_least_deviation_over_rounding": min(row.printed_over_allowed for row in tables.misprints),
        "as_printed_z_L_error_mm": as_printed.z_L_error_mm,
        "as_printed_normal_error_deg": as_printed.normal_error_deg,
    }


def _of(rows: Sequence[AnswerRow], method: str) -> list[AnswerRow]:
    return [row for row in rows if row.method == method]


def decides(row: MisprintRow) -> bool:
    """Whether the corrected reading agrees and the printed one does not."""
    return row.right_over_allowed <= 1 < row.printed_over_allowed


def headline(said: Mapping[str, float]) -> str:
    """Say it in a few sentences."""
    side = "nearer" if said["as_printed_z_L_error_mm"] < 0 else "farther"
    return (
        f"From the paper's table of points and its start {said['methods_within_rounding']} of {said['methods']} "
        f"methods give the stated solution, at most {said['largest_error_over_what_rounding_allows']:.2f} of what the "
        f"table's rounding allows away. From {said['tables_that_round_alike']} tables that round alike SWIFT "
        f"without an objective ends on the plane in {said['swift_J_0_on_the_plane']}, with the image block as one in "
        f"{said['swift_image_objective_on_the_plane']}, IPOPT with slack in {said['constrained_on_the_plane']}. "
        f"{said['numbers_that_decide']} numbers decide {said['misprints']} misprints: "
        f"the corrected readings are at most {said['corrected_largest_deviation_over_rounding']:.2f} of what rounding "
        f"allows off, the printed ones at least {said['printed_least_deviation_over_rounding']:.1f} times as much. "
        f"Solved with all misprints left in, the ten equations give a plane "
        f"{abs(said['as_printed_z_L_error_mm']):.1f} mm {side} and {said['as_printed_normal_error_deg']:.1f} deg off."
    )


def finding(tables: Tables, said: Mapping[str, float]) -> str:
    """Say what was found; every number comes from the tables."""
    second = second_pose()
    ranks = tables.ranks[0]
    left = {row.reading: row for row in tables.consequences}
    exact = [row for row in tables.table_2 if abs(row.printed_minus_6) <= 5e-5]
    return "\n".join(
        [
            "# The paper's worked example, and its misprints",
            "",
            f"**In short.** {headline(said)}",
            "",
            "**The stated solution** (`answers.csv`: columns `error` and `allowed_worst`; what is allowed is each "
            "coordinate of Table 1 off by 0.00005 mm in the direction that does most harm, carried through the method "
            "to first order).",
            "",
            "| method | R mm | z_L mm | alpha deg | beta deg | largest error over allowed | function evaluations | "
            "derivatives |",
            "|---|---|---|---|---|---|---|---|",
            *_answers(tables.answers),
            "",
            f"**Where searches end** (`searches.csv`). The ten equations have a second exact solution, "
            f"({second.R:.4f} mm, {second.z_L:.4f} mm, {np.degrees(second.alpha):.4f} deg, "
            f"{np.degrees(second.beta or 0.0):.4f} deg), which the camera would see from behind.",
            "",
            "| search from the paper's start | ends on | iterations | largest misfit of the ten |",
            "|---|---|---|---|",
            *(
                f"| {row.search} | {row.end} | {row.iterations} | {row.misfit:.1e} |"
                for row in sorted(tables.searches, key=lambda row: row.end)
            ),
            "",
            "**Chance** (`repeats.csv`: other tables, each coordinate off by up to 0.00005 mm; the paper's start).",
            "",
            "| method | tables | on the plane | on the second plane | on neither | median evaluations |",
            "|---|---|---|---|---|---|",
            *(
                f"| {row.method} | {row.tables} | {row.on_the_plane} | {row.on_the_second_plane} | {row.on_neither} | "
                f"{row.median_evaluations:.0f} |"
                for row in tables.repeats
            ),
            "",
            f"**As hard constraints** (`ranks.csv`): {ranks.equations} equations for {ranks.unknowns} unknowns, of "
            f"rank {ranks.rank} (laser block {ranks.laser_rank}, image block {ranks.image_rank}); "
            f"{ranks.repeat_the_others.replace(' ', ', ')} repeat the others. The outcome is {ranks.outcome}.",
            "",
            "**The misprints** (`misprints.csv`).",
            "",
            "| where | number | must be | corrected | printed | deviation over allowed: corrected | printed |",
            "|---|---|---|---|---|---|---|",
            *(
                f"| {row.where} | {row.quantity} ({row.unit}) | {_shown(row.must_be)} | {_shown(row.right_gives)} | "
                f"{_shown(row.printed_gives)} | {row.right_over_allowed:.2g} | {row.printed_over_allowed:.3g} |"
                for row in tables.misprints
            ),
            "",
            f"Of Table 2 {len(exact)} of {len(tables.table_2)} entries are (6) to their last digit (`table_2.csv`); "
            "Table 1 is made again from the corrected (3), so it is no evidence of its own for it.",
            "",
            "**What a misprint does to the plane** (`consequences.csv`: least squares of the ten, each over the size "
            "of its data, with Table 2).",
            "",
            "| left as printed | R mm | z_L mm | alpha deg | beta deg | z_L error mm | normal off by deg | "
            "largest misfit left |",
            "|---|---|---|---|---|---|---|---|",
            *(
                f"| {row.reading} | {row.R_mm:.3f} | {row.z_L_mm:.3f} | {row.alpha_deg:.3f} | {row.beta_deg:.3f} | "
                f"{row.z_L_error_mm:+.4f} | {row.normal_error_deg:.4f} | {row.largest_misfit:.1e} |"
                for row in tables.consequences
            ),
            "",
            f"With d_5 alone as printed, whose term vanishes where the spot lies on the beam, z_L is off by "
            f"{abs(left['d_5 of (9)'].z_L_error_mm):.4f} mm and the largest misfit is "
            f"{left['d_5 of (9)'].largest_misfit:.1e}; with (15) as printed a misfit of "
            f"{left['(15) and (28)'].largest_misfit:.3g} is left.",
        ]
    )


def _answers(rows: Sequence[AnswerRow]) -> list[str]:
    lines = []
    for method in dict.fromkeys(row.method for row in rows):
        own = _of(rows, method)
        lines.append(
            f"| {method} | {' | '.join(row.found for row in own)} | {max(row.error_over_worst for row in own):.3f} | "
            f"{own[0].evaluations} | {own[0].derivative_evaluations} |"
        )
    return lines


def _shown(value: float) -> str:
    return f"{value:.7g}" if value == 0 or abs(value) >= 1e-2 else f"{value:.1e}"
