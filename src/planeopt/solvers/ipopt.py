"""IPOPT through CasADi: interior point, exact first and second derivatives."""

from dataclasses import dataclass

from planeopt.nlp import Nlp
from planeopt.solvers.base import Found, check_limits
from planeopt.solvers.plugin import Options, prepare, run


@dataclass(frozen=True)
class Ipopt:
    """IPOPT with its MUMPS linear solver.

    Parameters
    ----------
    tol : float
        IPOPT's scaled optimality tolerance.
    max_iter : int
        For each stage.
    record : bool
        Keep every iterate in the trace (a callback: some 40 % slower).
    """

    tol: float = 1e-8
    max_iter: int = 300
    record: bool = False

    def __post_init__(self) -> None:
        check_limits(self.tol, self.max_iter)

    @property
    def name(self) -> str:
        return "Ipopt"

    def prepare(self, nlp: Nlp) -> None:
        prepare(nlp, "ipopt", self._options)

    def solve(self, nlp: Nlp) -> Found:
        return run(nlp, "ipopt", self._options, record=self.record)

    @property
    def _options(self) -> Options:
        return (
            ("ipopt.print_level", 0),
            ("ipopt.sb", "yes"),
            ("ipopt.tol", self.tol),
            # Where rounding keeps it from tol (exact points), IPOPT may stop a hundred times looser, not the default's
            # ten thousand; Newton's method finishes, and our own check decides.
            ("ipopt.acceptable_tol", 100 * self.tol),
            ("ipopt.acceptable_iter", 3),
            # By default IPOPT moves every bound outwards by 1e-8 and may answer from there.
            ("ipopt.bound_relax_factor", 0.0),
            ("ipopt.max_iter", self.max_iter),
        )
