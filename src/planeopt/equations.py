"""The paper's equations, each once: a short function over a namespace that carries its number, name, unit and block.

Every function takes the namespace ``m`` first: ``numpy`` evaluates it on arrays (it broadcasts), ``casadi`` builds it
as a symbolic expression. Lengths are in mm, angles in rad, image coordinates in mm on the image plane at ``z = f``,
origin at the principal point, in the laser-parallel frame (`planeopt.rig` rotates the rays there).

The numbers are those of Zhu et al., *An Algorithm of Determining the Plane Based on Monocular Vision and Laser Loop*,
with the misprints corrected; what the paper prints is kept in `planeopt.paper`. ``docs/model.md`` derives all of it.

| number | here |
|---|---|
| (1) | `planeopt.plane.Plane.intercepts` |
| (3) | `spot_point`; on the laser constraint, in slopes, `spot_point_in_slopes` |
| (5) | `image_point`, and its inverse `spot_angle` with the coefficients `a_coefficients` |
| (6) | `image_conic`; on the laser constraint, in slopes, `image_conic_in_slopes` |
| (9) | `laser_conic` |
| (11)-(15) | `eq11` ... `eq15`, together `LASER_BLOCK`; their independent form `laser_constraint` |
| (16) | `eq16` |
| (17)-(21) | `eq17` ... `eq21`, together `IMAGE_BLOCK` |
| (23)-(28) | as constraints h = 0: `eq23` the image block as one vector, `eq24` ... `eq28` the laser block |
| (29) | `eq29` |
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

Namespace = Any
"""`numpy` or `casadi`: a module with sin, cos and sqrt for the numbers at hand."""

Coefficients = Any
"""B_1 ... B_5: anything that indexes, from arrays to lists of symbols."""


class Block(StrEnum):
    """Which measurement an equation speaks of."""

    LASER = "laser"
    IMAGE = "image"
    GEOMETRY = "geometry"
    SEARCH = "search"


class Setup(NamedTuple):
    """What is known before the image: focal length ``f``, beam offset ``(e_x, e_y)`` and radius ``r``, all mm."""

    f: Any
    e_x: Any
    e_y: Any
    r: Any


class PaperVariables(NamedTuple):
    """The paper's unknowns: long semi-axis ``R`` and depth ``z_L`` (mm), tilt ``alpha`` and azimuth ``beta`` (rad)."""

    R: Any
    z_L: Any
    alpha: Any
    beta: Any


class SlopeVariables(NamedTuple):
    """The same plane without a singularity at ``alpha = 0``: ``z = z_L + p (x - e_x) + q (y - e_y)``."""

    R: Any
    z_L: Any
    p: Any
    q: Any


def slopes(m: Namespace, v: PaperVariables) -> tuple[Any, Any]:
    """Slopes ``p = -tan(alpha) sin(beta)``, ``q = tan(alpha) cos(beta)`` of the plane."""
    tangent = m.tan(v.alpha)
    return -tangent * m.sin(v.beta), tangent * m.cos(v.beta)


def long_axis(m: Namespace, p: Any, q: Any, r: Any) -> Any:
    """The R that puts the spot on the beam: ``r / cos(alpha) = r sqrt(1 + p^2 + q^2)``."""
    return r * m.sqrt(1 + p**2 + q**2)


@dataclass(frozen=True)
class Equation:
    """A numbered equation: call it as ``equation(m, ...)``; its number, name, unit and block go into every message."""

    number: str
    name: str
    unit: str
    block: Block
    function: Callable[..., Any]

    def __call__(self, m: Namespace, *arguments: Any) -> Any:
        return self.function(m, *arguments)

    def __str__(self) -> str:
        return f"({self.number}) {self.name}"


def equation(number: str, name: str, unit: str, block: Block) -> Callable[[Callable[..., Any]], Equation]:
    """Give a function its number, name, unit and block."""

    def numbered(function: Callable[..., Any]) -> Equation:
        numbered_equation = Equation(number, name, unit, block, function)
        object.__setattr__(numbered_equation, "__doc__", function.__doc__)
        return numbered_equation

    return numbered


# --- The spot in space and in the image ------------------------------------------------------------------------------


@equation("3", "boundary of the spot in space", "mm", Block.GEOMETRY)
def spot_point(m: Namespace, v: PaperVariables, k: Setup, theta: Any) -> tuple[Any, Any, Any]:
    """(3): the point at angle ``theta`` of the spot, ``r`` along the tilt axis and ``R`` across it."""
    along, across = k.r * m.cos(theta), v.R * m.sin(theta)
    x = k.e_x + along * m.cos(v.beta) - across * m.sin(v.beta) * m.cos(v.alpha)
    y = k.e_y + along * m.sin(v.beta) + across * m.cos(v.beta) * m.cos(v.alpha)
    return x, y, v.z_L + across * m.sin(v.alpha)


