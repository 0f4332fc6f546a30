"""One spot, one rig, one formulation, one solver: the plane, or the reason why not."""

import time
from dataclasses import replace

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation import evidence, starts
from planeopt.estimation.efficiency import within_reach
from planeopt.estimation.reservations import reservations
from planeopt.estimation.rig_part import sensitivity
from planeopt.formulations import (
    Constrained,
    DirectAnswer,
    EitherSide,
    Elastic,
    Formulation,
    Penalty,
    Problem,
    Refusal,
    Start,
    identify,
)
from planeopt.formulations.snooping import explained_without
from planeopt.rig import Rig
from planeopt.solution import (
    FEASIBLE,
    RESOLUTION,
    Effort,
    End,
    Flag,
    Identifiability,
    KktCheck,
    Solution,
    SolveError,
    Status,
)
from planeopt.solvers import Found, Ipopt, Solver, Swift
from planeopt.solvers.kkt import NoCovariance, plane_covariance
from planeopt.spot import Spot

Array = NDArray[np.float64]


def solve(
    spot: Spot,
    rig: Rig,
    *,
    formulation: Formulation | None = None,
    solver: Solver | None = None,
    start: starts.StartLike | None = None,
    restart: bool = True,
    throw: bool = False,
) -> Solution:
    """Find the plane that a spot lies on.

    Parameters
    ----------
    spot : Spot
        Boundary points in raw pixels, from `find_spot` or `read_points`.
    rig : Rig
        With a beam.
    formulation : Formulation, optional
        `Constrained()` unless given.
    solver : Solver, optional
        Unless given, `Swift()` for `Penalty`, whose many equalities it penalises, and `Ipopt()` for all others; not
        used by direct formulations.
    start : SpotPose or (R, z_L, alpha, beta), optional
        mm and rad; the closed form unless given.
    restart : bool
        Whether a search from a given start that fails, or whose chi-squared is beyond its 1e-6 quantile, is repeated
        from the closed form.
    throw : bool
        Raise `SolveError`, carrying the solution, where no defensible plane was found; otherwise it is returned with
        its status.

    Returns
    -------
    Solution

    Raises
    ------
    InputError
        If spot, rig or start cannot be used.
    SolveError
        With ``throw``, for a status whose record is ``refused``.
    """
    problem = Problem.from_spot(spot, rig)
    found = solve_problem(problem, formulation=formulation, solver=solver, start=start, restart=restart)
    return _returned(replace(found, flags=(*spot.flags, *found.flags)), throw=throw)


def solve_problem(
    problem: Problem,
    *,
    formulation: Formulation | None = None,
    solver: Solver | None = None,
    start: starts.StartLike | Start | None = None,
    restart: bool = True,
    throw: bool = False,
) -> Solution:
    """As `solve`, from a `Problem`: points or an ellipse on the laser-parallel image plane, in mm.

    A `Start` is taken as it is.
    """
    formulation = Constrained() if formulation is None else formulation
    if solver is None:
        searched = formulation.formulation if isinstance(formulation, EitherSide) else formulation
        solver = Swift() if isinstance(searched, Penalty) else Ipopt()
    if isinstance(start, Start):
        first = start
    else:
        first = starts.from_closed_form(problem) if start is None else starts.given(start, problem)
    solution = _attempt(problem, formulation, solver, first)
    if restart and start is not None and _failed(solution):
        again = _attempt(problem, formulation, solver, starts.from_closed_form(problem))
        solution = replace(again, effort=solution.effort + again.effort, flags=(*again.flags, Flag.RESTARTED))
    return _returned(solution, throw=throw)


def _returned(solution: Solution, *, throw: bool) -> Solution:
    if throw and solution.status.record == "refused":
        raise SolveError(solution)
    return solution


def _failed(solution: Solution) -> bool:
    return solution.status in (
        Status.INCONSISTENT,
        Status.INFEASIBLE,
        Status.NOT_CONVERGED,
        Status.AT_BOUND,
        Status.NO_COVARIANCE,
        Status.UNIDENTIFIABLE,
        Status.LOCAL_MINIMUM,
        Status.UNSEEN,
    )


