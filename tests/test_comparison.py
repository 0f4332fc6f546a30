"""Comparisons: every pair has its row, what they share is shared, and what is said of them is so."""

import inspect
import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import scipy.stats

from example_rig import example_rig, pose_at, seen, spot_of
from planeopt import equations as eq
from planeopt.accuracy import Score, Truth
from planeopt.comparison import (
    Comparison,
    InBound,
    Pooled,
    Root,
    compare,
    compare_problem,
    nearest_root,
)
from planeopt.comparison.rows import EFFORT
from planeopt.comparison.simulated import boundary, simulated_spot, worked_example
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.formulations import ClosedForm, Constrained, EitherSide, LeastSquares, Problem
from planeopt.methods import EVERY, FORMULATIONS, METHODS, SOLVERS, Method, methods_named
from planeopt.nlp import Nlp
from planeopt.plane import SpotPose
from planeopt.solution import Status
from planeopt.solvers import Found, Sqp, Swift
from planeopt.spot import Spot
from problems import noisy

TRUE_POSE = pose_at()
SQP = (Method(Constrained(), Sqp()), Method(LeastSquares(), Sqp()), Method(ClosedForm()))
DRAWS = 40


def truth() -> Truth:
    return Truth(TRUE_POSE, example_rig().plane_from_pose(TRUE_POSE))


def _cut_short(method: Method) -> Method:
    """A simplex search of nine unknowns, which fails in any case, with fewer evaluations."""
    slow = isinstance(method.solver, Swift) and isinstance(method.formulation, Constrained)
    return replace(method, solver=Swift(max_evaluations=100)) if slow else method


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(spot_of(TRUE_POSE), example_rig(), truth=truth(), methods=[_cut_short(method) for method in EVERY])


@pytest.fixture(scope="module")
def many() -> Comparison:
    """Draws of the paper's example."""
    rig, pose = worked_example()
    spots = [simulated_spot(rig, pose, n=60, noise_px=0.3, seed=(7, i)) for i in range(DRAWS)]
    return compare(spots, rig, truth=Truth(pose, rig.plane_from_pose(pose)), methods=[SQP[0], SQP[2]])


def rows_of(comparison: Comparison) -> dict[str, Any]:
    return {row.method: row for row in comparison.rows}


# --- The table is complete --------------------------------------------------------------------------------------------


def test_every_formulation_has_a_row_with_every_solver_once(comparison: Comparison):
    assert inspect.signature(compare).parameters["methods"].default is EVERY
    assert [row.method for row in comparison.rows] == [method.name for method in EVERY]
    direct = {"ClosedForm", "AsPrinted"}
    pairs = {(f, s) for f in FORMULATIONS if f not in direct for s in SOLVERS} | {(f, "none") for f in direct}
    found = [(method.formulation.name, "none" if method.solver is None else method.solver.name) for method in EVERY]
    assert set(found) == pairs
    assert len(found) == len(pairs)
    assert set(METHODS) <= set(EVERY)


def test_pairs_that_suit_find_the_visible_plane_from_the_closed_form(comparison: Comparison):
    rows = rows_of(comparison)
    for method in METHODS[:-1]:
        row = rows[method.name]
        assert row.root is Root.VISIBLE, method.name
        assert row.solution.effort.evaluations > 0 or method.solver is None


def test_pairs_that_do_not_suit_say_why(comparison: Comparison):
    for row in comparison.rows:
        if row.solution.status in (Status.UNSUITED, Status.OVERDETERMINED):
            assert row.root is None
            assert row.error is row.error_in_bound is row.from_closed_form is None
            assert not row.residuals
            assert (row.build_s, row.solve_s) == (0, 0)
            assert row.took is None
            assert {row.to_dict()[key] for key in EFFORT} == {None}
    messages = {row.method: row.solution.message for row in comparison.rows}
    assert "10 equations, 4 unknowns, laser block rank 1" in messages["AsPrinted"]
    assert "63 unknowns" in messages["Reprojection + Swift"]
    assert "no equation to penalise" in messages["LeastSquares + Ipopt(penalty)"]
    assert "6 equations for 9 unknowns" in messages["Constrained + Ipopt(penalty)"]
    assert "10 hard equations" in messages["Penalty + Ipopt"]
    # Medians are over searches: nothing in place of zeros, which would read as for nothing.
    medians = {entry.method: (entry.evaluations, entry.total_ms) for entry in comparison.summary}
    assert medians["AsPrinted"] == (None, None)
    assert None not in medians["Constrained + Ipopt"]