@equation("3", "boundary of the spot in space, in slopes", "mm", Block.GEOMETRY)
def spot_point_in_slopes(m: Namespace, v: SlopeVariables, k: Setup, phi: Any) -> tuple[Any, Any, Any]:
    """(3) where ``R cos(alpha) = r`` holds, by the angle ``phi = theta + beta``: regular at alpha = 0."""
    x, y = k.r * m.cos(phi), k.r * m.sin(phi)
    return k.e_x + x, k.e_y + y, v.z_L + v.p * x + v.q * y


@equation("5", "image of a point", "mm", Block.GEOMETRY)
def image_point(m: Namespace, k: Setup, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
    """(5): the pinhole image of ``(x, y, z)`` on the plane ``z = f``."""
    del m
    return k.f * x / z, k.f * y / z


def a_coefficients(m: Namespace, v: PaperVariables, k: Setup) -> tuple[Any, ...]:
    """a_1 ... a_9 of (5) solved for ``theta``: see `spot_angle`."""
    sa, ca, sb, cb = m.sin(v.alpha), m.cos(v.alpha), m.sin(v.beta), m.cos(v.beta)
    return (
        v.z_L * cb * ca - k.e_y * sa,
        v.z_L * sb * ca + k.e_x * sa,
        -k.f * (k.e_x * cb + k.e_y * sb) * ca,
        -v.z_L * sb,
        v.z_L * cb,
        k.f * (k.e_x * sb - k.e_y * cb),
        sb * sa,
        -cb * sa,
        k.f * ca,
    )


def spot_angle(m: Namespace, v: PaperVariables, k: Setup, x: Any, y: Any) -> tuple[Any, Any]:
    """Cos and sin of the spot's angle seen at the image point ``(x, y)``, (5) inverted.

    ``cos = (a1 x + a2 y + a3)/(r D)``, ``sin = (a4 x + a5 y + a6)/(R D)`` with ``D = a7 x + a8 y + a9``.
    """
    a1, a2, a3, a4, a5, a6, a7, a8, a9 = a_coefficients(m, v, k)
    d = a7 * x + a8 * y + a9
    return (a1 * x + a2 * y + a3) / (k.r * d), (a4 * x + a5 * y + a6) / (v.R * d)


def _conic_of_squares(lines: Sequence[tuple[Any, Sequence[Any]]]) -> tuple[Any, ...]:
    """Coefficients (x^2, xy, y^2, x, y, 1) of ``sum_k weight_k (u x + v y + w)^2``."""
    return (
        sum(s * u * u for s, (u, _, _) in lines),
        sum(2 * s * u * v for s, (u, v, _) in lines),
        sum(s * v * v for s, (_, v, _) in lines),
        sum(2 * s * u * w for s, (u, _, w) in lines),
        sum(2 * s * v * w for s, (_, v, w) in lines),
        sum(s * w * w for s, (_, _, w) in lines),
    )


@equation("6", "image of the spot's boundary", "mm^6", Block.GEOMETRY)
def image_conic(m: Namespace, v: PaperVariables, k: Setup) -> tuple[Any, ...]:
    """(6): ``(b_0, ..., b_5)`` of the image ellipse, from cos^2 + sin^2 = 1."""
    a = a_coefficients(m, v, k)
    return _conic_of_squares([(v.R**2, a[0:3]), (k.r**2, a[3:6]), (-(v.R**2) * k.r**2, a[6:9])])


@equation("6", "image of the spot's boundary, in slopes", "mm^4", Block.GEOMETRY)
def image_conic_in_slopes(m: Namespace, v: SlopeVariables, k: Setup) -> tuple[Any, ...]:
    """(6) divided by r^2 where ``R cos(alpha) = r`` holds: polynomial in the slopes, regular at ``alpha = 0``.

    The ray through (x, y) meets the plane at ``w (x, y) / L`` with ``L = f - p x - q y``, ``w = z_L - p e_x - q e_y``;
    that point lies on the cylinder: ``(w x - e_x L)^2 + (w y - e_y L)^2 = r^2 L^2``. ``R`` does not enter.
    """
    del m
    w = v.z_L - v.p * k.e_x - v.q * k.e_y
    return _conic_of_squares(
        [
            (1, (w + k.e_x * v.p, k.e_x * v.q, -k.e_x * k.f)),
            (1, (k.e_y * v.p, w + k.e_y * v.q, -k.e_y * k.f)),
            (-(k.r**2), (-v.p, -v.q, k.f)),
        ]
    )


@equation("9", "the spot seen along the laser axis", "mm^4", Block.GEOMETRY)
def laser_conic(m: Namespace, v: PaperVariables, k: Setup) -> tuple[Any, ...]:
    """(9): ``(d_0, ..., d_5)`` of the spot's projection along the beam, which must be the beam's cross-section."""
    sb, cb, section = m.sin(v.beta), m.cos(v.beta), v.R**2 * m.cos(v.alpha) ** 2
    d0 = k.r**2 * sb**2 + section * cb**2
    d1 = (section - k.r**2) * m.sin(2 * v.beta)
    d2 = k.r**2 * cb**2 + section * sb**2
    return (
        d0,
        d1,
        d2,
        -2 * k.e_x * d0 - k.e_y * d1,
        -2 * k.e_y * d2 - k.e_x * d1,
        d0 * k.e_x**2 + d2 * k.e_y**2 + d1 * k.e_x * k.e_y - k.r**2 * section,
    )


# --- The laser block: the spot lies on the beam ----------------------------------------------------------------------


@equation("11", "beam section has no cross term", "1", Block.LASER)
def eq11(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """(11): ``d_1/d_0 = 0``."""
    d = laser_conic(m, v, k)
    return d[1] / d[0]


@equation("12", "beam section is round", "1", Block.LASER)
def eq12(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """(12): ``d_2/d_0 = 1``."""
    d = laser_conic(m, v, k)
    return d[2] / d[0] - 1


@equation("13", "beam section is centred at e_x", "mm", Block.LASER)
def eq13(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """(13): ``d_3/d_0 = -2 e_x``."""
    d = laser_conic(m, v, k)
    return d[3] / d[0] + 2 * k.e_x


@equation("14", "beam section is centred at e_y", "mm", Block.LASER)
def eq14(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """(14): ``d_4/d_0 = -2 e_y``."""
    d = laser_conic(m, v, k)
    return d[4] / d[0] + 2 * k.e_y


@equation("15", "beam section has radius r", "mm^2", Block.LASER)
def eq15(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """(15): ``d_5/d_0 = e_x^2 + e_y^2 - r^2``."""
    d = laser_conic(m, v, k)
    return d[5] / d[0] - (k.e_x**2 + k.e_y**2 - k.r**2)


LASER_BLOCK = (eq11, eq12, eq13, eq14, eq15)


@equation("11-15", "the spot lies on the beam, R cos(alpha) = r", "mm", Block.LASER)
def laser_constraint(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """The independent form of (11)-(15): each of them is a multiple of it, by `laser_factors`."""
    return v.R * m.cos(v.alpha) - k.r


@equation("11-15", "the spot lies on the beam, R^2 = r^2 (1 + p^2 + q^2)", "mm^2", Block.LASER)
def laser_constraint_in_slopes(m: Namespace, v: SlopeVariables, k: Setup) -> Any:
    """The independent form of (11)-(15) in slopes, where 1/cos^2(alpha) = 1 + p^2 + q^2."""
    del m
    return v.R**2 - k.r**2 * (1 + v.p**2 + v.q**2)


def laser_factors(m: Namespace, v: PaperVariables, k: Setup) -> tuple[Any, ...]:
    """The proof that the laser block is one fact: residual (11+i) = factor_i * (R^2 cos^2(alpha) - r^2), i = 0..4."""
    d0, sin2b, cos2b = laser_conic(m, v, k)[0], m.sin(2 * v.beta), m.cos(2 * v.beta)
    return (
        sin2b / d0,
        -cos2b / d0,
        -k.e_y * sin2b / d0,
        (2 * k.e_y * cos2b - k.e_x * sin2b) / d0,
        (k.e_x * k.e_y * sin2b - k.e_y**2 * cos2b - k.r**2 * m.sin(v.beta) ** 2) / d0,
    )


# --- The image block: the spot's image is the fitted ellipse ---------------------------------------------------------


@equation("16", "fitted image ellipse", "mm^2", Block.IMAGE)
def eq16(m: Namespace, B: Coefficients, x: Any, y: Any) -> Any:
    """(16): ``x^2 + B_1 x y + B_2 y^2 + B_3 x + B_4 y + B_5``, zero on the ellipse."""
    del m
    return x * x + B[0] * x * y + B[1] * y * y + B[2] * x + B[3] * y + B[4]


def _image_equation(number: str, i: int, unit: str) -> Equation:
    def residual(m: Namespace, v: PaperVariables, k: Setup, B: Coefficients) -> Any:
        b = image_conic(m, v, k)
        return b[i] / b[0] - B[i - 1]

    residual.__doc__ = f"({number}): ``b_{i}/b_0 = B_{i}``."
    return equation(number, f"image coefficient B_{i}", unit, Block.IMAGE)(residual)


eq17 = _image_equation("17", 1, "1")
eq18 = _image_equation("18", 2, "1")
eq19 = _image_equation("19", 3, "mm")
eq20 = _image_equation("20", 4, "mm")
eq21 = _image_equation("21", 5, "mm^2")
IMAGE_BLOCK = (eq17, eq18, eq19, eq20, eq21)

TEN = LASER_BLOCK + IMAGE_BLOCK
"""The paper's ten equations in its order."""


def ten_residuals(m: Namespace, v: PaperVariables, k: Setup, B: Coefficients) -> list[Any]:
    """Left minus right of all ten, in the units of `TEN`."""
    return [e(m, v, k) for e in LASER_BLOCK] + [e(m, v, k, B) for e in IMAGE_BLOCK]


@equation("17-21", "image coefficients in slopes", "1, 1, mm, mm, mm^2", Block.IMAGE)
def image_residuals_in_slopes(m: Namespace, v: SlopeVariables, k: Setup, B: Coefficients) -> list[Any]:
    """(17)-(21) with (6) in slopes: equal to the paper's wherever (11)-(15) hold, and regular at ``alpha = 0``."""
    b = image_conic_in_slopes(m, v, k)
    return [b[i] / b[0] - B[i - 1] for i in range(1, 6)]


# --- Where the model holds -------------------------------------------------------------------------------------------


@equation("6", "the whole spot is in front of the camera, z_L cos(alpha) > r sin(alpha)", "mm", Block.GEOMETRY)
def in_front(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """Positive exactly when the image of the spot is an ellipse and the spot lies before the camera."""
    return v.z_L * m.cos(v.alpha) - k.r * m.sin(v.alpha)


@equation("6", "the whole spot is in front of the camera, z_L > r |n|", "mm^2", Block.GEOMETRY)
def in_front_in_slopes(m: Namespace, v: SlopeVariables, k: Setup) -> Any:
    """`in_front` squared, smooth at ``n = (p, q) = 0``; together with ``z_L > 0``."""
    del m
    return v.z_L**2 - k.r**2 * (v.p**2 + v.q**2)


@equation("6", "the spot's centre is in front of the camera, z_L > 0", "mm", Block.GEOMETRY)
def before_camera(m: Namespace, v: SlopeVariables, k: Setup) -> Any:
    """Depth of the spot's centre: what `in_front_in_slopes`, a square, leaves open."""
    del m, k
    return v.z_L


@equation(
    "1",
    "the lit side faces the camera, z_L cos(alpha) + sin(alpha) (e_x sin(beta) - e_y cos(beta)) > 0",
    "mm",
    Block.GEOMETRY,
)
def lit_side(m: Namespace, v: PaperVariables, k: Setup) -> Any:
    """Intercept ``c`` of (1) times cos(alpha): positive where camera and laser are on one side of the plane."""
    return v.z_L * m.cos(v.alpha) + m.sin(v.alpha) * (k.e_x * m.sin(v.beta) - k.e_y * m.cos(v.beta))


@equation("1", "the lit side faces the camera, c > 0", "mm", Block.GEOMETRY)
def lit_side_in_slopes(m: Namespace, v: SlopeVariables, k: Setup) -> Any:
    """Intercept ``c`` of (1) on the optical axis."""
    del m
    return v.z_L - v.p * k.e_x - v.q * k.e_y


# --- The search: the ten as constraints, and the penalty function -----------------------------------------------------


@equation("23", "image block as constraint", "1, 1, mm, mm, mm^2", Block.IMAGE)
def eq23(m: Namespace, v: PaperVariables, k: Setup, B: Coefficients) -> list[Any]:
    """(23): ``b_i/b_0 - B_i = 0``, i = 1..5, as one vector: (17)-(21)."""
    return [e(m, v, k, B) for e in IMAGE_BLOCK]


def _constraint_form(number: str, of: Equation) -> Equation:
    return equation(number, f"{of.name}, as constraint", of.unit, of.block)(of.function)


eq24 = _constraint_form("24", eq11)
eq25 = _constraint_form("25", eq12)
eq26 = _constraint_form("26", eq13)
eq27 = _constraint_form("27", eq14)
eq28 = _constraint_form("28", eq15)


@equation("29", "penalty function", "mixed", Block.SEARCH)
def eq29(m: Namespace, objective: Any, residuals: Sequence[Any], weight: Any) -> Any:
    """(29): ``J + weight * sum h^2`` over the constraints ``h = 0``; the paper sets ``J = 0``."""
    del m
    return objective + weight * sum(h * h for h in residuals)
