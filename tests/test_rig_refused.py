"""A rig whose calibration was refused and forced is marked, and so is what is measured with it."""

from dataclasses import replace
from pathlib import Path

import planeopt as po
from example_rig import example_rig, pose_at, spot_of
from planeopt.record import from_solution
from planeopt.solution import Flag

WHY = 'Only 3 views, all "frontal".\nTilt them.'


def test_the_mark_survives_its_file(tmp_path: Path):
    rig = replace(example_rig(), refused=WHY)
    po.save_rig(rig, tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text(encoding="utf-8")
    assert "[calibration]" in text
    assert "nothing measured with it can be defended" in text
    assert po.load_rig(tmp_path / "rig.toml") == rig


def test_a_good_rig_has_no_such_table(tmp_path: Path):
    po.save_rig(example_rig(), tmp_path / "rig.toml")
    assert "[calibration]" not in (tmp_path / "rig.toml").read_text(encoding="utf-8")
    assert po.load_rig(tmp_path / "rig.toml").refused is None


def test_what_is_measured_with_it_is_degraded():
    rig = replace(example_rig(), refused=WHY)
    solution = po.solve(spot_of(pose_at()), rig)
    record = from_solution("a.csv", solution, rig)
    assert record.status == "degraded"
    assert record.message == Flag.RIG_REFUSED.value
    assert record.flags[0] == "rig_refused"
    assert record.z_L_mm is not None
    good = from_solution("a.csv", po.solve(spot_of(pose_at()), example_rig()), example_rig())
    assert good.status == "ok"
    assert "rig_refused" not in good.flags
    batch = po.solve_batch([spot_of(pose_at())], rig)
    assert Flag.RIG_REFUSED in batch.flags[0]
