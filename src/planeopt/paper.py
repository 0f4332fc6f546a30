"""What the paper publishes: its worked example, Tables 1 and 2, and what it prints that is not right.

Zhu, Zhang, Li, Gao, Zhou, *An Algorithm of Determining the Plane Based on Monocular Vision and Laser Loop*. The right
equations are in `planeopt.equations`; as printed they live only here, each beside numbers that tell the two apart.

Table 1 is not copied from the printed page but made again: (3) and (5) at ``theta = 0, 15, ..., 345`` deg, rounded to
the four decimals that the paper prints. Which angles the authors took is not recorded here. What is recorded of the
printed table agrees with this one: every entry lies within 5e-5 mm of (3) and (5), and the least-squares fit of (16) to
it has ``B_4 = -194.049 +- 0.003``, as to this one. Since the table is made from the corrected (3), it is no independent
evidence for the correction; Table 2 is, whose printed entries (6) must give.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq

Array = NDArray[np.float64]

SETUP = eq.Setup(f=25.0, e_x=30.0, e_y=40.0, r=10.0)
"""The worked example's rig: focal length, beam offset and radius, mm; a parallel beam."""

TRUTH = eq.PaperVariables(R=20.0, z_L=75.0, alpha=math.radians(60), beta=math.radians(30))
"""The worked example's stated solution; mm, rad."""

START = eq.PaperVariables(R=10.0, z_L=250.0, alpha=math.radians(20), beta=math.radians(20))
"""Where the paper's search begins; mm, rad."""

ROUNDING = 5e-5
"""Largest rounding error of a number printed with four decimals: mm in Table 1, the unit of the entry in Table 2."""

TABLE_1_ANGLES = np.radians(np.arange(0, 360, 15))
"""Angles ``theta`` (24,) of the points of `table_1`, rad."""

TABLE_2 = (-3.9899, 8.8868, 31.4459, -194.0465, 1111.1111)
"""``B_1 ... B_5`` of (16): 1, 1, mm, mm, mm^2. B_4 is as printed, two digits swapped (see `MISPRINTS`); the others,
which are printed right to their last digit, are given with as many decimals."""


def table_1() -> Array:
    """Boundary points of the spot in the image (24, 2), mm, to four decimals; the module's head says where from."""
    return np.round(exact_points(), 4)


def exact_points() -> Array:
    """What `table_1` rounds: (5) of (3) at the stated solution, (24, 2), mm."""
    return np.stack(eq.image_point(np, SETUP, *eq.spot_point(np, TRUTH, SETUP, TABLE_1_ANGLES)), axis=1)


def exact_ellipse() -> Array:
    """``B_1 ... B_5`` (5,) of (16) that (6) gives at the stated solution: what Table 2 rounds."""
    b = np.array(eq.image_conic(np, TRUTH, SETUP))
    return b[1:] / b[0]


# --- The equations as printed ----------------------------------------------------------------------------------------


def swapped_axes(v: eq.PaperVariables, k: eq.Setup) -> tuple[eq.PaperVariables, eq.Setup]:
    """Unknowns and setup that turn a right equation into the printed one: ``R`` along the tilt axis, ``r`` across."""
    return v._replace(R=k.r), k._replace(r=v.R)


def printed_spot_point(m: eq.Namespace, v: eq.PaperVariables, k: eq.Setup, theta: Any) -> tuple[Any, Any, Any]:
    """(3) as printed: ``R`` along the tilt axis, ``r`` across it; mm."""
    return eq.spot_point(m, *swapped_axes(v, k), theta)


def printed_laser_conic(m: eq.Namespace, v: eq.PaperVariables, k: eq.Setup) -> tuple[Any, ...]:
    """(9) as printed, which follows from (3) as printed: ``(d_0, ..., d_5)``; mm^2 to mm^4."""
    return eq.laser_conic(m, *swapped_axes(v, k))


def printed_a_coefficients(m: eq.Namespace, v: eq.PaperVariables, k: eq.Setup) -> tuple[Any, ...]:
    """a_1 ... a_9 as printed: ``- e_x sin(alpha)`` in a_1 and ``+ e_y sin(alpha)`` in a_2; mm and mm^2, 1."""
    sa, ca, sb, cb = m.sin(v.alpha), m.cos(v.alpha), m.sin(v.beta), m.cos(v.beta)
    return v.z_L * cb * ca - k.e_x * sa, v.z_L * sb * ca + k.e_y * sa, *eq.a_coefficients(m, v, k)[2:]


