"""Several frames of one plane, camera and plane still: one plane, whose uncertainty keeps what the frames share.

Frame i measures ``y_i = x + e_i + A_i deta``: the plane ``(z_L, p, q)``, the error of its own spot with covariance
``S_i``, and the error of the rig, which is the same in every frame. The covariances are ``cov(y_i, y_j) = delta_ij S_i
+ A_i Sigma A_j'``. Where the frames share ``A``, generalised least squares weights them by ``S_i^-1`` alone, and the
covariance is ``(sum S_i^-1)^-1 + A Sigma A'``: the spot's part shrinks, the rig's does not.

The ``A_i`` differ by the noise of the points at which they are evaluated, and that noise is in ``y_i`` too. Weights
that take such differences for information "calibrate" the rig from them: for 200 frames whose rig part is 13 to 44
times the spot's, the squared error over its covariance was 4 times what it should be. So the weights are the spots',
and whatever the ``A_i`` differ by is in the covariances only.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.estimation.evidence import split
from planeopt.estimation.second_order import bend
from planeopt.estimation.weighted_squares import weighted_chi2_sf
from planeopt.plane import Plane, SpotPose
from planeopt.rig import Rig
from planeopt.solution import Solution
from planeopt.uncertainty import Sigmas, Uncertainty, sigmas

Array = NDArray[np.float64]

LEVEL = 1e-3
"""How often frames that do agree are said to scatter, and how often one or more of them is called an outlier."""

_TAIL = 9 / np.sqrt(3)
"""Second order of a rig three standard deviations off, over its root mean square: no outlier is made of that."""


class Agreement(Enum):
    """How the frames stand to each other; the value is the sentence a user reads."""

    ALONE = "One frame has nothing to be compared with."
    AGREE = "The frames agree."
    SCATTER = (
        "The frames scatter by more than their spots' covariances say: the plane or the camera moved, or sigma_px is "
        "too small; sigma is too short."
    )
    ALIKE = (
        "The frames scatter by less than their spots' covariances say: errors that they have in common, as still "
        "speckle and texture, do not average out, or sigma_px is too large; the spot's part of one frame is safe."
    )


@dataclass(frozen=True, eq=False)
class Combined:
    """One plane from several frames.

    Attributes
    ----------
    agreement : Agreement
    message : str
        What was combined and whether it agrees, with the numbers.
    pose : SpotPose
    plane : Plane
        In the camera frame.
    uncertainty : Uncertainty
        As a solution's: the spots' part has shrunk, the rig's has not.
    radius : float
        Of the beam, mm.
    chi2, dof, p_value : float, int, float
        Scatter of the frames about the plane given the spots' covariances: chi-squared with 3 (n - 1) degrees of
        freedom where the rig moves all frames alike; the p-value allows for what it moves them differently. The
        p-value is None, and the others zero, for one frame.
    used : tuple of int
        Which of the given frames the plane is made of, counted from 0.
    left_out : tuple of (int, str)
        Which gave nothing to combine, and why.
    outliers : tuple of int
        Frames that the others contradict, worst first. They are in the plane unless they were to be left out.
    """

    agreement: Agreement
    message: str
    pose: SpotPose
    plane: Plane
    uncertainty: Uncertainty
    radius: float
    chi2: float
    dof: int
    p_value: float | None
    used: tuple[int, ...]
    left_out: tuple[tuple[int, str], ...]
    outliers: tuple[int, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing contradicts the frames being of one plane, and the covariance being right."""
        return self.agreement in (Agreement.ALONE, Agreement.AGREE) and not set(self.outliers).intersection(self.used)

    @property
    def n_frames(self) -> int:
        return len(self.used)

    @property
    def covariance(self) -> Array:
        """Of ``(z_L, p, q)``, (3, 3), spots and rig together."""
        return self.uncertainty.spot + self.uncertainty.rig

    @property
    def sigma(self) -> Sigmas:
        """Standard deviations, spots and rig together."""
        u = self.uncertainty
        return sigmas(self.pose, self.covariance, u.normal_spot + u.normal_rig, self.radius, u.radius)

    @property
    def sigma_spot(self) -> Sigmas:
        """Standard deviations without the rig's part."""
        return sigmas(self.pose, self.uncertainty.spot, self.uncertainty.normal_spot, self.radius)


