"""The published numbers; of each misprint, the corrected reading agrees with what is known and the printed does not."""

import numpy as np
import pytest

from cases import WORKED, WORKED_SETUP, boundary
from planeopt import equations as eq
from planeopt import paper
from planeopt.conic import least_squares


def test_worked_example_lies_on_the_beam() -> None:
    assert paper.TRUTH == WORKED
    assert paper.SETUP == WORKED_SETUP
    assert eq.laser_constraint(np, paper.TRUTH, paper.SETUP) == pytest.approx(0, abs=1e-14)
    assert paper.TRUTH._asdict() | {"alpha": 60, "beta": 30} == {"R": 20.0, "z_L": 75.0, "alpha": 60, "beta": 30}
    assert np.degrees(paper.TRUTH[2:]) == pytest.approx([60, 30])
    assert (*paper.START[:2], *np.degrees(paper.START[2:])) == pytest.approx((10, 250, 20, 20))


def test_table_1_has_24_points_with_four_decimals() -> None:
    points = paper.table_1()
    assert points.shape == (24, 2)
    assert np.abs(points * 1e4 - np.round(points * 1e4)).max() < 1e-9
    exact = boundary(paper.TRUTH, paper.SETUP, paper.TABLE_1_ANGLES)
    assert np.abs(points - exact).max() <= paper.ROUNDING
    # On the beam (3) is e + r (cos b, sin b), z_L at theta = 0, and e + r (-sin b, cos b), z_L + R sin a at 90 deg.
    at_0 = 25 * np.array([30 + 10 * np.sqrt(0.75), 45]) / 75
    at_90 = 25 * np.array([25, 40 + 10 * np.sqrt(0.75)]) / (75 + 20 * np.sqrt(0.75))
    assert points[[0, 6]] == pytest.approx(np.round([at_0, at_90], 4), abs=1e-12)


def test_least_squares_fit_to_table_1_is_the_one_recorded_of_the_printed_table() -> None:
    # Of the printed table a fit is recorded: B_4 = -194.049 +- 0.003. Another choice of angles gives another number.
    fit = least_squares(paper.table_1(), paper.ROUNDING / np.sqrt(3))
    assert fit.covariance is not None
    assert round(float(fit.B[3]), 3) == -194.049
    assert round(float(np.sqrt(fit.covariance[3, 3])), 3) == 0.003


def test_table_2_is_6_at_the_stated_solution_but_for_two_swapped_digits() -> None:
    exact = paper.exact_ellipse()
    assert exact == pytest.approx([-3.989885, 8.886751, 31.445856, -194.045574, 1111.111111], abs=5e-7)
    wrong = np.abs(np.array(paper.TABLE_2) - exact) > paper.ROUNDING
    assert wrong.tolist() == [False, False, False, True, False]
    printed, right = f"{paper.TABLE_2[3]:.4f}", f"{exact[3]:.4f}"
    assert sorted(printed) == sorted(right)
    assert sum(a != b for a, b in zip(printed, right, strict=True)) == 2


@pytest.mark.parametrize("misprint", paper.MISPRINTS, ids=lambda misprint: misprint.where)
def test_evidence_decides_for_the_corrected_reading(misprint: paper.Misprint) -> None:
    evidence = misprint.evidence()
    assert evidence
    assert misprint.printed != misprint.right
    for number in evidence:
        assert number.decides, number
        # No matter of rounding: the printed reading is off by at least ten times what is allowed.
        assert abs(number.printed - number.expected) > 10 * number.tolerance, number


def test_evidence_has_the_numbers_that_were_found_by_hand() -> None:
    semi_axes, a_coefficients, _, constant, table_2 = (m.evidence() for m in paper.MISPRINTS)
    assert round(semi_axes[0].printed, 2) == 2.58
    assert [round(e.printed, 2) for e in a_coefficients[:2]] == [-1.22, -3.31]
    # d_5/d_0 is e_x^2 + e_y^2 - r^2 = 2400 at the stated solution, and -r^2 = -100 is what the paper prints.
    assert constant[0].printed == pytest.approx(2500, abs=1e-9)
    assert table_2[0].printed == -194.0465


def test_evidence_that_does_not_distinguish_does_not_decide() -> None:
    assert not paper.Evidence("", "1", expected=1, tolerance=0.1, right=1, printed=1.05).decides
    assert not paper.Evidence("", "1", expected=1, tolerance=0.1, right=1.2, printed=2).decides


def test_printed_3_has_its_axes_exchanged() -> None:
    # A quarter turn on: the printed spot's long axis lies along the tilt axis.
    x, y, z = paper.printed_spot_point(np, paper.TRUTH, paper.SETUP, np.array([0.0, np.pi / 2]))
    offset = np.stack([x, y, z], axis=1) - [30, 40, 75]
    assert np.linalg.norm(offset, axis=1) == pytest.approx([20, 10])


def test_printed_9_is_no_circle_at_the_stated_solution() -> None:
    printed, right = (conic(np, paper.TRUTH, paper.SETUP) for conic in (paper.printed_laser_conic, eq.laser_conic))
    assert right[1] / right[0] == pytest.approx(0, abs=1e-14)
    assert abs(printed[1] / printed[0]) > 1


def test_d5_misprint_does_not_show_in_the_worked_example() -> None:
    assert paper.printed_d5(np, paper.TRUTH, paper.SETUP) == pytest.approx(
        eq.laser_conic(np, paper.TRUTH, paper.SETUP)[5], rel=1e-12
    )
