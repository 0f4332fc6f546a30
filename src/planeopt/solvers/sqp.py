"""Sequential quadratic programming through CasADi: the fastest from a good start."""

from dataclasses import dataclass

from planeopt.nlp import Nlp
from planeopt.solvers.base import Found, check_limits
from planeopt.solvers.plugin import Options, prepare, run


@dataclass(frozen=True)
class Sqp:
    """CasADi's ``sqpmethod`` with the sparse active-set solver ``qrqp`` and exact Hessians.

    From the closed form it takes two to four steps. The Hessians are left as they are: made convex, they cost it its
    quadratic convergence (60 steps and more). From far away, or with data that contradict the rig, it may fail instead,
    which is then reported.

    Parameters
    ----------
    tol : float
        Primal and dual tolerance.
    max_iter : int
        For each stage.
    record : bool
        Keep every iterate in the trace (a callback: about twice as slow).
    """

    tol: float = 1e-8
    max_iter: int = 50
    record: bool = False

    def __post_init__(self) -> None:
        check_limits(self.tol, self.max_iter)

    @property
    def name(self) -> str:
        return "Sqp"

    def prepare(self, nlp: Nlp) -> None:
        prepare(nlp, "sqpmethod", self._options)

    def solve(self, nlp: Nlp) -> Found:
        return run(nlp, "sqpmethod", self._options, record=self.record)

    @property
    def _options(self) -> Options:
        return (
            ("print_header", False),
            ("print_iteration", False),
            ("print_status", False),
            ("error_on_fail", False),
            ("tol_pr", self.tol),
            ("tol_du", self.tol),
            ("max_iter", self.max_iter),
            ("qpsol", "qrqp"),
            ("qpsol_options.print_iter", False),
            ("qpsol_options.print_header", False),
            ("qpsol_options.print_info", False),
            ("qpsol_options.error_on_fail", False),
            # Without it a bound on which nothing presses but rounding begins the next step's search as active, and one
            # in eighty searches of spots that a slightly wrong rig sees ends there.
            ("qpsol_options.min_lam", self.tol),
        )
