"""Intervals hold the truth as often as they claim: the quick form of `studies/coverage.py`.

Its full form is committed in `studies/results/coverage`, and held to the same.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from cases import WORKED_SETUP
from planeopt.estimation.distances import distances
from planeopt.formulations import Problem
from planeopt.posterior import Prior
from planeopt.rig import Rig
from studies import coverage
from studies.__main__ import RESULTS
from studies.coverage_checks import DRAWS, LEVELS, RANKS, UNRANKED, covered
from studies.coverage_draws import (
    QUANTITIES,
    Truth,
    draw_covariance,
    draw_planes,
    draw_rig,
    draw_spot,
    draw_true_rig,
    draw_truth,
    setup_of,
)
from studies.coverage_images import ImageRow
from studies.coverage_points import ARCS, NOISE_PX, Job, SetRow, sets_of
from studies.coverage_rig import WrongRigRow
from studies.coverage_summary import (
    IGNORING,
    IMAGES,
    POINTS,
    UNCERTAIN,
    CoverageRow,
    RankRow,
    groups_of,
    judge,
    ranks_of,
)
from studies.statistics import LEVEL, binomial_limits, uniform_p
from studies.study import read_rows
from study_files import written

COMMITTED = RESULTS / "coverage"
ENOUGH = 50
"""Sets that show a coverage of a third for what it is."""


@dataclass(frozen=True)
class Tables:
    sets: Sequence[SetRow]
    images: Sequence[ImageRow]
    wrong_rig: Sequence[WrongRigRow]
    coverage: Sequence[CoverageRow]
    ranks: Sequence[RankRow]


KINDS = {"sets": SetRow, "images": ImageRow, "wrong_rig": WrongRigRow, "coverage": CoverageRow, "ranks": RankRow}


@pytest.fixture(scope="module")
def committed() -> Tables:
    return Tables(**{name: read_rows(COMMITTED / f"{name}.csv", kind) for name, kind in KINDS.items()})


def complaints(tables: Tables) -> Iterator[str]:
    """Everything that is asked and does not hold."""
    for row in (*tables.coverage, *tables.ranks):
        if row.group != IGNORING and not row.within:
            yield f"{row}"
    # All that is wrong of these intervals is that the offset's 0.04 mm is left out.
    ignoring = [row for row in tables.coverage if (row.group, row.level) == (IGNORING, 0.95) and row.sets >= ENOUGH]
    assert {row.quantity for row in ignoring} == set(QUANTITIES)
    yield from (f"ignored, and no harm: {row}" for row in ignoring if row.covered >= row.least)


def test_the_quick_study(tmp_path: Path) -> None:
    result = coverage.run("quick")
    written(result, tmp_path, COMMITTED)
    tables = Tables(**result.tables)  # pyright: ignore[reportArgumentType] - rows of the kinds above
    assert not list(complaints(tables)), "\n".join(complaints(tables))
    assert {row.group for row in tables.coverage} == set(groups_of(tables.sets, tables.images, tables.wrong_rig))


def test_the_full_study_as_committed(committed: Tables) -> None:
    assert not list(complaints(committed)), "\n".join(complaints(committed))
    assert len(committed.sets) >= 1000
    assert sum(row.outcome == "measured" for row in committed.images) >= 200
    # Every set counts, whatever became of it.
    assert all(row.z_L_rank != UNRANKED for row in committed.sets)
    assert {(row.covariance, row.arc) for row in committed.sets} == {(c, a) for c in ("none", "given") for a in ARCS}
    low, high = np.quantile([row.sigma_px for row in committed.sets], [0.05, 0.95])
    assert NOISE_PX.low < low < 0.15 < 0.7 < high < NOISE_PX.high
    shares = {(row.group, row.method) for row in committed.coverage}
    assert shares == {(g, m) for g in groups_of([], [], []) for m in ("Laplace", "posterior")}


def test_the_committed_numbers_are_those_of_this_code(committed: Tables) -> None:
    """A rig without and one with a covariance; the last digits are the linear algebra's.

    A rank may be another where the chain's random numbers are used otherwise: the difference of two binomial counts of
    199 has a standard deviation of at most 10.
    """
    for rig in (0, 1):
        known = [row for row in committed.sets if row.rig == rig]
        for again, before in zip(sets_of(Job(rig, len(known), 1)), known, strict=True):
            assert (again.points, again.passed_over) == (before.points, before.passed_over)
            assert again.z_L_sigmas == pytest.approx(before.z_L_sigmas, abs=1e-3, nan_ok=True)
            if again.z_L_rank != UNRANKED:
                assert abs(again.z_L_rank - before.z_L_rank) < 45


def test_planes_are_drawn_from_the_prior_that_is_sampled() -> None:
    """Against the density of `planeopt.posterior.Prior`, integrated by quadrature over what can be seen."""
    prior, setup, n = Prior(depth_radii=(4.0, 40.0)), WORKED_SETUP, 20_000
    planes = draw_planes(prior, setup, n, np.random.default_rng(0))
    log_z = np.log(setup.r * np.geomspace(*prior.depth_radii, 101))
    log_z = (log_z[1:] + log_z[:-1]) / 2
    cosine = 1 - (np.arange(200) + 0.5) / 200 * (1 - math.cos(prior.max_tilt))
    turn = (np.arange(90) + 0.5) / 90 * 2 * np.pi
    z, c, t = np.meshgrid(np.exp(log_z), cosine, turn, indexing="ij")
    slope = np.sqrt(1 - c * c) / c
    grid = np.stack([z, slope * np.cos(t), slope * np.sin(t)], axis=-1)
    # d p d q = slope d slope d turn, and d slope / d cosine = -1 / (cosine^2 sine).
    weight = np.exp(prior.log_density(grid, setup)) * slope / (c * c * np.sqrt(1 - c * c))
    seen = (z > setup.r * slope) & (z - grid[..., 1] * setup.e_x - grid[..., 2] * setup.e_y > 0)
    weight = np.where(seen, weight, 0.0)
    for of in (lambda x: np.log(x[..., 0]), lambda x: x[..., 1], lambda x: np.hypot(x[..., 1], x[..., 2])):
        values, edges = of(grid), np.quantile(of(planes), np.linspace(0.05, 0.95, 10))
        expected = [np.sum(weight[values <= edge]) / np.sum(weight) for edge in edges]
        error = np.array(expected) - np.linspace(0.05, 0.95, 10)
        # Of 30 quantiles, two-sided, family-wise 0.001; and 0.005 for the grid.
        assert np.all(np.abs(error) < scipy.stats.norm.isf(LEVEL / 60) * np.sqrt(0.25 / n) + 0.005)


def test_boundary_points_have_the_noise_that_they_claim() -> None:
    rng = np.random.default_rng(1)
    rig = draw_rig(rng, covariance=False)
    truth = draw_truth(rig, Prior(depth_radii=(20.0, 30.0)), rng)
    squares = []
    for _ in range(50):
        problem = Problem.from_spot(draw_spot(truth, arc=1.0, points=100, sigma_px=0.2, rng=rng), rig)
        assert problem.noise is not None
        assert problem.points is not None
        squares.append(np.sum(distances(np.array(truth.plane), problem.points, problem.noise, problem.setup) ** 2))
    low, high = scipy.stats.chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], 5000)
    assert low < sum(squares) < high


def test_the_true_rig_varies_as_its_covariance_says() -> None:
    rng = np.random.default_rng(2)
    rig = replace(draw_rig(rng, covariance=False), covariance=draw_covariance(rng))
    assert rig.covariance is not None
    names = rig.covariance.parameters
    drawn = np.array([[true.parameter(n) for n in names] for true in (draw_true_rig(rig, rng) for _ in range(500))])
    off = drawn - [rig.parameter(n) for n in names]
    squares = np.sum(off * np.linalg.solve(rig.covariance.matrix, off.T).T)
    low, high = scipy.stats.chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], 500 * len(names))
    assert low < squares < high


def test_a_truth_says_what_a_rig_would_report() -> None:
    rng = np.random.default_rng(3)
    rig: Rig = draw_rig(rng, covariance=False)
    truth = Truth(rig, (60 * rig.require_beam().radius, 0.3, -0.4))
    assert truth.quantities["alpha"] == pytest.approx(math.atan(0.5))
    assert truth.quantities["R"] == pytest.approx(rig.require_beam().radius * math.sqrt(1.25))
    assert truth.quantities["z_L"] == pytest.approx(truth.plane[0] - rig.axial_shift)
    assert setup_of(rig).f == rig.focal_length


def test_ranks_cover_exactly() -> None:
    """Of the equally likely ranks 68 and 95 % are within, without a rest."""
    every = np.arange(RANKS)
    assert [float(covered(every, level).mean()) for level in LEVELS] == list(LEVELS)
    assert DRAWS == 199


@pytest.mark.parametrize(("scale", "honest"), [(0.8, False), (1.0, True), (1.25, False)])
def test_coverage_is_judged(scale: float, honest: bool) -> None:
    """Posteriors and sigmas a quarter too narrow or too wide fail, with as many sets as the study has."""
    rng = np.random.default_rng(4)
    errors = rng.standard_normal((1000, 5)) * scale
    ranks = np.minimum(scipy.stats.norm.cdf(errors) * RANKS, DRAWS).astype(int)
    rows = []
    for error, rank in zip(errors.tolist(), ranks.tolist(), strict=True):
        names = {f"{q}_sigmas": e for q, e in zip(QUANTITIES, error, strict=True)}
        names |= {f"{q}_rank": r for q, r in zip(QUANTITIES, rank, strict=True)}
        rows.append(ImageRow(**names, seed=0, kind="disc", covariance="none", outcome="measured"))
    proportions, tests = judge({POINTS: rows, IMAGES: rows, UNCERTAIN: rows})
    assert all(row.within for row in (*proportions, *tests)) is honest
    assert len(ranks_of(rows, "q")) == 1000


def test_limits_of_a_family() -> None:
    least, most = binomial_limits(1000, 0.95, 100)
    tails = scipy.stats.binom.cdf(least - 1, 1000, 0.95), scipy.stats.binom.sf(most, 1000, 0.95)
    assert max(tails) <= LEVEL / 200 < scipy.stats.binom.cdf(least, 1000, 0.95)
    assert uniform_p(list(range(200)), 200, 20) == 1.0
    with pytest.raises(ValueError, match="evenly"):
        uniform_p([0], 199, 20)
