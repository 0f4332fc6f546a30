"""What a solver is: any `Nlp` in, `Found` out. The only room that talks to CasADi's solver plug-ins."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.nlp import Model, Nlp
from planeopt.solution import Effort, KktCheck, Status, Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """Where a search ended.

    Attributes
    ----------
    nlp : Nlp
        The programme that ``x`` answers: the one given, or its penalised form.
    x : (n_x,)
        The last iterate, whether or not it is a solution.
    report : str
        The solver's own words; never the reason to believe it.
    kkt : KktCheck
        Recomputed here.
    effort : Effort
    trace : Trace
    refused : str or None
        Why the solver was not called.
    refusal : Status
        What that makes of the solution.
    """

    nlp: Nlp
    x: Array
    report: str
    kkt: KktCheck
    effort: Effort
    trace: Trace
    refused: str | None = None
    refusal: Status = Status.OVERDETERMINED


class Solver(Protocol):
    """Takes any `Nlp`."""

    @property
    def name(self) -> str:
        """What tables and records call it."""
        ...

    def prepare(self, nlp: Nlp) -> None:
        """Make what a search of this model needs and what checks its answer; nothing where that is there already."""
        ...

    def solve(self, nlp: Nlp) -> Found:
        """Search from ``nlp.start`` through its stages; never raises for a search that fails."""
        ...


def check_limits(tol: float, max_iter: int) -> None:
    """Refuse a tolerance or a budget that no search could work with.

    Raises
    ------
    InputError
        If ``tol`` is not between 0 and 1 or ``max_iter`` not positive.
    """
    if not 0 < tol < 1:
        raise InputError(f"a solver's tol must be between 0 and 1, not {tol}")
    if max_iter < 1:
        raise InputError(f"a solver's budget must be at least 1, not {max_iter}")


def check_weights(solver: str, weights: tuple[float, ...]) -> None:
    """Refuse a penalty's schedule that does not rise.

    Raises
    ------
    InputError
        If the weights are not positive, finite and rising.
    """
    try:
        values = np.asarray(weights, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{solver}'s weights must be numbers, not {weights!r}") from error
    rising = values.ndim == 1 and len(values) > 0 and np.isfinite(values).all()
    if not rising or values[0] <= 0 or np.any(np.diff(values) <= 0):
        raise InputError(f"{solver}'s weights must be positive, finite and rising, not {weights}")


def too_many_equalities(nlp: Nlp) -> str | None:
    """Why hard equalities outnumber the unknowns, in words; None where they do not.

    Refusing before the call matters: CasADi does not raise on IPOPT's Not_Enough_Degrees_Of_Freedom but returns the
    start with all rows zero.
    """
    equalities = [row.equation.number for row in nlp.model.rows if row.equality]
    n = len(nlp.start)
    if len(equalities) <= n:
        return None
    listed = ", ".join(f"({number})" for number in equalities)
    return f"{len(equalities)} hard equations ({listed}) for {n} unknowns: more equations than unknowns"


def functions(model: Model) -> None:
    """Make the functions that check an answer and give its covariance; they stay with the model."""
    for name in ("values", "first_order", "hessian", "data_adjoint", "plane_and_jacobian"):
        getattr(model, name)


def path_trace(nlp: Nlp, parameters: Array, path: Array, stage: NDArray[np.integer], *, keep: bool) -> Trace:
    """Objective and largest violation along iterates (n, n_x), evaluated again; the iterates themselves if kept."""
    if not len(path):
        return NO_TRACE
    f, g = nlp.model.values.map(len(path))(path.T, parameters)
    rows, equalities = np.asarray(g), nlp.model.equalities[:, None]
    violation = np.where(equalities, np.abs(rows), np.maximum(-rows, 0.0)).max(axis=0)
    return Trace(np.asarray(f).ravel(), violation, stage, path if keep else None)


NO_TRACE = Trace(np.empty(0), np.empty(0), np.empty(0, dtype=int))
