"""What the ten equations fix, and slack, elastic and hard rows: `studies/constraints.py`, and its committed results."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from planeopt import equations as eq
from planeopt import paper
from planeopt.estimation import starts
from planeopt.solvers import Ipopt
from studies import constraints
from studies.__main__ import RESULTS
from studies.constraints_culprit import PIXEL_MM, CulpritRow, spoilt
from studies.constraints_estimates import (
    DRAWS,
    ESTIMATORS,
    NOISE_MM,
    SCENES,
    TRIPLES,
    EstimateRow,
    TripleRow,
    draw,
    exact,
    information,
    predicted_over_bound,
)
from studies.constraints_forms import HardImageRows
from studies.constraints_ranks import EdgeRow, FreeRow, RankRow, image_derivatives
from studies.constraints_subsets import CHOICES, STARTS, SubsetRow, also_hold_at
from studies.constraints_summary import (
    INDEPENDENT,
    accepted,
    choices,
    independent_form,
    named_percent,
    singular,
)
from studies.study import Result, read_rows
from study_files import written

COMMITTED = RESULTS / "constraints"


def complaints(folder: Path) -> Iterator[str]:
    """Everything that is claimed and does not hold of the tables in a folder, in words."""
    yield from _of_ranks(folder)
    yield from _of_subsets(read_rows(folder / "subsets.csv", SubsetRow))
    yield from _of_estimates(read_rows(folder / "estimates.csv", EstimateRow))
    for triple in read_rows(folder / "triples.csv", TripleRow):
        if triple.predicted_over_bound < 1:
            yield f"three equations know more than five: {triple}"
    yield from _of_culprits(read_rows(folder / "culprits.csv", CulpritRow))


def _of_ranks(folder: Path) -> Iterator[str]:
    for row in read_rows(folder / "ranks.csv", RankRow):
        # Five equations for one fact; at alpha = 0 beta means nothing.
        if (row.laser_rank, row.repeated_laser_rows, row.ten_rank) != (1, 4, 4 if row.alpha_deg else 3):
            yield f"another rank: {row}"
    for row in read_rows(folder / "free.csv", FreeRow):
        # The rig's scale and the focal length are never seen; r alone is where no offset sets the scale.
        free = row.unknown in ("f", "e and r") or (row.unknown == "r" and row.offset_mm == 0)
        if row.rank != row.unknowns - free or bool(row.changes_nothing) != free:
            yield f"another rank: {row}"
    edge = read_rows(folder / "edge.csv", EdgeRow)
    for offset in {row.offset_mm for row in edge}:
        near = sorted((row for row in edge if row.offset_mm == offset), key=lambda row: row.intercept_over_z_L)
        a, b = near[:2]
        # The two planes are 2c/k (r^2, e) apart and have one image: to first order in c nothing changes along that.
        slope = np.log(b.smallest_over_largest / a.smallest_over_largest) / np.log(
            b.intercept_over_z_L / a.intercept_over_z_L
        )
        if abs(slope - 1) > 0.05 or a.from_second_plane_deg > 0.2:
            yield f"rank is not lost in proportion to c, towards the second plane: {a}, {b}"
        if a.whitened_smallest_over_largest < 0.3 * near[-1].whitened_smallest_over_largest:
            yield f"whitened it is lost too: {a}"


def _of_subsets(rows: list[SubsetRow]) -> Iterator[str]:
    for row in choices(rows):
        if row.independent != 1 or singular(row) != (row.count > 1):
            yield f"not one fact, or no singular KKT matrix for several rows: {row}"
        if accepted(row) != (row.count < 5):
            yield f"accepted or refused against the counts: {row}"
        if row.off_the_beam and not row.also_hold_at_beta_deg:
            yield f"off the beam although the rows hold nowhere else: {row}"
    form = independent_form(rows)
    if form.off_the_beam or singular(form) or form.right_with_slack != "yes" or form.right_with_objective != "yes":
        yield f"the independent form fails: {form}"
    holds = {row.rows: row.also_hold_at_beta_deg for row in rows}
    if holds["(12)"] != "-135 -45 45 135" or holds["(11) (12)"]:
        yield f"(12) alone, or (11) and (12): {holds}"


def _of_estimates(rows: list[EstimateRow]) -> Iterator[str]:
    for row in rows:
        solved = row.draws - row.lost
        if row.estimator == ESTIMATORS[0]:
            # Efficient: RMS 1; of a mean of N squares of unit variance each, pooled over three.
            if abs(row.rms_over_bound**2 - 1) > 5 * np.sqrt(2 / (3 * solved)) + 0.02 or row.lost:
                yield f"weighted slack is not at the bound: {row}"
            # Five standard deviations; the bias of second order is a part of a sigma that falls with the noise.
            if row.bias_over_bound > 5 / np.sqrt(solved):
                yield f"weighted slack is biased: {row}"
        if solved and row.rms_over_bound**2 < 1 - 5 * np.sqrt(2 / solved):
            yield f"below the bound by more than chance: {row}"


def _of_culprits(rows: list[CulpritRow]) -> Iterator[str]:
    for row in rows:
        # Seven hundred sigmas: beyond what noise can turn towards another coefficient, where the whole ellipse is seen.
        whole = "arc" not in row.scene
        if row.formulation == "Elastic" and row.outlier_px == 15 and whole and row.named != row.draws:
            yield f"the culprit is not named: {row}"
    if named_percent(rows, "Elastic", 15) <= named_percent(rows, "Constrained", 15):
        yield "least squares names the culprit as often"


@pytest.fixture(scope="module")
def result() -> Result:
    return constraints.run("quick")


@pytest.fixture(scope="module")
def folder(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(result, tmp_path_factory.mktemp("quick"), COMMITTED)


def test_the_quick_study(folder: Path) -> None:
    assert not list(complaints(folder))


def test_the_results_as_committed() -> None:
    assert not list(complaints(COMMITTED))
    subsets = read_rows(COMMITTED / "subsets.csv", SubsetRow)
    assert len(choices(subsets)) == 31 == len(CHOICES["full"]) - 1
    assert {row.searches for row in subsets} == {0, STARTS["full"]}
    assert subsets[-1].rows == INDEPENDENT
    # One row alone holds at four azimuths as well, and searches do end there.
    assert all(row.off_the_beam > 0 for row in subsets if row.count == 1 and row.rows != INDEPENDENT)
    estimates = read_rows(COMMITTED / "estimates.csv", EstimateRow)
    assert {row.draws for row in estimates} == {DRAWS["full"]}
    assert len(estimates) == len(SCENES) * len(ESTIMATORS)
    _predictions_hold(estimates, read_rows(COMMITTED / "triples.csv", TripleRow))


def _predictions_hold(estimates: list[EstimateRow], triples: list[TripleRow]) -> None:
    """What three hard rows do is what their part of the covariance says, where the noise is small enough for that."""
    ways = {"three hard, largest": "largest", "three hard, largest in sigmas": "largest in sigmas"}
    for row in estimates:
        if row.estimator in ways and "arc" not in row.scene:
            chosen = next(t for t in triples if t.scene == row.scene and ways[row.estimator] in t.chosen.split(", "))
            # One direction may hold all of the error: 1/sqrt(2 N) of it, five times.
            assert row.rms_over_bound == pytest.approx(chosen.predicted_over_bound, rel=5 / np.sqrt(2 * row.draws))


def test_estimates_made_again(result: Result) -> None:
    """The predictions of the quick form's scene are the committed ones."""
    committed = {(row.scene, row.rows): row for row in read_rows(COMMITTED / "triples.csv", TripleRow)}
    for row in result.tables["triples"]:
        assert isinstance(row, TripleRow)
        before = committed[row.scene, row.rows]
        assert before.predicted_over_bound == pytest.approx(row.predicted_over_bound, rel=1e-4)
        assert before.chosen == row.chosen


