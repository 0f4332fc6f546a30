"""What the axes add up to: numbers for the headline, and the finding in words."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from studies.efficiency_examples import ExampleRow
from studies.efficiency_fits import FITS, POSE, ROUTES, FitRow
from studies.efficiency_formulations import FORMULATIONS, FormulationRow
from studies.efficiency_sweeps import BASE

SHORT_ARC = 0.4

Row = TypeVar("Row", FitRow, FormulationRow)


def numbers(fits: Sequence[FitRow], formulations: Sequence[FormulationRow]) -> dict[str, float]:
    """Return the headline's numbers of the axes; each from the table and the column that `finding` names."""
    base, arc = _at(fits, "arc", BASE.arc), _at(fits, "arc", SHORT_ARC)
    found: dict[str, float] = {
        "base_depth_mm": BASE.depth_mm,
        "base_tilt_deg": BASE.tilt_deg,
        "base_noise_px": BASE.noise_px,
        "conic_fits": len(FITS),
    }
    for route in ROUTES:
        found[f"best_fit_over_bound_{route}"] = min(_over(base, route))
        found[f"worst_fit_over_bound_{route}"] = max(_over(base, route))
    found["short_arc_percent"] = 100 * SHORT_ARC
    found["least_over_bound_short_arc"] = min(_over(arc, *ROUTES))
    found["largest_over_bound_short_arc"] = max(_over(arc, *ROUTES))
    found["constrained_over_ml_least"], found["constrained_over_ml_largest"] = _range(formulations, "Constrained")
    at_base = _at(formulations, "arc", BASE.arc)
    squares = [row.over_ml for row in at_base if row.formulation in ("LeastSquares", "Penalty")]
    found["least_squares_and_penalty_over_ml"] = max(squares)
    return found


def headline(n: Mapping[str, float]) -> str:
    """Say it in two sentences."""
    return (
        f"With the paper's beam, a plane at {n['base_depth_mm']:g} mm tilted by {n['base_tilt_deg']:g} degrees "
        f"and {n['base_noise_px']:g} px of noise, planes by the closed form from any of "
        f"{n['conic_fits']:.0f} conic fits are at "
        f"{_span(n['best_fit_over_bound_primal'], n['worst_fit_over_bound_primal'])} times the bound by the primal "
        f"route and at {_span(n['best_fit_over_bound_dual'], n['worst_fit_over_bound_dual'])} by the dual, with "
        f"points on {n['short_arc_percent']:.0f} % of the ellipse at "
        f"{n['least_over_bound_short_arc']:.1f} to {n['largest_over_bound_short_arc']:.1f}. With points all round "
        f"LeastSquares and Penalty are at {n['least_squares_and_penalty_over_ml']:.2f} times maximum likelihood; "
        f"Constrained, wherever it was tried, at {n['constrained_over_ml_least']:.3f} to "
        f"{n['constrained_over_ml_largest']:.3f}."
    )


def fits_heading(fits: Sequence[FitRow]) -> str:
    """Say in the figure's heading what it shows."""
    base = _at(fits, "arc", BASE.arc)
    primal, dual, plane = (
        f"{np.median([row.over_bound for row in base if row.route == route]):.2f}" for route in ("primal", "dual", "-")
    )
    return (
        f"At the dotted base case the median fit is at {primal} times the bound by the primal route, {dual} by the "
        f"dual; maximum likelihood of the plane at {plane}"
    )


def formulations_heading(formulations: Sequence[FormulationRow]) -> str:
    """Say in the figure's heading what it shows."""
    low, high = _range(formulations, "Constrained")
    worst = max(row.over_ml for row in formulations if row.formulation == "LeastSquares" and row.axis == "arc")
    return (
        f"Constrained is at {low:.3f} to {high:.3f} times maximum likelihood; unweighted least squares, along the "
        f"arcs, at up to {worst:.3g}"
    )


