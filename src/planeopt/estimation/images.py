"""Image ellipses of many planes by their coefficients, and how these change with the planes and with the beam.

The plane of the spot of a beam of radius ``r`` at the offset ``e`` has the image ``F = a_1^2 + a_2^2 - r^2 l^2 = 0``
with the linear forms ``l = f - p x - q y``, ``a = w (x, y) - e l``, ``w = z_L - p e_x - q e_y``. They are linear in
``v = (1, z_L, p, q)`` too: each coefficient of F over ``x^2, xy, y^2, x, y, 1`` is a quadratic form ``v' S v``, and so
is its derivative by whatever the beam is described with.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.rig import rotation_to_axis

Array = NDArray[np.float64]

TRACE_ONE = np.array([0.5, 0.0, 0.5, 0.0, 0.0, 0.0])
SPAN = np.zeros((6, 5))
SPAN[[0, 2, 1, 3, 4, 5], [0, 0, 1, 2, 3, 4]] = 0.5, -0.5, 1.0, 1.0, 1.0, 1.0


@dataclass(frozen=True, eq=False)
class Images:
    """Image ellipses of planes as quadratic forms in ``v = (1, z_L, p, q)``.

    ``F`` is ``a_1^2 + a_2^2 - r^2 l^2`` with the linear forms ``l = f - p x - q y`` and ``a = w (x, y) - e l``, ``w =
    z_L - p e_x - q e_y``, which are linear in v too: each coefficient over the monomials is ``v' S v``.
    """

    forms: Array
    """(6, 4, 4): S of the six coefficients, symmetric."""

    @classmethod
    def of(cls, setup: eq.Setup) -> "Images":
        """For one rig."""
        a1, a2, level = _linear_forms(setup)
        return cls(_product(a1, a1) + _product(a2, a2) - setup.r**2 * _product(level, level))

    def coordinates(self, planes: Array, origin: Array) -> tuple[Array, Array]:
        """Five coordinates (M, 5) of ellipses of planes (M, 3) about origins (M, 2), and derivatives (M, 5, 3).

        Coefficients are scaled to the trace 1, ``theta_0 + theta_2 = 1``; the coordinates are ``theta_0 - theta_2,
        theta_1, theta_3, theta_4, theta_5``.
        """
        v = np.ones((len(planes), 4))
        v[:, 1:] = planes
        made = _times(v, self.forms)
        # A row of F and three of its derivatives, which are of one kind from here on.
        rows = np.empty((4, len(planes), 6))
        rows[0] = (made @ v[..., None])[..., 0]
        rows[1:] = 2 * made[..., 1:].transpose(2, 0, 1)
        shift(rows, origin)
        rows /= rows[0, :, :1] + rows[0, :, 2:3]
        at = five(rows[0])
        slope = rows[1:, :, :1] + rows[1:, :, 2:3]
        return at, (five(rows[1:]) - at * slope).transpose(1, 2, 0)

    def differences(self, planes: Array, moved: Array, origin: Array) -> tuple[Array, Array]:
        """First and second differences (M, 3, 6) of the coefficients over pairs of planes (M, 6, 3) about others.

        A pair are the planes k and k + 3. The coefficients have the scale that `coordinates` gives those of the planes
        in the middle.
        """
        v = np.ones((7, len(planes), 4))
        v[0, :, 1:], v[1:, :, 1:] = planes, np.swapaxes(moved, 0, 1)
        flat = v.reshape(-1, 4)
        rows = (_times(flat, self.forms) @ flat[..., None])[..., 0].reshape(7, -1, 6)
        shift(rows, origin)
        rows /= rows[0, :, :1] + rows[0, :, 2:3]
        first, second = (rows[1:4] - rows[4:]) / 2, rows[1:4] + rows[4:] - 2 * rows[0]
        return np.swapaxes(first, 0, 1), np.swapaxes(second, 0, 1)


def shift(rows: Array, origin: Array) -> None:
    """Write coefficients (..., M, 6) of conics as they are about origins (M, 2)."""
    x, y = origin[:, 0], origin[:, 1]
    xx, xy, yy, gx, gy = (rows[..., i] for i in range(5))
    along, across = xx * x, yy * y
    mixed_x, mixed_y = xy * y, xy * x
    rows[..., 5] += x * (gx + along + mixed_x) + y * (gy + across)
    rows[..., 3] += 2 * along + mixed_x
    rows[..., 4] += 2 * across + mixed_y


def five(six: Array) -> Array:
    """Return the five coordinates (..., 5) of coefficients (..., 6)."""
    made = np.empty((*six.shape[:-1], 5))
    np.subtract(six[..., 0], six[..., 2], out=made[..., 0])
    made[..., 1], made[..., 2:] = six[..., 1], six[..., 3:]
    return made


def conics_at(coordinates: Array) -> Array:
    """Coefficients (M, 6) of conics by their coordinates (M, 5)."""
    return TRACE_ONE + coordinates @ SPAN.T


@dataclass(frozen=True, eq=False)
class BeamImages:
    """Derivatives of `Images`, as the same points see them, by `BEAM` in the camera frame.

    The direction turns the points themselves: what a turn of the homogeneous points does to ``F`` on its curve it does
    to the matrix of F from both sides.
    """

    forms: Array
    """(5, 6, 4, 4)"""

    @classmethod
    def of(cls, setup: eq.Setup, offset: tuple[float, float], direction: tuple[float, float, float]) -> "BeamImages":
        """For a beam at an offset (e_x, e_y), mm, in a direction (l_x, l_y, l_z), both in the camera frame.

        `setup` is of the laser-parallel frame.
        """
        a1, a2, level = _linear_forms(setup)
        image = Images.of(setup).forms
        minus_p_x, minus_q_x, minus_p_y, minus_q_y = (np.zeros((3, 4)) for _ in range(4))
        minus_p_x[0, 2] = minus_q_x[0, 3] = minus_p_y[1, 2] = minus_q_y[1, 3] = -1.0
        turned = [
            2 * (_product(a1, minus_p_x - level) + _product(a2, minus_p_y)),
            2 * (_product(a1, minus_q_x) + _product(a2, minus_q_y - level)),
        ]
        radius = -2 * setup.r * _product(level, level)
        Q, by_direction = _turns(direction)
        e = np.array([*offset, 0.0])
        made = [Q[0, i] * turned[0] + Q[1, i] * turned[1] for i in range(2)]
        made.append(radius)
        for turn in by_direction:
            moved = turn @ e
            generator = turn @ Q.T
            made.append(moved[0] * turned[0] + moved[1] * turned[1] + _turned(image, generator, setup.f))
        return cls(np.array(made))

    def derivatives(self, planes: Array, trace: Array, origin: Array) -> Array:
        """Derivatives (M, 6, 5) of the ellipses' coefficients about origins (M, 2), over traces (M,).

        Where ``F = 0``: what a change of scale would add is left out.
        """
        v = np.ones((len(planes), 4))
        v[:, 1:] = planes
        rows = np.stack([(_times(v, forms) @ v[..., None])[..., 0] for forms in self.forms])
        shift(rows, origin)
        rows /= trace[:, None]
        return rows.transpose(1, 2, 0)


BEAM = ("e_x", "e_y", "radius", "direction_x", "direction_y")
"""What `BeamImages` differentiates by."""

_PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def _linear_forms(setup: eq.Setup) -> tuple[Array, Array, Array]:
    """``a_1, a_2, l``, each (3, 4): coefficients of ``x, y, 1`` by v."""
    f, e_x, e_y, _ = setup
    level = np.zeros((3, 4))
    level[0, 2], level[1, 3], level[2, 0] = -1.0, -1.0, f
    w = np.array([0.0, 1.0, -e_x, -e_y])
    a1, a2 = -e_x * level, -e_y * level
    a1[0] += w
    a2[1] += w
    return a1, a2, level


def _product(one: Array, other: Array) -> Array:
    """Forms (6, 4, 4), symmetric, of the product of two linear forms (3, 4)."""
    square = np.einsum("ik,jl->ijkl", one, other)
    forms = np.array([square[i, j] if i == j else square[i, j] + square[j, i] for i, j in _PAIRS])
    return (forms + np.swapaxes(forms, 1, 2)) / 2


def _times(v: Array, forms: Array) -> Array:
    """``S v`` (M, 6, 4)."""
    return (v @ np.moveaxis(forms, 2, 0).reshape(4, 24)).reshape(-1, 6, 4)


def _turns(direction: tuple[float, float, float]) -> tuple[Array, list[Array]]:
    """Q and its derivatives by l_x and l_y, (3, 3) each; a complex step is exact to rounding."""
    l_x, l_y, _ = direction
    step = 1e-30
    made = []
    for x, y in ((l_x + step * 1j, l_y), (l_x, l_y + step * 1j)):
        rows = np.array(rotation_to_axis(x, y, np.sqrt(1 - x * x - y * y + 0j)), dtype=complex)
        made.append(np.imag(rows) / step)
    return np.array(rotation_to_axis(*direction), dtype=float), made


def _turned(forms: Array, generator: Array, f: float) -> Array:
    """Change (6, 4, 4) of coefficients by a turn ``d X = G X`` of the points ``X ~ (x, y, f)``."""
    size = np.array([1.0, 1.0, f])
    matrix = np.zeros((3, 3, 4, 4))
    for k, (i, j) in enumerate(_PAIRS):
        matrix[i, j] += forms[k] / 2
        matrix[j, i] += forms[k] / 2
    matrix /= (size[:, None] * size)[..., None, None]
    once = np.einsum("ijkl,jn->inkl", matrix, generator)
    both = (once + np.swapaxes(once, 0, 1)) * (size[:, None] * size)[..., None, None]
    return np.array([both[i, j] if i == j else 2 * both[i, j] for i, j in _PAIRS])
