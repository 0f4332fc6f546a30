"""From places that are brighter than their surroundings to ellipses: the edges on rays from each, and what fits them.

The rays see a spot that is partly hidden, split by a bar, or touched by something brighter: most of its edge is there,
and the ellipse through most of the edges is found by trying many fives of them (Fischler and Bolles, Communications of
the ACM 24, 1981; rays from a seed: Li, Winfield, Parkhurst, Starburst, CVPR Workshops 2005).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.spot.ellipses import Ellipses
from planeopt.spot.pyramid import Level

Array = NDArray[np.floating]

_RAYS = 32
_REACH = 33  # px of the level that the rays are sampled at, one finer than that of the seeds: twice the largest spot
_FIVES = 96
_TOLERANCE = 0.8, 0.06  # px of the level, and of the radius
_SIGNIFICANT = 0.4  # of the typical edge: less is not looked at
_BEYOND = 0.5  # of a ray: what an edge further out than the ellipse counts against it
_PER_SEED = 3  # ellipses
_ALIKE = 0.15  # of the mean radius: ellipses that differ by less on the rays are one
_MIN_RADIUS = 1.5  # px of the level
_MAX_RATIO = 14.0  # of the axes


def _fives() -> NDArray[np.intp]:
    """Return fives of rays (F, 5), spread over arcs of 40 to 100 % of the circle; always the same."""
    rng = np.random.default_rng(20)
    widths = np.linspace(0.4, 1.0, _FIVES) * _RAYS
    start = rng.integers(0, _RAYS, _FIVES)
    steps = (np.arange(5) + rng.uniform(-0.35, 0.35, (_FIVES, 5))) * widths[:, None] / 5
    return (start[:, None] + np.rint(steps).astype(np.intp)) % _RAYS


_THETA = 2 * np.pi * np.arange(_RAYS) / _RAYS
_COS, _SIN = np.cos(_THETA), np.sin(_THETA)
_FIVE_RAYS = _fives()
_ODD = np.arange(_FIVES) % 3 == 0
_EVEN_TERMS = np.stack([np.ones(_RAYS), np.cos(2 * _THETA), np.sin(2 * _THETA)])
_ODD_TERMS = np.stack([_COS, _SIN])


def edges_on_rays(level: Level, seeds: Array) -> tuple[Array, Array]:
    """Return the two most likely edges on each ray, from bright to dark going outwards.

    Parameters
    ----------
    level : Level
    seeds : (K, 2) array
        Where the rays start, px of the whole image.

    Returns
    -------
    radius : (K, R, 2) array
        Of the strongest fall, and of the first that is nearly significant, or, where that is the strongest, of the
        last; px of the level, NaN where there is none.
    height : (K, R, 2) array
        By how much the grey value falls across three pixels, 0 where there is none.
    """
    # Single precision: a ten thousandth of a pixel, and half the time.
    offsets = level.factor * np.arange(_REACH)[:, None] * np.stack([_COS, _SIN], axis=1)[:, None, :]
    places = seeds.astype(np.float32)[:, None, None, :] + offsets.astype(np.float32)
    grey, there = level.sample(places)
    # Means of two samples, three apart: the fall half way between samples k + 1 and k + 2.
    fall = (grey[..., :-3] + grey[..., 1:-2] - grey[..., 2:-1] - grey[..., 3:]) / 2
    fall = np.where(there[..., 3:], np.maximum(fall, 0), 0)
    inner, outer = np.zeros_like(fall), np.zeros_like(fall)
    inner[..., 1:], outer[..., :-1] = fall[..., :-1], fall[..., 1:]
    # An edge right at the start is half seen and still one.
    top = (fall >= inner) & (fall > outer)
    peaks = np.where(top, fall, 0)
    strongest = peaks.argmax(axis=2)
    rows, columns = np.ogrid[: len(seeds), :_RAYS]
    height = peaks[rows, columns, strongest]
    typical = _median(height)[:, None, None]
    significant = peaks > _SIGNIFICANT * np.minimum(typical, height[..., None]) + 1e-9
    first = significant.argmax(axis=2)
    # What is brighter than a ring hides it from the places behind: its line is the last thing on their rays.
    last = peaks.shape[2] - 1 - significant[..., ::-1].argmax(axis=2)
    index = np.stack([strongest, np.where(first == strongest, last, first)], axis=2)
    at, before, after = (values[rows[..., None], columns[..., None], index] for values in (peaks, inner, outer))
    bend = 2 * at - before - after
    fine = np.where(bend > 0, (after - before) / (2 * np.where(bend > 0, bend, 1)), 0)
    return np.where(at > 0, index + 1.5 + np.clip(fine, -0.5, 0.5), np.nan), at


def _median(values: Array) -> Array:
    """Return the medians (K,) over all rays (K, R); numpy's own takes several times as long."""
    return np.partition(values, (_RAYS // 2 - 1, _RAYS // 2), axis=1)[:, _RAYS // 2 - 1 : _RAYS // 2 + 1].mean(axis=1)


@dataclass(frozen=True, eq=False)
class Seeds:
    """K places to start from, and the edges on the rays from them.

    Parameters
    ----------
    place : (K, 2) array
        px of the whole image.
    found_at : (K,) array of int
        The level that their edges were found at.
    factor : (K,) array
        Its factor.
    radius, height : (K, R, 2) arrays
        See `edges_on_rays`.
    """

    place: Array
    found_at: NDArray[np.intp]
    factor: Array
    radius: Array
    height: Array

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "Seeds":
        return Seeds(
            self.place[index], self.found_at[index], self.factor[index], self.radius[index], self.height[index]
        )

    @property
    def promise(self) -> Array:
        """How strong a spot each may be (K,): its likely size times the root of the height of its edge.

        The height that all but a third of the rays exceed: a peak on a line or at a corner has edges on few.
        """
        ordered = np.sort(self.height[..., 0], axis=1)
        there = np.sort(np.nan_to_num(self.radius[..., 0], nan=0.0), axis=1)
        return np.sqrt(ordered[:, _RAYS // 3]) * there[:, _RAYS // 2] * self.factor


def seeds_at(levels: list[Level], index: int, places: Array) -> Seeds:
    """Return the seeds at places (K, 2), with the edges as they show at a level."""
    count = len(places)
    if count:
        radius, height = edges_on_rays(levels[index], places)
    else:
        radius = height = np.empty((0, _RAYS, 2))
    return Seeds(places, np.full(count, index), np.full(count, float(levels[index].factor)), radius, height)


def all_seeds(parts: list[Seeds]) -> Seeds:
    """Return the seeds of several levels in one array."""
    parts = [Seeds(np.empty((0, 2)), np.empty(0, np.intp), np.empty(0), *np.empty((2, 0, _RAYS, 2))), *parts]
    names = ("place", "found_at", "factor", "radius", "height")
    return Seeds(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def ellipses_through(seeds: Seeds) -> tuple[Ellipses, Array, NDArray[np.intp]]:
    """Return the ellipses that most of the edges round each seed agree on, a few of each.

    Also the share of rays that agree, and the level that each was found at.

    With the seed inside, the conic ``q0 + q1 cos 2t + q2 sin 2t + w (q3 cos t + q4 sin t) = w^2`` in the inverse radius
    ``w`` is linear in its five coefficients, and solved exactly for five rays.
    """
    radius, height = seeds.radius, seeds.height
    w = 1 / np.maximum(np.where(np.isfinite(radius), radius, 1e3), 0.5)
    weight = np.minimum(height / np.maximum(_median(height[..., 0]), 1e-9)[:, None, None], 1.0)
    five = np.where(_ODD[None, :, None], w[:, _FIVE_RAYS, 1], w[:, _FIVE_RAYS, 0])
    system = np.concatenate([_EVEN_TERMS, _ODD_TERMS]).T[_FIVE_RAYS] * np.ones((len(w), 1, 1, 1))
    system[..., 3:] *= five[..., None]
    # A ridge far below rounding of the edges' places keeps a five with two equal rays solvable.
    q = np.linalg.solve(system + 1e-9 * np.eye(5), (five**2)[..., None])[..., 0]
    share, _ = _agreement(q, radius, weight)
    _, good = _geometric(q)
    share = np.where(good, share, 0)
    # As far as the rays reach: between two parallel lines are many ellipses that differ only beyond.
    radii = np.minimum(_radii(q)[0], _REACH)
    rows = np.arange(len(q))
    best = []
    for _ in range(_PER_SEED):
        top = share.argmax(axis=1)
        best.append(top)
        chosen = radii[rows, top][:, None]
        share = np.where(np.abs(radii - chosen).mean(axis=2) < _ALIKE * chosen.mean(axis=2), 0, share)
    ellipses, share = _refitted(q[rows[:, None], np.stack(best, axis=1)], radius, w, weight)
    place, factor = np.repeat(seeds.place, _PER_SEED, axis=0), np.repeat(seeds.factor, _PER_SEED)[:, None]
    moved = Ellipses(place + factor * ellipses.centre, factor[..., None] * ellipses.shape)
    return moved, share.ravel(), np.repeat(seeds.found_at, _PER_SEED)


def _agreement(q: Array, radius: Array, weight: Array) -> tuple[Array, Array]:
    """Return the share of rays (K, H) whose edges are on the conics (K, H, 5), and how well each edge is (K, H, R, 2).

    What hides a spot cuts its edge short. An edge further out speaks against an ellipse that claims to be all.
    """
    predicted, real = _radii(q)
    inverse = 1 / (np.float32(_TOLERANCE[0]) + np.float32(_TOLERANCE[1]) * predicted)
    # No edge: as one far inside, which neither agrees nor speaks against anything.
    edges = np.where(np.isfinite(radius), radius, -1e6).astype(np.float32)[:, None]
    weight = weight.astype(np.float32)[:, None]
    miss = (predicted[..., None] - edges) * inverse[..., None]
    credit = np.maximum(1 - miss * miss, 0) * weight
    further = np.clip(-np.maximum(miss[..., 0], miss[..., 1]) - 1, 0, 1) * (weight[..., 1] > _SIGNIFICANT)
    share = (np.maximum(credit[..., 0], credit[..., 1]) - np.float32(_BEYOND) * further).mean(axis=2)
    return np.where(real, share, 0), credit


def _radii(q: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return where the rays cross conics (K, H, 5), px of the level, (K, H, R), and for which (K, H) all do."""
    odd = q[..., 3:] @ _ODD_TERMS
    root = odd**2 + 4 * (q[..., :3] @ _EVEN_TERMS)
    radius = 2 / np.maximum(odd + np.sqrt(np.maximum(root, 0)), 1e-6)
    # Single precision for what is large, and far from any limit of it.
    return radius.astype(np.float32), np.asarray(np.all(root > 0, axis=2))


def _refitted(q: Array, radius: Array, w: Array, weight: Array) -> tuple[Ellipses, Array]:
    """Return conics (K, H, 5) fitted anew to all edges that agree with them, and the share (K, H) that does then."""
    share, credit = _agreement(q, radius, weight)
    design = np.broadcast_to(np.concatenate([_EVEN_TERMS, _ODD_TERMS]).T[:, None], (*w.shape, 5)).copy()
    design[..., 3:] *= w[..., None]
    design, target = design.reshape(len(w), 1, -1, 5), (w**2).reshape(len(w), 1, -1, 1)
    # An error dr of a radius is one of 2 w^3 dr in the equation.
    use = (credit / w[:, None] ** 6).reshape(*q.shape[:2], -1, 1)
    left = (design * use).swapaxes(2, 3)
    normal = left @ design
    scale = np.trace(normal, axis1=2, axis2=3)[..., None, None]
    again = np.linalg.solve(normal + (1e-12 * scale + 1e-30) * np.eye(5), left @ target)[..., 0]
    new, _ = _agreement(again, radius, weight)
    _, good = _geometric(again)
    better = good & (new > share)
    kept = np.where(better[..., None], again, q)
    ellipses, _ = _geometric(kept)
    return ellipses, np.where(better, new, share)


def _geometric(q: Array) -> tuple[Ellipses, NDArray[np.bool_]]:
    """Return the ellipses of coefficients (..., 5), flattened, and which (...) of them are ellipses of some size."""
    # q0 + q1 cos 2t + ... times r^2:  x' M x + m x = 1.
    M = np.stack([q[..., 0] + q[..., 1], q[..., 2], q[..., 2], q[..., 0] - q[..., 1]], axis=-1).reshape(-1, 2, 2)
    m = q[..., 3:].reshape(-1, 2)
    determinant = np.linalg.det(M)
    real = (determinant > 1e-12) & (M[:, 0, 0] > 0)
    M = np.where(real[:, None, None], M, np.eye(2))
    inverse = np.linalg.inv(M)
    centre = -(inverse @ m[..., None])[..., 0] / 2
    level = 1 - np.einsum("ki,ki->k", m, centre) / 2
    # The symmetric root of a positive matrix: shape shape' = inverse * level.
    squared = inverse * np.maximum(level, 1e-12)[:, None, None]
    root = np.sqrt(np.maximum(np.linalg.det(squared), 1e-24))
    trace = np.sqrt(np.maximum(squared[:, 0, 0] + squared[:, 1, 1] + 2 * root, 1e-24))
    shape = (squared + root[:, None, None] * np.eye(2)) / trace[:, None, None]
    # Of the symmetric shape trace and determinant are the sum and the product of the semi-axes.
    a = trace / 2 + np.sqrt(np.maximum(trace**2 / 4 - root, 0))
    b = root / np.maximum(a, 1e-12)
    good = (
        real & (level > 0) & (b > _MIN_RADIUS / 2) & (a < 3 * _REACH) & (a < _MAX_RATIO * b) & (root > _MIN_RADIUS**2)
    )
    return Ellipses(centre, shape), good.reshape(q.shape[:-1])
