"""The reproduction as files: three figures and all numbers."""

import json
import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from planeopt import paper
from planeopt.plane import SpotPose
from planeopt.reproduction.figure4 import figure4
from planeopt.reproduction.figure5 import figure5
from planeopt.reproduction.figure7 import figure7
from planeopt.reproduction.results import Answer, Array, Reproduction
from planeopt.reproduction.searches import Search
from planeopt.reproduction.style import SAVED
from planeopt.whole_files import write_text, write_whole

_FIGURES = {"figure4": figure4, "figure5": figure5, "figure7": figure7}
_SUFFIXES = (".png", ".svg")
_FORMAT = 1


def write(result: Reproduction, out: Path) -> list[Path]:
    """Write the figures and ``reproduce.json``; each file beside its place, then renamed into it.

    Parameters
    ----------
    result : Reproduction
    out : Path
        Folder, made where it is missing.

    Returns
    -------
    list of Path
    """
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for name, draw in _FIGURES.items():
        figure = draw(result)
        for suffix in _SUFFIXES:
            path = out / f"{name}{suffix}"
            # Without a date the same numbers give the same file.
            metadata = {"Date": None} if suffix == ".svg" else None
            with mpl.rc_context(SAVED):
                write_whole(
                    path, lambda part, f=figure, s=suffix, m=metadata: f.savefig(part, format=s[1:], metadata=m)
                )
            written.append(path)
    text = f"{json.dumps(to_dict(result), indent=1, allow_nan=False)}\n"
    write_text(out / "reproduce.json", text)
    return [*written, out / "reproduce.json"]


def to_dict(result: Reproduction) -> dict[str, Any]:
    """All numbers as plain JSON values; mm and degrees, null for what is not finite."""
    second = result.second_plane
    return {
        "format": _FORMAT,
        "setup_mm": {"f": paper.SETUP.f, "e": [paper.SETUP.e_x, paper.SETUP.e_y], "r": paper.SETUP.r},
        "truth": _unknowns(np.array(paper.TRUTH)),
        "start": _unknowns(np.array(paper.START)),
        "table_1": {
            "origin": "made again from (3) and (5), rounded to four decimals; not copied from the printed page",
            "theta_deg": np.degrees(paper.TABLE_1_ANGLES).round(9).tolist(),
            "points_mm": paper.table_1().tolist(),
        },
        "table_2": {
            "printed": list(paper.TABLE_2),
            "from_equation_6": paper.exact_ellipse().tolist(),
            "fit_to_table_1": result.problem.B.tolist(),
            "fit_sigma": np.sqrt(np.sum(result.problem.B_factor**2, axis=1)).tolist(),
            "least_squares_B4": {"value_mm": result.fitted_B4.value, "sigma_mm": result.fitted_B4.sigma},
        },
        "results": [_answer(answer) for answer in result.answers],
        "second_plane": {
            "exact": _pose(second.pose),
            "from_table_1": _pose(second.from_table_1),
            "misfit_of_the_ten": second.misfit,
            "reason": second.reason,
        },
        "as_printed": {"status": result.refusal.status.record, "message": result.refusal.message},
        "searches": [_search(search) for search in result.searches],
        "misprints": [
            {
                "where": misprint.where,
                "printed": misprint.printed,
                "right": misprint.right,
                "why": misprint.why,
                "evidence": [
                    {
                        "quantity": evidence.quantity,
                        "unit": evidence.unit,
                        "expected": evidence.expected,
                        "tolerance": evidence.tolerance,
                        "right": evidence.right,
                        "printed": evidence.printed,
                    }
                    for evidence in misprint.evidence()
                ],
            }
            for misprint in paper.MISPRINTS
        ],
    }


def _unknowns(values: Array) -> dict[str, float]:
    R, z_L, alpha, beta = values.tolist()
    return {"R_mm": R, "z_L_mm": z_L, "alpha_deg": math.degrees(alpha), "beta_deg": math.degrees(beta)}


def _pose(pose: SpotPose) -> dict[str, float | None]:
    beta = None if pose.beta is None else math.degrees(pose.beta)
    return {"R_mm": pose.R, "z_L_mm": pose.z_L, "alpha_deg": math.degrees(pose.alpha), "beta_deg": beta}


def _answer(answer: Answer) -> dict[str, Any]:
    solution = answer.solution
    return {
        "formulation": solution.formulation,
        "solver": solution.solver,
        "status": solution.status.record,
        "found": _unknowns(answer.found),
        "error": _unknowns(answer.error),
        "allowed_worst": _unknowns(answer.allowance.worst),
        "allowed_sigma": _unknowns(answer.allowance.sigma),
        "within_rounding": answer.within_rounding,
        "chi2": _finite(solution.chi2),
        "p_value": _finite(solution.p_value),
        "iterations": solution.effort.iterations,
        "evaluations": solution.effort.evaluations,
    }


def _search(search: Search) -> dict[str, Any]:
    R, z_L, alpha, beta = search.poses.T
    columns = {"R_mm": R, "z_L_mm": z_L, "alpha_deg": np.degrees(alpha), "beta_deg": np.degrees(beta)}
    return {
        "name": search.name,
        "ends_on": search.end,
        "evaluations": search.effort.evaluations,
        "derivative_evaluations": search.effort.derivative_evaluations,
        "stage": search.stage.tolist(),
        "misfit": [_finite(value) for value in search.misfit.tolist()],
        **{name: [_finite(value) for value in column.tolist()] for name, column in columns.items()},
    }


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value
