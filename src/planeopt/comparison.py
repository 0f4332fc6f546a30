"""Every formulation with every solver that suits it, on the same spot from the same start."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from planeopt.accuracy import Deviation, Truth, deviation, error_of, truth_beside
from planeopt.batch import measure
from planeopt.errors import InputError
from planeopt.estimation import solve_problem
from planeopt.estimation.starts import StartLike
from planeopt.formulations import ClosedForm, Problem
from planeopt.methods import METHODS, Method
from planeopt.plane import Plane, SpotPose
from planeopt.record import PoseRecord, degrees, finite, input_error
from planeopt.rig import Rig
from planeopt.solution import Solution
from planeopt.spot import Spot

NEAR = 0.1
"""Two planes count as the same root where the angle between their normals (rad) plus their relative difference in depth
is below this: far above noise and the bias of any formulation, far below the usual distance between the two roots."""


class Root(Enum):
    """Which of the two exact solutions of the ten equations an answer is near; the value says it."""

    VISIBLE = "the visible plane"
    OTHER = "the second plane, which cannot be seen"
    ELSEWHERE = "neither of the two planes"


@dataclass(frozen=True, eq=False)
class Row:
    """What one formulation with one solver gave.

    Attributes
    ----------
    solution : Solution
        Also where it failed: its status and message are the reason.
    root : Root or None
        None where there is no plane, or no closed form to compare with.
    from_closed_form : Deviation or None
        This plane minus the closed form's visible one.
    error : Deviation or None
        This plane minus the truth, where that is known.
    seconds : float
        Wall time of everything but the ellipse fit, checks and covariance included.
    """

    solution: Solution
    root: Root | None
    from_closed_form: Deviation | None
    error: Deviation | None
    seconds: float

    @property
    def formulation(self) -> str:
        return self.solution.formulation

    @property
    def solver(self) -> str:
        return self.solution.solver

    @property
    def ok(self) -> bool:
        return self.solution.ok

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain JSON values: mm, degrees, milliseconds; None where there is no value."""
        solution, effort = self.solution, self.solution.effort
        pose, sigma = solution.pose, solution.sigma
        return {
            "formulation": self.formulation,
            "solver": self.solver,
            "status": solution.status.record,
            "outcome": solution.status.name.lower(),
            "message": solution.message,
            "z_L_mm": None if pose is None else pose.z_L,
            "alpha_deg": None if pose is None else math.degrees(pose.alpha),
            "beta_deg": None if pose is None else degrees(pose.beta),
            "R_mm": None if pose is None else pose.R,
            "sigma_z_L_mm": None if sigma is None else finite(sigma.z_L),
            "sigma_normal_deg": None if sigma is None else degrees(sigma.normal),
            "root": None if self.root is None else self.root.name.lower(),
            "z_L_minus_closed_form_mm": None if self.from_closed_form is None else self.from_closed_form.depth,
            "normal_to_closed_form_deg": None
            if self.from_closed_form is None
            else degrees(self.from_closed_form.normal),
            "z_L_error_mm": None if self.error is None else self.error.depth,
            "normal_error_deg": None if self.error is None else degrees(self.error.normal),
            "chi2": finite(solution.chi2),
            "p_value": finite(solution.p_value),
            "iterations": effort.iterations,
            "evaluations": effort.evaluations,
            "derivative_evaluations": effort.derivative_evaluations,
            "build_ms": 1e3 * effort.build_s,
            "solve_ms": 1e3 * effort.solve_s,
            "total_ms": 1e3 * self.seconds,
            "residuals": {f"{r.equation} {r.unit}": finite(r.value) for r in solution.residuals},
        }


@dataclass(frozen=True, eq=False)
class Comparison:
    """All rows for one spot, failures included, in the order of the methods."""

    rows: tuple[Row, ...]

    def to_dicts(self) -> list[dict[str, Any]]:
        """Return the rows as plain JSON values."""
        return [row.to_dict() for row in self.rows]


def compare(
    spot: Spot,
    rig: Rig,
    *,
    truth: Truth | None = None,
    start: StartLike | None = None,
    methods: Sequence[Method] = METHODS,
) -> Comparison:
    """Solve one spot by every formulation and solver, from the same start, without second attempts.

    Parameters
    ----------
    spot : Spot
    rig : Rig
        With a beam.
    truth : Truth, optional
        Known plane, for the error of each answer.
    start : SpotPose or (R, z_L, alpha, beta), optional
        mm and rad; the closed form unless given. A start far off shows which searches find their way.
    methods : sequence of Method, optional
        `planeopt.methods.METHODS` unless given.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If the spot, the rig or the start cannot be used.
    """
    problem = Problem.from_spot(spot, rig)
    direct = solve_problem(problem, formulation=ClosedForm())
    return Comparison(tuple(_row(problem, method, start, direct, truth) for method in methods))


@dataclass(frozen=True, eq=False)
class FileComparison:
    """A comparison for one file.

    Attributes
    ----------
    record : PoseRecord
        Of the default method; its status and message say why there is no comparison, where there is none.
    truth : Truth or None
        Of the JSON file beside the image.
    comparison : Comparison or None
    """

    record: PoseRecord
    truth: Truth | None = None
    comparison: Comparison | None = None


def compare_file(path: str, rig: Rig) -> FileComparison:
    """Compare all methods on an image or a `.csv` of boundary points; never raises for what is wrong with the file."""
    measured = measure(path, rig)
    if measured.spot is None or measured.solution is None:
        return FileComparison(measured.record)
    try:
        truth = truth_beside(path)
    except InputError as error:
        return FileComparison(input_error(path, str(error)))
    return FileComparison(measured.record, truth, compare(measured.spot, rig, truth=truth))


def _row(problem: Problem, method: Method, start: StartLike | None, direct: Solution, truth: Truth | None) -> Row:
    begun = time.perf_counter()
    solution = solve_problem(problem, formulation=method.formulation, solver=method.solver, start=start, restart=False)
    seconds = time.perf_counter() - begun
    from_closed_form = root = None
    if (
        solution.pose is not None
        and solution.plane is not None
        and direct.pose is not None
        and direct.plane is not None
    ):
        from_closed_form = deviation(solution.pose, solution.plane, direct.pose, direct.plane)
        root = nearest_root(solution.pose, solution.plane, direct)
    error = None if truth is None else error_of(solution, truth)
    return Row(solution, root, from_closed_form, error, seconds)


def nearest_root(pose: SpotPose, plane: Plane, direct: Solution) -> Root:
    """Return which of the two planes of a closed-form solution a plane is `NEAR`."""
    candidates: list[tuple[float, Root]] = []
    if direct.pose is not None and direct.plane is not None:
        candidates.append((_distance(pose, plane, direct.pose, direct.plane), Root.VISIBLE))
    if direct.other_plane is not None:
        other = direct.other_plane
        candidates.append((_distance(pose, plane, other.pose, other.plane), Root.OTHER))
    distance, root = min(candidates, key=lambda candidate: candidate[0], default=(math.inf, Root.ELSEWHERE))
    return root if distance < NEAR else Root.ELSEWHERE


def _distance(pose: SpotPose, plane: Plane, other_pose: SpotPose, other_plane: Plane) -> float:
    away = deviation(pose, plane, other_pose, other_plane)
    return away.normal + abs(away.depth / other_pose.z_L)
