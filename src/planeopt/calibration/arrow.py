"""Normal equations with an arrow's shape: what all views share, and a pose of six numbers each.

    N = [[V, W_1', W_2', ...],        V (g, g) shared, U_v (6, 6) of a view, W_v (6, g) between.
         [W_1, U_1,  0,  ...],
         [W_2,  0,  U_2, ...]]

The poses are eliminated view by view (Schur complement), so that time and memory grow as the number of views.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arrow:
    """Normal equations of one linearisation; sums of them are those of all observations.

    Parameters
    ----------
    V, W, U : (g, g), (views, 6, g) and (views, 6, 6) arrays
    shared, pose : (g,) and (views, 6) arrays
        J' w residual.
    """

    V: Array
    W: Array
    U: Array
    shared: Array
    pose: Array

    @classmethod
    def of(cls, residual: Array, by_shared: Array, by_pose: Array, weight: Array) -> "Arrow":
        """Return the equations of weighted residuals (views, N) with derivatives (views, N, g) and (views, N, 6)."""
        left = np.swapaxes(by_shared * weight[..., None], -1, -2)
        below = np.swapaxes(by_pose * weight[..., None], -1, -2)
        column = residual[..., None]
        return cls(
            V=(left @ by_shared).sum(axis=0),
            W=below @ by_shared,
            U=below @ by_pose,
            shared=(left @ column).sum(axis=0)[:, 0],
            pose=(below @ column)[..., 0],
        )

    def __add__(self, other: "Arrow") -> "Arrow":
        """Return the equations of both."""
        return Arrow(
            self.V + other.V, self.W + other.W, self.U + other.U, self.shared + other.shared, self.pose + other.pose
        )

    def with_prior(self, information: Array, pull: Array) -> "Arrow":
        """Return the equations with pseudo-observations of the shared parameters: (g, g) and (g,)."""
        return Arrow(self.V + information, self.W, self.U, self.shared + pull, self.pose)

    def damped(self, damping: float) -> "Arrow":
        """Return the equations with their diagonals raised by a factor, after Marquardt."""
        g = np.arange(len(self.V))
        six = np.arange(6)
        V, U = self.V.copy(), self.U.copy()
        V[g, g] *= 1 + damping
        U[:, six, six] *= 1 + damping
        return Arrow(V, self.W, U, self.shared, self.pose)

    def reduced(self) -> Array:
        """Return the information (g, g) about what is shared, the poses being unknown: V - sum W' U^-1 W."""
        return _symmetric(self.V - (np.swapaxes(self.W, -1, -2) @ np.linalg.solve(self.U, self.W)).sum(axis=0))

    def step(self) -> tuple[Array, Array]:
        """Return the solution of N x = -J' w residual: (g,) and (views, 6).

        Raises
        ------
        numpy.linalg.LinAlgError
            If the equations are singular.
        """
        right = np.concatenate([self.W, self.pose[..., None]], axis=-1)
        solved = np.asarray(np.linalg.solve(self.U, right), dtype=np.float64)
        by_shared, alone = solved[..., :-1], solved[..., -1]
        g = len(self.V)
        if g == 0:
            return np.zeros(0), -alone
        S = self.V - (np.swapaxes(self.W, -1, -2) @ by_shared).sum(axis=0)
        pull = self.shared - np.einsum("vkg,vk->g", self.W, alone)
        scale = _unit_columns(self.V)
        shared = np.empty(g)
        shared[:] = -scale * np.linalg.solve(scale[:, None] * S * scale, scale * pull)
        return shared, -alone - by_shared @ shared

    def decrement(self, shared: Array, pose: Array) -> float:
        """Return the length of a step in standard deviations: sqrt(x' N x)."""
        value = shared @ self.V @ shared + np.einsum("vi,vij,vj->", pose, self.U, pose)
        value += 2 * np.einsum("vi,vig,g->", pose, self.W, shared)
        return float(np.sqrt(max(value, 0.0)))


@dataclass(frozen=True, eq=False)
class Inverse:
    """The blocks of N^-1 that are asked for.

    Parameters
    ----------
    shared : (g, g) array
    between : (views, 6, g) array
        Of each pose with what is shared.
    pose : (views, 6, 6) array
    """

    shared: Array
    between: Array
    pose: Array

    @classmethod
    def of(cls, arrow: Arrow) -> "Inverse":
        """Return the inverse's blocks.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the equations are singular.
        """
        alone = np.linalg.inv(arrow.U)
        by_shared = alone @ arrow.W
        S = _symmetric(arrow.V - (np.swapaxes(arrow.W, -1, -2) @ by_shared).sum(axis=0))
        scale = _unit_columns(arrow.V)
        shared = _symmetric(scale[:, None] * np.linalg.inv(scale[:, None] * S * scale) * scale) if len(S) else S
        between = -by_shared @ shared
        return cls(shared, between, alone - between @ np.swapaxes(by_shared, -1, -2))

    def trace(self, part: Arrow) -> float:
        """Return the trace of N^-1 N_part: how many of the unknowns a part of the observations pays for."""
        value = np.sum(self.shared * part.V) + np.sum(self.pose * part.U) + 2 * np.sum(self.between * part.W)
        return float(value)


def condition(arrow: Arrow) -> float:
    """Return the condition number of the Jacobian of what is shared, its columns scaled, the poses eliminated.

    The columns have unit length before the poses are taken out of them: a parameter that the poses can imitate is then
    a short column, and not scaled up to look well.
    """
    if not len(arrow.V):
        return 1.0
    scale = _unit_columns(arrow.V)
    values = np.linalg.eigvalsh(scale[:, None] * arrow.reduced() * scale)
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def _unit_columns(V: Array) -> Array:
    """Return what scales the columns of the shared parameters to unit length; px, mm and 1 stand side by side."""
    return np.asarray(1 / np.sqrt(np.maximum(np.diagonal(V), np.finfo(np.float64).tiny)), dtype=np.float64)


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2
