"""The KKT conditions of a programme, linearised at a point: assembled, brought to a common scale, solved."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt.nlp import Nlp
from planeopt.ranks import independent_rows

Array = NDArray[np.float64]

ACTIVE = 1e-4
"""An inequality or bound this close to its limit, in units of its scale, is taken to be active.

An interior-point search stops a little inside. The Newton step then goes onto the limit; where that was wrong, the
multiplier's sign says so."""

DEPENDENT = 1e-9
"""Gradients of unit length whose part orthogonal to the others is smaller than this say nothing of their own."""

FLAT = 1e-12
"""Curvature below this share of the largest is rounding."""


@dataclass(frozen=True)
class Linearised:
    """The Newton system on the KKT conditions, over scaled unknowns and the constraints active at a point.

    Attributes
    ----------
    matrix : (n + m, n + m) array, or sparse DM (n, n) where no constraint is active
        ``D K D`` with ``K`` the Hessian of the Lagrangian bordered by the gradients of ``m`` independent active
        constraints: equalities, near inequalities, bounds. Sparse, because the programme with an unknown for every
        boundary point has no active constraints at its solution.
    unit : (n + m,)
        The diagonal of ``D``: unknowns in units of their effect, constraints at length 1.
    gradient : (n,)
        Of the Lagrangian, with least-squares multipliers.
    misfit : (m,)
        Values of the active constraints.
    multipliers : (m_active,)
        Of all active constraints, dependent ones included.
    rows : (m_rows,) of int
        Which rows of the model the first of the active constraints are; the rest are bounds.
    kept : (m,) of int
        Which of the active constraints entered the system.
    n_equalities : int
    row_multipliers : (n_rows,)
        Of the model's rows, zero where not active.
    """

    matrix: Array | ca.DM
    unit: Array
    gradient: Array
    misfit: Array
    multipliers: Array
    rows: NDArray[np.integer]
    kept: NDArray[np.integer]
    n_equalities: int
    row_multipliers: Array

    def solve(self, load: Array) -> Array:
        """Solve ``K y = load`` for columns; the shortest least-squares solution where K is singular."""
        right = load * self.unit[:, None]
        try:
            if isinstance(self.matrix, np.ndarray):
                solution = np.linalg.solve(self.matrix, right)
            else:
                solution = np.asarray(ca.solve(self.matrix, ca.DM(right), "csparse"))
        except (RuntimeError, np.linalg.LinAlgError):
            solution = np.full_like(right, np.nan)
        if not np.isfinite(solution).all():
            solution = np.linalg.lstsq(np.asarray(self.matrix), right, rcond=None)[0]
        return np.asarray(solution * self.unit[:, None], dtype=float)

    def remainder(self, load: Array, solution: Array) -> Array:
        """``load - K solution``."""
        scaled = solution / self.unit[:, None]
        product = self.matrix @ (scaled if isinstance(self.matrix, np.ndarray) else ca.DM(scaled))
        return load - np.asarray(product) / self.unit[:, None]

    @property
    def is_minimum(self) -> bool:
        """Whether the Lagrangian curves upwards along the active constraints, which a Newton step cannot tell.

        It does so exactly when the matrix has as many negative eigenvalues as active constraints; one at rounding level
        is neither.
        """
        if isinstance(self.matrix, np.ndarray):
            eigenvalues = np.linalg.eigvalsh(self.matrix)
            return int(np.sum(eigenvalues < -FLAT * np.abs(eigenvalues).max())) <= len(self.kept)
        # Pivots of a sparse factor tell the signs of the Hessian.
        pivots = np.asarray(ca.ldl(self.matrix)[0]).ravel()
        return bool(np.all(pivots > -FLAT * np.abs(pivots).max()))


