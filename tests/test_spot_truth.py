"""Path-traced targets end to end through `planeopt pose` with the true rigs: right, precise, and honest about it.

The path tracer shares nothing with this package; its surfaces are uneven and partly glossy, its light and noise real.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from planeopt.accuracy import Truth, read_truth
from planeopt.cli import main
from planeopt.example import example_folder
from planeopt.record import PoseRecord, record_from_json

NORMAL_DEG = 0.045
DEPTH_SHARE = 0.0012e-2
SIGMAS = 3.5
RIGS_OF_DATA = ("rig-a", "rig-demo")


@dataclass(frozen=True)
class Measured:
    record: PoseRecord
    truth: Truth

    @property
    def error(self) -> NDArray[np.float64]:
        """Of (z_L, p, q)."""
        pose = self.truth.pose
        found = (self.record.z_L_mm, self.record.slopes.p, self.record.slopes.q)
        return np.array(found, dtype=float) - [pose.z_L, *pose.slopes]

    @property
    def covariance(self) -> NDArray[np.float64]:
        return np.array(self.record.covariance.matrix, dtype=float)

    @property
    def normal_deg(self) -> float:
        assert self.record.normal is not None
        away = np.linalg.norm(np.cross(self.record.normal, self.truth.plane.normal))
        return float(np.degrees(np.arcsin(away)))

    @property
    def depth_share(self) -> float:
        return abs(self.error[0]) / self.truth.pose.z_L


def folder_of(name: str) -> Path:
    if name == "example":
        return example_folder()
    data = os.environ.get("PLANEOPT_DATA")
    if data is None:
        pytest.skip("PLANEOPT_DATA, the folder of further path-traced images, is not set")
    return Path(data) / name


@pytest.mark.parametrize("name", ["example", *RIGS_OF_DATA])
def test_targets_with_the_true_rig(name: str, tmp_path: Path) -> None:
    folder = folder_of(name)
    targets = sorted((folder / "targets").glob("*.png"))
    assert targets
    output = tmp_path / "poses.jsonl"
    status = main(["pose", *map(str, targets), "--rig", str(folder / "truth_rig.toml"), "-o", str(output)])
    records = [record_from_json(line) for line in output.read_text(encoding="utf-8").splitlines()]
    assert status == 0, [record.message for record in records if record.status != "ok"]
    assert [record.input for record in records] == [str(target) for target in targets]
    measured = [Measured(r, read_truth(t.with_suffix(".json"))) for r, t in zip(records, targets, strict=True)]
    normals = [m.normal_deg for m in measured]
    assert np.median(normals) < NORMAL_DEG, normals
    depths = [m.depth_share for m in measured]
    assert np.median(depths) < DEPTH_SHARE, depths
    for m in measured:
        assert m.record.sigma.normal_deg is not None
        in_sigmas = m.error / np.sqrt(np.diag(m.covariance))
        assert np.all(np.abs(in_sigmas) < SIGMAS), (m.record.input, in_sigmas)
        assert m.normal_deg < SIGMAS * m.record.sigma.normal_deg, m.record.input
