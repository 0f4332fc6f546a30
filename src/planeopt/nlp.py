"""A nonlinear programme as data: symbolic once (`Model`), with the numbers of one case (`Nlp`).

A solver sees only this. Rows carry the paper's equation numbers, so that every message about a residual names its
equation.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from planeopt.equations import Equation, eq29, lit_side, lit_side_in_slopes

Array = NDArray[np.float64]
Symbol = Any
"""`casadi.SX` or `casadi.MX`."""


@dataclass(frozen=True)
class Row:
    """A constraint row: which equation it is, and whether it is ``= 0`` or ``>= 0``."""

    equation: Equation
    equality: bool = True


@dataclass(frozen=True, eq=False)
class Model:
    """A programme in symbols: built once per formulation, its compiled functions and solvers cached on it.

    Attributes
    ----------
    name : str
    variables : tuple of str
    x, p : casadi symbols, columns
        Unknowns, and parameters (the data of a case enter only here).
    objective, constraints : casadi expressions
        Scalar, and a column with one entry a row in ``rows``.
    rows : tuple of Row
    plane : casadi expression
        ``(z_L, p, q)`` of the laser-parallel frame as a function of ``x`` (and of ``p``, where units are parameters).
    data : casadi symbol
        The measured part of ``p``, so that its covariance can be carried through the KKT conditions.
    """

    name: str
    variables: tuple[str, ...]
    x: Symbol
    p: Symbol
    objective: Symbol
    constraints: Symbol
    rows: tuple[Row, ...]
    plane: Symbol
    data: Symbol

    @cached_property
    def values(self) -> ca.Function:
        """``(x, p) -> f, g``."""
        return ca.Function("values", [self.x, self.p], [self.objective, self.constraints])

    @cached_property
    def first_order(self) -> ca.Function:
        """``(x, p) -> f, grad f, g, dg/dx``."""
        gradient = ca.gradient(self.objective, self.x)
        jacobian = ca.jacobian(self.constraints, self.x)
        return ca.Function("first", [self.x, self.p], [self.objective, gradient, self.constraints, jacobian])

    @cached_property
    def _lagrangian(self) -> tuple[Symbol, Symbol]:
        multipliers = type(self.x).sym("multipliers", self.constraints.shape[0])
        return multipliers, self.objective + ca.dot(multipliers, self.constraints)

    @cached_property
    def hessian(self) -> ca.Function:
        """``(x, p, multipliers) -> Hessian of the Lagrangian``."""
        multipliers, lagrangian = self._lagrangian
        return ca.Function("hessian", [self.x, self.p, multipliers], [ca.hessian(lagrangian, self.x)[0]])

    @cached_property
    def data_adjoint(self) -> ca.Function:
        """``(x, p, multipliers, w, m) -> d (w' grad L + m' g) / d data``: one reverse sweep for all data."""
        multipliers, lagrangian = self._lagrangian
        w, m = type(self.x).sym("w", self.x.shape[0]), type(self.x).sym("m", self.constraints.shape[0])
        weighted = ca.jtimes(lagrangian, self.x, w) + ca.dot(m, self.constraints)
        return ca.Function(
            "data_adjoint", [self.x, self.p, multipliers, w, m], [ca.vec(ca.gradient(weighted, self.data))]
        )

    @cached_property
    def plane_and_jacobian(self) -> ca.Function:
        """``(x, p) -> (z_L, p, q), d(z_L, p, q)/dx``."""
        return ca.Function("plane", [self.x, self.p], [self.plane, ca.jacobian(self.plane, self.x)])

    @cached_property
    def penalised(self) -> "Model":
        """The same programme with its equalities moved into the objective by (29); the weight is one more parameter."""
        weight = type(self.p).sym("weight")
        equal = [i for i, row in enumerate(self.rows) if row.equality]
        other = [i for i, row in enumerate(self.rows) if not row.equality]
        residuals = [self.constraints[i] for i in equal]
        return Model(
            f"{self.name}_penalised",
            self.variables,
            self.x,
            ca.vertcat(self.p, weight),
            eq29(ca, self.objective, residuals, weight),
            self.constraints[other],
            tuple(self.rows[i] for i in other),
            self.plane,
            self.data,
        )

    @cached_property
    def either_side(self) -> "Model":
        """The same programme without the inequality ``c > 0``, in whichever unknowns it is written."""
        kept = [i for i, row in enumerate(self.rows) if row.equation not in (lit_side, lit_side_in_slopes)]
        return replace(
            self,
            name=f"{self.name}_either_side",
            constraints=self.constraints[kept],
            rows=tuple(self.rows[i] for i in kept),
        )

    @property
    def equalities(self) -> NDArray[np.bool_]:
        return np.array([row.equality for row in self.rows], dtype=bool)


@dataclass(frozen=True)
class Nlp:
    """A `Model` with the numbers of one case.

    Attributes
    ----------
    model : Model
    stages : tuple of (n_p,)
        Parameter vectors to solve one after another, each from the last one's answer; the last one is the programme.
    start, lower, upper : (n_x,)
    x_scale : (n_x,)
        Typical size of the unknowns, for checks that compare with 1.
    row_scale : (n_g,)
        What a row's value of 1 means in its equation's unit.
    data_factor : (n_data, m), dense or sparse
        ``S`` with ``S S'`` the covariance of the measured parameters.
    decoupling : (m, m) or None
        What makes the first ``m`` rows, whose noise is correlated, independent and of unit noise: applied before
        anything is solved with their gradients, which may differ in the eighth digit only.
    """

    model: Model
    stages: tuple[Array, ...]
    start: Array
    lower: Array
    upper: Array
    x_scale: Array
    row_scale: Array
    data_factor: Array | scipy.sparse.csr_array
    decoupling: Array | None = None

    @property
    def parameters(self) -> Array:
        return self.stages[-1]

    def penalised(self, weight: float) -> "Nlp":
        """Only the last stage, with the equalities in the objective at a weight."""
        keep = ~self.model.equalities
        return replace(
            self,
            model=self.model.penalised,
            stages=(np.append(self.parameters, weight),),
            row_scale=self.row_scale[keep],
            decoupling=None,
        )

    def either_side(self) -> "Nlp":
        """The same case without the inequality ``c > 0``: which side of the plane is lit is left open."""
        model = self.model.either_side
        kept = [row in model.rows for row in self.model.rows]
        return replace(self, model=model, row_scale=self.row_scale[kept])

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the rows: 0 and 0 for an equality, 0 and infinity otherwise."""
        n = len(self.model.rows)
        return np.zeros(n), np.where(self.model.equalities, 0.0, np.inf)

    def plane(self, x: Array) -> Array:
        """``(z_L, p, q)`` of the laser-parallel frame at ``x``."""
        return np.asarray(self.model.plane_and_jacobian(x, self.parameters)[0]).ravel()
