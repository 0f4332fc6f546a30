"""Maximum likelihood at the Cramér-Rao bound: the quick form of `studies/efficiency.py`.

Its full form is committed in `studies/results/efficiency`, and held to the same.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from studies import efficiency
from studies.__main__ import RESULTS, STUDIES
from studies.efficiency_cells import (
    ARCS,
    DEPTHS_MM,
    NOISES_PX,
    OFFSETS_MM,
    RADII_MM,
    TILTS_DEG,
    Cell,
    CellRow,
    Job,
    cells_of,
    measure,
    squared_errors,
    within,
)
from studies.efficiency_summary import EFFICIENT, VerdictRow, finding, headline, limits, verdicts
from studies.study import read_rows, write

COMMITTED = RESULTS / "efficiency"


def complaints(rows: Sequence[CellRow]) -> Iterator[str]:
    """Everything that is asked of the bound and its criterion and does not hold, in words."""
    least, most = limits(rows)
    for row, low, high in zip(rows, least, most, strict=True):
        if row.over_bound < low:
            yield f"below the bound by more than chance: {row}"
        if row.excess <= 1 and row.over_bound > high:
            yield f"above {EFFICIENT} by more than chance where the bound can be reached: {row}"
        if row.excess <= 1 and row.lost:
            yield f"{row.lost} draws without a plane: {row}"
        # What the answers say of themselves is what the truth says, but near the edge.
        if (row.noticed > 0.5 and row.excess < 0.9) or (row.noticed < 0.5 and row.excess > 1.1):
            yield f"the criterion says another thing at the answers: {row}"
    inside = within(rows)
    solved = np.array([row.draws - row.lost for row in inside])
    pooled = np.sqrt(np.sum(solved * np.array([row.over_bound for row in inside]) ** 2) / np.sum(solved))
    if pooled > EFFICIENT:
        yield f"{pooled} over all draws"


def test_the_quick_study(tmp_path: Path) -> None:
    result = efficiency.run("quick")
    write(result, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in COMMITTED.iterdir()}
    rows = read_rows(tmp_path / "cells.csv", CellRow)
    wrong = list(complaints(rows))
    assert not wrong, "\n".join(wrong)
    assert min(len(within(rows)), len(rows) - len(within(rows))) >= 10


def test_the_full_study_as_committed() -> None:
    rows = read_rows(COMMITTED / "cells.csv", CellRow)
    wrong = list(complaints(rows))
    assert not wrong, "\n".join(wrong)
    cells = [Cell(**{name: getattr(row, name) for name in Cell.__dataclass_fields__}) for row in rows]
    assert cells == cells_of("full")
    assert (min(TILTS_DEG), max(TILTS_DEG), min(DEPTHS_MM), max(DEPTHS_MM)) == (0, 70, 100, 1000)
    assert (min(NOISES_PX), max(NOISES_PX), min(ARCS), max(ARCS)) == (0.05, 1, 0.3, 1)
    assert (min(OFFSETS_MM), max(OFFSETS_MM), max(RADII_MM)) == (0, 40, 10)
    assert all(row.draws >= 2000 for row in within(rows))
    found = verdicts(rows)
    assert found == read_rows(COMMITTED / "verdicts.csv", VerdictRow) or _alike(found)
    # Beyond the criterion there are cells that are truly beyond the bound: it is not for nothing.
    assert found[1].above >= 5


def _alike(found: Sequence[VerdictRow]) -> bool:
    """The tables hold six digits."""
    committed = read_rows(COMMITTED / "verdicts.csv", VerdictRow)
    return all(
        getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-5)
        for one, other in zip(found, committed, strict=True)
        for name in VerdictRow.__dataclass_fields__
        if name != "criterion"
    )


def test_the_finding_and_the_index_say_what_the_tables_say() -> None:
    rows = read_rows(COMMITTED / "cells.csv", CellRow)
    found = verdicts(rows)
    assert (COMMITTED / "finding.md").read_text(encoding="utf-8") == finding(rows, found) + "\n"
    index = (RESULTS.parent / "README.md").read_text(encoding="utf-8")
    said = index.split("<!-- efficiency -->\n")[1].split("<!-- /efficiency -->")[0]
    assert " ".join(said.split()) == headline(found)
    assert "efficiency" in STUDIES


def test_a_cell_is_measured_again() -> None:
    """A committed cell, by the same draws: equal but for rounding that other machines' arithmetic leaves."""
    rows = read_rows(COMMITTED / "cells.csv", CellRow)
    before = within(rows)[7]
    cell = Cell(**{name: getattr(before, name) for name in Cell.__dataclass_fields__})
    again = measure(Job(cell, before.draws))
    for name in ("sigma_over_axis", "curvature", "slope_sigma", "over_bound", "isotropic_over_bound", "covered_95"):
        assert getattr(again, name) == pytest.approx(getattr(before, name), rel=1e-4)


def test_an_estimator_that_loses_a_tenth_fails() -> None:
    rows = read_rows(COMMITTED / "cells.csv", CellRow)
    worse = [CellRow(**{**vars(row), "over_bound": 1.1 * row.over_bound}) for row in rows]
    assert sum("above" in complaint for complaint in complaints(worse)) > 100
    better = [CellRow(**{**vars(row), "over_bound": 0.9 * row.over_bound}) for row in rows]
    assert sum("below" in complaint for complaint in complaints(better)) > 100


def test_errors_are_measured_in_the_metric_of_the_covariance() -> None:
    rng = np.random.default_rng(0)
    root = np.diag([1e-3, 1.0, 1e3]) @ rng.normal(size=(3, 3))
    errors = rng.normal(size=(20, 3))
    np.testing.assert_allclose(squared_errors(errors @ root.T, root @ root.T), np.sum(errors**2, axis=1), rtol=1e-6)
