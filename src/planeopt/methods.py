"""Formulations and solvers by name, and the pairs of them that make sense."""

from collections.abc import Iterable, Iterator, Mapping
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
from planeopt.solvers import Ipopt, Penalised, Solver, Sqp, Swift

Choice = TypeVar("Choice")


@dataclass(frozen=True)
class Method:
    """A formulation with a solver for it; no solver for a direct answer or a refusal."""

    formulation: Formulation
    solver: Solver | None = None

    @property
    def name(self) -> str:
        """What tables call it."""
        return self.formulation.name if self.solver is None else f"{self.formulation.name} + {self.solver.name}"


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
    Method(Penalty(), Penalised()),
    Method(Penalty("image objective"), Swift()),
    Method(Penalty("image objective"), Penalised()),
    Method(ClosedForm()),
    Method(AsPrinted()),
)
"""The pairs that suit each other; the first is the default of `planeopt.solve`."""

FORMULATIONS: Mapping[str, Formulation] = {method.formulation.name: method.formulation for method in METHODS}
SOLVERS: Mapping[str, Solver] = {method.solver.name: method.solver for method in METHODS if method.solver is not None}


def _every() -> Iterator[Method]:
    for formulation in FORMULATIONS.values():
        fitting = [method for method in METHODS if method.formulation == formulation]
        if fitting[0].solver is None:
            yield fitting[0]
            continue
        yield from fitting
        others = [Method(formulation, solver) for solver in SOLVERS.values()]
        yield from (method for method in others if method not in fitting)


EVERY: tuple[Method, ...] = tuple(_every())
"""Every formulation with every solver, those that suit it first; what needs no solver once."""


def methods_named(names: Iterable[str]) -> tuple[Method, ...]:
    """Return the methods of these names: a pair ("LeastSquares + Sqp"), or a formulation with all that suit it.

    Raises
    ------
    InputError
        If there is no such name; lists those that there are.
    """
    found: dict[str, Method] = {}
    for name in names:
        formulation, plus, solver = name.partition("+")
        chosen = method_named(formulation, solver if plus else None)
        several = [chosen] if plus else [method for method in METHODS if method.formulation == chosen.formulation]
        found |= {method.name: method for method in several}
    return tuple(found.values())


def method_named(formulation: str | None, solver: str | None) -> Method:
    """Return the formulation and solver of these names, each with its usual partner where one is not given.

    Parameters
    ----------
    formulation, solver : str or None
        As records and tables write them; letters and digits alone count, capitals do not ("least-squares").

    Raises
    ------
    InputError
        If there is no such name; lists those that there are. If a solver is named where none is needed.
    """
    chosen = METHODS[0].formulation if formulation is None else _named("formulation", formulation, FORMULATIONS)
    if solver is not None:
        partner = _named("solver", solver, SOLVERS)
        if all(method.solver is None for method in METHODS if method.formulation == chosen):
            raise InputError(f"{chosen.name} needs no solver: leave {partner.name} out")
        return Method(chosen, partner)
    return next(method for method in METHODS if method.formulation == chosen)


def _named(what: str, name: str, known: Mapping[str, Choice]) -> Choice:
    for candidate, choice in known.items():
        if _bare(candidate) == _bare(name):
            return choice
    raise InputError(f"there is no {what} {name.strip()!r}; there are {', '.join(known)}")


def _bare(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum())
