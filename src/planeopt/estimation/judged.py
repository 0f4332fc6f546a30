"""Planes of many spots with what is known of them, judged: covariances, tests, statuses."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.estimation import evidence
from planeopt.estimation.descent import solve_all
from planeopt.estimation.sets import Sets
from planeopt.formulations.bounds import FARTHEST, STEEPEST
from planeopt.solution import Status

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

STATUSES = tuple(Status)
"""`PointsSolution.codes` count in it."""

DEFICIENT = 1e-13
"""Smallest eigenvalue of an information matrix scaled to ones on its diagonal that is more than rounding."""

# Relative distance from the edge of what can be seen at which a plane counts as being on it.
_EDGE = 1e-6


@dataclass(frozen=True, eq=False)
class PointsSolution:
    """Maximum-likelihood planes, a row a spot; NaN where there is no number, and `codes` says why.

    Attributes
    ----------
    planes : (M, 3)
        ``(z_L, p, q)`` in the equations' sense (`z_L` the spot centre's z in the laser-parallel frame); mm, 1, 1.
    covariance : (M, 3, 3)
        Of the planes, to first order, from the points alone.
    cost : (M,)
        Sum of squared distances in standard deviations, weighted where robust: chi-squared with N - 3 degrees of
        freedom where the noise was given and right.
    chi2 : (M,)
        The part of it that another ellipse would explain and no plane does: chi-squared with 2 degrees of freedom, or
        twice an F variable with 2 and `scale_dof` where the scale was estimated; tests the rig.
    scale : (M,)
        What the given noise was multiplied by: 1, or its estimated scale (sigma in mm where no noise was given).
    scale_dof : (M,) of int
        Degrees of freedom behind an estimated scale; -1 where it was given.
    floored : (M,) of bool
        Whether the residuals were at rounding level and the noise was set to a floor.
    counts : (M,) of int
        Points of each row.
    codes : (M,) of int
        Index into `STATUSES`.
    steps : (M,) of int
        Of Gauss-Newton.
    """

    planes: Array
    covariance: Array
    cost: Array
    chi2: Array
    scale: Array
    scale_dof: NDArray[np.int64]
    floored: Bools
    counts: NDArray[np.int64]
    codes: NDArray[np.int64]
    steps: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.planes)

    @property
    def status(self) -> tuple[Status, ...]:
        """A status a row."""
        return tuple(STATUSES[code] for code in self.codes)

    @property
    def ok(self) -> Bools:
        """Where the plane was found and image and rig agree, (M,)."""
        return self.codes == STATUSES.index(Status.CONVERGED)


def improbability(chi2: Array, scale_dof: NDArray[np.int64]) -> Array:
    """p-value (M,) of `PointsSolution.chi2`: of chi-squared with 2 degrees of freedom, or of its F counterpart."""
    dof = np.maximum(scale_dof, 1)
    return np.where(scale_dof < 0, np.exp(-chi2 / 2), (1 + chi2 / dof) ** (-dof / 2))


def blank(m: int, counts: NDArray[np.int64]) -> PointsSolution:
    """Rows of which nothing can be said."""
    nan = np.full(m, np.nan)
    return PointsSolution(
        planes=np.full((m, 3), np.nan),
        covariance=np.full((m, 3, 3), np.nan),
        cost=nan.copy(),
        chi2=nan.copy(),
        scale=nan.copy(),
        scale_dof=np.full(m, -1),
        floored=np.zeros(m, dtype=bool),
        counts=counts,
        codes=np.full(m, STATUSES.index(Status.UNUSABLE)),
        steps=np.zeros(m, dtype=np.int64),
    )


def put(into: PointsSolution, rows: NDArray[np.intp], values: PointsSolution) -> None:
    """Write some rows."""
    for field in fields(PointsSolution):
        getattr(into, field.name)[rows] = getattr(values, field.name)


def _code(status: Status) -> int:
    return STATUSES.index(status)


NOWHERE = [_code(status) for status in (Status.NOT_CONVERGED, Status.AT_BOUND, Status.UNIDENTIFIABLE)]
POOR = [*NOWHERE, _code(Status.INCONSISTENT)]


def rows_of(solution: PointsSolution, rows: NDArray[np.intp]) -> PointsSolution:
    """Return some rows."""
    return PointsSolution(*(getattr(solution, field.name)[rows] for field in fields(PointsSolution)))


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over the points of squares and products of the distances, in standard deviations, and their derivatives."""

    by_plane: Array
    """(M, 3, 3), by planes with planes."""
    by_ellipse: Array
    """(M, 5, 5), by five coordinates of an ellipse."""
    score: Array
    """(M, 5), distances with derivatives by these."""
    cost: Array
    """(M,), distances squared."""