def _attempt(problem: Problem, formulation: Formulation, solver: Solver, start: Start) -> Solution:
    identifiability = identify(problem, start)
    blank = Solution(
        Status.NOT_CONVERGED,
        "",
        formulation.name,
        solver.name,
        radius=problem.setup.r,
        identifiability=identifiability,
        n_points=problem.n_points,
        arc_fraction=problem.arc,
        flags=problem.flags,
    )
    if identifiability.null_vector is not None:
        return _refused(blank, Status.UNIDENTIFIABLE, f"{Status.UNIDENTIFIABLE.value} {identifiability.null_vector}.")
    begun = time.perf_counter()
    built = formulation.build(problem, start)
    building = time.perf_counter() - begun
    if isinstance(built, Refusal):
        return replace(_refused(blank, built.status, built.message), solver="none")
    if isinstance(built, DirectAnswer):
        singular = NoCovariance(Status.NO_COVARIANCE, "the closed form is singular here")
        covariance = singular if built.covariance is None else built.covariance
        direct = replace(blank, solver="none", end=_end(problem, None, built.plane), effort=Effort(solve_s=building))
        return _judged(direct, problem, built.plane, covariance)
    return _searched(replace(blank, effort=Effort(build_s=building)), problem, solver.solve(built))


def _searched(blank: Solution, problem: Problem, found: Found) -> Solution:
    solution = replace(blank, effort=blank.effort + found.effort, trace=found.trace, kkt=found.kkt)
    if found.refused is not None:
        return replace(_refused(solution, found.refusal, _why_not_called(found, blank.identifiability)), kkt=None)
    plane = found.nlp.plane(found.x)
    solution = replace(solution, end=_end(problem, found, plane))
    if not np.isfinite(plane).all() or not found.kkt.feasible:
        return _refused(solution, Status.INFEASIBLE, f"{Status.INFEASIBLE.value} {_worst_row(found)}")
    if not found.kkt.ok:
        message = f"{Status.NOT_CONVERGED.value} {_what_is_missing(found.kkt)} ({solution.solver}: {found.report})."
        return _refused(solution, Status.NOT_CONVERGED, message)
    return _judged(solution, problem, plane, plane_covariance(found.nlp, found.x))


def _why_not_called(found: Found, identifiability: Identifiability | None) -> str:
    if found.refusal is Status.OVERDETERMINED:
        return f"{found.refused}; {_sentence(identifiability)}. Use Swift, which penalises them."
    return f"{found.refusal.value} Here {found.refused}."


def _end(problem: Problem, found: Found | None, plane: Array) -> End | None:
    """Where the search stopped; None where its functions are not finite."""
    z_L, p, q = (float(value) for value in plane)
    if not np.isfinite(plane).all():
        return None
    if found is not None and "R" in found.nlp.model.variables:
        return End(float(found.x[found.nlp.model.variables.index("R")]), z_L, p, q)
    return End(float(eq.long_axis(np, p, q, problem.setup.r)), z_L, p, q)


def _what_is_missing(kkt: KktCheck) -> str:
    if kkt.step > RESOLUTION:
        return f"A Newton step would still move the plane by {kkt.step:.1e} of itself"
    if not kkt.minimum:
        return "It is a saddle or a maximum"
    return "A multiplier has the wrong sign: leaving an inequality's limit would still improve the objective"


def _sentence(identifiability: Identifiability | None) -> str:
    return "" if identifiability is None else identifiability.sentence


def _worst_row(found: Found) -> str:
    """Name the equation that is violated most, by how much, in its own unit."""
    nlp = found.nlp
    g = np.asarray(nlp.model.values(found.x, nlp.parameters)[1]).ravel()
    violation = np.where(nlp.model.equalities, np.abs(g), np.maximum(-g, 0.0))
    if not len(violation) or not np.isfinite(violation).all():
        return f"Its functions are not finite there ({found.report})."
    worst = int(np.argmax(violation))
    if violation[worst] < found.kkt.feasibility:
        outside = np.maximum(nlp.lower - found.x, found.x - nlp.upper)
        name = nlp.model.variables[int(np.argmax(outside / nlp.x_scale))]
        equation = name.rpartition("_")[2]
        name = f"The slack of ({equation})" if equation.isdigit() else name
        return f"{name} is beyond its bound by {outside.max():.3g} ({found.report})."
    equation, size = nlp.model.rows[worst].equation, violation[worst] * nlp.row_scale[worst]
    return f"{equation} is off by {size:.3g} {equation.unit} ({found.report})."


def _refused(solution: Solution, status: Status, message: str) -> Solution:
    return replace(solution, status=status, message=message)


