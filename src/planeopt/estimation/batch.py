"""Many spots, one rig: the maximum-likelihood planes in arrays, and a status for each spot."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.conic import fit_conic
from planeopt.errors import InputError
from planeopt.estimation import evidence
from planeopt.estimation.batch_pieces import Solved, solve_spots
from planeopt.estimation.efficiency import Reach, minor_axes
from planeopt.estimation.judged import STATUSES, PointsSolution, improbability
from planeopt.estimation.reservations import reservations, slope_sigmas
from planeopt.estimation.rig_effect import RigEffect
from planeopt.estimation.second_order import fineness, misfit_covariance
from planeopt.estimation.sets import check_robust
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig
from planeopt.solution import Flag, RigTest, Solution, Status
from planeopt.spot import Spot
from planeopt.uncertainty import Uncertainty

Array = NDArray[np.float64]

FORMULATION = "Reprojection"
SOLVER = "Batch"

_UNUSABLE, _CONVERGED, _INCONSISTENT = (
    STATUSES.index(status) for status in (Status.UNUSABLE, Status.CONVERGED, Status.INCONSISTENT)
)


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


def solve_batch(spots: Iterable[Spot], rig: Rig, *, robust: float | None = None) -> BatchSolution:
    """Find the planes that many spots lie on, by maximum likelihood.

    The planes of `planeopt.solve` with `planeopt.Reprojection` to a thousandth of a standard deviation, wherever both
    find the least sum of squares, but all at once; a spot that cannot be solved costs itself and no other.

    Parameters
    ----------
    spots : iterable of Spot
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
        If the rig has no beam, or `robust` is not positive and finite.
    """
    check_robust(robust)
    spots, beam = list(spots), rig.require_beam()
    setup = eq.Setup(rig.focal_length, *rig.laser_offset, beam.radius)
    solved = solve_spots(spots, rig, setup, robust)
    found, effect = solved.points, solved.effect
    sigma = rig.covariance_matrix
    rig_covariance = effect.plane_by_rig @ sigma @ np.swapaxes(effect.plane_by_rig, 1, 2)
    reached = _reach(solved, setup)
    ratio = reached.sigma_over_axis
    fine = fineness(np.where(np.isfinite(ratio), ratio, 0.0), found.counts)
    chi2, p_value = _test(found, effect, sigma, fine, robust)
    codes = _tested(found.codes, p_value)
    along = found.planes - [rig.axial_shift, 0.0, 0.0]
    normal, point = rig.plane_arrays(*along.T)
    chi2_points = np.where((found.scale_dof < 0) & (robust is None), found.cost, np.nan)
    dof_points = np.maximum(found.counts - 3, 0)
    raised = reservations(along, found.covariance + rig_covariance, reached.excess, solved.arc, chi2_points, dof_points)
    return BatchSolution(
        status=tuple(STATUSES[code] for code in codes.tolist()),
        message=_messages(codes, spots, rig, chi2, p_value),
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
        arc_fraction=solved.arc,
        scale=found.scale,
        flags=_flags(spots, found, rig, raised),
        rig=rig,
    )


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


def _tested(codes: NDArray[np.int64], p_value: Array) -> NDArray[np.int64]:
    """Statuses as the points alone have them, but for the rig's part in the test of the rig."""
    good = np.where(p_value >= evidence.IMPROBABLE, _CONVERGED, _INCONSISTENT)
    return np.where(np.isin(codes, (_CONVERGED, _INCONSISTENT)), good, codes)


def _messages(
    codes: NDArray[np.int64], spots: Sequence[Spot], rig: Rig, chi2: Array, p_value: Array
) -> tuple[str, ...]:
    sentences = [status.value for status in STATUSES]
    made = [sentences[code] for code in codes.tolist()]
    for i in np.flatnonzero(codes == _INCONSISTENT).tolist():
        made[i] += f" (chi-squared {chi2[i]:.4g} with {evidence.DOF} degrees of freedom, p = {p_value[i]:.1e})"
    for i in np.flatnonzero(codes == _UNUSABLE).tolist():
        made[i] = f"{made[i]} {_refusal(spots[i], rig)}".rstrip()
    return tuple(made)


def _refusal(spot: Spot, rig: Rig) -> str:
    try:
        mm, jacobian = rig.to_laser_plane(spot.points)
        sigma = np.ones(len(spot)) if spot.sigma is None else spot.sigma
        with np.errstate(over="ignore"):  # which is what may be wrong
            noise = jacobian @ np.swapaxes(jacobian, 1, 2) * (sigma**2)[:, None, None]
        fit_conic(mm, noise)
    except InputError as reason:
        return str(reason)
    return ""


def _flags(
    spots: Sequence[Spot], found: PointsSolution, rig: Rig, raised: list[tuple[Flag, ...]]
) -> tuple[tuple[Enum, ...], ...]:
    """The spots' own, those of the noise's scale and of the rig, and those of the planes; alike tuples are one."""
    used = found.codes != _UNUSABLE
    of_rig = [rig.covariance is None, rig.refused is not None]
    estimated, floored = used & (found.scale_dof >= 0), used & found.floored
    made: dict[tuple[int, ...], tuple[Enum, ...]] = {}
    flags = []
    for spot, *marks, others in zip(spots, used.tolist(), estimated.tolist(), floored.tolist(), raised, strict=True):
        # What is alike is one object: its identity is hashed faster than its flags.
        key = (*marks, id(others))
        if key not in made:
            told = zip(_OF_USED, (marks[1], marks[2], *(marks[0] and mark for mark in of_rig)), strict=True)
            made[key] = (*(flag for flag, raise_it in told if raise_it), *others)
        flags.append((*spot.flags, *made[key]) if spot.flags else made[key])
    return tuple(flags)


_OF_USED = (Flag.SCALE_ESTIMATED, Flag.SCALE_AT_FLOOR, Flag.RIG_WITHOUT_COVARIANCE, Flag.RIG_REFUSED)


def _reach(solved: Solved, setup: eq.Setup) -> Reach:
    """Where the bound can be reached; NaN where a spot has no covariance."""
    found = solved.points
    known = np.flatnonzero(~np.isnan(solved.curvature))
    made = Reach(*np.full((3, len(found)), np.nan))
    made.curvature[known] = solved.curvature[known]
    made.sigma_over_axis[known] = solved.sigma[known] * found.scale[known] / minor_axes(setup, found.planes[known])
    made.slope_sigma[known] = slope_sigmas(found.covariance[known])
    return made