# --- The parts --------------------------------------------------------------------------------------------------------


def test_rows_hold_for_any_R_where_they_are_said_to() -> None:
    """And nowhere else on a grid: the residual of (11)-(15) off the beam vanishes only at those azimuths."""
    k = paper.SETUP
    for rows in CHOICES["full"][:15:2]:
        found = also_hold_at(rows, k)
        for beta in found:
            v = eq.PaperVariables(1.7 * k.r, 90.0, 0.9, beta)
            sizes = [1, 1, 2 * k.e_x, 2 * k.e_y, k.e_x**2 + k.e_y**2]
            assert all(abs(eq.LASER_BLOCK[i](np, v, k)) < 1e-9 * sizes[i] for i in rows), (rows, beta)
        assert len(found) == (4 if len(rows) == 1 or rows == (0, 2) else 0), rows


def test_hard_rows_hold_and_the_others_do_not() -> None:
    problem = draw(SCENES[0], 0)
    for rows in (TRIPLES[0], TRIPLES[-1]):
        found = Ipopt().solve(HardImageRows(rows).build(problem, starts.from_closed_form(problem)))
        assert found.kkt.ok
        v = eq.SlopeVariables(*found.x)
        left = np.abs(eq.image_residuals_in_slopes(np, v, problem.setup, problem.B))
        sigma = np.sqrt(np.sum(problem.B_factor**2, axis=1))
        # An answer is feasible to FEASIBLE = 1e-4 of a row's scale.
        assert np.all((left < 1e-3 * sigma) == np.isin(np.arange(5), rows))
        assert found.x[0] == pytest.approx(eq.long_axis(np, v.p, v.q, problem.setup.r), rel=1e-6)


