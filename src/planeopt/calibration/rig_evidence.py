"""What new observations say of a rig whose calibration is known with a covariance: linear algebra only.

Observations with white noise say of n parameters ``A (x - eta_0) = h``: A their information, poses and all else that is
not asked for eliminated. With the calibration's covariance ``Sigma``, a rig as calibrated has ``h ~ N(0, A + A Sigma
A)``, and with ``P = (A + Sigma^-1)^-1`` the update is ``P h`` and the score ``b = Sigma^-1 P h``, of covariance
``M = A - A P A``: how hard each parameter is pulled, in the metric of data and calibration together. Of a change
``delta`` of one group g of parameters alone the most likely value is ``M_gg^-1 b_g``, and it explains ``b_g' M_gg^-1
b_g`` of chi-squared.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.stats
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Explained:
    """What a change of some parameters alone explains of chi-squared, with their most likely change (k,)."""

    chi2: float
    dof: int
    change: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """What observations say of n parameters, and what was known of them.

    Parameters
    ----------
    information : (n, n)
        A.
    pull : (n,)
        h.
    sigma : (n, n)
        Covariance of the calibration, positive definite.
    reach : (n,)
        For each parameter, a change so large that what cannot be seen within it cannot be seen.
    """

    information: Array
    pull: Array
    sigma: Array
    reach: Array

    @cached_property
    def _white(self) -> tuple[Array, Array, Array]:
        """Directions (n, n) in which information and calibration are diagonal, the information, and the pull there."""
        factor = np.asarray(np.linalg.cholesky(self.sigma), dtype=np.float64)
        inside = factor.T @ self.information @ factor
        share, turn = np.linalg.eigh((inside + inside.T) / 2)
        share = np.maximum(share, 0.0)
        directions = factor @ turn
        return directions, share, directions.T @ self.pull

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Directions (n,) in which a change within reach can be seen."""
        directions, share, _ = self._white
        size = np.sum((directions / self.reach[:, None]) ** 2, axis=0)
        return size * (share + 1) < share

    @cached_property
    def update(self) -> Array:
        """The most probable change (n,), the calibration being the prior."""
        directions, share, pull = self._white
        return directions @ (pull / (1 + share))

    @cached_property
    def updated(self) -> Array:
        """The covariance (n, n) after the update."""
        directions, share, _ = self._white
        return (directions / (1 + share)) @ directions.T

    @cached_property
    def expected(self) -> Array:
        """The covariance (n, n) of the update of a rig that is as calibrated."""
        directions, share, _ = self._white
        return (directions * (share / (1 + share))) @ directions.T

    @cached_property
    def metric(self) -> Array:
        """M (n, n), in the directions that can be seen."""
        directions, share, _ = self._white
        # The directions' inverse, transposed, is Sigma^-1 directions.
        back = np.linalg.solve(self.sigma, directions)[:, self.seen]
        return (back * (share / (1 + share))[self.seen]) @ back.T

    def test(self) -> tuple[float, int]:
        """Return chi-squared of a rig that is as calibrated, in what can be seen, and its degrees of freedom."""
        _, share, pull = self._white
        seen = self.seen
        return float(np.sum(pull[seen] ** 2 / (share * (1 + share))[seen])), int(np.count_nonzero(seen))

    def explained_by(self, rows: Sequence[int]) -> Explained:
        """Return what a change of some parameters alone explains."""
        chosen = list(rows)
        directions, share, pull = self._white
        back = np.linalg.solve(self.sigma, directions)[chosen][:, self.seen]
        score = back @ (pull / (1 + share))[self.seen]
        metric = self.metric[np.ix_(chosen, chosen)]
        size = np.sqrt(np.maximum(np.diagonal(metric), np.finfo(np.float64).tiny))
        inverse = np.linalg.pinv(metric / np.outer(size, size), rcond=1e-9, hermitian=True) / np.outer(size, size)
        rank = int(np.linalg.matrix_rank(metric / np.outer(size, size), tol=1e-9, hermitian=True))
        return Explained(
            float(score @ inverse @ score), rank, inverse @ score, np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
        )

    def beyond(self, extra: "Extra") -> tuple[float, int]:
        """Return chi-squared of parameters that the calibration does not have being zero, and their number."""
        posterior = self.updated
        left = extra.pull - extra.across @ self.update
        covariance = extra.information - extra.across @ posterior @ extra.across.T
        size = np.sqrt(np.maximum(np.diagonal(covariance), np.finfo(np.float64).tiny))
        inverse = np.linalg.pinv(covariance / np.outer(size, size), rcond=1e-9, hermitian=True)
        rank = int(np.linalg.matrix_rank(covariance / np.outer(size, size), tol=1e-9, hermitian=True))
        return float((left / size) @ inverse @ (left / size)), rank


@dataclass(frozen=True, eq=False)
class Extra:
    """What the observations say of m parameters that are not free: pull (m,), information (m, m) and (m, n) across."""

    information: Array
    across: Array
    pull: Array


def found_from(evidence: RigEvidence, level: float, power: float) -> Array:
    """Return the change (n,) of each parameter alone that the test at a level finds with a probability; inf: none."""
    _, dof = evidence.test()
    if dof == 0:
        return np.full(len(evidence.pull), np.inf)
    needed = noncentrality(dof, level, power)
    weight = np.diagonal(evidence.metric)
    return np.where(weight > 0, np.sqrt(needed / np.where(weight > 0, weight, 1.0)), np.inf)


def noncentrality(dof: int, level: float, power: float) -> float:
    """Return by how much chi-squared must be raised for a test at a level to fail with a probability."""
    limit = float(scipy.stats.chi2.isf(level, dof))
    low, high = 0.0, 10.0 * (limit + 10.0)
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (low, middle) if scipy.stats.ncx2.sf(limit, dof, middle) >= power else (middle, high)
    return high
