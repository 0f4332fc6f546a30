"""What SWIFT's rising weight does: the quick form of `studies/swift.py`, and its results as committed."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from planeopt import paper
from planeopt.solution import RESOLUTION
from planeopt.solvers import Swift
from studies import swift
from studies.__main__ import RESULTS
from studies.study import Result, read_rows
from studies.swift_paths import PathRow, ValleyRow, WorkRow
from studies.swift_problems import Case, apart, boundary, problem_of, start_of, truth_of
from studies.swift_runs import (
    AT_MINIMISER,
    DEFAULT,
    RANDOM_CASES,
    READINGS,
    SCHEDULES,
    STARTS,
    RunRow,
    cases_of,
    minimiser,
)
from studies.swift_summary import (
    EndRow,
    ReachedRow,
    ends,
    ends_of,
    reached,
    slope_of_tolerance,
    slope_of_violation,
)
from studies.swift_weights import DRAWS, TOLERANCE_WEIGHTS, ToleranceRow, WeightRow
from study_files import written

COMMITTED = RESULTS / "swift"


def complaints(folder: Path) -> Iterator[str]:
    """Everything that is claimed and does not hold of the tables in a folder, in words."""
    yield from _of_weights(read_rows(folder / "weights.csv", WeightRow))
    yield from _of_tolerances(read_rows(folder / "tolerances.csv", ToleranceRow))
    runs, table = read_rows(folder / "runs.csv", RunRow), read_rows(folder / "ends.csv", EndRow)
    yield from _of_ends(table)
    if [_counts(row) for row in ends_of(runs)] != [_counts(row) for row in table]:
        yield "ends.csv is not what runs.csv says"
    work, first = read_rows(folder / "work.csv", WorkRow), read_rows(folder / "reached.csv", ReachedRow)
    if [str(row.calls) for row in reached(work)] != [str(row.calls) for row in first]:
        yield "reached.csv is not what work.csv says"
    yield from _of_paths(folder)


def _counts(row: EndRow) -> tuple[object, ...]:
    return row.start, row.reading, row.method, row.schedule, row.searches, row.minimiser, row.local, row.none


def _of_weights(rows: list[WeightRow]) -> Iterator[str]:
    for row in rows:
        # Two answers, each within a Newton step of RESOLUTION.
        if row.reading == "printed" and row.most_from_weight_1 > 2 * RESOLUTION:
            yield f"the weight moves the minimiser with J = 0: {row}"
    # lambda / (2 w), and the multiplier itself changes by no more than the violation's share of the whole, a hundredth.
    if abs(slope_of_violation(rows) + 1) > 0.02:
        yield f"the violation falls as the weight to the power {slope_of_violation(rows)}"
    heaviest = max(row.weight for row in rows)
    for problem in {row.problem for row in rows}:
        printed, image = (
            next(r for r in rows if (r.problem, r.reading, r.weight) == (problem, reading, heaviest))
            for reading in READINGS
        )
        if abs(image.rms_error / printed.rms_error - 1) > 1e-3:
            yield f"the two readings do not agree at a heavy weight: {printed}, {image}"
        # An efficient estimate is no worse than this one, but for the Monte Carlo error of a ratio of correlated RMS.
        if printed.over_constrained < 1 - 4 / np.sqrt(2 * printed.draws):
            yield f"better than the efficient estimate: {printed}"


def _of_tolerances(rows: list[ToleranceRow]) -> Iterator[str]:
    # Where a simplex stops is known to a power of ten, over half as many of those as the weights span.
    decades = np.log10(max(TOLERANCE_WEIGHTS) / min(TOLERANCE_WEIGHTS))
    if abs(slope_of_tolerance(rows) + 0.5) > 2 / decades:
        yield f"a simplex of equal values ends as the weight to the power {slope_of_tolerance(rows)}"


def _of_ends(rows: list[EndRow]) -> Iterator[str]:
    for row in rows:
        # IPOPT, which knows of no squares, may creep along the bottom of a valley with walls of 1e5.
        creeps = row.method == "Ipopt" and row.reading == "image objective"
        if row.start == "closed form" and row.minimiser != row.searches and not creeps:
            yield f"not found from near by: {row}"
        if row.searches != row.minimiser + row.local + row.none:
            yield f"searches are missing: {row}"
    rising = ends(rows, "paper's", "image objective", "Swift", DEFAULT)
    heavy = ends(rows, "paper's", "image objective", "Swift", "1e5")
    if rising.minimiser < heavy.minimiser:
        yield f"the rising weight does not help: {rising}, {heavy}"
    for start in STARTS:
        one, six = (ends(rows, start, "printed", "Swift", name) for name in ("1", DEFAULT))
        newton = ends(rows, start, "printed", "Ipopt")
        if not newton.median_calls < one.median_calls < six.median_calls:
            yield f"more stages, or derivatives, do not cost what they should: {newton}, {one}, {six}"


def _of_paths(folder: Path) -> Iterator[str]:
    for row in read_rows(folder / "paths.csv", PathRow):
        if not (0 <= row.alpha_deg <= 90 and -180 < row.beta_deg <= 180):
            yield f"angles are not canonical: {row}"
    valley = [row for row in read_rows(folder / "valley.csv", ValleyRow) if np.isfinite(row.least_sum)]
    least = min(valley, key=lambda row: row.least_sum)
    # The grid's steps are at most a quarter of the depth and ten degrees, those of the quick form.
    near = abs(np.log(least.z_L_mm / paper.TRUTH.z_L)) < 0.25 and abs(least.alpha_deg - 60) < 10
    if not near:
        yield f"the valley's lowest point is elsewhere: {least}"


@pytest.fixture(scope="module")
def result() -> Result:
    return swift.run("quick")


@pytest.fixture(scope="module")
def folder(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(result, tmp_path_factory.mktemp("quick"), COMMITTED)


def test_the_quick_study(folder: Path) -> None:
    assert not list(complaints(folder))


def test_the_results_as_committed() -> None:
    assert not list(complaints(COMMITTED))
    table = read_rows(COMMITTED / "ends.csv", EndRow)
    assert {row.searches for row in table} == {len(cases_of("full"))} == {2 * (RANDOM_CASES["full"] + 1)}
    assert {row.schedule for row in table if row.method == "Swift"} == set(SCHEDULES)
    assert {row.draws for row in read_rows(COMMITTED / "weights.csv", WeightRow)} == {DRAWS["full"]}
    # From far away the schedule decides, where it has something to do.
    rising = ends(table, "paper's", "image objective", "Swift", DEFAULT)
    heavy = ends(table, "paper's", "image objective", "Swift", "1e5")
    assert rising.minimiser > heavy.minimiser + rising.searches // 4


def test_a_search_is_made_again(result: Result) -> None:
    """Of the committed runs those that the quick form has too: the same but for what rounding does to a search."""
    committed = read_rows(COMMITTED / "runs.csv", RunRow)
    again = result.tables["runs"]
    for row in again:
        assert isinstance(row, RunRow)
        key = (row.problem, row.noise_px, row.reading, row.start, row.method, row.schedule)
        before = next(r for r in committed if (r.problem, r.noise_px, r.reading, r.start, r.method, r.schedule) == key)
        if row.start == "closed form":
            assert before.end == row.end
            assert before.evaluations == pytest.approx(row.evaluations, rel=0.3, abs=5)
        assert before.minimiser_to_truth == pytest.approx(row.minimiser_to_truth, rel=1e-3)


def test_the_random_problems_can_be_seen_and_their_boundary_is_that_of_the_plane() -> None:
    for case in cases_of("full")[::2]:
        truth = truth_of(case.index)
        exact = problem_of(Case(case.index, 0.0))
        assert exact.points is not None
        np.testing.assert_array_equal(exact.points, boundary(truth))
        # Exact points: the closed form is right to rounding, the conic's condition at most 1e6 of it.
        start = start_of(exact, "closed form")
        assert apart(np.array(start.plane), truth.plane) < 1e-8


def test_distances_between_planes() -> None:
    one = np.array([100.0, 0.3, -0.2])
    assert apart(one, one) == 0
    assert apart(one * [1.01, 1, 1], one) == pytest.approx(0.01)
    assert apart(np.array([100.0, np.tan(0.3), 0.0]), np.array([100.0, np.tan(0.1), 0.0])) == pytest.approx(0.2)


def test_the_minimiser_is_where_a_simplex_ends() -> None:
    """Two methods that share nothing but the function."""
    case = Case(0, 0.3)
    best = minimiser(case, "printed", 1.0)
    found = Swift((1.0,), 1e-11).solve(best.nlp)
    assert apart(found.nlp.plane(found.x), best.nlp.plane(best.x)) < AT_MINIMISER / 1000