def test_rows_are_json_with_the_residual_of_each_equation(comparison: Comparison):
    rows = json.loads(json.dumps(comparison.to_dicts(), allow_nan=False))
    assert len({tuple(row) for row in rows}) == 1
    equations = [f"({number})" for number in (11, 12, 13, 14, 15, 17, 18, 19, 20, 21)]
    assert [name.split()[0] for name in rows[0]["residuals"]] == equations
    # The laser block is hard in Constrained: it holds to rounding of its own terms, R^2 and r^2 among them.
    assert all(abs(value) < 1e-6 for name, value in rows[0]["residuals"].items() if name[:4] <= "(15)")


def test_a_solver_that_breaks_down_costs_its_row():
    @dataclass(frozen=True)
    class Broken:
        name: str = "Broken"

        def prepare(self, nlp: Nlp) -> None:
            pass

        def solve(self, nlp: Nlp) -> Found:
            raise RuntimeError(f"out of\norder with {nlp.model.name}")

    case = compare_problem(noisy(1, n=20), [Method(Constrained(), Broken()), Method(ClosedForm())])
    assert [row.ok for row in case.rows] == [False, True]
    assert "RuntimeError: out of order with constrained_slopes" in case.rows[0].solution.message


# --- What they find ---------------------------------------------------------------------------------------------------


def test_maximum_likelihood_methods_agree_far_within_the_noise(comparison: Comparison):
    names = ("Constrained", "Constrained(paper)", "Reprojection")
    answers = [row for row in comparison.rows if row.formulation in names and row.ok]
    sigma = comparison.rows[0].solution.sigma
    assert sigma is not None
    # They are equal to first order in the noise; what is left is its square, and the solvers' tolerance.
    assert len(answers) >= 6
    assert np.ptp([row.solution.pose.z_L for row in answers if row.solution.pose]) < 0.01 * sigma.z_L


def test_a_penalty_without_objective_has_the_minimiser_of_least_squares(comparison: Comparison):
    rows = rows_of(comparison)
    least = rows["LeastSquares + Sqp"].error_in_bound
    for name in ("LeastSquares + Ipopt", "LeastSquares + Swift", "Penalty + Swift", "Penalty + Ipopt(penalty)"):
        other = rows[name].error_in_bound
        # A simplex compares rounded sums of squares: of the minimiser it sees half the digits.
        assert abs(other.mahalanobis - least.mahalanobis) < 1e-3, name


def test_errors_against_the_truth_are_within_five_sigmas(comparison: Comparison):
    for row in comparison.rows:
        sigma = row.solution.sigma
        if sigma is not None:
            assert row.error is not None
            assert abs(row.error.depth) < 5 * sigma.z_L, row.method
            assert row.error.normal < 5 * sigma.normal, row.method


def test_closed_form_is_no_distance_from_itself(comparison: Comparison):
    row = rows_of(comparison)["ClosedForm"]
    assert row.from_closed_form is not None
    assert (row.from_closed_form.depth, row.from_closed_form.normal) == (0.0, 0.0)
    assert row.from_closed_form_in_bound.mahalanobis == 0.0


def test_residuals_are_those_of_the_search_s_own_unknowns():
    """Where the beam is believed too wide, unweighted least squares puts the spot off the beam: (15) says so."""
    problem = noisy(1, n=40)
    problem = replace(problem, setup=problem.setup._replace(r=1.5 * problem.setup.r))
    (row,) = compare_problem(problem, [Method(LeastSquares(), Sqp())]).rows
    end = row.solution.end
    assert end is not None
    v = eq.PaperVariables(end.R, end.z_L, math.atan(math.hypot(end.p, end.q)), math.atan2(-end.p, end.q))
    assert [r.value for r in row.residuals] == eq.ten_residuals(np, v, problem.setup, problem.B.tolist())
    assert abs(end.R * math.cos(v.alpha) - problem.setup.r) > 1e-6


