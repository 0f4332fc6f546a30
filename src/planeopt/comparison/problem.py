"""One problem, solved by every method from one start."""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from planeopt.accuracy import Truth, error_of
from planeopt.batch import UNFORESEEN
from planeopt.comparison.rows import InBound, Root, Row, nearest, residuals_at
from planeopt.errors import InputError
from planeopt.estimation import evidence, solve_problem, starts
from planeopt.estimation.efficiency import bound, within_reach
from planeopt.formulations import ClosedForm, Problem, Start
from planeopt.methods import Method
from planeopt.nlp import Model, Nlp
from planeopt.plane import Plane, SpotPose
from planeopt.solution import Solution, Status

Array = NDArray[np.float64]
Planes = Sequence[tuple[SpotPose, Plane, Root]]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Case:
    """One problem with all its rows.

    Attributes
    ----------
    name : str
    rows : tuple of Row
        In the order of the methods, failures included; empty where the problem could not be set up.
    message : str or None
        Why it could not.
    start : Start or None
        Where all searches began.
    truth : (3,) or None
        ``(z_L, p, q)`` as in the equations, in the frame of the rig that measures.
    bound : (3, 3) or None
        Cramér-Rao bound of ``(z_L, p, q)`` from the points' noise, the rig taken as it is; at the truth, or at the
        closed form's plane where no truth is known. None where the noise is not known, or without points.
    reachable : bool or None
        Whether the bound can be reached there (`planeopt.estimation.efficiency.Reach`).
    n_points : int
    scale_estimated : bool
        The points came without sigma: the bound is that of the noise estimated from their residuals.
    """

    name: str
    rows: tuple[Row, ...] = ()
    message: str | None = None
    start: Start | None = None
    truth: Array | None = None
    bound: Array | None = None
    reachable: bool | None = None
    n_points: int = 0
    scale_estimated: bool = False


def compare_problem(
    problem: Problem,
    methods: Sequence[Method],
    *,
    name: str = "",
    truth: Truth | None = None,
    start: starts.StartLike | None = None,
    repeats: int = 1,
    builds: bool = True,
) -> Case:
    """Solve one problem by all methods from one start, without second attempts.

    Parameters
    ----------
    problem : Problem
    methods : sequence of Method
    name : str
    truth : Truth, optional
    start : SpotPose or (R, z_L, alpha, beta), optional
        mm and rad; the closed form unless given.
    repeats : int
        How often each is solved; the shortest times count.
    builds : bool
        Whether to find out what building takes, which means building once more than needed.

    Raises
    ------
    InputError
        If the start cannot be used.
    """
    first = starts.from_closed_form(problem) if start is None else starts.given(start, problem)
    held = replace(first, held=True)
    direct = solve_problem(problem, formulation=ClosedForm(), start=held, restart=False)
    true_plane = None if truth is None else _in_equations(problem, truth)
    at = true_plane if truth is not None else _plane_of(problem, direct.pose)
    limit, reachable = (None, None) if at is None else _bound(problem, at)
    told = _Told(direct, truth, _planes(problem, direct, truth, true_plane), limit)
    rows = tuple(_row(problem, method, held, told, repeats=repeats, builds=builds) for method in methods)
    return Case(
        name,
        rows,
        start=held,
        truth=true_plane,
        bound=limit,
        reachable=reachable,
        n_points=problem.n_points,
        scale_estimated=problem.scale_dof is not None,
    )


@dataclass(frozen=True, eq=False)
class _Told:
    """What all rows of a problem are held against."""

    direct: Solution
    truth: Truth | None
    planes: Planes
    bound: Array | None


def _in_equations(problem: Problem, truth: Truth) -> Array | None:
    """``(z_L, p, q)`` (3,) of the true plane; None where it is parallel to the beam."""
    if problem.rig is None:
        return _plane_of(problem, truth.pose)
    try:
        return _plane_of(problem, problem.rig.pose_from_plane(truth.plane))
    except InputError:
        return None


def _plane_of(problem: Problem, pose: SpotPose | None) -> Array | None:
    return None if pose is None else np.array([pose.z_L + problem.axial_shift, *pose.slopes])


def _bound(problem: Problem, plane: Array) -> tuple[Array | None, bool | None]:
    """The bound, and whether it can be reached; None where the noise is not known or the plane cannot be seen."""
    if problem.points is None or problem.scale_dof == 0:
        return None, None
    try:
        with np.errstate(all="ignore"):  # a plane that the camera cannot see has no bound
            found = bound(problem, plane)
            reach = within_reach(problem, plane)
    except (np.linalg.LinAlgError, ValueError):
        return None, None
    usable = np.isfinite(found).all() and np.all(np.diag(found) > 0)
    return (found, bool(reach.ok[0])) if usable else (None, None)


