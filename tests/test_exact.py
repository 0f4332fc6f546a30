"""Exact points give the exact plane, by every accurate formulation, over the whole range of rigs and planes."""

import numpy as np
import pytest

from cases import Case, random_case
from planeopt.estimation import solve
from planeopt.formulations import ClosedForm, Constrained, Formulation, Reprojection
from planeopt.solution import Solution
from planeopt.solvers import Ipopt, Sqp
from planeopt.spot import Spot

KINDS = ["any"] * 210 + ["on the beam"] * 10 + ["on the axis"] * 10 + ["frontal"] * 10 + ["beta 180"] * 10


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    rng = np.random.default_rng(20260101)
    return [random_case(rng, kind=kind) for kind in KINDS]


def error(case: Case, solution: Solution) -> float:
    """The largest of relative depth error, angle between the normals (rad) and relative error of R."""
    assert solution.pose is not None, solution.message
    assert solution.plane is not None
    return max(
        abs(solution.pose.z_L / case.pose.z_L - 1),
        solution.plane.angle_to(case.plane),
        abs(solution.pose.R / case.pose.R - 1),
    )


@pytest.mark.parametrize(
    ("formulation", "solver", "tolerance"),
    [
        (ClosedForm(), Sqp(), 1e-8),
        (Constrained(), Ipopt(), 1e-9),
        (Constrained(), Sqp(), 1e-9),
        (Reprojection(), Ipopt(), 1e-9),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_exact_points_give_the_exact_plane(
    cases: list[Case], formulation: Formulation, solver: Ipopt | Sqp, tolerance: float
) -> None:
    worst, at = 0.0, 0
    for i, case in enumerate(cases):
        solution = solve(Spot(case.pixels), case.rig, formulation=formulation, solver=solver)
        found = error(case, solution)
        worst, at = max((worst, at), (found, i))
        assert solution.ok, (i, KINDS[i], solution.message)
    assert worst < tolerance, (at, cases[at].pose)
