"""Optimality recomputed from the model, and the covariance that the KKT conditions give.

A solver's own word is not evidence: CasADi's ``success`` can be true at an infeasible point. Everything here is
evaluated again from the model's functions, with multipliers of its own.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt.nlp import Nlp
from planeopt.plane import BETA_TOLERANCE
from planeopt.ranks import independent_rows
from planeopt.solution import FEASIBLE, RESOLUTION, KktCheck, Status

Array = NDArray[np.float64]

ACTIVE = 1e-4
"""An inequality or bound this close to its limit, in units of its scale, is taken to be active: an interior-point
search stops a little inside. The Newton step then goes onto the limit; where that was wrong, the multiplier's sign
says so."""


DEPENDENT = 1e-9
"""Gradients of unit length whose part orthogonal to the others is smaller than this say nothing of their own."""


@dataclass(frozen=True)
class System:
    """The linearised KKT conditions at a point, over scaled unknowns and the constraints active there.

    Attributes
    ----------
    kkt : DM (n + m, n + m)
        Hessian of the Lagrangian and gradients of the ``m`` active constraints: equalities, near inequalities, bounds.
    gradient : (n,)
        Of the Lagrangian, with least-squares multipliers.
    misfit : (m,)
        Values of the active constraints.
    multipliers : (m_active,)
        Of all active constraints, dependent ones included.
    rows : (m_rows,) of int
        Which rows of the model the first of the active constraints are; the rest are bounds.
    kept : (m,) of int
        Which of the active constraints entered the system: a largest independent set.
    n_equalities : int
    row_multipliers : (n_rows,)
        Of the model's rows, zero where not active.
    """

    kkt: ca.DM
    gradient: Array
    misfit: Array
    multipliers: Array
    rows: NDArray[np.integer]
    kept: NDArray[np.integer]
    n_equalities: int
    row_multipliers: Array


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
    step = _solve(system.kkt, len(x), -np.concatenate([system.gradient, system.misfit])[:, None])[: len(x), 0]
    wrong = float(np.max(system.multipliers[system.n_equalities :], initial=0.0))
    dual = wrong / max(1.0, float(np.max(np.abs(system.multipliers), initial=0.0)))
    plane, by_unknowns = (np.asarray(value) for value in nlp.model.plane_and_jacobian(x, nlp.parameters))
    z_L, p, q = plane.ravel()
    size = np.array([max(abs(z_L), np.finfo(float).tiny), 1 + p**2 + q**2, 1 + p**2 + q**2])
    length = float(np.max(np.abs(by_unknowns @ (step * nlp.x_scale)) / size))
    if not np.isfinite(length):
        return KktCheck(feasibility, np.inf, dual, minimum=False), None
    # Where the unknowns cannot express every plane (beta at alpha = 0), curvature along them says nothing of the plane.
    minimum = _tilt_is_stuck(by_unknowns * nlp.x_scale) or _is_minimum(system, len(x))
    return KktCheck(feasibility, length, dual, minimum), step


def _is_minimum(system: System, n: int) -> bool:
    """Whether the Lagrangian curves upwards along the active constraints, which a Newton step cannot tell.

    It does so exactly when the KKT matrix has ``n`` positive and ``m`` negative eigenvalues; one at rounding level
    (beta at ``alpha = 0``) is neither.
    """
    m = system.kkt.shape[0] - n
    if m == 0:
        # Without active constraints the matrix is the Hessian: pivots of a sparse factor tell its signs.
        pivots = np.asarray(ca.ldl(_equilibrated(system.kkt, n)[0])[0]).ravel()
        return bool(np.all(pivots > -_FLAT * np.abs(pivots).max()))
    eigenvalues = np.linalg.eigvalsh(np.asarray(_equilibrated(system.kkt, n)[0]))
    return int(np.sum(eigenvalues < -_FLAT * np.abs(eigenvalues).max())) <= m


_FLAT = 1e-12
"""Curvature below this share of the largest is rounding."""


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
    load = np.zeros((system.kkt.shape[0], 3))
    load[:n] = by_unknowns.T
    adjoint = _solve(system.kkt, n, load)
    # One step of iterative refinement shows how many digits the factorisation had; a singular matrix leaves none.
    correction = _solve(system.kkt, n, load - np.asarray(system.kkt @ ca.DM(adjoint)))
    if not np.linalg.norm(correction) <= _FEW_DIGITS * np.linalg.norm(adjoint):
        return NoCovariance(Status.NO_COVARIANCE, "the KKT matrix is singular: the data do not fix every unknown here")
    adjoint = adjoint + correction
    weights = adjoint[:n] * nlp.x_scale[:, None]
    of_active = np.zeros((len(system.multipliers), 3))
    of_active[system.kept] = adjoint[n:]
    by_rows = _of_rows(nlp, system.rows, of_active[: len(system.rows)])
    by_data = [
        np.asarray(model.data_adjoint(x, nlp.parameters, system.row_multipliers, weights[:, i], by_rows[:, i])).ravel()
        for i in range(3)
    ]
    root = np.array(by_data) @ nlp.data_factor
    covariance = root @ root.T
    if not _positive_definite(covariance):
        return NoCovariance(Status.NO_COVARIANCE, "the KKT conditions give one that is not positive definite")
    return (covariance + covariance.T) / 2


_FEW_DIGITS = 1e-3
"""Largest relative correction of a covariance's factor: three digits are enough for a standard deviation."""