def linearise(nlp: Nlp, x: Array) -> Linearised | None:
    """The KKT conditions at ``x``, or None where a derivative is not finite.

    An inequality or bound is active within `ACTIVE` of its limit.

    Of active constraints that say the same thing (the five laser equations of an L1 vertex) only independent ones enter
    the system; the multipliers are those of all.
    """
    model, scale, n = nlp.model, nlp.x_scale, len(x)
    _, gradient, g, jacobian = (np.asarray(value) for value in model.first_order(x, nlp.parameters))
    if not (np.isfinite(gradient).all() and np.isfinite(jacobian).all()):
        return None
    values = g.ravel()
    equalities = np.flatnonzero(model.equalities)
    rows = np.concatenate([equalities, np.flatnonzero(~model.equalities & (values <= ACTIVE))])
    inside, below = (x - nlp.lower) / scale, (nlp.upper - x) / scale
    at_lower, at_upper = np.flatnonzero(inside <= ACTIVE), np.flatnonzero(below <= ACTIVE)
    bounds = np.zeros((len(at_lower) + len(at_upper), n))
    bounds[np.arange(len(at_lower)), at_lower] = 1.0
    bounds[len(at_lower) + np.arange(len(at_upper)), at_upper] = -1.0
    active = np.vstack([jacobian[rows] * scale, bounds])
    misfit = np.concatenate([values[rows], inside[at_lower], below[at_upper]])
    if nlp.decoupling is not None:
        m = len(nlp.decoupling)
        active[:m], misfit[:m] = nlp.decoupling @ active[:m], nlp.decoupling @ misfit[:m]
    slope = gradient.ravel() * scale
    kept = _independent(active)
    multipliers = _multipliers(active, slope, len(equalities), unique=len(kept) == len(active))
    row_multipliers = of_rows(nlp, rows, multipliers[: len(rows), None])[:, 0]
    hessian = model.hessian(x, nlp.parameters, row_multipliers)
    if not np.isfinite(hessian.nonzeros()).all():
        return None
    matrix, unit = _assemble(hessian, scale, active[kept])
    return Linearised(
        matrix,
        unit,
        slope + multipliers @ active,
        misfit[kept],
        multipliers,
        rows,
        kept,
        len(equalities),
        row_multipliers,
    )


def of_rows(nlp: Nlp, rows: NDArray[np.integer], values: Array) -> Array:
    """Multipliers (m, k) of the active rows as they enter the system, as those of all the model's rows (n_rows, k)."""
    spread = np.zeros((len(nlp.model.rows), values.shape[1]))
    spread[rows] = values
    if nlp.decoupling is not None:
        m = len(nlp.decoupling)
        spread[rows[:m]] = nlp.decoupling.T @ values[:m]
    return spread


def _assemble(hessian: ca.DM, scale: Array, active: Array) -> tuple[Array | ca.DM, Array]:
    """``D K D`` and ``D`` of `Linearised`.

    An unknown's effect is its largest entry in a constraint, or the root of its curvature. That keeps what the noise of
    a nearly exact case spreads over seven decades; dividing by the largest entry of a row would lose half of them.
    """
    curvature = np.sqrt(np.abs(np.asarray(ca.diag(hessian)).ravel())) * scale
    effect = np.maximum(curvature, np.max(np.abs(active), axis=0, initial=0.0))
    unit = 1 / np.where(effect > 0, effect, 1.0)
    if not len(active):
        scaling = ca.diag(ca.DM(scale * unit))
        return scaling @ hessian @ scaling, unit
    rows = active * unit
    length = np.max(np.abs(rows), axis=1)
    row_unit = 1 / np.where(length > 0, length, 1.0)
    rows *= row_unit[:, None]
    block = np.asarray(hessian) * np.outer(scale * unit, scale * unit)
    zero = np.zeros((len(rows), len(rows)))
    return np.block([[block, rows.T], [rows, zero]]), np.concatenate([unit, row_unit])


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


def _independent(active: Array) -> NDArray[np.integer]:
    """Which active constraints say something of their own, unknowns scaled to comparable effect.

    At a noise of a billionth the pose's columns are 1e7 times the slacks', by which alone the image rows differ.
    """
    effect = np.max(np.abs(active), axis=0, initial=0.0)
    return independent_rows(active / np.where(effect > 0, effect, 1.0), DEPENDENT)
