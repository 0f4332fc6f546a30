"""Many spots, one rig: the maximum-likelihood planes in arrays, and a status for each spot."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.conic import arc_fraction, fit_conic, is_ellipse
from planeopt.errors import InputError
from planeopt.estimation import evidence
from planeopt.estimation.efficiency import reach
from planeopt.estimation.feet import Boundary
from planeopt.estimation.points import STATUSES, PointsSolution, improbability, solve_points
from planeopt.estimation.reservations import reservations
from planeopt.estimation.rig_effect import RigEffect, rig_effect
from planeopt.estimation.second_order import fineness, misfit_covariance, typical_sigma
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig
from planeopt.solution import Flag, RigTest, Solution, Status
from planeopt.spot import Spot
from planeopt.uncertainty import Uncertainty

Array = NDArray[np.float64]

FORMULATION = "Reprojection"
SOLVER = "Batch"

_REACH_POINTS = 1 << 12

_UNUSABLE = STATUSES.index(Status.UNUSABLE)


@dataclass(frozen=True, eq=False)
class BatchSolution:
    """Maximum-likelihood planes, a row a spot. Numbers are NaN where there are none; `status` says why.

    Attributes
    ----------
    status : tuple of Status
    message : tuple of str
        The statuses' sentences, with the numbers of each case.
    planes : (M, 3)
        ``(z_L, p, q)``: distance along the beam from ``(e_x, e_y, 0)``, mm, and slopes in the laser-parallel frame.
    spot_covariance, rig_covariance : (M, 3, 3)
        Of the planes, from the points' noise and from the rig's covariance (zero where it has none).
    plane_by_rig : (M, 3, n)
        Derivatives of the planes by the free parameters of the rig's covariance.
    normal, point : (M, 3)
        Of the planes in the camera frame.
    chi2, p_value : (M,)
        With 2 degrees of freedom: tests the rig and the points, not the plane (`planeopt.solution.Solution`).
    misfit : (M, 2), misfit_by_rig : (M, 2, n), misfit_by_beam : (M, 2, 4), fineness : (M,)
        What chi2 is made of (`planeopt.solution.RigTest`).
    chi2_points : (M,)
        Of the points' distances, where their noise was given; not where robust.
    dof_points, n_points : (M,) of int
    arc_fraction : (M,)
    scale : (M,)
        What sigma was multiplied by; the sigma of the points in px where the spot gave none.
    flags : tuple of tuples of Enum
        Reservations, the spots' own first.
    rig : Rig
    """

    status: tuple[Status, ...]
    message: tuple[str, ...]
    planes: Array
    spot_covariance: Array
    rig_covariance: Array
    plane_by_rig: Array
    normal: Array
    point: Array
    chi2: Array
    p_value: Array
    misfit: Array
    misfit_by_rig: Array
    misfit_by_beam: Array
    fineness: Array
    chi2_points: Array
    dof_points: NDArray[np.int64]
    n_points: NDArray[np.int64]
    arc_fraction: Array
    scale: Array
    flags: tuple[tuple[Enum, ...], ...]
    rig: Rig

    def __len__(self) -> int:
        return len(self.status)

    def __iter__(self) -> Iterator[Solution]:
        return map(self.row, range(len(self)))

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Where the plane was found and image and rig agree, (M,)."""
        return np.array([status is Status.CONVERGED for status in self.status], dtype=bool)

    @property
    def covariance(self) -> Array:
        """Of the planes, (M, 3, 3), spot and rig together."""
        return self.spot_covariance + self.rig_covariance

    def row(self, i: int) -> Solution:
        """One spot's answer, as `planeopt.solve` gives it but for the ten residuals and the search's own evidence."""
        radius = self.rig.require_beam().radius
        blank = Solution(self.status[i], self.message[i], FORMULATION, SOLVER, radius=radius)
        arc = None if np.isnan(self.arc_fraction[i]) else float(self.arc_fraction[i])
        counted = {"n_points": int(self.n_points[i]), "arc_fraction": arc, "flags": self.flags[i]}
        if self.status[i].record == "refused":
            return replace(blank, **counted)
        z_L, p, q = (float(value) for value in self.planes[i])
        known = bool(np.isfinite(self.spot_covariance[i]).all())
        tested = bool(np.isfinite(self.chi2[i]))
        scattered = bool(np.isfinite(self.chi2_points[i]))
        return replace(
            blank,
            **counted,
            pose=SpotPose.from_slopes(z_L, p, q, radius),
            plane=Plane(self.normal[i], self.point[i]),
            uncertainty=self._uncertainty(i) if known else None,
            uncertainty_reason=None if known else self.message[i],
            chi2=float(self.chi2[i]) if tested else None,
            p_value=float(self.p_value[i]) if tested else None,
            chi2_points=float(self.chi2_points[i]) if scattered else None,
            dof_points=int(self.dof_points[i]) if scattered else None,
            rig_test=self._rig_test(i) if tested else None,
        )

    def _rig_test(self, i: int) -> RigTest:
        return RigTest(self.misfit[i], self.misfit_by_rig[i], self.misfit_by_beam[i], float(self.fineness[i]))

    def _uncertainty(self, i: int) -> Uncertainty:
        return evidence.split(self.rig, self.planes[i], self.spot_covariance[i], self.plane_by_rig[i])