def _planes(problem: Problem, direct: Solution, truth: Truth | None, true_plane: Array | None) -> Planes:
    """The visible plane and the second one: the truth's where it is known, else the closed form's."""
    if truth is not None and true_plane is not None:
        pose, plane = evidence.pose_and_plane(problem, true_plane)
        other = evidence.second_plane(problem, true_plane)
    elif direct.pose is not None and direct.plane is not None:
        pose, plane, other = direct.pose, direct.plane, direct.other_plane
    else:
        return ()
    second = () if other is None else ((other.pose, other.plane, Root.OTHER),)
    return ((pose, plane, Root.VISIBLE), *second)


def _row(problem: Problem, method: Method, start: Start, told: _Told, *, repeats: int, builds: bool) -> Row:
    solution, build_s, seconds = _solved(problem, method, start, repeats=repeats, builds=builds)
    direct, closed_form, error, plane = told.direct, None, None, None
    # Only an answer has an error: what a refused search ended on is no measurement.
    if solution.status.record != "refused":
        plane = _plane_of(problem, solution.pose)
        error = None if told.truth is None else error_of(solution, told.truth)
        if direct.pose is not None and direct.plane is not None:
            closed_form = error_of(solution, Truth(direct.pose, direct.plane))
    return Row(
        method.name,
        solution,
        _root(problem, solution, told.planes),
        () if solution.end is None else residuals_at(problem, solution.end),
        closed_form,
        _under(plane, _plane_of(problem, direct.pose), told.bound),
        error,
        None if told.truth is None else _under(plane, _in_equations(problem, told.truth), told.bound),
        # Of a pair that was refused before the search nothing was built.
        0.0 if solution.end is None else build_s,
        seconds,
    )


def _under(plane: Array | None, other: Array | None, limit: Array | None) -> InBound | None:
    return None if plane is None or other is None or limit is None else InBound.of(plane - other, limit)


def _root(problem: Problem, solution: Solution, planes: Planes) -> Root | None:
    """Near which plane the search ended, defensible or not."""
    if solution.end is None or not planes:
        return None
    try:
        place = evidence.pose_and_plane(problem, np.array([solution.end.z_L, solution.end.p, solution.end.q]))
    except InputError:
        return Root.ELSEWHERE
    return nearest(*place, planes)


def _solved(
    problem: Problem, method: Method, start: Start, *, repeats: int, builds: bool
) -> tuple[Solution, float, float]:
    """The solution with its shortest times; what building took; the shortest time of everything else."""
    try:
        build_s = _built(problem, method, start, builds=builds)
        runs = [_timed(problem, method, start) for _ in range(repeats)]
    except UNFORESEEN as error:
        _log.debug("%s failed", method.name, exc_info=error)
        solver = "none" if method.solver is None else method.solver.name
        message = f"{Status.NOT_CONVERGED.value} {broken_down(error)}"
        return Solution(Status.NOT_CONVERGED, message, method.formulation.name, solver), 0.0, 0.0
    solution = min((run for run, _ in runs), key=lambda run: run.effort.solve_s)
    return solution, build_s, min(seconds for _, seconds in runs)


def broken_down(error: Exception) -> str:
    """Return what to say of an error that nobody foresaw, on one line."""
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
    return f"The computation broke down ({said})."


def _timed(problem: Problem, method: Method, start: Start) -> tuple[Solution, float]:
    begun = time.perf_counter()
    solution = solve_problem(problem, formulation=method.formulation, solver=method.solver, start=start, restart=False)
    return solution, time.perf_counter() - begun


_building: WeakKeyDictionary[Model, dict[str, float]] = WeakKeyDictionary()
"""Seconds that building took, by model and solver: found out once, because the second building is never faster."""


def _built(problem: Problem, method: Method, start: Start, *, builds: bool) -> float:
    """Make what a method's search needs, so that no solve pays for it; return the seconds it takes from nothing."""
    if method.solver is None:
        return 0.0
    nlp = method.formulation.build(problem, start)
    if not isinstance(nlp, Nlp):
        return 0.0
    method.solver.prepare(nlp)
    known = _building.setdefault(nlp.model, {})
    if builds and repr(method.solver) not in known:
        # A copy has the symbols, and none of the functions and solvers that are kept with the model.
        fresh = replace(nlp, model=replace(nlp.model))
        begun = time.perf_counter()
        method.solver.prepare(fresh)
        known[repr(method.solver)] = time.perf_counter() - begun
    return known.get(repr(method.solver), 0.0)
