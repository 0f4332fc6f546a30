"""Where the walkers begin, and a density to draw from that covers the posterior."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from planeopt.posterior.prior import Prior, Random
from planeopt.posterior.target import SCALE_BOUNDS, Target

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

_STENCIL_STEP = 0.02
_NEWTON_STEPS = 60
_SETTLED = 1e-4
_FRACTIONS = np.array([1.0, 0.5, 0.25, 0.1, 0.03, 0.01])
_LONGEST_STEP = 20.0

_DOF = 5.0
_INFLATION = 1.3
_PRIOR_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Peak:
    """A normal law laid to the top of a log density.

    Attributes
    ----------
    centre : (d,)
    root : (d, d)
        Lower triangular; ``root root'`` is the covariance.
    height : float
        The log density at the centre.
    curved : bool
        Whether the covariance is the inverse of the curvature there. False where that is not positive definite, as on
        the edge of what can be seen: the covariance is then a guess.
    """

    centre: Array
    root: Array
    height: float
    curved: bool

    @property
    def covariance(self) -> Array:
        return self.root @ self.root.T


def climb(density: Density, start: Array, root: Array) -> Peak:
    """Find a top of a log density by Newton's method with central differences, in units of its own width.

    Parameters
    ----------
    density : callable
        From (W, d) to (W,); minus infinity outside its domain.
    start : (d,)
        Where it is finite.
    root : (d, d)
        A guess of the width there; three orders too wide or too narrow do no harm.
    """
    centre, height, curved = start, float(density(start[None])[0]), False
    for _ in range(_NEWTON_STEPS):
        gradient, curvature = _derivatives(density, centre, root)
        if not (np.isfinite(gradient).all() and np.isfinite(curvature).all()):
            break
        values, axes = np.linalg.eigh(-curvature)
        curved = bool(values[0] > 0)
        bent = np.maximum(np.abs(values), 1e-6 * max(np.max(np.abs(values)), np.finfo(float).tiny))
        step = axes @ ((axes.T @ gradient) / bent)
        length = float(np.linalg.norm(step))
        if length > _LONGEST_STEP:
            step *= _LONGEST_STEP / length
        settled = curved and abs(float(gradient @ step)) < _SETTLED**2
        tried = centre + _FRACTIONS[:, None] * (root @ step)
        heights = density(tried)
        best = int(np.argmax(heights))
        improved = bool(heights[best] > height)
        if improved:
            centre, height = tried[best], float(heights[best])
        if curved:
            root = np.asarray(np.linalg.cholesky(root @ (axes / bent) @ axes.T @ root.T), dtype=float)
        if settled or not (improved or curved):
            break
    return Peak(centre, root, height, curved)


def _derivatives(density: Density, centre: Array, root: Array) -> tuple[Array, Array]:
    """Gradient (d,) and second derivatives (d, d) by ``y`` in ``centre + root y``."""
    d, h = len(centre), _STENCIL_STEP
    unit = h * np.eye(d)
    pairs = [(i, j) for i in range(d) for j in range(i)]
    corners = [a * unit[i] + b * unit[j] for i, j in pairs for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    values = density(centre + np.stack([np.zeros(d), *unit, *-unit, *corners]) @ root.T)
    with np.errstate(invalid="ignore"):
        middle, ahead, behind, mixed = values[0], values[1 : d + 1], values[d + 1 : 2 * d + 1], values[2 * d + 1 :]
        curvature = np.diag((ahead - 2 * middle + behind) / h**2)
        for (i, j), (a, b, c, e) in zip(pairs, mixed.reshape(-1, 4), strict=True):
            curvature[i, j] = curvature[j, i] = (a - b - c + e) / (4 * h**2)
        return (ahead - behind) / (2 * h), curvature


@dataclass(frozen=True, eq=False)
class Mixture:
    """Student-t laws at the peaks, wider than these, and a share of the prior.

    The share of the prior bounds the ratio of the posterior to this density: no part of it is out of reach.
    """

    target: Target
    peaks: tuple[Peak, ...]
    wide: Prior

    def draw(self, rng: Random, n: int) -> Array:
        """(n, d)."""
        d = self.target.dimension
        # All are drawn from every part, and kept from one: few numbers, and the same stream whatever is chosen.
        choice = rng.uniform(0.0, 1.0, n)
        planes = self.wide.draw_unseen(rng, n, self.target.likelihood.setup)
        drawn = np.column_stack([np.log(planes[:, 0]), planes[:, 1:]])
        if d == 4:
            drawn = np.column_stack([drawn, rng.uniform(*SCALE_BOUNDS, n)])
        tails = _INFLATION * np.sqrt(_DOF / rng.chisquare(_DOF, n))
        normal = rng.standard_normal((n, d)) * tails[:, None]
        edges = _PRIOR_SHARE + (1 - _PRIOR_SHARE) * np.arange(len(self.peaks) + 1) / max(len(self.peaks), 1)
        for peak, low, high in zip(self.peaks, edges[:-1], edges[1:], strict=True):
            mine = (choice >= low) & (choice < high)
            drawn[mine] = peak.centre + normal[mine] @ peak.root.T
        return drawn

    def log_density(self, theta: Array) -> Array:
        """(W,), normalised."""
        d = self.target.dimension
        wide = self.wide.log_density(self.target.planes(theta), self.target.likelihood.setup)
        if d == 4:
            inside = (theta[:, 3] >= SCALE_BOUNDS[0]) & (theta[:, 3] <= SCALE_BOUNDS[1])
            wide = np.where(inside, wide - math.log(SCALE_BOUNDS[1] - SCALE_BOUNDS[0]), -np.inf)
        parts = [wide + math.log(_PRIOR_SHARE)]
        constant = gammaln((_DOF + d) / 2) - gammaln(_DOF / 2) - d / 2 * math.log(_DOF * math.pi * _INFLATION**2)
        for peak in self.peaks:
            y = np.linalg.solve(peak.root, (theta - peak.centre).T)
            far = np.sum(y * y, axis=0) / (_DOF * _INFLATION**2)
            size = float(np.sum(np.log(np.diagonal(peak.root))))
            share = math.log((1 - _PRIOR_SHARE) / len(self.peaks))
            parts.append(share + constant - size - (_DOF + d) / 2 * np.log1p(far))
        return np.asarray(logsumexp(np.stack(parts), axis=0))


def resample(rng: Random, log_weights: Array, n: int) -> NDArray[np.intp]:
    """Draw n different rows with probabilities in proportion to their weights, one after the other (Gumbel's trick).

    Rows of no weight are taken only where there are no others left.
    """
    uniform = np.clip(rng.uniform(0.0, 1.0, len(log_weights)), 1e-300, 1 - 1e-16)
    weights = np.where(np.isfinite(log_weights), log_weights, -1e300)
    keys = weights - np.log(-np.log(uniform))
    return np.argsort(-keys, kind="stable")[:n]
