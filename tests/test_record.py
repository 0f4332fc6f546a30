import json
import math
from dataclasses import replace

import numpy as np
import pytest

from example_rig import example_rig, pose_at, spot_of
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.formulations import AsPrinted
from planeopt.plane import Plane, SpotPose
from planeopt.record import PoseRecord, from_solution, input_error, record_from_json, spot_not_found
from planeopt.rig import RigCovariance
from planeopt.solution import Flag, Solution, Status
from planeopt.spot import NoSpotReason, SpotNotFound

KEYS = [
    *("input", "status", "message", "formulation", "solver", "z_L_mm", "alpha_deg", "beta_deg", "R_mm", "normal"),
    *("point_mm", "intercepts_mm", "slopes", "sigma", "sigma_spot", "covariance", "chi2", "dof", "p_value"),
    *("chi2_points", "dof_points", "other_plane", "mount", "n_points", "arc_fraction", "flags"),
]
NESTED = {
    "intercepts_mm": ["a", "b", "c"],
    "slopes": ["p", "q"],
    "sigma": ["z_L_mm", "alpha_deg", "beta_deg", "normal_deg"],
    "sigma_spot": ["z_L_mm", "alpha_deg", "beta_deg", "normal_deg"],
    "covariance": ["parameters", "matrix"],
}
OTHER_KEYS = ["z_L_mm", "alpha_deg", "beta_deg", "R_mm", "normal", "point_mm", "reason"]


def strict(line: str) -> dict:
    """Parse JSON as the standard has it: without NaN and infinity."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(line, parse_constant=refuse)


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(spot_of(pose_at()), example_rig())


@pytest.fixture(scope="module")
def record(solution: Solution) -> PoseRecord:
    return from_solution("points.csv", solution)


def refused_solution() -> Solution:
    return solve(spot_of(pose_at()), example_rig(), formulation=AsPrinted())


@pytest.mark.parametrize("case", ["ok", "refused", "no spot", "error"])
def test_every_record_has_all_keys_in_order(case: str, record: PoseRecord):
    records = {
        "ok": lambda: record,
        "refused": lambda: from_solution("a", refused_solution()),
        "no spot": lambda: spot_not_found("a", SpotNotFound(NoSpotReason.TOO_DARK)),
        "error": lambda: input_error("a", "a: there is no such image"),
    }
    values = strict(records[case]().to_json())
    assert list(values) == KEYS
    assert {key: list(values[key]) for key in NESTED} == NESTED
    assert values["status"] == ("refused" if case == "no spot" else case)


def test_numbers_are_the_solutions_in_mm_and_degrees(solution: Solution, record: PoseRecord):
    pose, plane, sigma = solution.pose, solution.plane, solution.sigma
    assert pose is not None
    assert plane is not None
    assert sigma is not None
    assert (record.z_L_mm, record.R_mm) == (pose.z_L, pose.R)
    assert record.alpha_deg == math.degrees(pose.alpha)
    assert record.beta_deg == math.degrees(pose.beta or math.nan)
    assert record.normal == tuple(plane.normal.tolist())
    assert (record.intercepts_mm.a, record.intercepts_mm.b, record.intercepts_mm.c) == plane.intercepts
    assert record.sigma.normal_deg == math.degrees(sigma.normal)
    assert record.sigma.z_L_mm == sigma.z_L
    assert record.covariance.parameters == ("z_L_mm", "p", "q")
    np.testing.assert_array_equal(np.array(record.covariance.matrix), solution.covariance)
    assert record.dof == 2
    assert (record.n_points, record.dof_points) == (60, 57)


def test_second_plane_is_told_with_its_reason(record: PoseRecord):
    other = strict(record.to_json())["other_plane"]
    assert list(other) == OTHER_KEYS
    assert "c < 0" in other["reason"]
    # It is the other solution, not a copy of the first: its intercept on the optical axis has the other sign.
    assert np.dot(other["normal"], other["point_mm"]) / other["normal"][2] < 0 < (record.intercepts_mm.c or 0)


def test_rigs_part_is_in_sigma_and_not_in_sigma_spot():
    rig = example_rig()
    uncertain = replace(rig, covariance=RigCovariance(("e_x", "radius"), np.diag([0.01**2, 0.005**2])))
    record = from_solution("a", solve(spot_of(pose_at()), uncertain))
    alone = from_solution("a", solve(spot_of(pose_at()), rig))
    assert record.sigma_spot == alone.sigma_spot == alone.sigma
    assert (record.sigma.z_L_mm or 0) > (record.sigma_spot.z_L_mm or math.inf)
    assert "rig_without_covariance" in alone.flags
    assert "rig_without_covariance" not in record.flags


def test_what_is_infinite_or_has_no_value_is_null(solution: Solution):
    assert solution.pose is not None
    across = replace(
        solution,
        pose=SpotPose(6.0, 240.0, 0.0, None),
        plane=Plane(np.array([0.0, 0.0, 1.0]), np.array([20.0, 15.0, 240.0])),
        chi2=math.nan,
        p_value=math.inf,
    )
    values = strict(from_solution("a", across).to_json())
    assert values["alpha_deg"] == 0
    assert values["beta_deg"] is None
    assert values["intercepts_mm"] == {"a": None, "b": None, "c": 240.0}
    assert (values["chi2"], values["dof"], values["p_value"]) == (None, None, None)
    assert values["sigma"]["beta_deg"] is None
    assert values["sigma"]["z_L_mm"] is not None


def test_plane_through_the_camera_has_no_intercepts(solution: Solution):
    through = replace(solution, plane=Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3)))
    assert from_solution("a", through).to_dict()["intercepts_mm"] == {"a": None, "b": None, "c": None}


def test_flags_are_names_and_the_cause_comes_first(solution: Solution):
    assert from_solution("a", replace(solution, flags=(Flag.WEAK, Flag.WEAK, Flag.SHORT_ARC))).flags == (
        "weak",
        "short_arc",
    )
    doubtful = from_solution("a", replace(solution, status=Status.INCONSISTENT, flags=(Flag.WEAK,)))
    assert doubtful.status == "degraded"
    assert doubtful.flags == ("inconsistent", "weak")
    assert spot_not_found("a", SpotNotFound(NoSpotReason.TOO_DARK)).flags == ("too_dark",)


def test_a_line_reads_back_equal(record: PoseRecord):
    line = record.to_json()
    assert "\n" not in line
    assert record_from_json(line) == record
    assert record_from_json(line).to_json() == line


def test_any_file_name_makes_valid_ascii_that_reads_back():
    name = "a\n\udce9ü\t.png"  # what Python makes of a name that is not UTF-8
    line = input_error(name, "unreadable").to_json()
    assert line.isascii()
    assert "\n" not in line
    assert record_from_json(line).input == name


@pytest.mark.parametrize(
    "line", ["", "{", "[]", '{"input": "a"}', '{"input": 1, "status": "ok", "message": ""}', "NaN"]
)
def test_what_is_no_record_is_refused(line: str):
    with pytest.raises(InputError, match="not a pose record"):
        record_from_json(line)
