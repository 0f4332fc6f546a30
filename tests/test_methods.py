"""Every formulation with every solver that the command line can combine: an answer or a reason, never a crash."""

import pytest

from planeopt.estimation import solve_problem
from planeopt.methods import FORMULATIONS, SOLVERS
from planeopt.solution import Status
from problems import noisy


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_every_pair_gives_an_answer_or_a_reason(formulation: str, solver: str) -> None:
    solution = solve_problem(noisy(0, n=40), formulation=FORMULATIONS[formulation], solver=SOLVERS[solver])
    assert solution.message.startswith(solution.status.value[:20]) or solution.status is Status.OVERDETERMINED
    assert (solution.pose is None) == (solution.status.record == "refused")
    if solution.ok:
        assert solution.pose is not None
        # The plane is that of the worked example to a hundredth of a millimetre, some hundred standard deviations.
        assert abs(solution.pose.z_L - 75) < 0.05
