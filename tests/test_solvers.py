"""Formulations by solvers: every pair converges to the right plane or says why not; both plug-ins behave."""

import logging
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from cases import WORKED, Array, random_case
from planeopt.errors import InputError
from planeopt.estimation import solve_problem
from planeopt.estimation.starts import from_closed_form
from planeopt.formulations import (
    AsPrinted,
    ClosedForm,
    Constrained,
    Elastic,
    Formulation,
    LeastSquares,
    Penalty,
    Problem,
    Reprojection,
)
from planeopt.nlp import Nlp
from planeopt.solution import Solution, Status
from planeopt.solvers import Ipopt, Solver, Sqp, Swift, plugin
from planeopt.spot import Spot
from problems import covariance_of, noisy, plane_of, start_at

EXACT_TWINS = [(Constrained(), Sqp()), (Constrained("paper"), Ipopt()), (Constrained("paper"), Sqp())]
LIKELIHOOD = [(Reprojection(), Ipopt()), (Reprojection(), Sqp())]
ONE_STAGE = Swift(weights=(1.0,))
INEFFICIENT = [
    (Elastic(), Ipopt()),
    (LeastSquares(), Ipopt()),
    (LeastSquares(), Sqp()),
    (LeastSquares(), ONE_STAGE),
    (Penalty(), ONE_STAGE),
    (Penalty("image objective"), Swift()),
    (ClosedForm(), Ipopt()),
]
MAY_FAIL = [(Elastic(), Sqp())]
"""An active-set search by quadratic models has trouble on the edges of a sum of absolute values."""
REFUSED = [
    (
        Penalty(),
        Ipopt(),
        "10 hard equations ((11), (12), (13), (14), (15), (17), (18), (19), (20), (21)) for 4 unknowns",
    ),
    (Penalty(), Sqp(), "10 hard equations"),
    (Penalty("image objective"), Ipopt(), "5 hard equations ((11), (12), (13), (14), (15)) for 4 unknowns"),
    (Penalty("image objective"), Sqp(), "5 hard equations"),
    (AsPrinted(), Ipopt(), "10 equations, 4 unknowns, laser block rank 1"),
    (AsPrinted(), Sqp(), "10 equations, 4 unknowns, laser block rank 1"),
    (AsPrinted(), Swift(), "10 equations, 4 unknowns, laser block rank 1"),
]
PLUGINS = [Ipopt(), Sqp()]


def name_of(value: object) -> str | None:
    return getattr(value, "name", None)


def programme(formulation: Formulation, problem: Problem) -> Nlp:
    nlp = formulation.build(problem, from_closed_form(problem))
    assert isinstance(nlp, Nlp)
    return nlp


def solved(problem: Problem, formulation: Formulation, solver: Solver) -> Solution:
    return solve_problem(problem, formulation=formulation, solver=solver)


def relative(plane: Array, reference: Array) -> float:
    """The largest difference relative to depth, and in slopes to 1 + tan^2(alpha)."""
    tilt = 1 + reference[1] ** 2 + reference[2] ** 2
    return float(np.max(np.abs(plane - reference) / [reference[0], tilt, tilt]))


# --- The matrix -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("formulation", "solver"), EXACT_TWINS, ids=name_of)
@pytest.mark.parametrize("seed", range(4))
def test_one_programme_has_one_answer_whoever_solves_it(formulation: Formulation, solver: Solver, seed: int) -> None:
    problem = noisy(seed)
    reference, solution = solved(problem, Constrained(), Ipopt()), solved(problem, formulation, solver)
    assert solution.ok, solution.message
    assert relative(plane_of(solution), plane_of(reference)) < 1e-8
    sigma = np.sqrt(np.diag(covariance_of(reference)))
    scaled = (covariance_of(solution) - covariance_of(reference)) / np.outer(sigma, sigma)
    assert np.max(np.abs(scaled)) < 1e-6
    assert solution.chi2 == pytest.approx(reference.chi2, rel=1e-6)