def ellipse_of(a: Sequence[Any], v: eq.PaperVariables, k: eq.Setup) -> Array:
    """``B`` (5,) from cos^2 + sin^2 = 1 with given a_1 ... a_9: (6) step by step, so that the printed a_i can enter."""
    weights = (v.R**2, k.r**2, -(v.R**2) * k.r**2)
    matrix = sum(w * np.outer(line, line) for w, line in zip(weights, (a[0:3], a[3:6], a[6:9]), strict=True))
    c = np.asarray(matrix)
    return np.array([2 * c[0, 1], c[1, 1], 2 * c[0, 2], 2 * c[1, 2], c[2, 2]]) / c[0, 0]


def printed_d5(m: eq.Namespace, v: eq.PaperVariables, k: eq.Setup) -> Any:
    """d_5 of (9) with ``e_x^2 e_y sin(2 beta)`` in its cross term as printed, the semi-axes right; mixed units."""
    d = eq.laser_conic(m, v, k)
    return d[5] + d[1] * k.e_x * k.e_y * (k.e_x - 1)


def printed_eq15(m: eq.Namespace, v: eq.PaperVariables, k: eq.Setup) -> Any:
    """(15), and so (28), as printed: ``d_5/d_0 = -r^2``; mm^2."""
    d = eq.laser_conic(m, v, k)
    return d[5] / d[0] + k.r**2


# --- The misprints ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Evidence:
    """A number that one reading gets right and the other does not.

    Attributes
    ----------
    quantity, unit : str
    expected, tolerance : float
        What it must be, and how far rounding may take it from there.
    right, printed : float
        What the corrected and the printed reading give.
    """

    quantity: str
    unit: str
    expected: float
    tolerance: float
    right: float
    printed: float

    def __post_init__(self) -> None:
        for name in ("expected", "tolerance", "right", "printed"):
            object.__setattr__(self, name, float(getattr(self, name)))

    @property
    def decides(self) -> bool:
        """Whether the corrected reading agrees and the printed one does not."""
        return abs(self.right - self.expected) <= self.tolerance < abs(self.printed - self.expected)


@dataclass(frozen=True)
class Misprint:
    """A misprint of the paper.

    Attributes
    ----------
    where, printed, right : str
        The place, and the two readings.
    why : str
        The evidence in words.
    evidence : callable
        Computes the evidence's numbers.
    """

    where: str
    printed: str
    right: str
    why: str
    evidence: Callable[[], tuple[Evidence, ...]]


# A hundred units in the last place, at the size of the terms that cancel: what rounding may do, on any machine.
_EXACT = 100 * float(np.finfo(float).eps)
_OFF_THE_BEAM = TRUTH._replace(R=1.25 * TRUTH.R)


def _from_table_2(quantity: str, i: int, right: Array, printed: Array) -> Evidence:
    return Evidence(quantity, "1", TABLE_2[i], ROUNDING, right[i], printed[i])


def _semi_axes() -> tuple[Evidence, ...]:
    def distance(points: tuple[Any, Any, Any]) -> float:
        return float(np.max(np.abs(np.stack(eq.image_point(np, SETUP, *points), axis=1) - table_1())))

    printed_v, printed_k = swapped_axes(TRUTH, SETUP)
    printed = ellipse_of(eq.a_coefficients(np, printed_v, printed_k), printed_v, printed_k)
    right_d, printed_d = eq.laser_conic(np, TRUTH, SETUP), printed_laser_conic(np, TRUTH, SETUP)
    return (
        Evidence(
            "(12) at the stated solution: d_2/d_0",
            "1",
            1.0,
            _EXACT,
            right_d[2] / right_d[0],
            printed_d[2] / printed_d[0],
        ),
        _from_table_2("Table 2: B_1 from (6)", 0, exact_ellipse(), printed),
        _from_table_2("Table 2: B_2 from (6)", 1, exact_ellipse(), printed),
        Evidence(
            "Table 1: largest deviation of (5) of (3)",
            "mm",
            0.0,
            ROUNDING,
            distance(eq.spot_point(np, TRUTH, SETUP, TABLE_1_ANGLES)),
            distance(printed_spot_point(np, TRUTH, SETUP, TABLE_1_ANGLES)),
        ),
    )


