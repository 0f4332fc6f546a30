"""The study of times runs and writes its files; no time is asserted, but what committed ones say of their growth is."""

from pathlib import Path

from studies import scaling
from studies.__main__ import RESULTS
from studies.scaling_runs import TimeRow, growth
from studies.scaling_workers import WorkerRow
from studies.study import read_rows
from study_files import written

COMMITTED = RESULTS / "scaling"


def test_the_quick_study(tmp_path: Path) -> None:
    result = scaling.run("quick")
    written(result, tmp_path, COMMITTED)
    times = read_rows(tmp_path / "times.csv", TimeRow)
    assert {row.axis for row in times} == {"frames", "points", "views", "walkers"}
    workers = read_rows(tmp_path / "workers.csv", WorkerRow)
    assert all(row.failed == "" for row in workers)
    assert {row.place for row in workers} == {"in process", "processes"}


def test_an_exponent_is_that_of_its_power_law() -> None:
    rows = [TimeRow("points", "x", size, 3e-6 * size**1.5, 3.0 * size**0.5) for size in (10, 30, 200)]
    (found,) = growth(rows)
    assert abs(found.exponent - 1.5) < 1e-12
    assert abs(found.exponent_at_the_end - 1.5) < 1e-12