@pytest.mark.parametrize("solver", PLUGINS, ids=name_of)
@pytest.mark.parametrize("seed", range(4))
def test_maximum_likelihood_is_the_same_to_first_order(solver: Solver, seed: int) -> None:
    """`Constrained` linearises the ellipse's fit; what is left is of second order and vanishes with the noise."""
    distances = []
    for sigma in (0.0015, 0.00015):
        problem = noisy(seed, sigma=sigma)
        reference, solution = solved(problem, Constrained(), Ipopt()), solved(problem, Reprojection(), solver)
        assert solution.ok, solution.message
        difference = plane_of(solution) - plane_of(reference)
        distances.append(np.sqrt(difference @ np.linalg.solve(covariance_of(reference), difference)))
    # In sigmas the difference is proportional to the noise: a tenth of it, with half as much again for third order.
    assert distances[0] < 0.1
    assert distances[1] < 0.15 * distances[0]


@pytest.mark.parametrize(("formulation", "solver"), INEFFICIENT, ids=name_of)
@pytest.mark.parametrize("seed", range(4))
def test_an_inefficient_formulation_is_within_its_sigma(formulation: Formulation, solver: Solver, seed: int) -> None:
    problem = noisy(seed)
    reference, solution = solved(problem, Constrained(), Ipopt()), solved(problem, formulation, solver)
    assert solution.ok, solution.message
    # Its difference from the efficient estimate has the difference of the covariances (Hausman): 5 sigma of its own are
    # beyond 1e-6 for each component.
    own = covariance_of(solution)
    assert np.all(np.abs(plane_of(solution) - plane_of(reference)) < 5 * np.sqrt(np.diag(own)))
    # No unbiased estimate is better than the efficient one, in any direction.
    gain = np.linalg.eigvals(np.linalg.solve(covariance_of(reference), own))
    assert np.min(np.real(gain)) > 1 - 1e-2


def test_solvers_of_one_inefficient_formulation_agree() -> None:
    for seed in range(4):
        problem = noisy(seed)
        newton = plane_of(solved(problem, LeastSquares(), Ipopt()))
        assert relative(plane_of(solved(problem, LeastSquares(), Sqp())), newton) < 1e-8
        # A simplex compares values: it cannot tell planes apart whose sums of squares differ by less than rounding,
        # which is the square root of it in the unknowns.
        sigma = np.sqrt(np.diag(covariance_of(solved(problem, LeastSquares(), Ipopt()))))
        for formulation in (LeastSquares(), Penalty()):
            assert np.all(np.abs(plane_of(solved(problem, formulation, Swift())) - newton) < 1e-3 * sigma)


@pytest.mark.parametrize(("formulation", "solver", "words"), REFUSED, ids=name_of)
def test_a_pair_that_cannot_work_is_refused_with_its_sentence(
    formulation: Formulation, solver: Solver, words: str
) -> None:
    solution = solved(noisy(1), formulation, solver)
    assert solution.status is Status.OVERDETERMINED
    assert solution.status.record == "refused"
    assert words in solution.message
    assert "laser block rank 1" in solution.message
    assert solution.pose is None
    assert solution.covariance is None
    assert solution.effort.evaluations == 0


def test_reprojection_without_points_is_refused() -> None:
    problem = replace(noisy(1), points=None, noise=None)
    solution = solved(problem, Reprojection(), Ipopt())
    assert solution.status.record == "refused"
    assert "needs the boundary points" in solution.message


def test_random_rigs_and_planes_converge_to_one_plane_or_are_refused_with_a_reason() -> None:
    rng = np.random.default_rng(42)
    for i in range(8):
        case = random_case(rng, n=100, kind=["any", "any", "on the beam", "on the axis"][i % 4])
        spot = Spot(case.pixels + 0.02 * rng.standard_normal(case.pixels.shape), np.full(100, 0.02))
        problem = Problem.from_spot(spot, case.rig)
        reference = solved(problem, Constrained(), Ipopt())
        assert reference.ok, (i, reference.message)
        covariance = covariance_of(reference)
        for formulation, solver in [
            *EXACT_TWINS,
            *((Reprojection(), solver) for solver in PLUGINS),
            *INEFFICIENT,
            *MAY_FAIL,
        ]:
            solution = solved(problem, formulation, solver)
            where = (i, formulation.name, solver.name, solution.message)
            if solution.status.record == "refused":
                # Poor formulations may fail on hard cases, the default one not; they must say so.
                assert (formulation, solver) not in (EXACT_TWINS[0], LIKELIHOOD[0]), where
                assert solution.message.startswith(solution.status.value), where
                assert solution.pose is None
                continue
            if not solution.ok:
                continue
            difference = plane_of(solution) - plane_of(reference)
            if (formulation, solver) in EXACT_TWINS:
                assert relative(plane_of(solution), plane_of(reference)) < 1e-8, where
            elif formulation == Reprojection():
                # Second order: the small ellipses of this range have a curvature of 0.1 a sigma at this noise.
                assert difference @ np.linalg.solve(covariance, difference) < 0.1**2, where
            else:
                assert np.all(np.abs(difference) < 6 * np.sqrt(np.diag(covariance_of(solution)))), where