def combine(solutions: Iterable[Solution], rig: Rig, *, without_outliers: bool = False) -> Combined:
    """Combine frames of one plane, taken with camera and plane still.

    Parameters
    ----------
    solutions : iterable of Solution
        Solved with this rig; a `BatchSolution` will do. Refused frames, and those without a covariance, are left out,
        and named.
    rig : Rig
        Whose covariance, if it has one, is the error that all frames share.
    without_outliers : bool
        Leave the outliers out of the plane; otherwise they are only named. An outlier is a frame whose squared
        distance from the combination of the others, over its covariance, is beyond the quantile of chi-squared with 3
        degrees of freedom that one is beyond with probability ``LEVEL / n``; the worst is taken away first, then the
        others are looked at again, as long as a majority is left. Two frames have none. What a rig three standard
        deviations off does to second order (`planeopt.estimation.second_order`), to frames that it moves differently,
        makes none.

    Returns
    -------
    Combined

    Raises
    ------
    InputError
        If no frame has a plane with a covariance, or a frame was solved with a rig of other free parameters.
    """
    frames, left_out = _frames(solutions, rig)
    sigma = rig.covariance_matrix
    found = _outliers(frames, sigma)
    outliers = tuple(int(frames.index[row]) for row in found)
    if without_outliers and outliers:
        frames = frames.take(np.setdiff1d(np.arange(len(frames.index)), found))
    mean, spot, by_rig = _weighted(frames)
    chi2, dof, p_value = _scatter(frames, mean, by_rig, sigma)
    pose, plane, uncertainty = _carried(mean, spot, by_rig, rig)
    agreement = _agreement(p_value)
    combined = Combined(
        agreement,
        "",
        pose,
        plane,
        uncertainty,
        rig.require_beam().radius,
        chi2,
        dof,
        p_value,
        tuple(frames.index.tolist()),
        tuple(left_out),
        outliers,
    )
    return replace(combined, message=_message(combined))


@dataclass(frozen=True, eq=False)
class _Frames:
    """Frames that have a plane: which they are, ``y`` (n, 3), ``S`` (n, 3, 3) and ``A`` (n, 3, k).

    ``bend`` (n,) is what the rig's covariance does to each to second order, in standard deviations of its spot.
    """

    index: NDArray[np.integer]
    plane: Array
    spot: Array
    by_rig: Array
    bend: Array

    def take(self, rows: NDArray[np.integer]) -> "_Frames":
        return _Frames(self.index[rows], self.plane[rows], self.spot[rows], self.by_rig[rows], self.bend[rows])


def _frames(solutions: Iterable[Solution], rig: Rig) -> tuple[_Frames, list[tuple[int, str]]]:
    n_free = 0 if rig.covariance is None else len(rig.covariance.parameters)
    rows, left_out = [], []
    for index, solution in enumerate(solutions):
        if solution.pose is None or solution.status.record == "refused":
            left_out.append((index, solution.message))
        elif solution.uncertainty is None:
            left_out.append((index, f"without a covariance: {solution.message}"))
        else:
            u = solution.uncertainty
            by_rig = np.zeros((3, 0)) if u.plane_by_rig is None else u.plane_by_rig
            if by_rig.shape[1] != n_free:
                raise InputError(
                    f"frame {index} (counted from 0) was solved with a rig of {by_rig.shape[1]} free parameters, and "
                    f"this rig has {n_free}: give the rig that the frames were solved with"
                )
            bends = _bend(solution, u.spot, by_rig, rig)
            rows.append((index, (solution.pose.z_L, *solution.pose.slopes), u.spot, by_rig, bends))
    if not rows:
        why = f": the first is {left_out[0][1]!r}" if left_out else ""
        raise InputError(f"none of the {len(left_out)} frames has a plane to combine{why}")
    index, plane, spot, by_rig, bends = zip(*rows, strict=True)
    frames = _Frames(np.array(index), np.array(plane), np.array(spot), np.array(by_rig), np.array(bends))
    return frames, left_out


def _bend(solution: Solution, spot: Array, by_rig: Array, rig: Rig) -> float:
    if rig.covariance is None or solution.rig_test is None:
        return 0.0
    sigma, test = rig.covariance.matrix, solution.rig_test
    plane = np.trace(np.linalg.solve(spot, by_rig @ sigma @ by_rig.T))
    misfit = np.trace(test.by_rig @ sigma @ test.by_rig.T)
    return float(bend(plane + misfit, test.fineness))


def _weighted(frames: _Frames) -> tuple[Array, Array, Array]:
    """Mean (3,) weighted by the spots' information, its covariance from the spots (3, 3), its ``A`` (3, k)."""
    information = np.linalg.inv(frames.spot)
    spot = np.linalg.inv(information.sum(axis=0))
    mean = spot @ np.einsum("nij,nj->i", information, frames.plane)
    return mean, (spot + spot.T) / 2, spot @ np.einsum("nij,njk->ik", information, frames.by_rig)


