"""The study of rigs in use: its quick form runs, and what is committed is within its limits."""

from dataclasses import replace
from pathlib import Path

from studies import rig_checks
from studies.rig_checks_cells import CheckRow, UpdateRow
from studies.study import read_rows, write

RESULTS = Path(rig_checks.__file__).parent / "results" / "rig_checks"


def committed() -> tuple[list[CheckRow], list[UpdateRow]]:
    return read_rows(RESULTS / "checks.csv", CheckRow), read_rows(RESULTS / "updates.csv", UpdateRow)


def test_quick_form_is_within_its_limits_and_writes_its_files(tmp_path: Path) -> None:
    result = rig_checks.run("quick")
    checks = [row for row in result.tables["checks"] if isinstance(row, CheckRow)]
    updates = [row for row in result.tables["updates"] if isinstance(row, UpdateRow)]
    assert rig_checks.faults(checks, updates) == []
    write(result, tmp_path)
    names = {"checks.csv", "updates.csv", "headline.csv", "rig_checks.png", "finding.md"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_what_is_committed_is_within_its_limits_and_shows_what_is_claimed() -> None:
    checks, updates = committed()
    assert rig_checks.faults(checks, updates) == []
    most = max(row.views for row in checks)
    for row in checks:
        if row.moved != "nothing" and row.views == most:
            assert row.degraded > 0.9, row.moved
            assert row.named > 0.9, row.moved
    assert sum(row.checks for row in checks if row.moved == "nothing") >= 500
    assert all(row.updates >= 250 for row in updates)


def test_a_fault_is_found() -> None:
    checks, updates = committed()
    assert any("degraded" in fault for fault in rig_checks.faults([replace(checks[0], degraded=0.1)], updates))
    assert any("four" in fault for fault in rig_checks.faults(checks, [replace(updates[0], four=2.0)]))
    assert any("uniform" in fault for fault in rig_checks.faults([replace(checks[0], shift_uniform=1e-9)], updates))