# --- Both plug-ins ----------------------------------------------------------------------------------------------------


def test_too_many_equalities_are_refused_before_the_solver_which_would_have_answered_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nlp = programme(Penalty(), noisy(1))
    monkeypatch.setattr(plugin, "compiled", lambda *_: pytest.fail("the solver was called"))
    for solver in PLUGINS:
        found = solver.solve(nlp)
        assert found.refused is not None
        assert found.effort.evaluations == 0
        np.testing.assert_array_equal(found.x, nlp.start)
    # What CasADi says instead: no exception, the start as the answer, and all rows zero, as if it were feasible.
    model = nlp.model
    symbols = {"x": model.x, "p": model.p, "f": model.objective, "g": model.constraints}
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    function = ca.nlpsol("as_printed", "ipopt", symbols, quiet)
    lower, upper = nlp.row_bounds
    start = nlp.start * 1.1
    answer = function(x0=start, p=nlp.parameters, lbx=nlp.lower, ubx=nlp.upper, lbg=lower, ubg=upper)
    assert function.stats()["return_status"] == "Not_Enough_Degrees_Of_Freedom"
    np.testing.assert_array_equal(np.asarray(answer["x"]).ravel(), start)
    assert not np.any(np.asarray(answer["g"]))
    truly = np.asarray(model.values(start, nlp.parameters)[1]).ravel()
    assert np.max(np.abs(truly[model.equalities])) > 1


@pytest.mark.parametrize("solver", PLUGINS, ids=name_of)
def test_functions_are_built_once(solver: Solver, monkeypatch: pytest.MonkeyPatch) -> None:
    first = solver.solve(programme(Constrained(), noisy(1)))
    assert first.kkt.ok
    monkeypatch.setattr(ca, "nlpsol", lambda *_: pytest.fail("built again"))
    for seed in (2, 3):
        assert solver.solve(programme(Constrained(), noisy(seed))).kkt.ok


def test_compiled_returns_the_same_object_for_a_model_a_plugin_and_options() -> None:
    model = programme(LeastSquares(), noisy(1)).model
    options = (("ipopt.print_level", 0), ("ipopt.sb", "yes"))
    assert plugin.compiled(model, "ipopt", options) is plugin.compiled(model, "ipopt", options)
    assert plugin.compiled(model, "ipopt", options) is not plugin.compiled(
        model, "ipopt", (*options, ("ipopt.tol", 1e-9))
    )


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [*((f, s) for f in (Constrained(), Reprojection(), Elastic()) for s in PLUGINS), (Penalty(), Swift())],
    ids=name_of,
)
def test_the_same_input_gives_the_same_bytes(formulation: Formulation, solver: Solver) -> None:
    def bytes_of(solution: Solution) -> bytes:
        # Times differ from run to run, all else does not.
        effort = replace(solution.effort, build_s=0.0, solve_s=0.0)
        return pickle.dumps(replace(solution, effort=effort))

    once, again = (bytes_of(solved(noisy(1), formulation, solver)) for _ in range(2))
    solved(noisy(2), formulation, solver)
    assert once == again == bytes_of(solved(noisy(1), formulation, solver))


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [*((f, s) for f in (Constrained(), Reprojection()) for s in PLUGINS), (Elastic(), Ipopt()), (Penalty(), Swift())],
    ids=name_of,
)
def test_threads_give_what_one_thread_gives(formulation: Formulation, solver: Solver) -> None:
    problems = [noisy(seed, n=50) for seed in range(12)]

    def summary(problem: Problem) -> tuple[bytes, bytes, int, int]:
        solution = solved(problem, formulation, solver)
        effort = solution.effort
        return plane_of(solution).tobytes(), covariance_of(solution).tobytes(), effort.iterations, effort.evaluations

    with ThreadPoolExecutor(4) as executor:
        together = list(executor.map(summary, problems))
    assert together == [summary(problem) for problem in problems]