def _scatter(frames: _Frames, mean: Array, by_rig: Array, sigma: Array) -> tuple[float, int, float | None]:
    """Chi-squared of the frames' scatter, its degrees of freedom, its p-value.

    What the rig moves differently in the frames, ``D_i = A_i - A``, adds to the statistic's law: one of its squares
    gets the factor ``1 + lambda`` for each eigenvalue ``lambda`` of ``(sum D_i' S_i^-1 D_i) Sigma``.
    """
    n = len(frames.index)
    if n == 1:
        return 0.0, 0, None
    information = np.linalg.inv(frames.spot)
    deviation, differently = frames.plane - mean, frames.by_rig - by_rig
    chi2 = float(np.einsum("ni,nij,nj->", deviation, information, deviation))
    dof = 3 * (n - 1)
    if not sigma.size:
        return chi2, dof, float(scipy.stats.chi2.sf(chi2, dof))
    root = np.linalg.cholesky(sigma)
    added = np.linalg.eigvalsh(root.T @ np.einsum("nik,nij,njl->kl", differently, information, differently) @ root)
    # No more squares than the scatter has can be stretched.
    weights = 1 + np.maximum(added[-dof:], 0.0)
    return chi2, dof, weighted_chi2_sf(chi2, np.concatenate([weights, np.ones(dof - len(weights))]))


def _outliers(frames: _Frames, sigma: Array) -> NDArray[np.integer]:
    """Rows that the others contradict, worst first: see `combine`."""
    n = len(frames.index)
    found: list[int] = []
    kept = np.arange(n)
    while len(kept) > 2 and len(found) < (n - 1) // 2:
        distance = _from_the_others(frames.take(kept), sigma)
        worst = int(np.argmax(distance))
        if scipy.stats.chi2.sf(distance[worst], 3) >= LEVEL / n:
            break
        found.append(int(kept[worst]))
        kept = np.delete(kept, worst)
    return np.array(found, dtype=int)


def _from_the_others(frames: _Frames, sigma: Array) -> Array:
    """Squared distance (n,) of each frame from the combination of all others, over its covariance."""
    information = np.linalg.inv(frames.spot)
    weighted = np.einsum("nij,nj->ni", information, frames.plane)
    by_rig = np.einsum("nij,njk->nik", information, frames.by_rig)
    spot = np.linalg.inv(information.sum(axis=0) - information)
    step = frames.plane - np.einsum("nij,nj->ni", spot, weighted.sum(axis=0) - weighted)
    differently = frames.by_rig - np.einsum("nij,njk->nik", spot, by_rig.sum(axis=0) - by_rig)
    apart = np.einsum("nik,kl,njl->nij", differently, sigma, differently)
    moved = np.einsum("nik,kl,njl->nij", frames.by_rig, sigma, frames.by_rig)
    share = np.trace(information @ apart, axis1=1, axis2=2) / np.maximum(
        np.trace(information @ moved, axis1=1, axis2=2), np.finfo(float).tiny
    )
    # Frames that the rig moves alike to first order it moves alike to second order too.
    bent = ((_TAIL * frames.bend) ** 2 * np.minimum(share, 1.0))[:, None, None] * frames.spot
    covariance = frames.spot + spot + apart + bent
    return np.einsum("ni,ni->n", step, np.linalg.solve(covariance, step[..., None])[..., 0])


def _carried(mean: Array, spot: Array, by_rig: Array, rig: Rig) -> tuple[SpotPose, Plane, Uncertainty]:
    """Pose, plane in the camera frame and the split covariances of a plane ``(z_L along the beam, p, q)``."""
    z_L, p, q = mean.tolist()
    pose = SpotPose.from_slopes(z_L, p, q, rig.require_beam().radius)
    return pose, rig.plane_from_pose(pose), split(rig, mean, spot, by_rig)


def _agreement(p_value: float | None) -> Agreement:
    if p_value is None:
        return Agreement.ALONE
    if p_value < LEVEL / 2:
        return Agreement.SCATTER
    return Agreement.ALIKE if p_value > 1 - LEVEL / 2 else Agreement.AGREE


def _message(combined: Combined) -> str:
    words = [f"{_count(combined.n_frames, 'frame')} of one plane."]
    words.append(
        combined.agreement.value if combined.p_value is None else f"{combined.agreement.value} {_numbers(combined)}"
    )
    if combined.outliers:
        names = ", ".join(str(index + 1) for index in combined.outliers)
        what = "in the plane all the same" if combined.outliers[0] in combined.used else "left out"
        words.append(f"Contradicted by the others, and {what}: frame {names} (counted from 1).")
    if combined.left_out:
        words.append(f"Nothing to combine in {_count(len(combined.left_out), 'more frame')}.")
    rig = float(np.sqrt(combined.uncertainty.rig[0, 0]))
    spot = combined.sigma_spot.z_L
    if rig:
        words.append(
            f"Of the sigma of z_L the spots' part is {spot:.2g} mm; the rig's, {rig:.2g} mm, is common to all."
        )
    else:
        words.append(f"Sigma of z_L is {spot:.2g} mm, without the rig's part: its file has no covariance.")
    return " ".join(words)


def _numbers(combined: Combined) -> str:
    return f"(chi-squared {combined.chi2:.4g} with {combined.dof} degrees of freedom, p = {combined.p_value:.2g})"


def _count(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"
