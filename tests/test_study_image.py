"""Boundary and plane from simulated images: unbiased, at the bound, honest: the quick form of `studies/image.py`.

Its full form is committed in `studies/results/image`, and held to the same.
"""

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from studies import image
from studies.__main__ import RESULTS
from studies.image_cells import CellRow, Image, cells_of, measure_image, summary
from studies.image_flags import FlagRow
from studies.image_poses import CASES, HARD, Job, PoseRow, measure_pose
from studies.image_summary import RIGHT, CaseRow, HonestyRow, honesty_of
from studies.image_sweeps import AXES, KINDS, SweepRow
from studies.statistics import LEVEL
from studies.study import Mode, read_rows
from study_files import written

COMMITTED = RESULTS / "image"
BIAS_PX, BIAS_OVER_PX, OVER_BOUND = 0.02, 0.05, 1.5
FALSE_ALARMS = 0.01
ENOUGH_PX = 0.001


@dataclass(frozen=True)
class Tables:
    cells: Sequence[CellRow]
    sweeps: Sequence[SweepRow]
    cases: Sequence[CaseRow]
    honesty: Sequence[HonestyRow]
    flags: Sequence[FlagRow]
    poses: Sequence[PoseRow]


def committed() -> Tables:
    kinds = {"cells": CellRow, "sweeps": SweepRow, "cases": CaseRow, "honesty": HonestyRow}
    kinds |= {"flags": FlagRow, "poses": PoseRow}
    return Tables(**{name: read_rows(COMMITTED / f"{name}.csv", kind) for name, kind in kinds.items()})


def complaints(tables: Tables) -> list[str]:
    """Everything that is asked of the measurement and does not hold, in words."""
    families = (
        boundaries(tables.cells),
        axes(tables.sweeps),
        cases(tables.cases),
        honesty(tables.honesty),
        flags(tables.flags),
    )
    return [complaint for family in families for complaint in family]


def boundaries(rows: Sequence[CellRow]) -> Iterator[str]:
    tail = LEVEL / 2 / len(rows)
    for row in rows:
        n = row.images - row.refused
        # Where the edge is less than 10 times the noise, which is flagged as faint, a refusal is an answer.
        if row.contrast >= 10 * row.noise and row.refused > scipy.stats.binom.isf(tail, row.images, 1 - RIGHT):
            yield f"refused {row.refused} of {row.images}: {row}"
        if n < 2:
            continue
        # What is asked, and what noise within the limit makes of it in so few images.
        bias = BIAS_PX if row.over == 1 else BIAS_OVER_PX
        bias += scipy.stats.norm.isf(tail) * OVER_BOUND * row.least_error_px
        if not abs(row.bias_px) < bias:
            yield f"bias of {row.bias_px:.4f} px, beyond {bias:.4f}: {row}"
        for what, over_bound, freedom in (
            ("points", row.points_over_bound, np.inf),
            ("size", row.size_over_bound, n),
            ("shape", row.shape_over_bound, 4 * n),
        ):
            limit = OVER_BOUND
            if np.isfinite(freedom):
                limit *= np.sqrt(scipy.stats.chi2.isf(tail, freedom) / freedom)
                # A thousandth of a pixel is enough of an ellipse, whatever the noise would allow.
                limit = max(limit, ENOUGH_PX / (row.least_error_px * np.sqrt(n)))
            if not over_bound < limit:
                yield f"{what} {over_bound:.2f} times the bound, beyond {limit:.2f}: {row}"


def axes(rows: Sequence[SweepRow]) -> Iterator[str]:
    """As `boundaries`; with speckle, of which the bound knows nothing, by the scatter of the images themselves."""
    tail = LEVEL / 2 / len(rows)
    for row in rows:
        n = row.images - row.refused
        faint = row.axis == "contrast" and row.value < 20
        if not faint and row.refused > scipy.stats.binom.isf(tail, row.images, 1 - RIGHT):
            yield f"refused {row.refused} of {row.images}: {row}"
        if n < 2:
            continue
        speckled = row.axis == "speckle" and row.value > 0
        bias = BIAS_OVER_PX if row.axis == "over" and row.value > 1 else BIAS_PX
        chance = scipy.stats.norm.isf(tail) * OVER_BOUND * row.least_error_px
        if speckled:
            chance = scipy.stats.t.isf(tail, n - 1) * row.bias_error_px
        if not abs(row.bias_px) < bias + chance:
            yield f"bias of {row.bias_px:.4f} px, beyond {bias + chance:.4f}: {row}"
        if not speckled and not row.points_over_bound < OVER_BOUND:
            yield f"noise {row.points_over_bound:.2f} times the bound: {row}"