@pytest.mark.parametrize("solver", [*PLUGINS, Swift()], ids=name_of)
def test_nothing_is_printed_even_where_it_fails(solver: Solver, capfd: pytest.CaptureFixture[str]) -> None:
    problem = noisy(1)
    outlier = replace(problem, B=problem.B * [1, 1, 1, 1.5, 1])
    formulation = Penalty() if solver.name == "Swift" else Constrained()
    for case in (problem, outlier):
        for start in (None, (10.0, 250.0, 0.35, 0.35), (100.0, 5000.0, 1.4, 2.0)):
            solve_problem(case, formulation=formulation, solver=solver, start=start)
    recorder = replace(solver, record=True)  # type: ignore[type-var] - each of them is a dataclass
    solve_problem(problem, formulation=formulation, solver=recorder)
    assert capfd.readouterr() == ("", "")


def test_what_a_solver_said_goes_to_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, logger="planeopt"):
        solve_problem(noisy(1))
    assert any("Solve_Succeeded" in record.message for record in caplog.records)


@pytest.mark.parametrize("solver", [Ipopt(record=True), Sqp(record=True)], ids=name_of)
@pytest.mark.parametrize("formulation", [Constrained(), Constrained("paper"), Reprojection()], ids=name_of)
def test_recorded_iterates_lead_from_the_start_to_the_solution(formulation: Formulation, solver: Solver) -> None:
    nlp = programme(formulation, noisy(1, n=40))
    found = solver.solve(nlp)
    path = found.trace.x
    assert path is not None
    assert len(path) == len(found.trace.objective) == len(found.trace.infeasibility) == len(found.trace.stage)
    np.testing.assert_allclose(path[0], nlp.start, rtol=1e-2, atol=1e-2)
    # The last iterate is the solver's own; Newton's last steps take it home from within its tolerance.
    assert relative(nlp.plane(path[-1]), nlp.plane(found.x)) < 1e-6
    assert found.trace.objective[-1] == pytest.approx(float(nlp.model.values(path[-1], nlp.parameters)[0]), rel=1e-6)
    plain = replace(solver, record=False).solve(nlp)  # type: ignore[type-var] - each of them is a dataclass
    np.testing.assert_array_equal(plain.x, found.x)
    assert plain.trace.x is None


@pytest.mark.parametrize("solver", [Ipopt(record=True), Sqp(record=True)], ids=name_of)
def test_a_cold_start_records_both_stages(solver: Solver) -> None:
    nlp = Constrained().build(noisy(1), start_at(WORKED._replace(z_L=80.0), cold=True))
    found = solver.solve(nlp)
    assert found.trace.x is not None
    assert set(found.trace.stage) == {0, 1}
    assert np.all(np.diff(found.trace.stage) >= 0)
    assert " then " in found.report
    # The second stage begins where the first one ended, but for the step back from the bounds that IPOPT takes.
    first_of_second = int(np.argmax(found.trace.stage))
    before, after = (nlp.plane(found.trace.x[i]) for i in (first_of_second - 1, first_of_second))
    assert relative(after, before) < 1e-2


@pytest.mark.parametrize(
    "make",
    [
        lambda: Ipopt(tol=0.0),
        lambda: Ipopt(tol=-1.0),
        lambda: Ipopt(max_iter=0),
        lambda: Sqp(tol=float("nan")),
        lambda: Sqp(max_iter=-1),
        lambda: Swift(tol=2.0),
        lambda: Swift(max_evaluations=0),
    ],
)
def test_impossible_limits_are_refused_in_one_line(make: Callable[[], Any]) -> None:
    with pytest.raises(InputError) as refusal:
        make()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("solver", [Ipopt(max_iter=1), Sqp(max_iter=1)], ids=name_of)
def test_too_small_a_budget_is_a_refusal_not_an_answer(solver: Solver) -> None:
    solution = solve_problem(noisy(1), solver=solver, start=(10.0, 250.0, 0.35, 0.35), restart=False)
    assert solution.status.record == "refused"
    assert "Maximum_Iterations_Exceeded" in solution.message
    assert solution.pose is None