def test_a_refused_search_says_near_which_plane_it_ended():
    rig, pose = worked_example()
    spot = simulated_spot(rig, pose, n=60, noise_px=0.1, seed=1)
    second = solve(spot, rig, formulation=ClosedForm()).other_plane
    assert second is not None
    methods = [Method(EitherSide(Constrained()), Sqp())]
    (row,) = compare(spot, rig, methods=methods, start=second.pose).rows
    assert row.solution.status is Status.UNSEEN
    assert row.root is Root.OTHER
    assert row.error is row.from_closed_form is None


def test_the_second_plane_is_called_the_second_plane():
    spot, rig = spot_of(TRUE_POSE), example_rig()
    direct = solve(spot, rig, formulation=ClosedForm())
    assert direct.pose is not None
    assert direct.plane is not None
    other = direct.other_plane
    assert other is not None
    assert nearest_root(other.pose, other.plane, direct) is Root.OTHER
    assert nearest_root(direct.pose, direct.plane, direct) is Root.VISIBLE
    nowhere = SpotPose.canonical(direct.pose.R, 2 * direct.pose.z_L, direct.pose.alpha, direct.pose.beta)
    assert nearest_root(nowhere, rig.plane_from_pose(nowhere), direct) is Root.ELSEWHERE


# --- The bound --------------------------------------------------------------------------------------------------------


def test_the_bound_is_the_inverse_of_the_information_by_finite_differences():
    """How the boundary moves across itself per unit of the plane, from nothing but the rig's own projection."""
    rig = example_rig()
    noise, n = 1e-3, 80
    spot = simulated_spot(rig, TRUE_POSE, n=n, noise_px=noise, seed=3)
    case = compare(spot, rig, truth=truth(), methods=[Method(ClosedForm())]).cases[0]
    radius = rig.require_beam().radius

    def pixels(plane: np.ndarray, count: int) -> np.ndarray:
        z_L, p, q = plane.tolist()
        return boundary(rig, SpotPose.from_slopes(z_L, p, q, radius), count)

    at = np.array([TRUE_POSE.z_L, *TRUE_POSE.slopes])
    steps = np.diag([1e-3, 1e-5, 1e-5])
    moved = np.stack([(pixels(at + s, n) - pixels(at - s, n)) / (2 * s.sum()) for s in steps])
    # Every third place of three times as many is one of these; its neighbours tell the direction along the boundary.
    along = np.roll(pixels(at, 3 * n), -1, axis=0) - np.roll(pixels(at, 3 * n), 1, axis=0)
    along = along[1::3] / np.linalg.norm(along[1::3], axis=1)[:, None]
    across = np.einsum("kni,ni->kn", moved, np.stack([along[:, 1], -along[:, 0]], axis=1)) / noise
    expected = np.linalg.inv(across @ across.T)
    size = np.sqrt(np.diag(expected))
    assert case.bound is not None
    # Neighbours are 1.5 degrees off: the chord's direction is right to 3e-4, the noisy points' places to 1e-5.
    np.testing.assert_allclose(case.bound / np.outer(size, size), expected / np.outer(size, size), atol=2e-3)
    assert case.reachable


def test_differences_are_measured_by_the_bound():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3)) * np.array([[1.0], [1e-3], [1e-4]])
    bound, difference = root @ root.T, rng.normal(size=3) * [1.0, 1e-3, 1e-4]
    found = InBound.of(difference, bound)
    assert found.mahalanobis**2 == pytest.approx(difference @ np.linalg.inv(bound) @ difference, rel=1e-9)
    assert found.p == pytest.approx(difference[1] / math.sqrt(bound[1, 1]), rel=1e-12)


def test_without_points_or_noise_there_is_no_bound():
    problem = noisy(1, n=20)
    conic = Problem.from_conic(problem.B, problem.B_factor @ problem.B_factor.T, problem.setup)
    case = compare_problem(conic, SQP)
    assert (case.bound, case.reachable) == (None, None)
    assert all(row.from_closed_form_in_bound is None and row.ok for row in case.rows)
    five = compare(Spot(points=seen(TRUE_POSE, 5)), example_rig(), methods=SQP).cases[0]
    assert five.bound is None


# --- Many problems ----------------------------------------------------------------------------------------------------


