"""SWIFT, the paper's method: a penalty with a rising weight, each stage searched by the Nelder-Mead simplex."""

import time
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.nlp import Nlp
from planeopt.solution import Effort, Status, Trace
from planeopt.solvers.base import NO_TRACE, Found, check_limits, check_weights, functions, path_trace
from planeopt.solvers.kkt import check

Array = NDArray[np.float64]

MOST_UNKNOWNS = 10
"""Most unknowns of a simplex search.

With more of them its steps turn away from the descent (Han and Neumann, *Effect of dimensionality on the Nelder-Mead
simplex method*, 2006): with the 24 of an L1 programme all evaluations are used up short of the minimum.
"""


@dataclass(frozen=True)
class Swift:
    """Minimise (29), ``J + weight * sum h^2``, for each weight in turn, from the last one's answer.

    The objective ``J`` and the constraints ``h`` are those of the programme; a violated inequality counts as an ``h``
    of its violation. Derivatives are never used. With ``J = 0`` (the paper's reading) one common weight cannot move
    the minimiser: raising it only tightens the tolerance.

    Parameters
    ----------
    weights : tuple of float
        The schedule, rising.
    tol : float
        Size of the simplex at a stage's end, in the programme's scaled unknowns.
    value_tol : float
        Largest difference of (29) over the simplex at a stage's end; infinite unless given, because what a difference
        means depends on the weight.
    max_evaluations : int
        For each stage.
    record : bool
        Keep the best vertex of every iteration in the trace.
    """

    weights: tuple[float, ...] = (1.0, 1e1, 1e2, 1e3, 1e4, 1e5)
    tol: float = 1e-9
    max_evaluations: int = 4000
    record: bool = False
    value_tol: float = np.inf

    def __post_init__(self) -> None:
        check_weights("Swift", self.weights)
        check_limits(self.tol, self.max_evaluations)
        if not self.value_tol > 0:
            raise InputError(f"Swift's value_tol must be positive, not {self.value_tol}")

    @property
    def name(self) -> str:
        return "Swift"

    def prepare(self, nlp: Nlp) -> None:
        if len(nlp.start) <= MOST_UNKNOWNS:
            functions(nlp.model.penalised)

    def solve(self, nlp: Nlp) -> Found:
        n = len(nlp.start)
        if n > MOST_UNKNOWNS:
            reason = f"a simplex search of {n} unknowns does not end at a minimum; its limit here is {MOST_UNKNOWNS}"
            return Found(
                nlp, nlp.start, "not called", check(nlp, nlp.start), Effort(), NO_TRACE, reason, Status.UNSUITED
            )
        begun = time.perf_counter()
        self.prepare(nlp)
        model = nlp.model.penalised
        # CasADi's buffered call: 0.5 us instead of 10 us, and a simplex search makes thousands.
        buffer, trigger = model.values.buffer()
        inputs = np.zeros(len(nlp.start)), np.append(nlp.parameters, 0.0)
        outputs = np.zeros(1), np.zeros(len(model.rows))
        for i, argument in enumerate(inputs):
            buffer.set_arg(i, argument.data)  # pyright: ignore[reportCallIssue] - the stub knows only raw pointers
        for i, result in enumerate(outputs):
            buffer.set_res(i, result.data)  # pyright: ignore[reportCallIssue] - likewise

        def value(scaled: Array) -> float:
            inputs[0][:] = scaled * nlp.x_scale
            trigger()
            violation = np.minimum(outputs[1], 0.0)
            total = float(outputs[0][0] + inputs[1][-1] * (violation @ violation))
            return total if np.isfinite(total) else np.inf

        limits = list(zip(nlp.lower / nlp.x_scale, nlp.upper / nlp.x_scale, strict=True))
        effort = Effort(build_s=time.perf_counter() - begun)
        scaled, paths, reports = nlp.start / nlp.x_scale, [], []
        for weight in self.weights:
            inputs[1][-1] = weight
            path: list[Array] = []
            begun = time.perf_counter()
            result = scipy.optimize.minimize(
                value,
                scaled,
                method="Nelder-Mead",
                bounds=limits,
                callback=path.append,
                options={"xatol": self.tol, "fatol": self.value_tol, "maxfev": self.max_evaluations},
            )
            scaled = result.x
            reports.append("converged" if result.success else "evaluations used up")
            effort += Effort(len(path), int(result.nfev), solve_s=time.perf_counter() - begun)
            paths.append(np.array(path).reshape(-1, len(scaled)) * nlp.x_scale)
        solved, x = nlp.penalised(self.weights[-1]), scaled * nlp.x_scale
        begun = time.perf_counter()
        found = check(solved, x)
        effort += Effort(solve_s=time.perf_counter() - begun)
        return Found(solved, x, ", ".join(reports), found, effort, self._trace(nlp, paths))

    def _trace(self, nlp: Nlp, paths: list[Array]) -> Trace:
        """Best vertex of every iteration; objective and largest violation as the unpenalised programme has them."""
        stage = np.repeat(np.arange(len(paths)), [len(path) for path in paths])
        return path_trace(nlp, nlp.parameters, np.concatenate(paths), stage, keep=self.record)
