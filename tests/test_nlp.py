"""Programmes as data: every row knows its equation, unit and block; the penalised form; bounds; scales and units."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from cases import WORKED, WORKED_SETUP
from planeopt import equations as eq
from planeopt.formulations import Constrained, Elastic, LeastSquares, Penalty, Reprojection
from planeopt.formulations.bounds import pose_bounds
from planeopt.nlp import Nlp
from problems import exact, noisy, start_at

START = start_at(WORKED)
SEARCHED = [Constrained(), Constrained("paper"), Reprojection(), Elastic(), LeastSquares(), Penalty()]
SEARCHED.append(Penalty("image objective"))


@pytest.fixture(params=SEARCHED, ids=lambda formulation: formulation.name)
def nlp(request: pytest.FixtureRequest) -> Nlp:
    built = request.param.build(noisy(1, n=20), START)
    assert isinstance(built, Nlp)
    return built


def values(nlp: Nlp, x: np.ndarray) -> tuple[float, np.ndarray]:
    f, g = nlp.model.values(x, nlp.parameters)
    return float(f), np.asarray(g).ravel()


def test_every_row_carries_number_unit_and_block(nlp: Nlp) -> None:
    assert len(nlp.model.rows) == nlp.model.constraints.shape[0] == len(nlp.row_scale)
    for row in nlp.model.rows:
        assert row.equation.number
        assert row.equation.name
        assert row.equation.unit in ("1", "mm", "mm^2", "1, 1, mm, mm, mm^2")
        assert row.equation.block in (eq.Block.LASER, eq.Block.IMAGE, eq.Block.GEOMETRY)
        # Inequalities are where the model holds; measurements are equations.
        assert row.equality == (row.equation.block is not eq.Block.GEOMETRY)
        assert row.equation.number in str(row.equation)


@pytest.mark.parametrize(
    ("formulation", "numbers"),
    [
        (Constrained(), "17 18 19 20 21 11-15"),
        (Constrained("paper"), "17 18 19 20 21 11-15"),
        (Elastic(), "11 12 13 14 15 17 18 19 20 21"),
        (LeastSquares(), ""),
        (Reprojection(), ""),
        (Penalty(), "11 12 13 14 15 17 18 19 20 21"),
        (Penalty("image objective"), "11 12 13 14 15"),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_the_hard_rows_are_these_equations_in_this_order(formulation: Constrained, numbers: str) -> None:
    model = formulation.build(noisy(1, n=20), START).model
    assert [row.equation.number for row in model.rows if row.equality] == numbers.split()
    visible = [row.equation for row in model.rows if not row.equality]
    assert any("lit side" in equation.name for equation in visible)
    assert any("whole spot" in equation.name for equation in visible)


def test_dimensions_agree(nlp: Nlp) -> None:
    n = len(nlp.model.variables)
    assert nlp.model.x.shape == (n, 1)
    assert len({len(nlp.start), len(nlp.lower), len(nlp.upper), len(nlp.x_scale), n}) == 1
    assert all(stage.shape == (nlp.model.p.shape[0],) for stage in nlp.stages)
    weighted = nlp.data_factor.T @ np.ones(nlp.model.data.numel())  # raises unless it has a row for every datum
    assert np.all(np.isfinite(weighted))
    assert np.all(nlp.lower <= nlp.start)
    assert np.all(nlp.start <= nlp.upper)
    assert np.all(nlp.x_scale > 0)
    assert np.all(nlp.row_scale > 0)


@pytest.mark.parametrize("formulation", SEARCHED, ids=lambda formulation: formulation.name)
def test_a_user_s_start_is_the_plane_that_was_asked_for(formulation: Constrained) -> None:
    nlp = formulation.build(noisy(1, n=20), replace(START, cold=True))
    np.testing.assert_allclose(nlp.plane(nlp.start), START.plane, rtol=1e-12)


def test_row_bounds_are_zero_for_equalities_and_above_for_the_rest(nlp: Nlp) -> None:
    lower, upper = nlp.row_bounds
    assert np.all(lower == 0)
    assert np.array_equal(np.isinf(upper), ~nlp.model.equalities)
    assert np.all(upper[nlp.model.equalities] == 0)


def test_visible_planes_satisfy_the_inequalities_strictly(nlp: Nlp) -> None:
    g = values(nlp, nlp.start)[1]
    assert np.all(g[~nlp.model.equalities] > 0)


def test_rows_times_their_scale_are_the_paper_s_residuals() -> None:
    problem = noisy(1)
    residuals = np.array(eq.ten_residuals(np, WORKED, problem.setup, problem.B))
    for formulation, first in ((Constrained(), 0), (Constrained("paper"), 0)):
        nlp = formulation.build(problem, START)
        g = values(nlp, nlp.start)[1] * nlp.row_scale
        # Slack is zero at the start; (6) divided by r^2 and (6) give the same ratios up to rounding.
        np.testing.assert_allclose(g[first : first + 5], residuals[5:], rtol=1e-9, atol=1e-9)
    penalty = Penalty().build(problem, START)
    g = values(penalty, penalty.start)[1] * penalty.row_scale
    np.testing.assert_allclose(g[:10], residuals, rtol=1e-9, atol=1e-10)
    # Elastic takes each residual up into the slack above or below it, whose unit is the row's scale.
    elastic = Elastic().build(problem, replace(START, cold=True))
    assert np.max(np.abs(values(elastic, elastic.start)[1][:10])) < 1e-9
    slack = (elastic.start[4:14] - elastic.start[14:24]) * elastic.row_scale[:10]
    np.testing.assert_allclose(slack, residuals, rtol=1e-9, atol=1e-10)
    assert np.all(elastic.start[4:] >= 0)


def test_the_objectives_are_what_they_are_called() -> None:
    problem = noisy(1)
    residuals = np.array(eq.ten_residuals(np, WORKED, problem.setup, problem.B))
    least_squares = LeastSquares().build(problem, START)
    assert values(least_squares, least_squares.start)[0] == pytest.approx(0.5 * np.sum(residuals**2), rel=1e-12)
    image = Penalty("image objective").build(problem, START)
    assert values(image, image.start)[0] == pytest.approx(np.sum(residuals[5:] ** 2), rel=1e-12)
    printed = Penalty().build(problem, START)
    assert values(printed, printed.start)[0] == 0
    elastic = Elastic().build(problem, replace(START, cold=True))
    weighted = np.abs(residuals) / elastic.row_scale[:10]
    assert values(elastic, elastic.start)[0] == pytest.approx(np.sum(weighted), rel=1e-9)
    slack = np.arange(1.0, 6.0)
    constrained = Constrained().build(problem, START)
    assert values(constrained, np.concatenate([constrained.start[:4], slack]))[0] == 0.5 * 55


@pytest.mark.parametrize("weight", [0.0, 1.0, 1e4])
def test_the_penalised_form_moves_the_equalities_into_the_objective(nlp: Nlp, weight: float) -> None:
    f, g = values(nlp, nlp.start)
    penalised = nlp.penalised(weight)
    assert not any(row.equality for row in penalised.model.rows)
    assert len(penalised.row_scale) == len(penalised.model.rows)
    f_penalised, g_penalised = values(penalised, nlp.start)
    assert f_penalised == pytest.approx(f + weight * np.sum(g[nlp.model.equalities] ** 2), rel=1e-12, abs=1e-300)
    np.testing.assert_array_equal(g_penalised, g[~nlp.model.equalities])
    np.testing.assert_array_equal(penalised.plane(nlp.start), nlp.plane(nlp.start))
    assert penalised.model is nlp.penalised(2 * weight).model, "compiled again for every weight"


def test_derivatives_are_those_of_the_values(nlp: Nlp) -> None:
    x = nlp.start + 1e-3 * np.random.default_rng(2).uniform(0, 1, len(nlp.start)) * nlp.x_scale
    f, gradient, g, jacobian = (np.asarray(v) for v in nlp.model.first_order(x, nlp.parameters))
    # Unknowns measured in standard deviations take longer steps: a thousandth of one is as small as 1e-6 of a depth.
    h = (1e-3 if nlp.model.name.startswith("reprojection") else 1e-6) * nlp.x_scale
    size = max(1.0, float(np.abs(g).max()), float(abs(f[0, 0])))
    for i in range(len(x)):
        step = h[i] * np.eye(len(x))[i]
        (f_up, g_up), (f_down, g_down) = values(nlp, x + step), values(nlp, x - step)
        # Central differences: values in standard deviations are rounded at 1e-12 of their size (a point is 1e4 of them
        # from the origin); truncation is 1e-6 where curvature doubles over a thousand steps.
        rounding = 1e-12 * size / h[i]
        rows = np.abs((g_up - g_down) / (2 * h[i]) - jacobian[:, i])
        assert np.all(rows <= rounding + 1e-6 * np.abs(jacobian).max(axis=1)), nlp.model.variables[i]
        objective = abs((f_up - f_down) / (2 * h[i]) - gradient[i, 0])
        assert objective <= rounding + 1e-6 * np.abs(gradient).max(), nlp.model.variables[i]


def test_a_warm_start_has_one_stage_and_a_cold_one_the_mild_weight_first() -> None:
    problem = noisy(1)
    warm, cold = Constrained().build(problem, START), Constrained().build(problem, replace(START, cold=True))
    assert len(warm.stages) == 1
    assert len(cold.stages) == 2
    np.testing.assert_array_equal(cold.parameters, warm.parameters)
    mild = np.reshape(cold.stages[0][9:], (5, 5), order="F")
    assert np.count_nonzero(mild - np.diag(np.diag(mild))) == 0
    assert np.all(np.diag(mild) >= np.abs(problem.B))


@pytest.mark.parametrize("variables", ["slopes", "paper"])
def test_bounds_scale_with_the_beam_and_hold_every_visible_plane(variables: str) -> None:
    lower, upper = pose_bounds("slopes" if variables == "slopes" else "paper", 10.0)
    small_lower, small_upper = pose_bounds("slopes" if variables == "slopes" else "paper", 1.0)
    np.testing.assert_array_equal(lower[:2], 10 * small_lower[:2])
    np.testing.assert_allclose(upper[:2], 10 * small_upper[:2], rtol=1e-15)
    np.testing.assert_array_equal(upper[2:], small_upper[2:])
    start = START.in_slopes if variables == "slopes" else START.in_paper_variables
    assert np.all(lower < start)
    assert np.all(start < upper)
    assert np.isfinite([lower, upper]).all()


def test_a_change_of_the_unit_of_length_leaves_the_scaled_programme_alone() -> None:
    unit = 25.4
    big = exact(WORKED, WORKED_SETUP)
    sizes = np.array([1, 1, unit, unit, unit**2])
    small = replace(
        big, setup=eq.Setup(*(unit * v for v in big.setup)), B=big.B * sizes, B_factor=big.B_factor * sizes[:, None]
    )
    here = START
    there = start_at(WORKED._replace(R=WORKED.R * unit, z_L=WORKED.z_L * unit))
    moved = np.array([1.01, 1.02, 0.9, 1.1])
    for formulation in (Constrained(), Constrained("paper")):
        a, b = formulation.build(big, here), formulation.build(small, there)
        x = a.start.copy()
        x[:4] *= moved
        y = np.concatenate([x[:4] * [unit, unit, 1, 1], x[4:]])
        f_a, g_a = values(a, x)
        f_b, g_b = values(b, y)
        assert f_a == f_b
        # Rounding of a coefficient of B over its standard deviation: 1e-16 x 1e3 to 1e5.
        np.testing.assert_allclose(g_a, g_b, rtol=1e-9, atol=1e-9)
    # The unweighted sum of squares is not so: it depends on the unit.
    a, b = LeastSquares().build(big, here), LeastSquares().build(small, there)
    ratio = values(b, a.start * moved * [unit, unit, 1, 1])[0] / values(a, a.start * moved)[0]
    assert ratio > unit**2


def test_symbols_are_built_once_for_all_problems() -> None:
    first, second = noisy(1, n=20), noisy(2, n=20)
    for formulation in SEARCHED:
        a, b = formulation.build(first, START), formulation.build(second, START)
        assert a.model is b.model
        assert a.model.values is b.model.values
        assert isinstance(a.model.hessian, ca.Function)
