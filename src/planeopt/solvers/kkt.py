"""Optimality recomputed from the model, and the covariance that the KKT conditions give.

A solver's own word is not evidence: CasADi's ``success`` can be true at an infeasible point. Everything here is
evaluated again from the model's functions, with multipliers of its own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.nlp import Nlp
from planeopt.plane import BETA_TOLERANCE
from planeopt.solution import FEASIBLE, RESOLUTION, KktCheck, Status
from planeopt.solvers.linearised import ACTIVE, linearise, of_rows

Array = NDArray[np.float64]


def check(nlp: Nlp, x: Array) -> KktCheck:
    """First-order conditions at ``x``: feasibility, the Newton step that is left, and the multipliers' signs.

    Stationarity is measured by how far the step to the nearest KKT point would move the plane: unlike a gradient's size
    it says how far the answer is off, whatever the weights, units and unknowns of the programme.

    Parameters
    ----------
    nlp : Nlp
    x : (n_x,)
    """
    return _check_and_step(nlp, x)[0]


def polish(nlp: Nlp, x: Array) -> tuple[Array, KktCheck, int]:
    """Newton steps on the KKT conditions while one is left and each at least halves it.

    A search stops where its own scaled residuals are small; in unknowns as unequal as depth and slope that can be a
    millionth short of the answer. From there Newton's method converges quadratically.

    Returns
    -------
    x : (n_x,)
    check : KktCheck
    steps : int
    """
    found, step = _check_and_step(nlp, x)
    steps = 0
    while _distance(found) > 1 and step is not None and found.feasibility < _NEARLY_FEASIBLE and steps < _MOST_POLISH:
        moved = np.clip(x + step * nlp.x_scale, nlp.lower, nlp.upper)
        next_found, next_step = _check_and_step(nlp, moved)
        steps += 1
        if _distance(next_found) > _distance(found) / 2:
            break
        x, found, step = moved, next_found, next_step
    return x, found, steps


def _distance(found: KktCheck) -> float:
    """How far from an answer that needs no polish, a tenth of what still counts as one."""
    return 10 * max(found.step / RESOLUTION, found.feasibility / FEASIBLE)


_NEARLY_FEASIBLE = 1e-2
"""In units of the rows' scales; farther off, a Newton step is no polish but a search without safeguards."""

_MOST_POLISH = 5
"""Quadratic convergence doubles the digits each time: from 1e-3 to rounding in four."""


def _check_and_step(nlp: Nlp, x: Array) -> tuple[KktCheck, Array | None]:
    g = np.asarray(nlp.model.values(x, nlp.parameters)[1]).ravel()
    violation = np.where(nlp.model.equalities, np.abs(g), np.maximum(-g, 0.0))
    outside = np.maximum(np.maximum(nlp.lower - x, x - nlp.upper), 0.0) / nlp.x_scale
    feasibility = float(np.max(np.concatenate([violation, outside])))
    if not np.isfinite(feasibility):
        return KktCheck(np.inf, np.inf, np.inf, minimum=False), None
    system = linearise(nlp, x)
    if system is None:
        return KktCheck(feasibility, np.inf, np.inf, minimum=False), None
    step = system.solve(-np.concatenate([system.gradient, system.misfit])[:, None])[: len(x), 0]
    wrong = float(np.max(system.multipliers[system.n_equalities :], initial=0.0))
    dual = wrong / max(1.0, float(np.max(np.abs(system.multipliers), initial=0.0)))
    plane, by_unknowns = (np.asarray(value) for value in nlp.model.plane_and_jacobian(x, nlp.parameters))
    z_L, p, q = plane.ravel()
    size = np.array([max(abs(z_L), np.finfo(float).tiny), 1 + p**2 + q**2, 1 + p**2 + q**2])
    # A search that ran off to z_L = 0 leaves a step that overflows over it: not finite, and so no answer.
    with np.errstate(over="ignore"):
        length = float(np.max(np.abs(by_unknowns @ (step * nlp.x_scale)) / size))
    if not np.isfinite(length):
        return KktCheck(feasibility, np.inf, dual, minimum=False), None
    # Where the unknowns cannot express every plane (beta at alpha = 0), curvature along them says nothing of the plane.
    minimum = _tilt_is_stuck(by_unknowns * nlp.x_scale) or system.is_minimum
    return KktCheck(feasibility, length, dual, minimum), step


