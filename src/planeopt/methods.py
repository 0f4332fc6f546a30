"""Formulations and solvers by name, and the pairs of them that make sense."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from planeopt.errors import InputError
from planeopt.formulations import (
    AsPrinted,
    ClosedForm,
    Constrained,
    Elastic,
    Formulation,
    LeastSquares,
    Penalty,
    Reprojection,
)
from planeopt.solvers import Ipopt, Solver, Sqp, Swift

Choice = TypeVar("Choice")


@dataclass(frozen=True)
class Method:
    """A formulation with a solver for it; no solver for a direct answer or a refusal."""

    formulation: Formulation
    solver: Solver | None = None


METHODS: tuple[Method, ...] = (
    Method(Constrained(), Ipopt()),
    Method(Constrained(), Sqp()),
    Method(Constrained("paper"), Ipopt()),
    Method(Constrained("paper"), Sqp()),
    Method(Reprojection(), Ipopt()),
    Method(Reprojection(), Sqp()),
    Method(Elastic(), Ipopt()),
    Method(LeastSquares(), Ipopt()),
    Method(LeastSquares(), Sqp()),
    Method(Penalty(), Swift()),
    Method(Penalty("image objective"), Swift()),
    Method(ClosedForm()),
    Method(AsPrinted()),
)
"""What `planeopt.compare` compares; the first is the default of `planeopt.solve`."""

FORMULATIONS: Mapping[str, Formulation] = {method.formulation.name: method.formulation for method in METHODS}
SOLVERS: Mapping[str, Solver] = {method.solver.name: method.solver for method in METHODS if method.solver is not None}


def method_named(formulation: str | None, solver: str | None) -> Method:
    """Return the formulation and solver of these names, each with its usual partner where one is not given.

    Parameters
    ----------
    formulation, solver : str or None
        As records and tables write them; letters and digits alone count, capitals do not ("least-squares").

    Raises
    ------
    InputError
        If there is no such name; lists those that there are.
    """
    chosen = METHODS[0].formulation if formulation is None else _named("formulation", formulation, FORMULATIONS)
    if solver is not None:
        return Method(chosen, _named("solver", solver, SOLVERS))
    return next(method for method in METHODS if method.formulation == chosen)


def _named(what: str, name: str, known: Mapping[str, Choice]) -> Choice:
    for candidate, choice in known.items():
        if _bare(candidate) == _bare(name):
            return choice
    raise InputError(f"there is no {what} {name!r}; there are {', '.join(known)}")


def _bare(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum())
