"""The paper's result within what the rounding of Table 1 allows, the second plane, the refusal, and the files."""

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from rich.console import Console

from planeopt import paper
from planeopt.estimation import solve_problem, starts
from planeopt.formulations import AsPrinted, ClosedForm, Constrained, Formulation, Penalty, Problem
from planeopt.reproduction import Reproduction, compute, reproduce, rounding
from planeopt.reproduction.files import to_dict
from planeopt.reproduction.results import Answer, table_1_problem
from planeopt.reproduction.searches import relative_misfit, second_pose, stated_plane
from planeopt.reproduction.unguarded import Unguarded
from planeopt.solution import Flag, Solution, Status
from planeopt.solvers import Ipopt, Swift

TO_DEGREES = np.array([1.0, 1.0, 180 / np.pi, 180 / np.pi])


@pytest.fixture(scope="module")
def result() -> Reproduction:
    return compute()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("reproduce") / "made" / "on the way"
    printed = io.StringIO()
    reproduce(folder, Console(width=150, file=printed))
    return folder, printed.getvalue()


def unknowns(solution: Solution) -> np.ndarray:
    assert solution.pose is not None, solution.message
    assert solution.pose.beta is not None
    return np.array([solution.pose.R, solution.pose.z_L, solution.pose.alpha, solution.pose.beta])


# --- The result ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("i", range(4), ids=["slopes", "paper", "swift", "closed form"])
def test_each_method_finds_the_plane_within_what_rounding_allows(result: Reproduction, i: int) -> None:
    answer = result.answers[i]
    assert answer.solution.ok, answer.solution.message
    assert Flag.RESTARTED not in answer.solution.flags
    assert np.all(np.abs(answer.error) <= answer.allowance.worst)
    # Rounding errors of 48 coordinates are as good as independent: 5 standard deviations are very improbable.
    assert np.all(np.abs(answer.error) <= 5 * answer.allowance.sigma)


def test_worst_case_is_what_a_search_for_it_found(result: Reproduction) -> None:
    # Found apart from this code, by trying roundings. The figures have two digits, and the errors are not quite linear:
    # 3 %.
    worst = result.answers[0].allowance.worst * TO_DEGREES
    assert worst == pytest.approx([5.5e-4, 4.0e-4, 9.1e-4, 1.4e-3], rel=0.03)


def test_both_sets_of_variables_give_one_answer(result: Reproduction) -> None:
    slopes, paper_variables = result.answers[:2]
    # A hundredth of a standard deviation of the rounding: the two searches minimise the same function.
    assert np.all(np.abs(slopes.found - paper_variables.found) < 0.01 * slopes.allowance.sigma)


@pytest.mark.parametrize(
    ("formulation", "solver", "answer"),
    [(Constrained(), Ipopt(), 0), (Penalty(), Swift(), 2), (ClosedForm(), Ipopt(), 3)],
    ids=["Constrained", "Penalty", "ClosedForm"],
)
def test_allowance_is_the_derivative_of_the_whole_method(
    result: Reproduction, formulation: Formulation, solver: Ipopt | Swift, answer: int
) -> None:
    """Points moved in the direction that the bound calls worst for an unknown move it by the bound."""
    points, B, plane, k = paper.exact_points(), paper.exact_ellipse(), stated_plane(), paper.SETUP
    by_slopes = rounding.paper_by_slopes(plane, k.r)
    by_ellipse = {
        0: by_slopes @ rounding.constrained_by_ellipse(plane, k, B, points),
        2: rounding.penalty_by_ellipse(paper.TRUTH, k, B),
        3: by_slopes @ rounding.closed_form_by_ellipse(k, B),
    }[answer]
    by_points = by_ellipse @ rounding.ellipse_by_points(B, points)
    for i in range(4):
        step = paper.ROUNDING * np.sign(by_points[i]).reshape(points.shape)
        problem = Problem.from_points(points + step, k, paper.ROUNDING / np.sqrt(3))
        found = unknowns(solve_problem(problem, formulation=formulation, solver=solver))
        moved = found[i] - paper.TRUTH[i]
        # Second-order terms: the step over the ellipse's width, 1e-5, amplified by its weak directions.
        assert moved == pytest.approx(result.answers[answer].allowance.worst[i], rel=0.01)


def test_answer_outside_the_allowance_is_not_within_rounding(result: Reproduction) -> None:
    answer = result.answers[0]
    off = Answer(answer.solution, answer.found + 2 * answer.allowance.worst, answer.allowance)
    assert answer.within_rounding
    assert not off.within_rounding


# --- The second plane ------------------------------------------------------------------------------------------------


def test_second_plane_to_four_decimals(result: Reproduction) -> None:
    pose = result.second_plane.pose
    assert pose.beta is not None
    assert round(pose.z_L, 4) == 78.4151
    assert round(math.degrees(pose.alpha), 4) == 70.7925
    assert round(math.degrees(pose.beta), 4) == -3.1653
    assert result.second_plane.misfit < 1e-12


def test_second_plane_is_reported_from_table_1_and_from_exact_points(result: Reproduction) -> None:
    exact = solve_problem(Problem.from_points(paper.exact_points(), paper.SETUP, paper.ROUNDING)).other_plane
    assert exact is not None
    assert exact.pose.z_L == pytest.approx(second_pose().z_L, rel=1e-8)
    assert exact.pose.alpha == pytest.approx(second_pose().alpha, abs=1e-8)
    # Rounding of Table 1 moves it by as much as it moves the plane, to an order of magnitude.
    reported = result.second_plane.from_table_1
    assert reported.z_L == pytest.approx(second_pose().z_L, abs=1e-3)
    assert reported.alpha == pytest.approx(second_pose().alpha, abs=np.radians(2e-3))
    assert "not visible" in result.second_plane.reason