def _tilt_is_stuck(plane_by_unknowns: Array) -> bool:
    """Whether some change of the slopes is out of the unknowns' reach, to the tolerance where beta means nothing."""
    reach = np.linalg.svd(plane_by_unknowns[1:], compute_uv=False)
    return bool(reach[1] < BETA_TOLERANCE * reach[0])


def _independent(active: Array) -> NDArray[np.integer]:
    """Which active constraints say something of their own, unknowns scaled to comparable effect.

    At a noise of a billionth the pose's columns are 1e7 times the slacks', by which alone the image rows differ.
    """
    effect = np.max(np.abs(active), axis=0, initial=0.0)
    return independent_rows(active / np.where(effect > 0, effect, 1.0), DEPENDENT)


def _positive_definite(covariance: Array) -> bool:
    """Whether the correlations are finite and no combination has vanishing variance."""
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variances > 0).all()):
        return False
    unit = 1 / np.sqrt(variances)
    return bool(np.linalg.eigvalsh(covariance * np.outer(unit, unit))[0] > 1e3 * np.finfo(float).eps)


def linearise(nlp: Nlp, x: Array) -> System:
    """The KKT conditions at ``x``; an inequality or bound is active within `ACTIVE` of its limit.

    Of active constraints that say the same thing (the five laser equations of an L1 vertex) only independent ones enter
    the system; the multipliers are those of all.
    """
    model, scale = nlp.model, nlp.x_scale
    _, gradient, g, jacobian = model.first_order(x, nlp.parameters)
    values = np.asarray(g).ravel()
    equalities = np.flatnonzero(model.equalities)
    rows = np.concatenate([equalities, np.flatnonzero(~model.equalities & (values <= ACTIVE))])
    at_lower = np.flatnonzero((x - nlp.lower) / scale <= ACTIVE)
    at_upper = np.flatnonzero((nlp.upper - x) / scale <= ACTIVE)
    scaling, identity = ca.diag(ca.DM(scale)), ca.DM.eye(len(x))
    active = ca.vertcat(
        jacobian[rows.tolist(), :] @ scaling, identity[at_lower.tolist(), :], -identity[at_upper.tolist(), :]
    )
    inside = (x - nlp.lower)[at_lower] / scale[at_lower], (nlp.upper - x)[at_upper] / scale[at_upper]
    misfit = np.concatenate([values[rows], *inside])
    if nlp.decoupling is not None:
        m = len(nlp.decoupling)
        active = ca.vertcat(ca.DM(nlp.decoupling) @ active[:m, :], active[m:, :])
        misfit[:m] = nlp.decoupling @ misfit[:m]
    slope = np.asarray(gradient).ravel() * scale
    dense = np.asarray(active)
    kept = _independent(dense)
    solved = _multipliers(dense, slope, len(equalities), unique=len(kept) == len(dense))
    multipliers = _of_rows(nlp, rows, solved[: len(rows), None])[:, 0]
    hessian = model.hessian(x, nlp.parameters, multipliers)
    active = active[kept.tolist(), :]
    kkt = ca.blockcat([[scaling @ hessian @ scaling, active.T], [active, ca.DM(len(kept), len(kept))]])
    return System(kkt, slope + solved @ dense, misfit[kept], solved, rows, kept, len(equalities), multipliers)