def solve_batch(spots: Sequence[Spot], rig: Rig, *, robust: float | None = None) -> BatchSolution:
    """Find the planes that many spots lie on, by maximum likelihood.

    The same planes as `planeopt.solve` with `planeopt.Reprojection` to a thousandth of a standard deviation, but all
    at once; a spot that cannot be solved costs itself and no other.

    Parameters
    ----------
    spots : sequence of Spot
        Boundary points in raw pixels, from `find_spot` or `read_points`, with sigma or without, of any lengths.
    rig : Rig
        With a beam.
    robust : float, optional
        Degrees of freedom of Student's t, for points with gross errors among them; sigma is then its scale. Without it
        noise is normal.

    Returns
    -------
    BatchSolution

    Raises
    ------
    InputError
        If the rig has no beam, or `robust` is not positive.
    """
    beam = rig.require_beam()
    setup = eq.Setup(rig.focal_length, *rig.laser_offset, beam.radius)
    points = _on_laser_plane(spots, rig)
    known = np.array([spot.sigma is not None for spot in spots], dtype=bool)
    found = solve_points(points.mm, points.noise, setup, counts=points.counts, robust=robust, scale_known=known)
    effect = _effect(found, points, rig, setup)
    sigma = rig.covariance_matrix
    rig_covariance = effect.plane_by_rig @ sigma @ np.swapaxes(effect.plane_by_rig, 1, 2)
    ratio, excess = _reach(found, points, setup)
    fine = fineness(np.where(np.isfinite(ratio), ratio, 0.0), found.counts)
    chi2, p_value = _test(found, effect, sigma, fine, robust)
    status = _statuses(found, p_value)
    along = found.planes - [rig.axial_shift, 0.0, 0.0]
    normal, point = rig.plane_arrays(*along.T)
    arc = _arcs(found, points, setup)
    chi2_points = np.where((found.scale_dof < 0) & (robust is None), found.cost, np.nan)
    dof_points = np.maximum(found.counts - 3, 0)
    raised = reservations(along, found.covariance + rig_covariance, excess, arc, chi2_points, dof_points)
    return BatchSolution(
        status=status,
        message=tuple(_message(i, status[i], points, chi2[i], p_value[i]) for i in range(len(status))),
        planes=along,
        spot_covariance=found.covariance,
        rig_covariance=rig_covariance,
        plane_by_rig=effect.plane_by_rig,
        normal=normal,
        point=point,
        chi2=chi2,
        p_value=p_value,
        misfit=effect.misfit,
        misfit_by_rig=effect.misfit_by_rig,
        misfit_by_beam=effect.misfit_by_beam,
        fineness=fine,
        chi2_points=chi2_points,
        dof_points=dof_points,
        n_points=found.counts,
        arc_fraction=arc,
        scale=found.scale,
        flags=tuple(
            (*spot.flags, *_of_scale(found, i, rig), *flags)
            for i, (spot, flags) in enumerate(zip(spots, raised, strict=True))
        ),
        rig=rig,
    )


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of all spots on the laser-parallel image plane, rows filled up with their own; none of unusable spots."""

    mm: Array
    noise: Array
    rays: Array
    counts: NDArray[np.int64]
    refusals: dict[int, str]


def _on_laser_plane(spots: Sequence[Spot], rig: Rig) -> _Points:
    """All points in one call; only where some pixel has no ray are the spots looked at one by one."""
    refusals = _without_rays(spots, rig)
    used = [i for i in range(len(spots)) if i not in refusals]
    lengths = np.array([len(spot) if i not in refusals else 0 for i, spot in enumerate(spots)], dtype=np.int64)
    longest = int(np.max(lengths, initial=0))
    mm, rays = np.zeros((len(spots), longest, 2)), np.zeros((len(spots), longest, 2))
    noise = np.zeros((len(spots), longest, 2, 2))
    if used:
        pixels = np.concatenate([spots[i].points for i in used])
        sigma = np.concatenate([_sigma(spots[i]) for i in used])
        there = np.arange(longest) < lengths[:, None]
        mm[there], jacobian = rig.to_laser_plane(pixels)
        noise[there] = jacobian @ np.swapaxes(jacobian, 1, 2) * (sigma**2)[:, None, None]
        rays[there] = rig.camera.normalise(pixels)[0]
        again = np.arange(longest) % np.maximum(lengths, 1)[:, None]
        row = np.arange(len(spots))[:, None]
        mm, noise = mm[row, again], noise[row, again]
    return _Points(mm, noise, rays, lengths, refusals)


def _sigma(spot: Spot) -> Array:
    return np.ones(len(spot)) if spot.sigma is None else spot.sigma


def _without_rays(spots: Sequence[Spot], rig: Rig) -> dict[int, str]:
    """Spots with a pixel that no ray of this camera reaches, and why."""
    try:
        if spots:
            rig.to_laser_plane(np.concatenate([spot.points for spot in spots]))
    except InputError:
        return {i: reason for i, spot in enumerate(spots) if (reason := _refusal(spot, rig))}
    return {}


def _refusal(spot: Spot, rig: Rig) -> str:
    try:
        rig.to_laser_plane(spot.points)
    except InputError as reason:
        return str(reason)
    return ""


def _effect(found: PointsSolution, points: _Points, rig: Rig, setup: eq.Setup) -> RigEffect:
    """Of the rows that have a plane and a known scale; NaN elsewhere."""
    rows = np.flatnonzero(np.isfinite(found.covariance).all(axis=(1, 2)))
    noise = points.noise[rows] * (found.scale[rows] ** 2)[:, None, None, None]
    some = rig_effect(rig, setup, found.planes[rows], points.mm[rows], noise, points.rays[rows], found.counts[rows])

    def spread(values: Array) -> Array:
        full = np.full((len(found), *values.shape[1:]), np.nan)
        full[rows] = values
        return full

    return RigEffect(*(spread(getattr(some, field.name)) for field in fields(RigEffect)))


def _test(
    found: PointsSolution, effect: RigEffect, sigma: Array, fine: Array, robust: float | None
) -> tuple[Array, Array]:
    """chi-squared with 2 degrees of freedom, the rig's covariance added to the statistic's, and its p-value; (M,)."""
    chi2 = found.chi2.copy()
    rows = np.flatnonzero(np.isfinite(effect.misfit).all(axis=1))
    if robust is None and sigma.size:
        misfit, spread = effect.misfit[rows], misfit_covariance(effect.misfit_by_rig[rows], sigma, fine[rows])
        chi2[rows] = np.sum(misfit * np.linalg.solve(spread, misfit[..., None])[..., 0], axis=-1)
    return chi2, improbability(chi2, found.scale_dof)


def _statuses(found: PointsSolution, p_value: Array) -> tuple[Status, ...]:
    """As the points alone have them, but for the rig's part in the test of the rig."""
    tested = (Status.CONVERGED, Status.INCONSISTENT)
    return tuple(
        status if status not in tested else tested[int(not p >= evidence.IMPROBABLE)]
        for status, p in zip(found.status, p_value, strict=True)
    )


