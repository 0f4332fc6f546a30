"""The reproduction as text: tables for a terminal."""

from collections.abc import Iterator

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from planeopt import paper
from planeopt.paper import Evidence, Misprint
from planeopt.plane import SpotPose
from planeopt.reproduction.results import Answer, Reproduction

_DEG = np.array([1.0, 1.0, 180 / np.pi, 180 / np.pi])
"""From mm and rad to mm and degrees, for (R, z_L, alpha, beta)."""

_UNKNOWNS = ("R mm", "z_L mm", "alpha deg", "beta deg")
_BLOCKS = 2


def all_parts(result: Reproduction) -> Iterator[RenderableType]:
    """Yield everything that is printed, in order."""
    yield table_1()
    yield Text(
        "Made again from (3) and (5) at theta = 0, 15, ..., 345 deg: which angles the paper took is not recorded; the "
        "entries recorded of its table lie within 0.00005 mm of (3) and (5), as these do.\n"
    )
    yield table_2(result)
    yield results(result)
    yield Text(
        "Allowed: each coordinate of Table 1 off by 0.00005 mm in the direction that does most harm (worst), or by "
        "independent uniform errors (one sigma), carried through the method to first order.\n"
    )
    yield second_plane(result)
    yield Text(f"Excluded: {result.second_plane.reason}.")
    yield Text(
        "\n".join(f"From the paper's start, {search.name}: ends on {search.end}." for search in result.searches) + "\n"
    )
    yield Text(f"The ten equations as hard constraints (AsPrinted): {result.refusal.message}\n")
    yield misprints()
    yield Text("\n".join(f"{misprint.where}: {misprint.why}" for misprint in paper.MISPRINTS))
    b4 = result.fitted_B4
    yield Text(f"The least-squares fit to Table 1 has B_4 = {b4.value:.4f} +- {b4.sigma:.4f}: it cannot decide.")


def table_1() -> Table:
    """Table 1, side by side in two blocks."""
    table = _table("Table 1: boundary of the spot in the image")
    for _ in range(_BLOCKS):
        for heading in ("theta deg", "x mm", "y mm"):
            table.add_column(heading, justify="right")
    rows = np.column_stack([np.degrees(paper.TABLE_1_ANGLES), paper.table_1()])
    for parts in zip(*np.split(rows, _BLOCKS), strict=True):
        table.add_row(*(cell for theta, x, y in parts for cell in (f"{theta:.0f}", f"{x:.4f}", f"{y:.4f}")))
    return table


def table_2(result: Reproduction) -> Table:
    """Table 2 beside (6) at the stated solution and beside the fit to Table 1."""
    table = _table("Table 2: the image ellipse (16)")
    table.add_column("")
    for heading in ("printed", "from (6)", "printed minus (6)", "fit to Table 1", "its sigma"):
        table.add_column(heading, justify="right")
    sigma = np.sqrt(np.sum(result.problem.B_factor**2, axis=1))
    rows = zip(paper.TABLE_2, paper.exact_ellipse(), result.problem.B, sigma, strict=True)
    for i, (printed, exact, fitted, one_sigma) in enumerate(rows, start=1):
        numbers = (f"{printed:.4f}", f"{exact:.6f}", f"{printed - exact:+.6f}", f"{fitted:.6f}", f"{one_sigma:.6f}")
        table.add_row(f"B_{i}", *numbers)
    return table


def results(result: Reproduction) -> Table:
    """Each method's answer, its error, and the error that the rounding of Table 1 allows."""
    table = _table("The result, from Table 1 and the paper's start (10 mm, 250 mm, 20 deg, 20 deg)")
    table.add_column("method", no_wrap=True)
    table.add_column("")
    for heading in _UNKNOWNS:
        table.add_column(heading, justify="right")
    table.add_row("stated in the paper", "", *(f"{value:.4f}" for value in np.array(paper.TRUTH) * _DEG))
    for answer in result.answers:
        _add_answer(table, answer)
    return table


def _add_answer(table: Table, answer: Answer) -> None:
    table.add_section()
    table.add_row(answer.name, "found", *(f"{value:.5f}" for value in answer.found * _DEG))
    table.add_row("", "error", *(f"{value:+.5f}" for value in answer.error * _DEG))
    allowed = answer.allowance
    table.add_row("", "allowed, worst", *(f"{value:.5f}" for value in allowed.worst * _DEG))
    table.add_row("", "allowed, one sigma", *(f"{value:.5f}" for value in allowed.sigma * _DEG))


def second_plane(result: Reproduction) -> Table:
    """The second exact solution of the ten equations."""
    second = result.second_plane
    table = _table("The second plane with the same image")
    table.add_column("")
    for heading in (*_UNKNOWNS, "misfit of the ten"):
        table.add_column(heading, justify="right")
    table.add_row("exact", *_pose_cells(second.pose), f"{second.misfit:.0e}")
    table.add_row("from Table 1", *_pose_cells(second.from_table_1), "")
    return table


def _pose_cells(pose: SpotPose) -> list[str]:
    beta = np.nan if pose.beta is None else pose.beta
    return [f"{value:.4f}" for value in np.array([pose.R, pose.z_L, pose.alpha, beta]) * _DEG]


def misprints() -> Table:
    """The misprints, each with the numbers that show it."""
    table = _table("Misprints, and what shows them")
    for heading in ("where", "printed", "right", "evidence"):
        table.add_column(heading)
    for heading in ("must be", "right gives", "printed gives"):
        table.add_column(heading, justify="right")
    for misprint in paper.MISPRINTS:
        _add_misprint(table, misprint)
    return table


def _add_misprint(table: Table, misprint: Misprint) -> None:
    table.add_section()
    first, *rest = misprint.evidence()
    table.add_row(misprint.where, misprint.printed, misprint.right, *_evidence_cells(first))
    for evidence in rest:
        table.add_row("", "", "", *_evidence_cells(evidence))


def _evidence_cells(evidence: Evidence) -> list[str]:
    unit = "" if evidence.unit == "1" else f" ({evidence.unit})"
    return [f"{evidence.quantity}{unit}", *map(_number, (evidence.expected, evidence.right, evidence.printed))]


def _number(value: float) -> str:
    """Seven digits; of what is zero to rounding, only its size."""
    return f"{value:.7g}" if value == 0 or abs(value) >= 1e-2 else f"{value:.1e}"


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
