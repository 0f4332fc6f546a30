"""From pixels to planes and their derivatives, some hundred spots at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.conic import arc_fraction, is_ellipse
from planeopt.estimation.descent import at_planes, within_bounds
from planeopt.estimation.efficiency import curvatures_seen
from planeopt.estimation.feet import Boundary
from planeopt.estimation.images import Images, conics_at
from planeopt.estimation.judged import PointsSolution, blank
from planeopt.estimation.points import CHUNK, Piece, alike, keep_memory, solve_piece
from planeopt.estimation.rig_effect import RigDerivatives, RigEffect, Seen, Sight
from planeopt.estimation.sets import Sets
from planeopt.estimation.tangents import Cloud, complete
from planeopt.rig import Rig
from planeopt.spot import Spot

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Rows = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Solved:
    """What is known of M spots from their points; NaN where it is not.

    Attributes
    ----------
    points : PointsSolution
    effect : RigEffect
    curvature : (M,)
        As `planeopt.estimation.efficiency.Reach` has it.
    sigma : (M,)
        Typical standard deviation of the points, mm, as the spot gave it.
    arc : (M,)
        Fractions of the planes' ellipses that the points cover.
    """

    points: PointsSolution
    effect: RigEffect
    curvature: Array
    sigma: Array
    arc: Array

    @classmethod
    def blank(cls, counts: NDArray[np.int64], n_free: int, n_seen: int) -> "Solved":
        """Of spots of which nothing is known."""
        m = len(counts)
        nan = [np.full((m, *shape), np.nan) for shape in ((3, n_free), (2,), (2, n_free), (2, n_seen), (), (), ())]
        return cls(blank(m, counts), RigEffect(*nan[:4]), *nan[4:])

    def put(self, rows: Rows, values: "Solved") -> None:
        """Write those of some spots."""
        for ours, theirs in ((self.points, values.points), (self.effect, values.effect)):
            for field in fields(ours):
                getattr(ours, field.name)[rows] = getattr(theirs, field.name)
        self.curvature[rows], self.sigma[rows], self.arc[rows] = values.curvature, values.sigma, values.arc


def solve_spots(spots: Sequence[Spot], rig: Rig, setup: eq.Setup, robust: float | None) -> Solved:
    """Solve spots of any lengths.

    Parameters
    ----------
    spots : sequence of Spot
        Those with a pixel that no ray of the camera reaches are unusable, and have no points.
    rig : Rig
        With a beam.
    setup : Setup
        Of the rig.
    robust : float or None
    """
    keep_memory()
    derivatives = RigDerivatives(rig, setup)
    n_free, n_seen = derivatives.sizes
    counts = np.array([len(spot.points) for spot in spots], dtype=np.int64)
    found = Solved.blank(counts, n_free, n_seen)
    for rows, length in alike(counts, CHUNK):
        piece = [spots[row] for row in rows.tolist()]
        found.put(rows, _solve(piece, counts[rows], length, derivatives, setup, robust))
    return found


def pixels(spots: Sequence[Spot], counts: NDArray[np.int64], length: int) -> tuple[Array, Array, Array]:
    """Pixels u, v and sigmas (M, N) of spots, each filled up with its own points; sigma is 1 where it is not known."""
    at = np.concatenate([spot.points for spot in spots])
    known = [spot.sigma is not None for spot in spots]
    if all(known):
        sigma = np.concatenate([spot.sigma for spot in spots if spot.sigma is not None])
    elif any(known):
        sigma = np.concatenate([np.ones(len(spot)) if spot.sigma is None else spot.sigma for spot in spots])
    else:
        sigma = np.ones(len(at))
    if np.all(counts == length):
        shape = (len(spots), length)
        return at[:, 0].reshape(shape), at[:, 1].reshape(shape), sigma.reshape(shape)
    begin = np.cumsum(counts) - counts
    index = begin[:, None] + np.arange(length) % counts[:, None]
    return at[index, 0], at[index, 1], sigma[index]


def _solve(
    spots: Sequence[Spot],
    counts: NDArray[np.int64],
    length: int,
    derivatives: RigDerivatives,
    setup: eq.Setup,
    robust: float | None,
) -> Solved:
    u, v, sigma = pixels(spots, counts, length)
    x, y, sight, seen = on_laser_plane(derivatives.rig, u, v)
    if not np.all(seen):
        counts = np.where(seen.all(axis=1), counts, 0)
        x[counts == 0] = np.nan
    known = np.array([spot.sigma is not None for spot in spots])
    given = Sets(
        np.moveaxis(np.stack([x, y]), 0, -1),
        _covariances(sight, sigma),
        setup,
        counts,
        np.full((len(spots), 3), np.nan),
        robust,
        known,
        np.ones(len(spots)),
    )
    piece = solve_piece(given)
    with np.errstate(all="ignore"):  # of rows that have no plane, and feet at centres of curvature
        effect, curvature = _looked_at(piece, given, sight, derivatives)
    arc = _arcs(piece.solution.planes, x, y, counts, derivatives.images)
    return Solved(piece.solution, effect, curvature, piece.sigma, arc)


def on_laser_plane(rig: Rig, u: Array, v: Array) -> tuple[Array, Array, Sight, Bools]:
    """Coordinates of pixels on the laser-parallel image plane, mm, and which have a ray that meets it; all (M, N).

    As `Rig.to_laser_plane`, but component by component, and in place: this is where time goes.
    """
    camera = rig.camera
    nx, ny, inner, good = camera.normalise_components(u, v)
    (q00, q01, q02), (q10, q11, q12), (q20, q21, q22) = rig.Q.tolist()
    depth = _linear(nx, ny, q20, q21, q22)
    good &= depth > 0
    np.divide(1.0, depth, out=depth, where=good)
    x, y = _linear(nx, ny, q00, q01, q02), _linear(nx, ny, q10, q11, q12)
    x *= depth
    y *= depth
    depth *= rig.focal_length
    by = []
    for ratio, (one, other) in ((x, (q00, q01)), (y, (q10, q11))):
        first, second = ratio * -q20, ratio * -q21
        first += one
        second += other
        first *= depth
        second *= depth
        for k in range(2):
            made = first * inner[k]
            made += second * inner[2 + k]
            by.append(made)
    x *= rig.focal_length
    y *= rig.focal_length
    sight = Sight((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, nx, ny, (by[0], by[1], by[2], by[3]))
    return x, y, sight, good


def _linear(x: Array, y: Array, a: float, b: float, c: float) -> Array:
    made = x * a
    made += y * b
    made += c
    return made


def _covariances(sight: Sight, sigma: Array) -> Array:
    """Covariances (M, N, 2, 2) on the laser-parallel image plane, mm^2, of pixels with sigmas (M, N)."""
    xu, xv, yu, yv = sight.by_pixel
    made = np.empty((3, *sigma.shape))
    # What is too large for a number is no noise, and says so by its row's status.
    part = np.empty(sigma.shape)
    for to, one, other in ((made[0], (xu, xv), (xu, xv)), (made[1], (xu, xv), (yu, yv)), (made[2], (yu, yv), (yu, yv))):
        np.multiply(one[0], other[0], out=to)
        np.multiply(one[1], other[1], out=part)
        to += part
    with np.errstate(over="ignore"):
        np.multiply(sigma, sigma, out=part)
        made *= part
    # Element (i, j) is part i + j: each is there once.
    step, *others = made.strides
    view = as_strided(made, (2, 2, *sigma.shape), (step, step, *others), writeable=False)
    return view.transpose(2, 3, 0, 1)


def _looked_at(piece: Piece, given: Sets, sight: Sight, derivatives: RigDerivatives) -> tuple[RigEffect, Array]:
    """The rig's effect, and the curvatures (M,), at solutions; NaN where these have no covariance."""
    solution, setup, images = piece.solution, given.setup, derivatives.images
    known: Bools = np.all(np.isfinite(solution.covariance), axis=(1, 2))
    planes = np.where(known[:, None], solution.planes, [setup.f * setup.r, 0.0, 0.0])
    cloud, scale = piece.cloud, np.ones(len(planes))
    if cloud is None or piece.found is None:
        n = given.points.shape[1]
        used = None if np.all(given.counts == n) else np.arange(n) < given.counts[:, None]
        cloud = Cloud.of(given.points, given.noise, np.where(known, solution.scale, 1.0), used)
        seen = Seen.of(planes, images, cloud, cloud.monomials())
    else:
        scale[known] = solution.scale[known] / piece.factor[known]
        seen = Seen(piece.found.by_plane, piece.found.tangents, piece.found.quadratic)
    others = np.flatnonzero(known & ~piece.regular)
    if len(others):
        part = cloud.take(others)
        feet = _feet(planes[others], part, given.take(others).filled())
        seen.put(others, Seen.of(planes[others], images, part, feet))
    square = np.flatnonzero(known & piece.regular)
    effect = derivatives.effect(planes, cloud.origin, seen, sight, scale, square, others)
    harmless = np.where(known[:, None, None], solution.covariance, 1e-12 * np.eye(3))
    bent = curvatures_seen(setup, images, planes, harmless, cloud.origin, seen.tangents, seen.by_plane, seen.quadratic)
    return effect, np.where(known & within_bounds(planes, setup), bent / scale, np.nan)