def cases(rows: Sequence[CaseRow]) -> Iterator[str]:
    # Right is within 4 of the own standard deviations in each of three numbers: chance alone goes beyond now and then.
    by_chance = 3 * 2 * scipy.stats.norm.sf(4)
    for row in rows:
        beyond = scipy.stats.binom.isf(LEVEL / 2 / len(rows), row.images, by_chance)
        if row.right < row.least_right or row.broken or row.degraded + row.wrong > beyond:
            yield f"{row}"
    right, images = sum(row.right for row in rows), sum(row.images for row in rows)
    if right < scipy.stats.binom.ppf(LEVEL / 2, images, RIGHT):
        yield f"{right} of {images} planes are right"


def honesty(rows: Sequence[HonestyRow]) -> Iterator[str]:
    for row in rows:
        if not row.least_variance < row.variance < row.largest_variance:
            yield f"{row}"
        if row.kolmogorov_p < LEVEL / len(rows):
            yield f"not normal: {row}"


def flags(rows: Sequence[FlagRow]) -> Iterator[str]:
    tail = LEVEL / 2 / len(rows)
    for row in rows:
        silent = row.said < scipy.stats.binom.ppf(tail, row.images, RIGHT)
        if silent if row.expected else row.said > scipy.stats.binom.isf(tail, row.images, FALSE_ALARMS):
            yield f"{row}"
    said = sum(row.said for row in rows if row.expected)
    faulty = sum(row.images for row in rows if row.expected)
    if said < scipy.stats.binom.ppf(LEVEL / 2, faulty, RIGHT):
        yield f"{said} of {faulty} faults are said"


def test_the_quick_study(tmp_path: Path) -> None:
    result = image.run("quick")
    written(result, tmp_path, COMMITTED)
    wrong = complaints(Tables(**result.tables))  # pyright: ignore[reportArgumentType] - rows of the kinds above
    assert not wrong, "\n".join(wrong)


def test_the_full_study_as_committed() -> None:
    tables = committed()
    assert not complaints(tables), "\n".join(complaints(tables))
    assert min(row.images for row in tables.cases) >= 200
    # Over all hard cases the share itself holds, not only what chance would excuse in each.
    hard = [row for row in tables.cases if row.case in HARD]
    assert sum(row.right for row in hard) >= RIGHT * sum(row.images for row in hard)
    assert {row.case for row in tables.cases} == set(CASES)
    assert {(row.kind, row.over) for row in tables.cells} == {(k, o) for k in ("disc", "ring") for o in (1.0, 2.0)}
    assert sum(row.case == "plain" for row in tables.poses) >= 400
    places = [(axis, value, kind) for axis, values in AXES.items() for value in values for kind in KINDS]
    assert [(row.axis, row.value, row.kind) for row in tables.sweeps] == places
    # Noise grows with blur and speckle, and falls with contrast, from one end to the other.
    ends = {(row.axis, row.value, row.kind): row.points_px for row in tables.sweeps}
    for kind in KINDS:
        for axis, more in (("blur_px", True), ("contrast", False), ("speckle", True)):
            assert (ends[axis, AXES[axis][-1], kind] > 1.4 * ends[axis, AXES[axis][0], kind]) is more


def test_the_committed_numbers_are_those_of_this_code() -> None:
    """An image of some cases, and a cell; to a hundredth, since the last digits are the linear algebra's."""
    known = {(row.case, row.seed): row for row in committed().poses}
    for case in ("plain", "speckle", "faint", "small"):
        again, before = measure_pose(Job(case, 0)), known[case, 0]
        assert (again.outcome, again.reason, again.flags) == (before.outcome, before.reason, before.flags)
        numbers = [[row.z_L_sigmas, row.p_sigmas, row.q_sigmas, row.mahalanobis] for row in (again, before)]
        np.testing.assert_allclose(*numbers, rtol=0.01, atol=0.01)
    full: Mode = "full"
    chosen = next(c for c, _ in cells_of(full) if c.radius_px == 8 and c.kind == "disc")
    before = next(
        row
        for row in committed().cells
        if (row.kind, row.over, row.radius_px, row.blur_px, row.contrast, row.noise) == astuple(chosen)
    )
    again = summary(chosen, [measure_image(Image(chosen, draw)) for draw in range(before.images)])
    assert again.bias_px == pytest.approx(before.bias_px, abs=1e-4)
    assert again.shape_over_bound == pytest.approx(before.shape_over_bound, rel=0.01)


def test_honesty_is_judged() -> None:
    """Sigmas a quarter too small or too large fail."""
    rng = np.random.default_rng(0)
    for scale, honest in ((0.8, False), (1.0, True), (1.25, False)):
        errors = (scale * rng.standard_normal((400, 3))).tolist()
        poses = [PoseRow("plain", i, "right", z_L, p, q, 0, 0, "", "") for i, (z_L, p, q) in enumerate(errors)]
        assert (not list(honesty(honesty_of(poses)))) is honest