def _judged(solution: Solution, problem: Problem, plane: Array, covariance: Array | NoCovariance) -> Solution:
    """Everything that is recomputed at a plane, and the status that follows from it."""
    rig = problem.rig
    effect = None
    if rig is not None and problem.scale_dof != 0:
        effect = sensitivity(problem, rig, plane)
    fit = evidence.fit_quality(problem, plane, effect)
    pose, in_camera = evidence.pose_and_plane(problem, plane)
    if problem.scale_dof == 0:
        covariance = NoCovariance(Status.NO_NOISE_SCALE, "five points leave nothing to estimate their noise from")
    missing = covariance if isinstance(covariance, NoCovariance) else None
    judged = replace(
        solution,
        pose=pose,
        plane=in_camera,
        uncertainty=None
        if isinstance(covariance, NoCovariance)
        else evidence.uncertainty(problem, plane, covariance, effect),
        uncertainty_reason=missing.reason if missing else None,
        chi2=fit.chi2,
        p_value=fit.p_value,
        chi2_points=fit.chi2_points,
        dof_points=fit.dof_points,
        rig_test=fit.rig_test,
        other_plane=evidence.second_plane(problem, plane),
        residuals=evidence.residuals(problem, plane),
    )
    v = evidence.slope_variables(plane, problem.setup)
    if eq.lit_side_in_slopes(np, v, problem.setup) < _UNSEEN * problem.setup.r:
        return _refused(judged, Status.UNSEEN, Status.UNSEEN.value)
    if not (isinstance(covariance, NoCovariance) or fit.improbable):
        excess = evidence.excess(problem, plane, covariance)
        if excess > evidence.EXCESS:
            message = f"{Status.LOCAL_MINIMUM.value} ({np.sqrt(excess):.0f} of its standard deviations)"
            return _refused(solution, Status.LOCAL_MINIMUM, message)
    status, message = _verdict(problem, judged, plane, fit, missing)
    flags = (*judged.flags, *_reservations(problem, judged, plane, fit))
    if status is Status.CONVERGED and Flag.POINTS_SCATTER in flags:
        message = _SCATTERED
    return replace(judged, status=status, message=message, flags=flags)


_SCATTERED = f"A plane was found. {Flag.POINTS_SCATTER.value}"
"""Where chi-squared of the ellipse is that of a right rig but that of the points is not: not that all agrees."""

_UNSEEN = -FEASIBLE
"""Intercept, in radii of the beam, that no solution with the inequality ``c > 0`` can have."""


def _verdict(
    problem: Problem, solution: Solution, plane: Array, fit: evidence.Fit, missing: NoCovariance | None
) -> tuple[Status, str]:
    if fit.improbable:
        numbers = f"chi-squared {fit.chi2:.4g} with {evidence.DOF} degrees of freedom, p = {fit.p_value:.1e}"
        return Status.INCONSISTENT, f"{Status.INCONSISTENT.value} ({numbers}){_fault(problem, solution, plane)}"
    if missing is not None:
        detail = "" if missing.status is Status.NO_NOISE_SCALE else f" ({missing.reason})"
        return missing.status, missing.status.value + detail
    return Status.CONVERGED, Status.CONVERGED.value


def _fault(problem: Problem, solution: Solution, plane: Array) -> str:
    """The equation at fault, where the formulation leaves a gross error in its place, and what else explains it."""
    worst = solution.worst
    if solution.formulation != Elastic().name or worst is None or (worst.sigmas or 0) < _AT_FAULT:
        return ""
    size = f"off by {worst.value:.4g} {worst.unit}, {worst.sigmas:.1f} standard deviations"
    others = [e for e in explained_without(problem, plane, evidence.IMPROBABLE) if f"({e.number})" != worst.equation]
    doubt = f" Without {' or '.join(f'({e.number})' for e in others)} the rest would agree as well." if others else ""
    return f" At fault: {worst.equation} {worst.name}, {size}.{doubt}"


_AT_FAULT = float(scipy.stats.norm.isf(evidence.IMPROBABLE / 2 / len(eq.IMAGE_BLOCK)))
"""Standard deviations that none of the five residuals of right data reaches more often than once in a million."""


def _reservations(problem: Problem, solution: Solution, plane: Array, fit: evidence.Fit) -> tuple[Flag, ...]:
    covariance = np.full((3, 3), np.nan) if solution.covariance is None else solution.covariance
    arc, chi2_points = (np.nan if value is None else value for value in (problem.arc, fit.chi2_points))
    return reservations(
        plane[None],
        covariance[None],
        _excess(problem, solution, plane),
        np.array([arc]),
        np.array([chi2_points]),
        np.array([fit.dof_points or 0]),
    )[0]


def _excess(problem: Problem, solution: Solution, plane: Array) -> Array:
    """How far beyond reach the bound is, (1,), for the points' noise; NaN where that is not known."""
    if problem.points is None or problem.noise is None or solution.uncertainty is None:
        return np.full(1, np.nan)
    return within_reach(problem, plane, solution.uncertainty.spot).excess