def _of_rows(nlp: Nlp, rows: NDArray[np.integer], values: Array) -> Array:
    """Multipliers of the active rows (m, k) as they enter the system, as those of all the model's rows (n_rows, k)."""
    spread = np.zeros((len(nlp.model.rows), values.shape[1]))
    spread[rows] = values
    if nlp.decoupling is not None:
        m = len(nlp.decoupling)
        spread[rows[:m]] = nlp.decoupling.T @ values[:m]
    return spread


def _multipliers(active: Array, gradient: Array, n_equalities: int, *, unique: bool) -> Array:
    """Least-squares multipliers of ``gradient + A' lambda = 0``.

    Where active constraints depend on each other the multipliers are not unique: then those with the right signs (not
    positive for inequalities) are looked for, which plain least squares need not return.
    """
    if not len(active):
        return np.zeros(0)
    solved = np.asarray(np.linalg.lstsq(active.T, -gradient, rcond=None)[0], dtype=float)
    if unique or np.all(solved[n_equalities:] <= 0):
        return solved
    upper = np.full(len(active), np.inf)
    upper[n_equalities:] = 0.0
    return scipy.optimize.lsq_linear(active.T, -gradient, bounds=(-np.inf, upper), method="bvls", tol=1e-14).x


def _equilibrated(kkt: ca.DM, n: int) -> tuple[ca.DM, Array]:
    """``D K D`` and the diagonal of ``D``: the ``n`` unknowns in units of their effect, the constraints at length 1.

    An unknown's effect is its largest entry in a constraint, or the root of its curvature. That keeps what the noise of
    a nearly exact case spreads over seven decades; dividing by the largest entry of a row would lose half of them.
    """
    rows, columns = np.array(kkt.row()), np.array(kkt.sparsity().get_col())
    values = np.abs(kkt.nonzeros())
    effect = np.zeros(kkt.shape[0])
    own, coupling = (rows == columns) & (rows < n), (rows >= n) & (columns < n)
    effect[rows[own]] = np.sqrt(values[own])
    np.maximum.at(effect, columns[coupling], values[coupling])
    unit = 1 / np.where(effect > 0, effect, 1.0)
    length = np.zeros(kkt.shape[0])
    np.maximum.at(length, rows[coupling], values[coupling] * unit[columns[coupling]])
    unit[n:] = 1 / np.where(length[n:] > 0, length[n:], 1.0)
    scaling = ca.diag(ca.DM(unit))
    return scaling @ kkt @ scaling, unit


def _solve(kkt: ca.DM, n: int, load: Array) -> Array:
    """Solve with the KKT matrix, equilibrated; the shortest least-squares solution where it is singular."""
    scaled, unit = _equilibrated(kkt, n)
    right = load * unit[:, None]
    try:
        solution = np.asarray(ca.solve(scaled, ca.DM(right), "csparse"))
    except RuntimeError:
        solution = np.full_like(load, np.nan)
    if not np.isfinite(solution).all():
        solution = np.linalg.lstsq(np.asarray(scaled), right, rcond=None)[0]
    return solution * unit[:, None]
