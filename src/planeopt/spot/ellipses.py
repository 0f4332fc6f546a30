"""Many ellipses at once: what the search compares, before one of them is an `Outline`."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.outline import Outline

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Ellipses:
    """K ellipses, the points ``centre + shape (cos t, sin t)``.

    Parameters
    ----------
    centre : (K, 2) array
        px.
    shape : (K, 2, 2) array
        Any matrix that takes the unit circle to the ellipse about its centre, px. A matrix, not axes and an angle: it
        changes smoothly where the two axes are equal.
    """

    centre: Array
    shape: Array

    def __len__(self) -> int:
        return len(self.centre)

    def __getitem__(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> "Ellipses":
        return Ellipses(self.centre[index], self.shape[index])

    @property
    def size(self) -> Array:
        """Radii (K,) of the circles of equal area, px."""
        return np.sqrt(np.abs(self._turn))

    @property
    def semi_axes(self) -> Array:
        """Major and minor semi-axes (K, 2), px."""
        # Their squares' sum is that of the matrix's elements, and their product its determinant.
        squares, twice = (self.shape**2).sum(axis=(1, 2)), 2 * np.abs(self._turn)
        total, apart = np.sqrt(squares + twice), np.sqrt(np.maximum(squares - twice, 0))
        return np.stack([total + apart, total - apart], axis=1) / 2

    @property
    def _turn(self) -> Array:
        """Determinants (K,): negative where the matrix mirrors the circle."""
        return self.shape[:, 0, 0] * self.shape[:, 1, 1] - self.shape[:, 0, 1] * self.shape[:, 1, 0]

    def at(self, count: int) -> tuple[Array, Array, Array]:
        """Return points (K, N, 2), outward normals (K, N, 2) and the share (K, N) of the boundary that each stands for.

        Evenly spaced in eccentric angle: closer together where the boundary is more curved.
        """
        around, ahead = _circle(count)
        points = self.centre[:, None, :] + (self.shape @ around).transpose(0, 2, 1)
        tangents = (self.shape @ ahead).transpose(0, 2, 1)
        length = np.maximum(np.hypot(tangents[..., 0], tangents[..., 1]), 1e-12)
        turn = np.sign(self._turn)[:, None]
        normals = np.stack([tangents[..., 1], -tangents[..., 0]], axis=-1) * (turn / length)[..., None]
        return points, normals, length / length.sum(axis=1, keepdims=True)

    def moved(self, shift: Array, stretch: Array) -> "Ellipses":
        """Return them shifted by (K, 2) px, and every point stretched about the centre by ``1 + stretch`` (K, 2, 2)."""
        return Ellipses(self.centre + shift, self.shape + stretch @ self.shape)

    def radius_of(self, points: Array) -> Array:
        """Return by how much each has to grow to pass through its points: (K, N) of (K, N, 2)."""
        local = np.linalg.solve(self.shape, (points - self.centre[:, None, :]).transpose(0, 2, 1))
        return np.hypot(local[:, 0], local[:, 1])

    def outline(self, index: int) -> Outline:
        """Return one of them by its axes and angle."""
        axes, values, _ = np.linalg.svd(self.shape[index])
        x, y = self.centre[index].tolist()
        angle = float(np.arctan2(axes[1, 0], axes[0, 0]))
        return Outline(x, y, float(values[0]), float(values[1]), (angle + np.pi / 2) % np.pi - np.pi / 2)


@cache
def _circle(count: int) -> tuple[Array, Array]:
    """Return points of the unit circle and unit tangents there, (2, N) each."""
    t = 2 * np.pi * np.arange(count) / count
    around = np.stack([np.cos(t), np.sin(t)])
    ahead = np.stack([-around[1], around[0]])
    for shared in (around, ahead):
        shared.flags.writeable = False
    return around, ahead


def unlike(ellipses: Ellipses, merit: Array, share: float) -> NDArray[np.intp]:
    """Return the indices, best first, of those that differ from all better ones by more than a share of their size."""
    kept: list[int] = []
    size = ellipses.size
    # Squared, a shape does not depend on where on the circle it starts.
    squared = ellipses.shape @ ellipses.shape.transpose(0, 2, 1)
    for index in np.argsort(-merit, kind="stable").tolist():
        apart = np.linalg.norm(ellipses.centre[kept] - ellipses.centre[index], axis=1) / size[index]
        other = np.linalg.norm(squared[kept] - squared[index], axis=(1, 2)) / (2 * size[index] ** 2)
        if np.all(apart + other > share):
            kept.append(index)
    return np.array(kept, dtype=np.intp)


def like(ellipses: Ellipses, others: Ellipses, share: float) -> NDArray[np.bool_]:
    """Return which (K,) of the ellipses differ by less than a share of their size from one of the others."""
    size = ellipses.size[:, None]
    squared, other = (e.shape @ e.shape.transpose(0, 2, 1) for e in (ellipses, others))
    apart = np.linalg.norm(ellipses.centre[:, None] - others.centre, axis=2) / size
    return np.any(apart + np.linalg.norm(squared[:, None] - other, axis=(2, 3)) / (2 * size**2) < share, axis=1)


def from_outline(outline: Outline) -> Ellipses:
    """Return one ellipse as an array of one."""
    return Ellipses(np.array([[outline.x, outline.y]]), (outline.axes * [outline.a, outline.b])[None])


def joined(parts: list[Ellipses]) -> Ellipses:
    """Return all of them in one array."""
    if not parts:
        return Ellipses(np.empty((0, 2)), np.empty((0, 2, 2)))
    return Ellipses(np.concatenate([p.centre for p in parts]), np.concatenate([p.shape for p in parts]))