def test_pooled_errors_of_maximum_likelihood_are_the_bound(many: Comparison):
    constrained, closed = many.summary
    assert constrained.statuses == {"ok": DRAWS, "degraded": 0, "refused": 0}
    assert constrained.roots["visible"] == DRAWS
    assert constrained.error is not None
    # A mean of chi-squared with 3 degrees of freedom, over 3: four of its standard deviations, halved by the root.
    assert constrained.error.rms == pytest.approx(1.0, abs=4 * math.sqrt(2 / 3 / DRAWS) / 2)
    assert constrained.error.monte_carlo == pytest.approx(math.sqrt(2 / 3 / DRAWS) / 2, rel=0.6)
    assert closed.error is not None
    assert closed.error.rms > constrained.error.rms
    assert closed.from_closed_form is not None
    assert closed.from_closed_form.rms == 0


def test_a_summary_is_made_of_its_rows(many: Comparison):
    rows = [row for row in many.rows if row.method == "Constrained + Sqp"]
    summary = many.summary[0]
    squares = [row.error_in_bound.mahalanobis**2 / 3 for row in rows if row.error_in_bound]
    assert summary.error is not None
    assert summary.error.rms == pytest.approx(math.sqrt(np.mean(squares)), rel=1e-12)
    assert summary.evaluations == np.median([row.solution.effort.evaluations for row in rows])
    image = [r.value for row in rows for r in row.residuals if r.equation == "(21)"]
    assert summary.residuals["(21) mm^2"] == pytest.approx(np.sqrt(np.mean(np.square(image))), rel=1e-12)
    assert Pooled.of([]) is None
    one = Pooled.of([row.error_in_bound for row in rows[:1] if row.error_in_bound])
    assert one is not None
    assert one.median == pytest.approx(one.rms * math.sqrt(3 / scipy.stats.chi2.median(3)), rel=1e-12)


def test_one_bad_spot_costs_itself_and_an_executor_changes_nothing_but_times():
    rig = example_rig()
    spots = [spot_of(TRUE_POSE, seed=1), Spot(points=np.arange(20.0).reshape(10, 2)), spot_of(TRUE_POSE, seed=2)]
    truths = [truth(), None, None]
    alone = compare(spots, rig, truth=truths, methods=SQP, names=["a", "b", "c"])
    assert [len(case.rows) for case in alone.cases] == [3, 0, 3]
    assert alone.cases[1].message is not None
    assert [case.truth is None for case in alone.cases] == [False, True, True]
    assert alone.summary[0].problems == 2
    with ThreadPoolExecutor(1) as pool:
        there = compare(spots, rig, truth=truths, methods=SQP, names=["a", "b", "c"], executor=pool)
    assert _timeless(there) == _timeless(alone)
    with pytest.raises(InputError):
        compare(spots[1], rig)


def _timeless(comparison: Comparison) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key[-3:] != "_ms"} for row in comparison.to_dicts()]


def test_coverage_of_the_reported_depth_sigma(many: Comparison):
    rig, pose = worked_example()
    true = Truth(pose, rig.plane_from_pose(pose))
    scores = [Score.of(case.name, case.rows[0].solution, true) for case in many.cases]
    standardised = [score.depth_sigmas or 0.0 for score in scores if score is not None]
    assert len(standardised) == DRAWS
    # The mean of the squared standardised error of independent draws has the deviation sqrt(2/n); four of them.
    assert np.mean(np.square(standardised)) == pytest.approx(1.0, abs=4 * math.sqrt(2 / DRAWS))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"problems": []}, "empty"),
        ({"methods": ()}, "empty"),
        ({"truth": [None, None]}, "go together"),
        ({"repeats": 0}, "at least 1"),
        ({"rig": None}, "need the rig"),
        ({"start": (1.0, 2.0)}, "four finite numbers"),
    ],
)
def test_what_cannot_be_compared_is_refused(wrong: dict[str, Any], words: str):
    given: dict[str, Any] = {"problems": spot_of(TRUE_POSE), "rig": example_rig(), "methods": SQP} | wrong
    with pytest.raises(InputError, match=words):
        compare(given.pop("problems"), given.pop("rig"), **given)


def test_methods_by_name():
    assert [method.name for method in methods_named(["least-squares", "penalty + sqp", "LeastSquares+Sqp"])] == [
        "LeastSquares + Ipopt",
        "LeastSquares + Sqp",
        "Penalty + Sqp",
    ]
    with pytest.raises(InputError, match="there is no solver 'Newton'"):
        methods_named(["LeastSquares + Newton"])