def _message(i: int, status: Status, points: _Points, chi2: float, p_value: float) -> str:
    if status is Status.INCONSISTENT:
        numbers = f"chi-squared {chi2:.4g} with {evidence.DOF} degrees of freedom, p = {p_value:.1e}"
        return f"{status.value} ({numbers})"
    if status is Status.UNUSABLE:
        return f"{status.value} {points.refusals.get(i) or _no_ellipse(points, i)}".rstrip()
    return status.value


def _no_ellipse(points: _Points, i: int) -> str:
    n = points.counts[i]
    try:
        fit_conic(points.mm[i, :n], points.noise[i, :n])
    except InputError as reason:
        return str(reason)
    return ""


def _of_scale(found: PointsSolution, i: int, rig: Rig) -> Iterator[Flag]:
    if found.codes[i] != _UNUSABLE:
        if found.scale_dof[i] >= 0:
            yield Flag.SCALE_ESTIMATED
        if found.floored[i]:
            yield Flag.SCALE_AT_FLOOR
        if rig.covariance is None:
            yield Flag.RIG_WITHOUT_COVARIANCE
        if rig.refused is not None:
            yield Flag.RIG_REFUSED


def _reach(found: PointsSolution, points: _Points, setup: eq.Setup) -> tuple[Array, Array]:
    """`Reach.sigma_over_axis` and `Reach.excess` (M,) of the rows.

    A few at a time, since each is looked at from six planes about its own.
    """
    ratio, excess = np.full(len(found), np.nan), np.full(len(found), np.nan)
    known = np.flatnonzero(np.isfinite(found.covariance).all(axis=(1, 2)))
    longest = points.mm.shape[1]
    if not len(known):
        return ratio, excess
    for rows in np.array_split(known, 1 + len(known) * longest // _REACH_POINTS):
        noise = points.noise[rows] * (found.scale[rows] ** 2)[:, None, None, None]
        boundary = Boundary.of(points.mm[rows], noise, np.arange(longest) < found.counts[rows, None])
        sigma = typical_sigma(noise)
        reached = reach(setup, found.planes[rows], found.covariance[rows], boundary, sigma)
        ratio[rows], excess[rows] = reached.sigma_over_axis, reached.excess
    return ratio, excess


def _arcs(found: PointsSolution, points: _Points, setup: eq.Setup) -> Array:
    """Fractions (M,) of the planes' ellipses that the points cover; spots with as many points go together."""
    arcs = np.full(len(found), np.nan)
    solved = np.isfinite(found.planes).all(axis=1)
    for n in np.unique(found.counts[solved]):
        rows = np.flatnonzero(solved & (found.counts == n))
        z_L, p, q = found.planes[rows].T
        conics = eq.image_conic_in_slopes(np, eq.SlopeVariables(None, z_L, p, q), setup)
        b = np.stack(np.broadcast_arrays(*conics), axis=-1)
        B = b[:, 1:] / b[:, :1]
        # A plane found in points that are no spot's may have an ellipse that rounding opens.
        closed = is_ellipse(B)
        arcs[rows[closed]] = arc_fraction(B[closed], points.mm[rows[closed], :n])
    return arcs
