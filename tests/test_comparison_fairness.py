"""Comparisons: all searches begin alike, within the same bounds, and are counted and timed alike."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from example_rig import example_rig, spot_of
from planeopt.comparison import Root, compare, compare_problem
from planeopt.estimation.starts import from_closed_form
from planeopt.formulations import Constrained, Elastic, LeastSquares
from planeopt.formulations.bounds import FARTHEST, STEEPEST
from planeopt.methods import FORMULATIONS, Method
from planeopt.nlp import Nlp
from planeopt.solvers import Found, Ipopt, Penalised, Solver, Sqp, plugin
from problems import noisy
from test_comparison import TRUE_POSE

PAPERS_START = (10.0, 250.0, math.radians(20), math.radians(20))


@dataclass(frozen=True)
class Spy:
    """A solver that keeps what it is given."""

    solver: Solver
    seen: list[Nlp] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.solver.name

    def prepare(self, nlp: Nlp) -> None:
        self.solver.prepare(nlp)

    def solve(self, nlp: Nlp) -> Found:
        self.seen.append(nlp)
        return self.solver.solve(nlp)


@pytest.mark.parametrize("start", [None, PAPERS_START])
def test_all_searches_begin_at_one_plane_within_the_same_bounds_and_scales(start: tuple[float, ...] | None):
    problem = noisy(1, n=20)
    # A gross error in B_3: alone, Elastic would begin from the best plane of the other four.
    problem = replace(problem, B=problem.B + np.array([0, 0, 0.3, 0, 0]))
    spies = [Spy(Penalised()) for _ in FORMULATIONS]
    methods = [Method(f, spy) for f, spy in zip(FORMULATIONS.values(), spies, strict=True)]
    case = compare_problem(problem, methods, start=start, builds=False)
    assert case.start is not None
    R, z_L, r = case.start.R, case.start.plane[0], problem.setup.r
    programmes = [nlp for spy in spies for nlp in spy.seen]
    assert len(programmes) == len(FORMULATIONS) - 2
    for nlp in programmes:
        name = nlp.model.name
        np.testing.assert_allclose(nlp.plane(nlp.start), case.start.plane, rtol=1e-12, err_msg=name)
        if "R" not in nlp.model.variables:
            continue
        assert nlp.model.variables[:2] == ("R", "z_L")
        assert nlp.start[0] == R, name
        np.testing.assert_array_equal(nlp.x_scale[:4], [r, z_L, 1, 1], err_msg=name)
        np.testing.assert_array_equal(nlp.lower[:2], [0, 0], err_msg=name)
        np.testing.assert_allclose(nlp.upper[:2], [r / np.cos(STEEPEST), FARTHEST * r], err_msg=name)
        tilt = nlp.upper[2] if "alpha" in nlp.model.variables else np.arctan(nlp.upper[2])
        assert tilt == pytest.approx(STEEPEST, rel=1e-12), name


@pytest.mark.parametrize(
    "outside", [(1.01 * FARTHEST, 0.0, 0.0), (1.0, 1.01 * np.tan(STEEPEST), 0.0), (-1.0, 0.0, 0.0)]
)
def test_what_bounds_the_unknowns_of_others_is_a_row_of_reprojection(outside: tuple[float, float, float]):
    problem = noisy(1, n=20)
    start = from_closed_form(problem)
    nlp = FORMULATIONS["Reprojection"].build(problem, start)
    assert isinstance(nlp, Nlp)
    z_L, p, q = outside
    # Its pose is the start's and a triangle times the last three unknowns.
    unit = np.asarray(nlp.model.plane_and_jacobian(nlp.start, nlp.parameters)[1])[:, -3:]
    away = np.linalg.solve(unit, np.array([z_L * problem.setup.r, p, q]) - start.plane)
    x = np.append(np.zeros(20), away).astype(np.float64)
    np.testing.assert_allclose(nlp.plane(x), [z_L * problem.setup.r, p, q], rtol=1e-6, atol=1e-6)
    assert np.min(np.asarray(nlp.model.values(x, nlp.parameters)[1])) < 0
    inside = np.asarray(nlp.model.values(nlp.start, nlp.parameters)[1])
    assert np.min(inside) > 0


@pytest.mark.parametrize("name", ["Constrained", "LeastSquares", "Elastic"])
def test_what_the_solvers_evaluate_is_the_model_s_own_function(name: str):
    """IPOPT's objective and rows, in its scaled unknowns, and SWIFT's kernel, at one point away from the start."""
    problem = noisy(1, n=20)
    nlp = FORMULATIONS[name].build(problem, from_closed_form(problem))
    assert isinstance(nlp, Nlp)
    x = nlp.start * 1.01 + 0.01
    f, g = (np.asarray(value).ravel() for value in nlp.model.values(x, nlp.parameters))
    solver = plugin.compiled(nlp.model, "ipopt", (("ipopt.print_level", 0), ("ipopt.sb", "yes")))
    known = np.concatenate([nlp.parameters, nlp.x_scale])
    objective, rows = (np.asarray(solver.get_function(n)(x / nlp.x_scale, known)).ravel() for n in ("nlp_f", "nlp_g"))
    np.testing.assert_allclose(objective, f, rtol=1e-12)
    np.testing.assert_allclose(rows, g, rtol=1e-9, atol=1e-9)
    penalised = nlp.penalised(10.0)
    kernel, left = (np.asarray(value).ravel() for value in penalised.model.values(x, penalised.parameters))
    equal = nlp.model.equalities
    np.testing.assert_allclose(kernel, f + 10 * np.sum(g[equal] ** 2), rtol=1e-12)
    np.testing.assert_allclose(left, g[~equal], rtol=1e-12)


def test_a_method_is_built_once_for_any_number_of_problems(monkeypatch: pytest.MonkeyPatch):
    built: list[str] = []
    build = plugin._build  # pyright: ignore[reportPrivateUsage] - counted here

    def counting(model: Any, name: str, *rest: Any) -> Any:
        built.append(f"{model.name} {name}")
        return build(model, name, *rest)

    monkeypatch.setattr(plugin, "_build", counting)
    # Tolerances of their own, so that no other test has built these.
    methods = [Method(Constrained(), Sqp(tol=1.1e-8)), Method(Constrained(), Ipopt(tol=1.1e-8))]
    problems = [noisy(seed, n=20) for seed in range(4)]
    rows = compare(problems, methods=methods, repeats=2).rows
    # Once to be used, and once from nothing to find out what that takes.
    assert sorted(built) == sorted(2 * ["constrained_slopes sqpmethod", "constrained_slopes ipopt"])
    assert len({row.build_s for row in rows if row.solver == "Sqp"}) == 1
    assert all(row.build_s > 0 for row in rows)
    assert len(rows) == 8


def test_same_start_is_used_for_all_and_wild_ones_are_told_apart():
    methods = (Method(Constrained(), Ipopt()), Method(LeastSquares(), Ipopt()))
    near = compare(spot_of(TRUE_POSE), example_rig(), methods=methods)
    far = compare(spot_of(TRUE_POSE), example_rig(), methods=methods, start=PAPERS_START)
    for warm, cold in zip(near.rows, far.rows, strict=True):
        assert cold.solution.effort.iterations > warm.solution.effort.iterations
    assert far.rows[0].root is Root.VISIBLE


def test_elastic_alone_still_begins_where_four_equations_agree():
    problem = noisy(1, n=20)
    problem = replace(problem, B=problem.B + np.array([0, 0, 0.3, 0, 0]))
    start = from_closed_form(problem)
    moved, held = (Elastic().build(problem, replace(start, held=held)) for held in (False, True))
    assert np.max(np.abs(moved.plane(moved.start) - start.plane)) > 1e-3
    np.testing.assert_allclose(held.plane(held.start), start.plane, rtol=1e-12)