@dataclass(frozen=True)
class NoCovariance:
    """Why there is no covariance, and what that makes of the solution."""

    status: Status
    reason: str


def plane_covariance(nlp: Nlp, x: Array) -> Array | NoCovariance:
    """Covariance (3, 3) of ``(z_L, p, q)``: the data's covariance carried through the KKT conditions at the solution.

    The conditions ``grad L = 0, g_active = 0`` define ``x`` as a function of the data; one adjoint solve with the KKT
    matrix for each of the three outputs gives its derivative ``D``, and ``D Sigma D'`` the covariance.
    """
    model, n = nlp.model, len(x)
    system = linearise(nlp, x)
    if system is None:
        return NoCovariance(Status.NO_COVARIANCE, "a derivative is not finite there")
    at_limit = [model.rows[i].equation.name for i in system.rows if not model.rows[i].equality]
    # Unknowns bounded on both sides are the pose's; a slack of an L1 programme belongs on its only bound.
    physical = np.isfinite(nlp.lower) & np.isfinite(nlp.upper)
    near = np.minimum(x - nlp.lower, nlp.upper - x) <= ACTIVE * nlp.x_scale
    at_limit += [f"the search's bound on {model.variables[i]}" for i in np.flatnonzero(physical & near)]
    if at_limit:
        return NoCovariance(Status.AT_BOUND, f"an inequality holds with equality there: {at_limit[0]}")
    by_unknowns = np.asarray(model.plane_and_jacobian(x, nlp.parameters)[1]) * nlp.x_scale
    if _tilt_is_stuck(by_unknowns):
        reason = "the unknowns cannot express every change of the plane there (at alpha = 0 use slopes)"
        return NoCovariance(Status.NO_COVARIANCE, reason)
    load = np.zeros((len(system.unit), 3))
    load[:n] = by_unknowns.T
    adjoint = system.solve(load)
    # One step of iterative refinement shows how many digits the factorisation had; a singular matrix leaves none.
    correction = system.solve(system.remainder(load, adjoint))
    if not np.linalg.norm(correction) <= _FEW_DIGITS * np.linalg.norm(adjoint):
        return NoCovariance(Status.NO_COVARIANCE, "the KKT matrix is singular: the data do not fix every unknown here")
    adjoint = adjoint + correction
    weights = adjoint[:n] * nlp.x_scale[:, None]
    of_active = np.zeros((len(system.multipliers), 3))
    of_active[system.kept] = adjoint[n:]
    by_rows = of_rows(nlp, system.rows, of_active[: len(system.rows)])
    by_data = [
        np.asarray(model.data_adjoint(x, nlp.parameters, system.row_multipliers, weights[:, i], by_rows[:, i])).ravel()
        for i in range(3)
    ]
    root = np.array(by_data) @ nlp.data_factor
    covariance = root @ root.T
    if not _positive_definite(covariance):
        return NoCovariance(Status.NO_COVARIANCE, "the KKT conditions give one that is not positive definite")
    return covariance


_FEW_DIGITS = 1e-3
"""Largest relative correction of a covariance's factor: three digits are enough for a standard deviation."""


def _tilt_is_stuck(plane_by_unknowns: Array) -> bool:
    """Whether some change of the slopes is out of the unknowns' reach, to the tolerance where beta means nothing."""
    reach = np.linalg.svd(plane_by_unknowns[1:], compute_uv=False)
    return bool(reach[1] < BETA_TOLERANCE * reach[0])


def _positive_definite(covariance: Array) -> bool:
    """Whether the correlations are finite and no combination has vanishing variance."""
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variances > 0).all()):
        return False
    unit = 1 / np.sqrt(variances)
    return bool(np.linalg.eigvalsh(covariance * np.outer(unit, unit))[0] > 1e3 * np.finfo(float).eps)
