"""Where searches end: the quick form of `studies/basins.py`.

Its full form is committed in `studies/results/basins`, and held to the same.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from planeopt import equations as eq
from planeopt import paper
from planeopt.closed_form import other_plane
from planeopt.formulations import Constrained
from planeopt.solvers import Ipopt
from studies import basins
from studies.__main__ import RESULTS
from studies.basins_example import DEPTHS, FINE, RANDOM, TILTS, EndRow, Job, Start, example, jobs, starts_of, work
from studies.basins_finding import from_papers_start, share, total
from studies.basins_rigs import DEFAULT, RIGS, RUNS, TILT_DEG, RigRow, draw_rig, one_rig
from studies.basins_searches import (
    AGREES,
    AT_ONCE,
    BEHIND,
    ENDS,
    FAST,
    OBVIOUS,
    PLANE,
    SLOW,
    UNSAID,
    Search,
    end_of,
    without,
)
from studies.basins_summary import CONFIDENCE, example_shares, rig_shares, upper_limit
from studies.study import read_rows, write

COMMITTED = RESULTS / "basins"
FILES = {"ends.csv", "shares.csv", "rigs.csv", "rig_shares.csv", "headline.csv", "finding.md"}
FIGURES = {"tilts.png", "depths.png", "shares.png"}
CLOSED_WITH = [DEFAULT, *(name for name, run in RUNS.items() if run.closed and run.search.seen)]


def complaints(ends: Sequence[EndRow], rigs: Sequence[RigRow]) -> Iterator[str]:
    """Everything that is claimed and does not hold, in words."""
    for row in ends:
        if row.inequality == "with" and row.end == BEHIND:
            yield f"behind, with the inequality: {row}"
        if row.end not in ENDS:
            yield f"not said how it ended: {row}"
        # The default never lets an answer elsewhere pass.
        if (row.method, row.inequality, row.end) == (FAST[0].method, "with", UNSAID):
            yield f"elsewhere and not told: {row}"
    for row in rigs:
        for name in CLOSED_WITH:
            if getattr(row, name) == BEHIND:
                yield f"{name} ends behind: {row}"
        if row.solve != PLANE and row.status == "converged":
            yield f"an answer that is not the plane: {row}"
        if (row.reasons == "") != all(
            getattr(row, name) in (PLANE, "") for name in (*CLOSED_WITH, "closed_ipopt_without")
        ):
            yield f"a failure without a reason: {row}"


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("basins")
    write(basins.run("quick"), folder)
    return folder


def test_the_quick_study(quick: Path) -> None:
    assert {path.name for path in quick.iterdir()} == FILES | FIGURES
    ends, rigs = read_rows(quick / "ends.csv", EndRow), read_rows(quick / "rigs.csv", RigRow)
    wrong = list(complaints(ends, rigs))
    assert not wrong, "\n".join(wrong)
    assert Counter(row.starts for row in ends).keys() == {TILTS, DEPTHS, RANDOM}
    assert len(rigs) == RIGS["quick"]
    assert all(row.solve == PLANE for row in rigs)
    # The programme without any inequality lands on the plane behind from the paper's own start.
    papers = from_papers_start(ends)
    assert papers[OBVIOUS.method, "without"] == BEHIND
    assert papers[FAST[0].method, "with"] == PLANE


@pytest.fixture(scope="module")
def committed() -> tuple[list[EndRow], list[RigRow]]:
    return read_rows(COMMITTED / "ends.csv", EndRow), read_rows(COMMITTED / "rigs.csv", RigRow)


def test_the_full_study_as_committed(committed: tuple[list[EndRow], list[RigRow]]) -> None:
    ends, rigs = committed
    wrong = list(complaints(ends, rigs))
    assert not wrong, "\n".join(wrong)
    assert [row.rig for row in rigs] == list(range(10_000))
    assert sum(row.solve != PLANE for row in rigs) < 10
    searched = {(row.method, row.inequality) for row in ends}
    for search in (*FAST, *SLOW):
        assert {(search.method, "with"), (search.method, "without")} <= searched
    assert len(ends) == sum(len(job.starts) for job in jobs("full"))
    # The rigs span what is claimed of them.
    offsets, tilts = (np.array([getattr(row, name) for row in rigs]) for name in ("offset_over_r", "alpha_deg"))
    distances = np.array([row.z_L_mm / row.r_mm for row in rigs])
    around = np.degrees(np.arctan2([row.e_y_mm for row in rigs], [row.e_x_mm for row in rigs]))
    for place in (offsets > 1.05, np.abs(offsets - 1) < 0.05, offsets < 0.95):
        assert np.mean(place) > 0.1
    assert np.histogram(around[offsets > 0], bins=8, range=(-180, 180))[0].min() > 900
    assert tilts.min() < 1 < 75 < tilts.max() <= TILT_DEG
    assert distances.min() < 3.5
    assert 950 < distances.max() <= 1000
    # Without the inequality searches do end behind, and only where the second plane is in front of the camera.
    behind = [row for row in rigs if row.random_ipopt_without == BEHIND]
    assert len(behind) > 100
    assert all(row.offset_over_r >= 1 for row in behind)
    assert not [row for row in rigs if row.random_ipopt == BEHIND]


def test_the_mild_stage_is_worth_its_time(committed: tuple[list[EndRow], list[RigRow]]) -> None:
    shares = example_shares(committed[0])
    for staged, at_once in zip(FAST[:2], AT_ONCE, strict=True):
        first, second = (share(shares, RANDOM, search.method, "with") for search in (staged, at_once))
        table = [[s.plane, s.searches - s.plane] for s in (first, second)]
        assert first.plane > second.plane
        assert float(np.asarray(scipy.stats.fisher_exact(table))[1]) < 1e-6


def test_searches_from_the_closed_form_end_where_they_are_said_to(
    committed: tuple[list[EndRow], list[RigRow]],
) -> None:
    """Some committed rigs again, by the same draws; from random starts rounding may decide."""
    for row in committed[1][600:640:10]:
        again = one_rig(row.rig, every=False)
        for name in ("offset_over_r", "f_mm", "z_L_mm", "noise", "start_z_L_mm"):
            assert getattr(again, name) == pytest.approx(getattr(row, name), rel=1e-5)
        assert [getattr(again, name) for name in CLOSED_WITH] == [getattr(row, name) for name in CLOSED_WITH]
        assert again.error_sigmas == pytest.approx(row.error_sigmas, rel=1e-3)


# --- Parts -----------------------------------------------------------------------------------------------------------


def test_a_search_is_named_by_where_it_ends() -> None:
    """Started at each of the two planes a search without the inequality stays there; with it, it never stays behind."""
    problem, truth = example()
    z_L, p, q = other_plane(truth, paper.SETUP).tolist()
    behind = (float(eq.long_axis(math, p, q, paper.SETUP.r)), z_L, math.atan(math.hypot(p, q)), math.atan2(-p, q))
    guarded = Search(Constrained(), Ipopt())
    assert end_of(without(guarded), problem, behind, truth) == BEHIND
    assert end_of(without(guarded), problem, tuple(paper.TRUTH), truth) == PLANE
    assert end_of(guarded, problem, behind, truth) == PLANE
    assert end_of(guarded, problem, None, truth) == PLANE
    # A search that has no time has not converged, wherever it stands.
    hasty = replace(guarded, solver=Ipopt(max_iter=1))
    assert end_of(hasty, problem, (10.0, 250.0, 0.3, 0.3), truth) in ("not converged", "infeasible")


def test_agreement_is_a_test_of_the_ellipse() -> None:
    assert scipy.stats.chi2(2).sf(AGREES) == pytest.approx(1e-9)


@pytest.mark.parametrize(("found", "trials"), [(0, 10_000), (0, 12), (3, 50), (5, 5)])
def test_the_upper_limit_is_clopper_and_pearsons(found: int, trials: int) -> None:
    limit = upper_limit(found, trials)
    if found == trials:
        assert limit == 1
    else:
        assert scipy.stats.binom(trials, limit).cdf(found) == pytest.approx(1 - CONFIDENCE)
    if not found:
        # The rule of three, from above.
        assert limit == pytest.approx(3 / trials, rel=3 / trials + 2e-3)


def test_rigs_are_seen_whole_and_from_the_lit_side() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        k, v = draw_rig(rng)
        x, y, z = eq.spot_point(np, v, k, np.linspace(0, 2 * np.pi, 50))
        assert z.min() > 0
        assert eq.lit_side(np, v, k) > 0
        assert np.degrees(np.arctan2(np.hypot(x, y), z)).max() < 57
        assert v.R * math.cos(v.alpha) == pytest.approx(k.r)


def test_both_maps_pass_through_the_papers_start() -> None:
    start = (paper.START.R, paper.START.z_L, *(math.degrees(angle) for angle in paper.START[2:]))
    for grid in FINE.values():
        for starts in (TILTS, DEPTHS):
            places = [s[1:] for s in starts_of(grid, maps=True) if s.starts == starts]
            assert any(np.allclose(place, start) for place in places)


def test_the_same_start_on_both_maps_is_searched_once() -> None:
    starts = tuple(Start(name, 10.0, 250.0, 20.0, 20.0) for name in (TILTS, DEPTHS))
    rows = work(Job(FAST[0], starts))
    assert [row.starts for row in rows] == [TILTS, DEPTHS]
    assert {row.end for row in rows} == {PLANE}


def test_a_search_that_ends_behind_fails(quick: Path) -> None:
    ends, rigs = read_rows(quick / "ends.csv", EndRow), read_rows(quick / "rigs.csv", RigRow)
    behind = [replace(row, end=BEHIND) if row.inequality == "with" else row for row in ends]
    assert len(list(complaints(behind, []))) == sum(row.inequality == "with" for row in ends)
    assert list(complaints([], [replace(rigs[0], closed_sqp=BEHIND), *rigs[1:]]))
    assert total(rig_shares([replace(row, solve=BEHIND) for row in rigs]), DEFAULT).behind == len(rigs)
