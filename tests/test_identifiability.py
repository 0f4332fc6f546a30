"""What the ten equations fix: counts, ranks, rows that repeat others, and what a degenerate case leaves free."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from cases import WORKED, WORKED_SETUP, Array, random_case
from planeopt import equations as eq
from planeopt.estimation import solve_problem
from planeopt.formulations import AsPrinted, Problem, Start, identify
from planeopt.formulations.identifiability import independent_jacobian, ten_jacobian
from planeopt.solution import Identifiability, Status
from problems import exact, noisy, start_at


def feasible_cases(n: int, seed: int = 1) -> list[tuple[eq.PaperVariables, eq.Setup]]:
    """Rigs and visible planes that are neither frontal nor on the beam's surface."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        case = random_case(rng, n=5)
        assert case.rig.beam is not None
        if case.pose.alpha > math.radians(1) and case.pose.beta is not None:
            k = eq.Setup(case.rig.focal_length, *case.rig.laser_offset, case.rig.beam.radius)
            # In the laser-parallel frame; the rows are taken there.
            z_L = case.pose.z_L + case.rig.axial_shift
            found.append((eq.PaperVariables(case.pose.R, z_L, case.pose.alpha, case.pose.beta), k))
    return found


def identified(v: eq.PaperVariables, k: eq.Setup) -> Identifiability:
    """At the exact plane; noise of 1e-5 of the spot's size in the image."""
    return identify(exact(v, k, 1e-5 * k.f * k.r / v.z_L), start_at(v))


def test_the_worked_example() -> None:
    found = identify(noisy(1), start_at(WORKED))
    assert (found.n_equations, found.n_unknowns) == (10, 4)
    assert (found.rank, found.laser_rank) == (4, 1)
    assert len(found.dependent_rows) == 4
    assert found.null_vector is None
    assert found.sentence.startswith("10 equations, 4 unknowns, laser block rank 1")
    for row in found.dependent_rows:
        assert row in found.sentence


def test_the_laser_block_has_rank_one_at_every_feasible_plane() -> None:
    for v, k in feasible_cases(60):
        found = identified(v, k)
        assert found.laser_rank == 1, (v, k)
        assert found.rank == 4, (v, k)
        assert len(found.dependent_rows) == 4
        assert set(found.dependent_rows) < {f"({e.number})" for e in eq.LASER_BLOCK}
        assert found.null_vector is None


@pytest.mark.parametrize("degrees", [-135.0, -90.0, -45.0, 0.0, 45.0, 90.0, 135.0, 180.0])
def test_laser_rows_that_vanish_repeat_the_others(degrees: float) -> None:
    """At these azimuths ``sin(2 beta)`` or ``cos(2 beta)`` is zero but for rounding."""
    v = WORKED._replace(alpha=math.radians(30), R=WORKED_SETUP.r / math.cos(math.radians(30)), z_L=100.0)
    found = identified(v._replace(beta=math.radians(degrees)), WORKED_SETUP)
    assert (found.laser_rank, len(found.dependent_rows)) == (1, 4)


def test_the_laser_rows_are_multiples_of_one_row() -> None:
    """The proof behind the rank: at a feasible plane the five gradients are `laser_factors` times one gradient."""
    for v, k in feasible_cases(20, seed=2):
        rows = np.asarray(ten_jacobian()(np.array(v), np.concatenate([k, np.ones(5)])))[:5]
        factors = np.array(eq.laser_factors(np, v, k))
        # d(R^2 cos^2 alpha - r^2) at R cos(alpha) = r.
        one = 2 * k.r * np.array([math.cos(v.alpha), 0, -v.R * math.sin(v.alpha), 0])
        size = np.abs(factors)[:, None] * np.abs(one).max() + k.r
        np.testing.assert_allclose(rows / size, factors[:, None] * one / size, atol=1e-11)


def test_off_the_constraint_the_laser_rows_are_not_one_fact() -> None:
    """Rank 1 belongs to feasible planes: elsewhere beta matters too, so it is not an artefact of the code."""
    v = WORKED._replace(R=1.3 * WORKED.R)
    rows = np.asarray(ten_jacobian()(np.array(v), np.concatenate([WORKED_SETUP, np.ones(5)])))[:5]
    values = np.linalg.svd(rows * [v.R, v.z_L, 1, 1], compute_uv=False)
    assert values[1] > 1e-3 * values[0]