def concluded(
    planes: Array,
    sums: Sums,
    given: Sets,
    converged: Bools,
    steps: NDArray[np.int64],
    scale: Array,
    information: float,
) -> PointsSolution:
    """Covariances, evidence and statuses; `scale` and `information` are of the loss."""
    counts = given.counts
    chi2 = _explained(sums.by_ellipse, sums.score) / information
    inverse, weakest = _inverse(sums.by_plane)
    scale_dof = np.where(given.known, -1, counts - 5)
    if given.robust is None:
        free2 = np.maximum(1.0, (sums.cost - chi2) / np.maximum(scale_dof, 1))
    else:
        free2 = np.maximum(1.0, scale**2 * counts / np.maximum(counts - 3, 1))
    scale2 = np.where(scale_dof > 0, free2, 1.0)
    solution = PointsSolution(
        planes=planes,
        covariance=inverse * (scale2 / information)[:, None, None],
        cost=sums.cost / scale2,
        chi2=chi2 / scale2,
        scale=given.factor * np.sqrt(scale2),
        scale_dof=scale_dof,
        floored=np.where(given.known, given.factor > 1, (scale_dof > 0) & (scale2 == 1)),
        counts=counts,
        codes=np.full(len(counts), _code(Status.CONVERGED)),
        steps=steps,
    )
    _judge(solution, converged, weakest, given.setup)
    return solution


def _explained(information: Array, score: Array) -> Array:
    """``score' information^-1 score`` (M,)."""
    size = np.sqrt(np.einsum("mii->mi", information))
    normed = _regular(information / (size[:, :, None] * size[:, None, :]))
    right = np.nan_to_num(score / size)
    return np.sum(solve_all(normed, right) * right, axis=-1)


def _inverse(information: Array) -> tuple[Array, Array]:
    """Inverses (M, 3, 3), and the smallest eigenvalues (M,) of the matrices scaled to ones on the diagonal."""
    size = np.sqrt(np.einsum("mii->mi", information))
    normed = _regular(information / (size[:, :, None] * size[:, None, :]))
    weakest = np.asarray(np.linalg.eigvalsh(normed)[:, 0], dtype=float)
    normed = np.where((weakest > DEFICIENT)[:, None, None], normed, np.eye(3))
    inverse = np.asarray(np.linalg.inv(normed), dtype=float)
    return inverse / (size[:, :, None] * size[:, None, :]), weakest


def _regular(matrices: Array) -> Array:
    """The matrices with the identity in place of what is not finite, and all of them kept invertible."""
    eye = np.eye(matrices.shape[-1])
    finite = np.isfinite(matrices).all(axis=(-1, -2), keepdims=True)
    return np.where(finite, matrices, eye) + 1e-15 * eye


def _judge(solution: PointsSolution, converged: Bools, weakest: Array, setup: eq.Setup) -> None:
    """Write the codes, and NaN where there is no pose or no covariance."""
    z_L, p, q = solution.planes.T
    slope = np.hypot(p, q)
    lit = z_L - p * setup.e_x - q * setup.e_y
    edge = (z_L - setup.r * slope < _EDGE * z_L) | (lit < _EDGE * z_L)
    edge |= (z_L > FARTHEST * setup.r * (1 - _EDGE)) | (slope > np.tan(STEEPEST) * (1 - _EDGE))
    codes = solution.codes
    codes[solution.scale_dof == 0] = _code(Status.NO_NOISE_SCALE)
    known = solution.scale_dof != 0
    improbable = ~(improbability(solution.chi2, solution.scale_dof) >= evidence.IMPROBABLE)
    codes[known & improbable] = _code(Status.INCONSISTENT)
    codes[~(weakest > DEFICIENT)] = _code(Status.UNIDENTIFIABLE)
    codes[~converged] = _code(Status.NOT_CONVERGED)
    codes[edge] = _code(Status.AT_BOUND)
    nowhere = np.isin(codes, NOWHERE)
    solution.planes[nowhere & ~edge] = np.nan
    solution.covariance[nowhere | ~known] = np.nan
    for values in (solution.chi2, solution.cost):
        values[~known] = np.nan
