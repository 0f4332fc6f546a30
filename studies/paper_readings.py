"""The ten equations with a misprint left in them, solved: which plane comes out."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.executors import ordered_map
from planeopt.plane import SpotPose

Array = NDArray[np.float64]
Conic = Callable[[eq.PaperVariables, eq.Setup], Any]


@dataclass(frozen=True)
class Reading:
    """The ten equations, as corrected unless said otherwise.

    Attributes
    ----------
    name : str
    swapped : bool
        (3), and so (6) and (9), with ``R`` along the tilt axis.
    a_printed, d5_printed, eq15_printed, table_2_printed : bool
    """

    name: str
    swapped: bool = False
    a_printed: bool = False
    d5_printed: bool = False
    eq15_printed: bool = False
    table_2_printed: bool = False

    def residuals(self, v: eq.PaperVariables) -> Array:
        """The ten (10,), each over the size of its own data: 1, 1, 2 e_x, 2 e_y, the constant term, ``|B_i|``."""
        k = paper.SETUP
        at_v, at_k = paper.swapped_axes(v, k) if self.swapped else (v, k)
        d = list(eq.laser_conic(np, at_v, at_k))
        if self.d5_printed:
            d[5] = paper.printed_d5(np, at_v, at_k)
        constant = k.e_x**2 + k.e_y**2 - k.r**2
        wanted = -(k.r**2) if self.eq15_printed else constant
        laser = np.array(
            [
                d[1] / d[0],
                d[2] / d[0] - 1,
                (d[3] / d[0] + 2 * k.e_x) / (2 * k.e_x),
                (d[4] / d[0] + 2 * k.e_y) / (2 * k.e_y),
                (d[5] / d[0] - wanted) / constant,
            ]
        )
        a_of = paper.printed_a_coefficients if self.a_printed else eq.a_coefficients
        B = self.ellipse
        return np.concatenate([laser, (paper.ellipse_of(a_of(np, at_v, at_k), at_v, at_k) - B) / np.abs(B)])

    @property
    def ellipse(self) -> Array:
        """Table 2 to four decimals (5,), B_4 as it is printed or as (6) gives it."""
        B = np.array(paper.TABLE_2)
        if not self.table_2_printed:
            B[3] = round(float(paper.exact_ellipse()[3]), 4)
        return B


READINGS = (
    Reading("corrected"),
    Reading("(3), and so (6) and (9)", swapped=True),
    Reading("a_1 and a_2 of (5)", a_printed=True),
    Reading("d_5 of (9)", d5_printed=True),
    Reading("(15) and (28)", eq15_printed=True),
    Reading("Table 2, B_4", table_2_printed=True),
    Reading("all as printed", True, True, True, True, True),
)
"""The misprints of `planeopt.paper.MISPRINTS` one by one, the corrected equations before, all of them after."""


@dataclass(frozen=True)
class ConsequenceRow:
    """The plane that a reading of the ten equations gives.

    Attributes
    ----------
    reading : str
        What is left as printed.
    R_mm, z_L_mm, alpha_deg, beta_deg : float
        Least squares of the ten equations and Table 2, each over the size of its data; the better of the answers from
        the stated solution and from the paper's start.
    z_L_error_mm, normal_error_deg : float
        Against the stated solution.
    largest_misfit : float
        Largest of the ten residuals there: how far the equations are from having a solution.
    """

    reading: str
    R_mm: float
    z_L_mm: float
    alpha_deg: float
    beta_deg: float
    z_L_error_mm: float
    normal_error_deg: float
    largest_misfit: float


def read_all(executor: Executor | None) -> list[ConsequenceRow]:
    """Solve every reading."""
    return list(ordered_map(solve_reading, READINGS, executor))


_SIZE = np.array([paper.TRUTH.R, paper.TRUTH.z_L, 1.0, 1.0])
_STEEPEST = np.radians(89.9)


def solve_reading(reading: Reading) -> ConsequenceRow:
    """Solve the ten equations of a reading by least squares."""

    def residuals(scaled: Array) -> Array:
        return reading.residuals(eq.PaperVariables(*(scaled * _SIZE)))

    lower = np.array([1e-3, 1e-3, -_STEEPEST, -np.inf])
    upper = np.array([50.0, 50.0, _STEEPEST, np.inf])
    answers = [
        scipy.optimize.least_squares(
            residuals, np.array(start) / _SIZE, bounds=(lower, upper), xtol=1e-14, ftol=1e-14, gtol=1e-14
        )
        for start in (paper.TRUTH, paper.START)
    ]
    best = min(answers, key=lambda answer: float(answer.cost))
    pose = SpotPose.canonical(*(float(value) for value in best.x * _SIZE))
    truth = SpotPose.canonical(*paper.TRUTH)
    return ConsequenceRow(
        reading.name,
        pose.R,
        pose.z_L,
        float(np.degrees(pose.alpha)),
        float(np.degrees(pose.beta or 0.0)),
        pose.z_L - truth.z_L,
        float(np.degrees(2 * np.arcsin(np.linalg.norm(pose.normal - truth.normal) / 2))),
        float(np.max(np.abs(residuals(best.x)))),
    )