def test_both_searches_end_on_the_plane_and_without_inequalities_on_either(result: Reproduction) -> None:
    ipopt, swift, *unguarded = result.searches
    assert ipopt.end == swift.end == "the plane"
    assert {search.end for search in unguarded} <= {"the plane", "the second plane"}
    for search in result.searches:
        assert search.poses[0] == pytest.approx(np.array(paper.START))
        assert len(search.poses) == len(search.stage) == len(search.misfit)
        # The ten fit the ellipse of the rounded points as well as rounding lets them.
        assert search.misfit[-1] < 1e-4 < 1 < search.misfit[0]


def test_without_inequalities_the_second_plane_holds_a_search_and_with_them_it_does_not() -> None:
    second, problem = second_pose(), table_1_problem()
    start = (second.R, second.z_L, second.alpha, second.beta or 0.0)
    found = Ipopt().solve(Unguarded().build(problem, starts.given(start, problem)))
    assert found.kkt.ok
    assert found.nlp.plane(found.x)[0] == pytest.approx(second.z_L, abs=1e-3)
    guarded = solve_problem(problem, start=start)
    assert guarded.ok
    assert unknowns(guarded) == pytest.approx(np.array(paper.TRUTH), abs=1e-3)


def test_misfit_is_zero_at_the_truth_and_not_beside_it() -> None:
    B = paper.exact_ellipse()
    assert relative_misfit(paper.TRUTH, B) < 1e-13
    assert relative_misfit(paper.TRUTH._replace(R=20.2), B) > 1e-3


# --- The ten as printed ----------------------------------------------------------------------------------------------


def test_as_printed_is_refused_with_counts_and_rank(result: Reproduction) -> None:
    refusal = solve_problem(table_1_problem(), formulation=AsPrinted())
    assert refusal.status is result.refusal.status is Status.OVERDETERMINED
    for solution in (refusal, result.refusal):
        assert "10 equations, 4 unknowns, laser block rank 1" in solution.message
        assert solution.pose is None


# --- What is printed and written -------------------------------------------------------------------------------------


def test_fit_to_table_1_cannot_decide_table_2(result: Reproduction) -> None:
    b4 = result.fitted_B4
    right, printed = paper.exact_ellipse()[3], paper.TABLE_2[3]
    # Both readings lie within two standard deviations of the fit.
    assert max(abs(b4.value - right), abs(b4.value - printed)) < 2 * b4.sigma


def test_tables_are_printed(written: tuple[Path, str]) -> None:
    printed = written[1]
    for words in (
        "Table 1",
        "12.8868   15.0000",
        "which angles the paper took is not recorded",
        "-194.0465",
        "stated in the paper",
        "Constrained(paper) + Ipopt",
        "Penalty + Swift",
        "ClosedForm",
        "allowed, worst",
        "78.4151",
        "70.7925",
        "-3.1653",
        "camera would be behind it",
        "10 equations, 4 unknowns, laser block rank 1",
        "e_x^2 + e_y^2 - r^2",
        "2.578947",
    ):
        assert words in printed, words


def test_printing_alone_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = reproduce(None, Console(width=80, file=io.StringIO()))
    assert result.answers[0].within_rounding
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["figure4", "figure5", "figure7"])
def test_figures_are_written(written: tuple[Path, str], name: str) -> None:
    pixels = imread(written[0] / f"{name}.png")
    assert min(pixels.shape[:2]) > 500
    # Something is drawn: neither blank nor full.
    assert 0.005 < np.mean(pixels[..., :3] < 0.9) < 0.5
    assert (written[0] / f"{name}.svg").read_text(encoding="utf-8").rstrip().endswith("</svg>")


def test_folder_holds_the_files_and_no_leftovers(written: tuple[Path, str]) -> None:
    figures = [f"figure{i}.{suffix}" for i in (4, 5, 7) for suffix in ("png", "svg")]
    assert sorted(path.name for path in written[0].iterdir()) == sorted([*figures, "reproduce.json"])


def test_json_has_all_numbers_and_no_nan(written: tuple[Path, str], result: Reproduction) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    data = json.loads((written[0] / "reproduce.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert data["format"] == 1
    assert data["table_1"]["points_mm"] == paper.table_1().tolist()
    assert "not copied" in data["table_1"]["origin"]
    assert data["table_2"]["printed"] == list(paper.TABLE_2)
    for entry, answer in zip(data["results"], result.answers, strict=True):
        assert entry["status"] == "ok"
        assert entry["within_rounding"] is True
        assert [entry["found"][key] for key in ("R_mm", "z_L_mm", "alpha_deg", "beta_deg")] == pytest.approx(
            answer.found * TO_DEGREES, rel=1e-12
        )
    assert data["second_plane"]["exact"]["z_L_mm"] == pytest.approx(78.4151, abs=5e-5)
    assert len(data["misprints"]) == len(paper.MISPRINTS)
    assert [search["name"] for search in data["searches"]] == [search.name for search in result.searches]
    assert all(len(search["R_mm"]) == len(search["misfit"]) for search in data["searches"])


def test_computed_again_the_numbers_are_the_same(written: tuple[Path, str], result: Reproduction) -> None:
    data = json.loads((written[0] / "reproduce.json").read_text(encoding="utf-8"))
    assert json.loads(json.dumps(to_dict(result))) == data
