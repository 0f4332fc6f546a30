"""The study of many images: its quick form runs, and what is committed is within its limits."""

from dataclasses import replace
from pathlib import Path

from studies import many_images
from studies.many_images_cells import CheckRow, CombineRow
from studies.study import read_rows, write

RESULTS = Path(many_images.__file__).parent / "results" / "many_images"


def test_quick_form_is_within_its_limits_and_writes_its_files(tmp_path: Path) -> None:
    result = many_images.run("quick")
    frames = [row for row in result.tables["frames"] if isinstance(row, CombineRow)]
    checks = [row for row in result.tables["checks"] if isinstance(row, CheckRow)]
    assert many_images.faults(frames, checks) == []
    write(result, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"frames.csv", "checks.csv", "many_images.png", "finding.md", "headline.csv"}


def test_what_is_committed_is_within_its_limits_and_shows_what_is_claimed() -> None:
    frames = read_rows(RESULTS / "frames.csv", CombineRow)
    checks = read_rows(RESULTS / "checks.csv", CheckRow)
    assert many_images.faults(frames, checks) == []
    one, many = frames[0], frames[-1]
    assert many.frames >= 256
    assert abs(many.frames * (many.sigma_z_spot_mm / one.sigma_z_spot_mm) ** 2 - 1) < 0.02
    assert abs(many.sigma_z_rig_mm / one.sigma_z_rig_mm - 1) < 0.01
    # Weights that take noise for knowledge fail where ours hold.
    assert many.believing > 2
    turned = [row for row in checks if row.turn_mrad == max(row.turn_mrad for row in checks)]
    assert all(row.degraded > 0.9 for row in turned)
    right = [row for row in checks if row.turn_mrad == 0 and row.images > 1]
    assert all(row.naive > 10 * max(row.degraded, 1e-3) for row in right)


def test_a_fault_is_found() -> None:
    frames = read_rows(RESULTS / "frames.csv", CombineRow)
    checks = read_rows(RESULTS / "checks.csv", CheckRow)
    wrong = [replace(row, total=row.believing) for row in frames]
    assert any("total error" in fault for fault in many_images.faults(wrong, checks))