@pytest.mark.parametrize("degrees", [0.0, 1e-7])
def test_at_alpha_zero_the_paper_s_variables_lose_beta_and_the_slopes_do_not(degrees: float) -> None:
    alpha = math.radians(degrees)
    v = eq.PaperVariables(WORKED_SETUP.r / math.cos(alpha), 100.0, alpha, 0.3)
    found = identified(v, WORKED_SETUP)
    assert found.rank == 3
    assert found.laser_rank == 1
    assert found.null_vector is None
    # In slopes all four unknowns are fixed: the smallest singular value is as far from zero as at a tilt of 60 deg.
    assert found.singular_values[-1] > 0.5 * identified(WORKED, WORKED_SETUP).singular_values[-1]


@pytest.mark.parametrize("offset", [(6.0, 8.0), (0.0, 0.0)], ids=["on the beam", "on the axis"])
def test_the_camera_may_stand_on_the_beam_or_on_its_axis(offset: tuple[float, float]) -> None:
    k = eq.Setup(25.0, *offset, 10.0)
    found = identified(eq.PaperVariables(10 / math.cos(0.5), 100.0, 0.5, 0.3), k)
    assert (found.rank, found.laser_rank) == (4, 1)


def test_singular_values_do_not_depend_on_the_unit_or_on_the_noise_level() -> None:
    problem, unit = exact(WORKED, WORKED_SETUP), 25.4
    sizes = np.array([1, 1, unit, unit, unit**2])
    inches = replace(
        problem,
        setup=eq.Setup(*(unit * v for v in problem.setup)),
        B=problem.B * sizes,
        B_factor=100 * problem.B_factor * sizes[:, None],
    )
    there = start_at(WORKED._replace(R=WORKED.R * unit, z_L=WORKED.z_L * unit))
    a, b = identify(problem, start_at(WORKED)), identify(inches, there)
    np.testing.assert_allclose(a.singular_values, b.singular_values, rtol=1e-9)
    assert len(a.singular_values) == 4
    assert list(a.singular_values) == sorted(a.singular_values, reverse=True)


def blind_along(direction: Array) -> Problem:
    """The worked example with an ellipse that says nothing about one direction of ``(z_L, p, q)``."""
    problem = exact(WORKED, WORKED_SETUP)
    x = np.array([WORKED.R, WORKED.z_L, *eq.slopes(np, WORKED)])
    rows = np.asarray(independent_jacobian()(x, np.concatenate([problem.setup, problem.B])))[1:]
    # R is not in (6) in slopes; the laser constraint then moves it with the slopes.
    unseen = rows[:, 1:] @ direction
    basis = np.linalg.qr(np.column_stack([unseen, problem.B_factor[:, :4]]))[0]
    return replace(problem, B_factor=basis * np.array([1e16, 1.0, 1.0, 1.0, 1.0]))


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (1.0, 0.01, 0.02)], ids=["depth", "depth and slopes"])
def test_what_a_degenerate_ellipse_leaves_free_is_said_in_words(direction: tuple[float, float, float]) -> None:
    problem = blind_along(np.array(direction))
    words = identify(problem, start_at(WORKED)).null_vector
    assert words is not None
    parts = {name: float(value) for value, name in re.findall(r"([+-][\d.e-]+) (R|z_L|p|q)", words)}
    # Three digits are printed, the largest is 1, and what is below 1e-3 of it is left out.
    for name, share in zip(("z_L", "p", "q"), direction, strict=True):
        assert parts.get(name, 0.0) / parts["z_L"] == pytest.approx(share, rel=1e-2, abs=2e-3)
    solution = solve_problem(problem)
    assert solution.status is Status.UNIDENTIFIABLE
    assert solution.status.record == "refused"
    assert "z_L" in solution.message
    assert solution.message.startswith(Status.UNIDENTIFIABLE.value)
    assert solution.pose is None
    assert solution.covariance is None


def test_every_solution_carries_the_evidence_and_as_printed_shows_it() -> None:
    problem = noisy(1)
    solution = solve_problem(problem)
    assert solution.identifiability is not None
    assert solution.identifiability.rank == 4
    refusal = AsPrinted().build(problem, Start(20.0, (75.0, -0.8, 1.5), 0.5))
    assert refusal.status is Status.OVERDETERMINED
    assert "10 equations, 4 unknowns, laser block rank 1" in refusal.message
    assert re.search(r"\(1\d\), \(1\d\), \(1\d\), \(1\d\) repeat the others", refusal.message)