def _a_coefficients() -> tuple[Evidence, ...]:
    right, printed = eq.a_coefficients(np, TRUTH, SETUP), printed_a_coefficients(np, TRUTH, SETUP)
    both_v, both_k = swapped_axes(TRUTH, SETUP)
    both = ellipse_of(printed_a_coefficients(np, both_v, both_k), both_v, both_k)
    x, y = exact_points().T

    def error_of_cosine(a: tuple[Any, ...]) -> float:
        cosine = (a[0] * x + a[1] * y + a[2]) / (SETUP.r * (a[6] * x + a[7] * y + a[8]))
        return float(np.max(np.abs(cosine - np.cos(TABLE_1_ANGLES))))

    ellipse = ellipse_of(right, TRUTH, SETUP)
    return (
        _from_table_2("Table 2: B_1 from (6), semi-axes right", 0, ellipse, ellipse_of(printed, TRUTH, SETUP)),
        _from_table_2("Table 2: B_1 from (6), semi-axes as printed too", 0, ellipse, both),
        Evidence(
            "(5) solved for cos(theta): largest error",
            "1",
            0.0,
            _EXACT,
            error_of_cosine(right),
            error_of_cosine(printed),
        ),
    )


def _cross_term() -> tuple[Evidence, ...]:
    stretch = 10.0
    v, k = _OFF_THE_BEAM, SETUP
    stretched_v, stretched_k = v._replace(R=stretch * v.R, z_L=stretch * v.z_L), eq.Setup(*(stretch * s for s in k))
    d = eq.laser_conic(np, v, k)
    x, y, _ = eq.spot_point(np, v, k, TABLE_1_ANGLES)

    def misfit(d5: float) -> float:
        return float(np.max(np.abs(d[0] * x**2 + d[1] * x * y + d[2] * y**2 + d[3] * x + d[4] * y + d5))) / d[0]

    return (
        Evidence(
            "(9) at the points of (3), over d_0, R = 25 mm: largest value",
            "mm^2",
            0.0,
            _EXACT * float(np.max(x**2 + y**2)),
            misfit(d[5]),
            misfit(printed_d5(np, v, k)),
        ),
        Evidence(
            "d_5 with all lengths times 10, over d_5, R = 25 mm",
            "1",
            stretch**4,
            _EXACT * stretch**4,
            eq.laser_conic(np, stretched_v, stretched_k)[5] / d[5],
            printed_d5(np, stretched_v, stretched_k) / printed_d5(np, v, k),
        ),
    )


def _constant_term() -> tuple[Evidence, ...]:
    return (
        Evidence(
            "(15) at the stated solution: left minus right",
            "mm^2",
            0.0,
            _EXACT * (SETUP.e_x**2 + SETUP.e_y**2),
            eq.eq15(np, TRUTH, SETUP),
            printed_eq15(np, TRUTH, SETUP),
        ),
    )


def _table_2() -> tuple[Evidence, ...]:
    exact = exact_ellipse()
    others = np.delete(np.array(TABLE_2) - exact, 3)
    worst = np.max(np.abs(others))
    return (
        Evidence("Table 2: B_4, against (6)", "mm", exact[3], ROUNDING, round(exact[3], 4), TABLE_2[3]),
        Evidence(
            "Table 2: largest deviation, of the other four and of all five entries",
            "mixed",
            0.0,
            ROUNDING,
            worst,
            max(worst, abs(TABLE_2[3] - exact[3])),
        ),
    )


MISPRINTS = (
    Misprint(
        "(3), and so (6) and (9)",
        "R along the tilt axis, r across",
        "r along, R across: R is the long semi-axis",
        "As printed the spot does not lie on the beam, (6) does not give Table 2, and (3) does not give Table 1.",
        _semi_axes,
    ),
    Misprint(
        "a_1 and a_2 of (5)",
        "a_1: - e_x sin(alpha), a_2: + e_y sin(alpha)",
        "a_1: - e_y sin(alpha), a_2: + e_x sin(alpha)",
        "As printed (5) is not inverted, and (6) does not give Table 2.",
        _a_coefficients,
    ),
    Misprint(
        "d_5 of (9)",
        "e_x^2 e_y sin(2 beta)",
        "e_x e_y sin(2 beta)",
        "Units; and as printed (9) does not hold at the points of (3). It does not show in the worked example, where "
        "R cos(alpha) = r makes the term vanish.",
        _cross_term,
    ),
    Misprint(
        "(15) and (28)",
        "-r^2",
        "e_x^2 + e_y^2 - r^2",
        "The beam's section (x - e_x)^2 + (y - e_y)^2 = r^2 has this constant term when expanded.",
        _constant_term,
    ),
    Misprint(
        "Table 2, B_4",
        "-194.0465",
        "-194.0456",
        "Two digits are swapped: the other four entries are exact to their last digit.",
        _table_2,
    ),
)
"""All misprints found, in the order of the paper."""