def _feet(planes: Array, cloud: Cloud, given: Sets) -> Array:
    """Monomials (6, M, N) of the feet, wherever the points are; of padding, the points'."""
    boundary = Boundary.of(given.points, given.noise)
    found = at_planes(planes, boundary, given.setup)[1]
    n, unit = given.points.shape[1], boundary.unit[:, None]
    made = cloud.monomials()
    made[3, :, :n] -= found.dx * unit
    made[4, :, :n] -= found.dy * unit
    complete(made)
    return made


def _arcs(planes: Array, x: Array, y: Array, counts: NDArray[np.int64], images: Images) -> Array:
    """Fractions (M,) of the planes' ellipses that the points cover, of rows filled up with their own."""
    arcs = np.full(len(planes), np.nan)
    rows = np.flatnonzero(np.all(np.isfinite(planes), axis=1))
    conics = conics_at(images.coordinates(planes[rows], np.zeros((len(rows), 2)))[0])
    B = conics[:, 1:] / conics[:, :1]
    # A plane found in points that are no spot's may have an ellipse that rounding opens.
    closed = np.flatnonzero(is_ellipse(B))
    kept = rows[closed]
    if len(kept):
        arcs[kept] = arc_fraction(B[closed], np.moveaxis(np.stack([x[kept], y[kept]]), 0, -1), counts[kept])
    return arcs