def finding(fits: Sequence[FitRow], formulations: Sequence[FormulationRow]) -> list[str]:
    """Say what was found along the axes, in paragraphs; every number comes from the tables."""
    n = numbers(fits, formulations)
    return [
        "**Conic fits and routes.** One axis at a time about a base case: the paper's camera, beam and direction of "
        f"tilt, {BASE.depth_mm:g} mm, {BASE.tilt_deg:g} degrees, {BASE.noise_px:g} px, {BASE.points} points all "
        f"round, offset {BASE.offset_mm:g} mm. `fits.csv` has {fits[0].draws} draws in each row. There (axis `arc`, "
        f"value 1) the closed form is at {n['best_fit_over_bound_primal']:.3f} to "
        f"{n['worst_fit_over_bound_primal']:.3f} times the bound by the primal route and at "
        f"{n['best_fit_over_bound_dual']:.3f} to {n['worst_fit_over_bound_dual']:.3f} by the dual (column "
        f"`over_bound`, least and largest of the fits); maximum likelihood of the plane is at "
        f"{_of(_at(fits, 'arc', BASE.arc), POSE).over_bound:.3f}. {_worst_bias(fits)} {_lost_fits(fits)}",
        "",
        "**Formulations.** `formulations.csv` has the first "
        f"{formulations[0].draws} of the same draws in each row. Column `over_ml` is the RMS error over that of "
        "maximum likelihood with the same draws; least and largest over all axes:",
        "",
        "| formulation | over maximum likelihood, least | base case | largest | without a plane | why |",
        "|---|---|---|---|---|---|",
        *(_formulation_line(formulations, name) for name in dict.fromkeys(row.formulation for row in formulations)),
        "",
        f"{_same_minimum(formulations)}",
    ]


def finding_of_examples(examples: Sequence[ExampleRow]) -> list[str]:
    """Say what the programmes give draw by draw; from `examples.csv`."""
    return [
        f"**Many draws of the programmes.** {examples[0].draws} draws of each example with 0.3 px of noise, solved by "
        "IPOPT (`examples.csv`, column `over_bound`):",
        "",
        "| example | formulation | over the bound | bias over the bound | without a plane |",
        "|---|---|---|---|---|",
        *(
            f"| {row.example} | {row.formulation} | {row.over_bound:.3f} | {row.bias_over_bound:.3f} | {row.failed} |"
            for row in examples
        ),
    ]


def _formulation_line(rows: Sequence[FormulationRow], name: str) -> str:
    mine = [row for row in rows if row.formulation == name]
    low, high = _range(rows, name)
    base = next(row.over_ml for row in _at(mine, "arc", BASE.arc))
    failed, draws = sum(row.failed for row in mine), sum(row.draws for row in mine)
    reasons = sorted({part.split(":")[0] for row in mine for part in row.reasons.split()})
    return (
        f"| {name} | {_cell(low)} | {_cell(base)} | {_cell(high)} | {failed} of {draws} | {', '.join(reasons) or '-'} |"
    )


def _same_minimum(rows: Sequence[FormulationRow]) -> str:
    by_name = {
        name: {(row.axis, row.value): row.over_bound for row in rows if row.formulation == name}
        for name in FORMULATIONS
    }
    squares = by_name["LeastSquares"]
    apart = [
        abs(by_name[name][place] / squares[place] - 1)
        for name in ("Penalty", "Penalty(image objective)")
        for place in squares
        if np.isfinite(by_name[name][place]) and np.isfinite(squares[place])
    ]
    return (
        "RMS errors of Penalty, in both readings, differ from those of LeastSquares by at most "
        f"{max(apart):.1%} (column `over_bound`)."
    )


def _worst_bias(fits: Sequence[FitRow]) -> str:
    row = max((row for row in fits if np.isfinite(row.bias_over_bound)), key=lambda row: row.bias_over_bound)
    return (
        f"The largest bias (column `bias_over_bound`) is {row.bias_over_bound:.1f} times the bound, of {row.fit} by "
        f"the {row.route} route at {row.axis} = {row.value:g}."
    )


def _lost_fits(fits: Sequence[FitRow]) -> str:
    lost = [row for row in fits if row.failed]
    if not lost:
        return "No draw is without a plane."
    places = dict.fromkeys(f"{row.route} at {row.axis} = {row.value:g}" for row in lost)
    return f"Draws without a plane (column `failed`): {sum(row.failed for row in lost)}, {'; '.join(places)}."


def _at(rows: Sequence[Row], axis: str, value: float) -> list[Row]:
    return [row for row in rows if (row.axis, row.value) == (axis, value)]


def _of(rows: Sequence[FitRow], fit: str) -> FitRow:
    return next(row for row in rows if row.fit == fit)


def _over(rows: Sequence[FitRow], *routes: str) -> list[float]:
    return [row.over_bound for row in rows if row.route in routes and np.isfinite(row.over_bound)]


def _range(rows: Sequence[FormulationRow], name: str) -> tuple[float, float]:
    found = [row.over_ml for row in rows if row.formulation == name and np.isfinite(row.over_ml)]
    return (min(found), max(found)) if found else (np.nan, np.nan)


def _span(low: float, high: float) -> str:
    first, last = f"{low:.2f}", f"{high:.2f}"
    return first if first == last else f"{first} to {last}"


def _cell(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "-"
