import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from example_rig import SIGMA_PX, TARGETS, example_rig, points_file, pose_at, seen, spot_of
from planeopt import batch
from planeopt.batch import load_spot, measure, measure_many
from planeopt.errors import InputError
from planeopt.formulations import ClosedForm
from planeopt.methods import FORMULATIONS, METHODS, SOLVERS, method_named
from planeopt.solvers import Sqp, Swift
from planeopt.spot import write_points

POSE = ("z_L_mm", "alpha_deg", "beta_deg", "R_mm", "normal", "point_mm", "sigma", "covariance", "chi2", "n_points")


@pytest.mark.parametrize("target", TARGETS, ids=lambda path: path.stem)
def test_bundled_targets_are_right_within_their_own_uncertainty(target: Path):
    record = measure(target, example_rig()).record
    truth = json.loads(target.with_suffix(".json").read_text())
    assert record.status == "ok"
    # 4.9 standard deviations: one in a million for each of the six depths.
    assert abs((record.z_L_mm or math.nan) - truth["z_L_mm"]) < 4.9 * (record.sigma.z_L_mm or 0)
    angle = math.degrees(math.acos(min(1.0, float(np.dot(record.normal or (), truth["normal"])))))
    # The squared angle over its mean is at most chi-squared with one degree of freedom: the same one in a million.
    assert angle < 4.9 * (record.sigma.normal_deg or 0)


def test_an_image_and_its_own_points_give_the_same_pose(tmp_path: Path):
    rig, target = example_rig(), TARGETS[3]
    points = tmp_path / "points.csv"
    write_points(load_spot(target, rig), points)
    from_image, from_points = (measure(path, rig).record.to_dict() for path in (target, points))
    assert {key: from_image[key] for key in POSE} == {key: from_points[key] for key in POSE}


def test_points_without_sigma_have_their_noise_estimated(tmp_path: Path):
    path = tmp_path / "points.csv"
    write_points(replace(spot_of(pose_at()), sigma=None), path)
    given, estimated = measure(points_file(tmp_path, "given.csv"), example_rig()), measure(path, example_rig())
    assert estimated.record.status == "ok"
    assert {"scale_estimated", "sigma_unknown"} <= set(estimated.record.flags)
    # The scale of 55 residuals has a relative deviation of 1/sqrt(110), 0.095: four of them.
    ratio = (estimated.record.sigma.z_L_mm or 0) / (given.record.sigma.z_L_mm or math.inf)
    assert ratio == pytest.approx(1.0, abs=0.4)


def test_upper_case_csv_is_a_file_of_points(tmp_path: Path):
    assert measure(points_file(tmp_path, "A.CSV"), example_rig()).record.status == "ok"


def test_image_without_a_spot_is_refused(tmp_path: Path):
    path = tmp_path / "black.png"
    cv2.imwrite(str(path), np.zeros((720, 960), np.uint8))
    measured = measure(path, example_rig())
    assert measured.record.status == "refused"
    assert measured.record.flags == ("too_dark",)
    assert measured.spot is None
    assert measured.solution is None


def test_points_outside_the_image_are_refused_with_where(tmp_path: Path):
    path = tmp_path / "outside.csv"
    shifted = replace(spot_of(pose_at()), points=seen(pose_at()) + np.array([900.0, 0.0]))
    write_points(shifted, path)
    record = measure(path, example_rig()).record
    assert record.status == "refused"
    assert record.flags == ("outside_image",)
    assert "960 x 720 px" in record.message


def test_error_names_the_file_and_nothing_else_is_lost(tmp_path: Path):
    bad = tmp_path / "bad.csv"
    bad.write_text("x_px,y_px\n1,2\n3,nan\n")
    good = points_file(tmp_path)
    records = list(measure_many([str(good), str(bad), str(good)], example_rig()))
    assert [record.status for record in records] == ["ok", "error", "ok"]
    assert records[1].message.startswith(f"{bad}, line 3")
    assert records[0] == records[2]


def test_a_numerical_breakdown_costs_one_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def break_down(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Singular\nmatrix")

    monkeypatch.setattr(batch, "solve", break_down)
    path = points_file(tmp_path)
    record = measure(path, example_rig()).record
    assert record.status == "error"
    assert record.message == f"{path}: the computation broke down (LinAlgError: Singular matrix)"


def test_a_programming_error_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(batch, "solve", lambda *_, **__: None)
    with pytest.raises(AttributeError):
        measure(points_file(tmp_path), example_rig())


def test_wrong_rig_is_degraded_not_ok(tmp_path: Path):
    rig = example_rig()
    wrong = replace(rig, beam=replace(rig.require_beam(), radius=7.0))
    record = measure(points_file(tmp_path), wrong).record
    assert record.status == "degraded"
    assert record.flags[0] == "inconsistent"
    assert record.z_L_mm is not None


def test_executor_gives_the_same_records_in_order(tmp_path: Path):
    rig = example_rig()
    paths = [str(points_file(tmp_path, f"{i}.csv", pose_at(200.0 + 10 * i), seed=i)) for i in range(6)]
    alone = list(measure_many(paths, rig, formulation=ClosedForm()))
    with ThreadPoolExecutor(2) as pool:
        assert list(measure_many(paths, rig, formulation=ClosedForm(), executor=pool)) == alone
    assert [record.input for record in alone] == paths


def test_measurement_is_a_pure_function_of_file_and_rig(tmp_path: Path):
    again = partial(measure, points_file(tmp_path), example_rig(), solver=Sqp())
    assert again().record == again().record


@pytest.mark.parametrize("name", ["Constrained(paper)", "constrained-paper", "CONSTRAINED PAPER"])
def test_methods_are_known_by_name(name: str):
    assert method_named(name, None).formulation.name == "Constrained(paper)"


def test_every_name_in_a_table_chooses_its_method():
    for method in METHODS:
        solver = None if method.solver is None else method.solver.name
        chosen = method_named(method.formulation.name, solver)
        assert (chosen.formulation, chosen.solver) == (method.formulation, method.solver)
    assert len(set(map(str.lower, FORMULATIONS))) == len(FORMULATIONS)
    assert set(SOLVERS) == {"Ipopt", "Sqp", "Swift", "Ipopt(penalty)"}


def test_penalty_goes_with_swift_unless_told_otherwise():
    assert isinstance(method_named("penalty", None).solver, Swift)
    assert isinstance(method_named("penalty", "sqp").solver, Sqp)


@pytest.mark.parametrize(("formulation", "solver"), [("nonsense", None), (None, "nonsense"), ("", None)])
def test_unknown_names_are_refused_with_the_known(formulation: str | None, solver: str | None):
    with pytest.raises(InputError, match=r"there are (Constrained|Ipopt)"):
        method_named(formulation, solver)


def test_noise_of_the_test_points_is_what_their_files_say(tmp_path: Path):
    # The helper that the tests above rest on: its exact points are on the ellipse, its noisy ones off by the sigma.
    exact, noisy = seen(pose_at(), 2000, noise=0.0), seen(pose_at(), 2000)
    assert np.std(noisy - exact) == pytest.approx(SIGMA_PX, rel=4 / math.sqrt(2 * 4000))
    spot = replace(spot_of(pose_at(), 2000), points=exact)
    path = tmp_path / "exact.csv"
    write_points(spot, path)
    assert measure(path, example_rig()).record.z_L_mm == pytest.approx(240.0, rel=1e-9)