def test_the_prediction_of_three_rows_by_differences() -> None:
    """A small change of the kept coefficients moves the plane as the derivative says; the others' does not matter."""
    scene, rows = SCENES[2], (0, 1, 4)
    problem, root = exact(scene), information(scene)
    columns = problem.B_factor @ root
    derivative = np.linalg.inv(columns[list(rows)])
    covariance = derivative @ (problem.B_factor @ problem.B_factor.T)[np.ix_(rows, rows)] @ derivative.T
    wanted = np.sqrt(np.trace(root @ covariance @ root.T) / 3)
    assert predicted_over_bound(scene, rows) == pytest.approx(wanted, rel=1e-6)


def test_the_information_is_that_of_the_boundary() -> None:
    """``sum_i j_i j_i' / sigma^2`` with ``j_i`` the boundary's change along its normal: B is sufficient."""
    scene = SCENES[0]
    problem = exact(scene)
    assert problem.points is not None
    x, y = problem.points.T
    B = problem.B
    monomials = np.stack([x * y, y * y, x, y, np.ones_like(x)], axis=1)
    gradient = np.hypot(2 * x + B[0] * y + B[2], B[0] * x + 2 * B[1] * y + B[3])
    moved = monomials / gradient[:, None] @ image_derivatives(scene.setup, np.array(scene.plane), ("z_L", "p", "q"))
    wanted = moved.T @ moved / NOISE_MM**2
    root = information(scene)
    np.testing.assert_allclose(root.T @ root / wanted, 1, rtol=1e-6)


def test_an_error_moves_the_boundary_by_its_size() -> None:
    """To first order, for a small one: the RMS distance of the clean points from the spoilt ellipse."""
    problem = draw(SCENES[2], 0)
    assert problem.points is not None
    size = 1e-3 * PIXEL_MM
    x, y = problem.points.T
    for i in range(5):
        B, spoiled = problem.B, spoilt(problem, i, size).B
        gradient = np.hypot(2 * x + B[0] * y + B[2], B[0] * x + 2 * B[1] * y + B[3])
        change = np.array([eq.eq16(np, spoiled, x, y) - eq.eq16(np, B, x, y)]) / gradient
        assert np.sqrt(np.mean(change**2)) == pytest.approx(size, rel=1e-6)
