"""SciPy's solvers on the weighted problem of `Constrained`: same start, bounds, scaling, exact derivatives.

The slack is eliminated: ``1/2 |S^-1 (b_i/b_0 - B_i)|^2`` is the objective. `least_squares` has no constraints: it
searches ``(z_L, p, q)``, from which R follows, and knows visibility only through its bounds. SLSQP and trust-constr
search ``(R, z_L, p, q)`` with the spot on the beam as equation and visibility as inequalities, like `Constrained`.
Values come from CasADi's buffered calls, which cost half a microsecond, so that the time is the solvers' own.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation.starts import from_closed_form
from planeopt.formulations import Problem
from planeopt.formulations.bounds import pose_bounds, pose_scale

Array = NDArray[np.float64]
Kernel = Callable[[Array], Array]


@dataclass(frozen=True)
class Outcome:
    """Where a rival ended: ``(z_L, p, q)`` and its counts."""

    plane: Array
    iterations: int
    evaluations: int
    derivative_evaluations: int


@dataclass(frozen=True)
class Weighted:
    """The problem over scaled unknowns ``x = (R, z_L, p, q) / scale``, as functions of ``x``."""

    start: Array
    lower: Array
    upper: Array
    scale: Array
    residuals: Kernel
    jacobian: Kernel
    objective: Kernel
    gradient: Kernel
    hessian: Kernel
    on_beam: Kernel
    on_beam_jacobian: Kernel
    on_beam_hessian: Kernel
    visible: Kernel
    visible_jacobian: Kernel
    visible_hessian: Callable[[Array, Array], Array]


class Buffered:
    """A function of all its inputs but the last, which is data, with half a microsecond's overhead a call."""

    def __init__(self, inputs: list[ca.SX], output: ca.SX, data: Array) -> None:
        function = ca.Function("kernel", inputs, [ca.densify(output)])
        self._inputs = [np.zeros(symbol.numel()) for symbol in inputs[:-1]]
        self._data, self._shape, self._result = data, output.shape, np.zeros(output.numel())
        # The trigger points into the buffer, and the buffer into the arrays: all must live as long as this.
        self._buffer, self._trigger = function.buffer()
        for i, array in enumerate([*self._inputs, data]):
            self._buffer.set_arg(i, array.data)  # pyright: ignore[reportCallIssue] - the stub knows only raw pointers
        self._buffer.set_res(0, self._result.data)  # pyright: ignore[reportCallIssue]

    def __call__(self, *values: Array) -> Array:
        for array, value in zip(self._inputs, values, strict=True):
            array[:] = value
        self._trigger()
        return self._result.reshape(self._shape, order="F").copy()


def weighted(problem: Problem) -> Weighted:
    """Build the kernels once; this is not timed."""
    start = from_closed_form(problem)
    scale = pose_scale(problem.setup.r, start.plane[0])
    lower, upper = pose_bounds("slopes", problem.setup.r)
    x, data = ca.SX.sym("x", 4), ca.SX.sym("data", 9 + 25)
    v, k = eq.SlopeVariables(*ca.vertsplit(x * scale)), eq.Setup(*ca.vertsplit(data[:4]))
    whitener = ca.reshape(data[9:], 5, 5)
    residuals = whitener @ ca.vertcat(*eq.image_residuals_in_slopes(ca, v, k, ca.vertsplit(data[4:9])))
    objective = ca.sumsqr(residuals) / 2
    on_beam = eq.laser_constraint_in_slopes(ca, v, k) / k.r**2
    visible = ca.vertcat(eq.in_front_in_slopes(ca, v, k) / k.r**2, eq.lit_side_in_slopes(ca, v, k) / k.r)
    weights = ca.SX.sym("weights", 2)
    values = np.concatenate([problem.setup, problem.B, np.linalg.inv(problem.B_factor).ravel(order="F")])

    def kernel(output: ca.SX) -> Buffered:
        return Buffered([x, data], output, values)

    scalar, column = kernel(objective), kernel(ca.gradient(objective, x))
    beam, rows = kernel(on_beam), kernel(residuals)
    inequalities = kernel(visible)
    return Weighted(
        start.in_slopes / scale,
        lower / scale,
        upper / scale,
        scale,
        lambda at: rows(at).ravel(),
        kernel(ca.jacobian(residuals, x)),
        lambda at: scalar(at)[0, 0],
        lambda at: column(at).ravel(),
        kernel(ca.hessian(objective, x)[0]),
        lambda at: beam(at).ravel(),
        kernel(ca.jacobian(on_beam, x)),
        kernel(ca.hessian(on_beam, x)[0]),
        lambda at: inequalities(at).ravel(),
        kernel(ca.jacobian(visible, x)),
        Buffered([x, weights, data], ca.hessian(ca.dot(weights, visible), x)[0], values),
    )


def least_squares(of: Weighted) -> Outcome:
    """Trust-region reflective, over ``(z_L, p, q)``; R does not enter the residuals in slopes."""
    x = of.start.copy()

    def full(free: Array) -> Array:
        x[1:] = free
        return x

    found = scipy.optimize.least_squares(
        lambda free: of.residuals(full(free)),
        of.start[1:],
        jac=cast(Any, lambda free: of.jacobian(full(free))[:, 1:]),
        bounds=(of.lower[1:], of.upper[1:]),
        method="trf",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    return Outcome(found.x * of.scale[1:], found.njev, found.nfev, found.njev)


def slsqp(of: Weighted) -> Outcome:
    """Sequential least squares programming with exact first derivatives."""
    found = scipy.optimize.minimize(
        of.objective,
        of.start,
        jac=of.gradient,
        method="SLSQP",
        bounds=list(zip(of.lower, of.upper, strict=True)),
        constraints=[
            {"type": "eq", "fun": of.on_beam, "jac": of.on_beam_jacobian},
            {"type": "ineq", "fun": of.visible, "jac": of.visible_jacobian},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return Outcome(found.x[1:] * of.scale[1:], found.nit, found.nfev, found.njev)


def trust_constr(of: Weighted) -> Outcome:
    """Interior point with trust regions and exact second derivatives."""
    equation: Any = scipy.optimize.NonlinearConstraint(
        of.on_beam, 0, 0, jac=cast(Any, of.on_beam_jacobian), hess=lambda x, v: v[0] * of.on_beam_hessian(x)
    )
    inequality: Any = scipy.optimize.NonlinearConstraint(
        of.visible, 0, np.inf, jac=cast(Any, of.visible_jacobian), hess=cast(Any, of.visible_hessian)
    )
    with warnings.catch_warnings():
        # "delta_grad == 0.0": said of quasi-Newton updates that are not used here.
        warnings.simplefilter("ignore", UserWarning)
        found = scipy.optimize.minimize(
            of.objective,
            of.start,
            jac=of.gradient,
            hess=of.hessian,
            method="trust-constr",
            bounds=list(zip(of.lower, of.upper, strict=True)),
            constraints=[equation, inequality],
            options={"gtol": 1e-9, "xtol": 1e-12, "maxiter": 1000},
        )
    return Outcome(found.x[1:] * of.scale[1:], found.nit, found.nfev, found.njev)
