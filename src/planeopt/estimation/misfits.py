"""What many images say of one rig, taken together: their misfits, whitened, and the parts of chi-squared.

The misfits ``t`` of n images, two each, answer a rig that is off by ``deta`` as ``t = u - G deta``, ``u`` white: their
covariance is ``C = I + G Sigma G'`` (`planeopt.estimation.drift`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt.estimation.rig_part import SEEN
from planeopt.rig import Rig

Array = NDArray[np.float64]

LEVEL = 1e-3
"""How often a rig that is as calibrated is called degraded."""


class Part(Enum):
    """What is tested; the value says what it means where it fails."""

    POOLED = "The images together contradict the rig."
    SHIFT = "The beam is not where the rig file has it."
    TREND = "The beam moves along the sequence."
    REST = "There are misfits that no change of the beam explains: the lens, the boundary points, or their sigma."


TEST_LEVEL = LEVEL / len(Part)
"""Of each part: together they are wrong no more often than `LEVEL`."""


@dataclass(frozen=True)
class PartTest:
    """One part of the evidence; ``p_value`` is how often a right rig does worse."""

    part: Part
    chi2: float
    dof: int
    p_value: float

    @property
    def ok(self) -> bool:
        return self.p_value >= TEST_LEVEL


@dataclass(frozen=True)
class Change:
    """How far something the images see is from the rig file; ``sigma`` has the calibration's own share in it."""

    name: str
    unit: str
    value: float
    sigma: float


SEEN_NUMBERS = (
    ("vanishing point x", "px"),
    ("vanishing point y", "px"),
    ("offset over radius, x", "1"),
    ("offset over radius, y", "1"),
)
"""The four numbers of a rig that images of planes see, with their units."""


@dataclass(frozen=True, eq=False)
class Misfits:
    """Whitened by ``C^-1/2``: misfits (2n,), what a change of the beam makes of them (2n, 4), and of one that grows.

    ``trend`` has no columns where there is nothing for a trend to be seen in.
    """

    misfit: Array
    shift: Array
    trend: Array

    @classmethod
    def of(cls, misfit: Array, by_beam: Array, by_rig: Array, sigma: Array, along: Array, own: Array) -> "Misfits":
        """Whiten the misfits of n images.

        Parameters
        ----------
        misfit : (2n,)
        by_beam : (2n, 4)
            Derivative by `SEEN`.
        by_rig : (2n, k)
            By the free parameters of the rig, whose covariance is `sigma` (k, k).
        along : (n,)
            Where in the sequence each image was taken.
        own : (n,)
            Each image's own standard deviation: 1, and more where the rig's second order is in it.
        """
        place = along - along.mean()
        extent = float(np.ptp(along))
        growing = by_beam * np.repeat(place / extent, 2)[:, None] if extent > 0 and len(along) > 2 else by_beam[:, :0]
        each = np.repeat(own, 2)[:, None]
        whitened = _whitened(
            np.column_stack([misfit, by_beam, growing]) / each, by_rig @ np.linalg.cholesky(sigma) / each
        )
        return cls(whitened[:, 0], whitened[:, 1:5], whitened[:, 5:])

    def tests(self) -> tuple[PartTest, ...]:
        """Pooled, and its independent parts."""
        shift = _basis(self.shift)
        trend = _basis(self.trend - shift @ (shift.T @ self.trend))
        total = float(self.misfit @ self.misfit)
        by_shift, by_trend = (float(np.sum((basis.T @ self.misfit) ** 2)) for basis in (shift, trend))
        dof = len(self.misfit)
        parts = [
            (Part.POOLED, total, dof),
            (Part.SHIFT, by_shift, shift.shape[1]),
            (Part.TREND, by_trend, trend.shape[1]),
            (Part.REST, max(total - by_shift - by_trend, 0.0), dof - shift.shape[1] - trend.shape[1]),
        ]
        return tuple(
            PartTest(part, chi2, n, float(scipy.stats.chi2.sf(chi2, n)))
            for part, chi2, n in parts
            if n > 0 and not (part is Part.SHIFT and n == dof)
        )

    def changes(self, rig: Rig) -> tuple[tuple[Change, ...], tuple[Change, ...]]:
        """Shift, and trend from the first image to the last, where all four numbers are fixed."""
        if _basis(self.shift).shape[1] < len(SEEN):
            return (), ()
        to_seen = seen_by(rig, SEEN)
        shift = _changes(self.shift, self.misfit, to_seen)
        both = np.column_stack([self.shift, self.trend])
        if not self.trend.shape[1] or _basis(both).shape[1] < both.shape[1]:
            return shift, ()
        return shift, _changes(both, self.misfit, np.column_stack([np.zeros((4, 4)), to_seen]))


def seen(rig: Rig) -> Array:
    """Vanishing point in an undistorted image, px, and offset over radius in the laser-parallel frame: (4,)."""
    beam, camera = rig.require_beam(), rig.camera
    l_x, l_y, l_z = beam.direction
    offset = np.array(rig.laser_offset) / beam.radius
    return np.array([camera.cx + camera.fx * l_x / l_z, camera.cy + camera.fy * l_y / l_z, *offset])


def seen_by(rig: Rig, names: Sequence[str]) -> Array:
    """Derivative (4, n) of `seen` by parameters, by central differences: the functions are smooth."""
    columns = [np.zeros((len(SEEN_NUMBERS), 0))]
    for name in names:
        step = 1e-5 * _size(rig, name)
        ahead, behind = (rig.with_parameters({name: rig.parameter(name) + sign * step}) for sign in (1, -1))
        columns.append(((seen(ahead) - seen(behind)) / (2 * step))[:, None])
    return np.hstack(columns)


def _size(rig: Rig, name: str) -> float:
    """Of a change that alters the picture as much as the parameter itself does: a radius, a focal length, or 1."""
    if name in ("e_x", "e_y", "radius"):
        return rig.require_beam().radius
    return rig.camera.fx if name in ("f", "fx", "fy", "cx", "cy") else 1.0


def _changes(columns: Array, misfit: Array, to_seen: Array) -> tuple[Change, ...]:
    """Least squares of ``misfit = -columns @ change``, carried to the four numbers."""
    size = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.pinv(columns / size) / size[:, None]
    carried = to_seen @ inverse
    values, sigmas = -carried @ misfit, np.linalg.norm(carried, axis=1)
    return tuple(
        Change(name, unit, float(value), float(sigma))
        for (name, unit), value, sigma in zip(SEEN_NUMBERS, values, sigmas, strict=True)
    )


def _whitened(columns: Array, common: Array) -> Array:
    """``C^-1/2`` times columns, ``C = I + common common'``."""
    if not common.shape[1]:
        return columns
    left, size, _ = np.linalg.svd(common, full_matrices=False)
    return columns + left @ ((1 / np.sqrt(1 + size**2) - 1)[:, None] * (left.T @ columns))


def _basis(columns: Array) -> Array:
    """Orthonormal basis (m, rank) of what columns of any unit span."""
    size = np.linalg.norm(columns, axis=0)
    if not columns.shape[1] or not size.any():
        return columns[:, :0]
    left, values, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return left[:, values > _DEFICIENT * values[0]]


_DEFICIENT = 1e-6
"""Singular values below this share of the largest are rounding: columns have unit length."""
